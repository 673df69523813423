from __future__ import annotations

from hexwire.ros1 import states


def test_interface() -> None:
    assert states.__all__ == sorted(states.__all__)
