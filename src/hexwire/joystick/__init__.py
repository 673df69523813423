"""Joysticks: the devices of this machine, and the chapter's channel that carries their axes and buttons."""
