"""An arm as a person thinks of it: one object whose verbs are those of the command line.

Owns the verbs, what they take and return, and the blocks and handles of what goes on beside the program. Must not
decide how a motion is checked, planned or run: `control` and `motion` do.
"""
