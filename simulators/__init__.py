"""Simulated devices of a capture rig: one world and one clock behind real wires, in a process of its own."""
