from __future__ import annotations

from typing import Any

import pytest

from hexwire.errors import UsageError
from hexwire.studio.servos import stress


def test_the_count_is_checked_and_live_values_stay_away(view: Any) -> None:
    for count in (None, 0, 1.5, 1e9, -3):
        with pytest.raises(UsageError, match="whole number"):
            stress.tested(view, (1, 2), count)
    with pytest.raises(UsageError, match="search first"):
        stress.tested(view, (), 10)
    test = stress.tested(view, (1, 2), 30)
    assert (test.reads, test.lost) == (30, 0)
    assert view.bus.bench.readable


def test_it_can_be_cancelled(view: Any) -> None:
    plain = view.bus.bus.sync_read
    reads: list[int] = []

    def read(name: str, ids: object) -> object:
        if name == "present_position":
            reads.append(1)
            if len(reads) == 5:
                view.bus.bench.cancel()
        return plain(name, ids)

    view.bus.bus.sync_read = read
    assert stress.tested(view, (1, 2), 1000).reads == 5
