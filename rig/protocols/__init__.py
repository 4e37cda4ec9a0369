"""Wire protocols as pure bytes: encode, decode, incremental framing. No port, no clock, no retry, no unit."""
