"""What a motion is: its goals and checks, the ways to execute it, arrival, and motions that a person guides."""
