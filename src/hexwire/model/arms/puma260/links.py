"""The links of the PUMA 260, metres.

Owns the lengths. In the zero pose, in inches: 13 z up to the shoulder, then 7.8 x - 4.9 y - 0.75 z to the elbow,
-8 z to the wrist, 2.2 x to the flange (GeneralRoboticsToolbox's model with its first axis put right). Knows no
joint.
"""

from __future__ import annotations

__all__ = ["DROP", "FLANGE", "FOREARM", "SHOULDER", "SIDE", "UPPER"]

_INCH = 0.0254
SHOULDER = 13.0 * _INCH
"""Shoulder axis above the base."""
UPPER = 7.8 * _INCH
SIDE = -4.9 * _INCH
DROP = -0.75 * _INCH
FOREARM = 8.0 * _INCH
FLANGE = 2.2 * _INCH
