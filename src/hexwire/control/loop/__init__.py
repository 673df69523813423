"""What runs while an arm moves: its one owner, the controllers, states in and targets out, threads and waiting."""
