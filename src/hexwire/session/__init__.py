"""Sans-I/O machines: decoding, matching, deadlines and retries, with time as an argument."""
