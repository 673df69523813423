"""Byte links, the channel handle, and the session that joins a link to a connection."""
