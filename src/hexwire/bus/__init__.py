"""Bus servos without a board: the pure machine, and `ServoBus`, which runs it over a link."""
