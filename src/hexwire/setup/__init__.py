"""Arms made ready: servos identified and set up one by one, calibrated, examined.

Works at servo buses and moves what it must by `control`. Must not know terminal or page.
"""
