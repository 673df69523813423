"""A gateway: one link up to its hosts, several boards below it."""
