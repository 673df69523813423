"""How much the long tests ask: a sample in `make test`, all of it in `make soak`.

A test that says `rounds` carries the mark `soak`, which is what `make soak` runs.
"""

from __future__ import annotations

import os

SOAK = os.environ.get("SOAK") == "1"


def rounds(ordinary: int, soak: int) -> int:
    """How often this run asks: `ordinary` in `make test`, `soak` in `make soak`."""
    return soak if SOAK else ordinary
