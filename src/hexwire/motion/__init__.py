"""Limits and trajectories; pure, but for the loop that keeps time."""
