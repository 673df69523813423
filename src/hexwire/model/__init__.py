"""The arm as data: joints, states, targets, calibration, geometry."""
