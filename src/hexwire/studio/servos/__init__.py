"""The parts of the page Servos: one file for each thing that is done with a servo."""
