"""Bytes to values and back: frames, packets, registers. No state, no time, no I/O."""
