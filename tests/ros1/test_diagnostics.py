from __future__ import annotations

from hexwire.ros1 import diagnostics


def test_interface() -> None:
    assert diagnostics.__all__ == sorted(diagnostics.__all__)
