"""A gateway: one link up to a host, several boards below it."""
