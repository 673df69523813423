"""State machines without I/O: decoding, matching, deadlines and retries, with time as an argument."""
