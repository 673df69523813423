"""Joint states for tests, with what a test is about."""

from __future__ import annotations

import math
from typing import Any

from hexwire.model.state import JointState

_MEASURED = ("velocity", "load", "current", "voltage", "temperature")


def make_state(*position: float, **known: Any) -> JointState:
    """A fresh state of the joints J1, J2 and so on at these angles; what is not given of it is unknown."""
    n = len(position)
    usual: dict[str, Any] = dict.fromkeys(_MEASURED, (math.nan,) * n)
    usual |= {"flags": (0,) * n, "age": (0.0,) * n, "stamp": 0.0}
    return JointState(**{"names": tuple(f"J{i + 1}" for i in range(n)), "position": position, **usual, **known})
