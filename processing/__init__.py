"""From frames to materials: arrays in, arrays out; knows no device, no clock and no window."""
