"""The arm, its servos and its wire in a browser."""
