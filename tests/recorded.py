"""States for recordings."""

from __future__ import annotations

from collections.abc import Sequence

from hexwire.model.state import JointState


def make_positions(names: Sequence[str], position: Sequence[float]) -> JointState:
    """A state of which only the positions are known, in radians."""
    return JointState.of(dict(zip(names, position, strict=True)), stamp=0.0, torque=False)
