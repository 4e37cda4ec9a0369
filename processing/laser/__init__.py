"""Laser range: from stripes over time or space to displacement and mesostructure."""
