"""Arms shared over Eclipse Zenoh: the server of an arm, and the driver for it in other programs."""
