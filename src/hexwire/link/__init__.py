"""Byte links, and what belongs to a port: addresses, adapters, who holds it."""
