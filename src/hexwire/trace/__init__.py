"""Seeing what happens on the wire: hex dump, decoding, recording."""
