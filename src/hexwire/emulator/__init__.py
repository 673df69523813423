"""Servos, their bus and the controller board, emulated in simulated time."""
