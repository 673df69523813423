from __future__ import annotations

from hexwire.ros1 import teaching


def test_interface() -> None:
    assert teaching.__all__ == sorted(teaching.__all__)
