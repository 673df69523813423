"""Bus servos without a board: the pure machine, and `ServoBus` that runs it over a link."""
