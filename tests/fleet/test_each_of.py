"""Calls for several arms at the same time."""

from __future__ import annotations

import threading

from hexwire.fleet.player import each_of


def test_calls_for_all_do_not_wait_for_the_one_that_hangs() -> None:
    over = threading.Event()

    def call(name: str) -> str:
        if name == "hangs":
            over.wait(30.0)
        if name == "fails":
            raise ValueError("a mistake")
        return name.upper()

    done, failed = each_of({name: name for name in ("a", "hangs", "fails")}, call, 0.2)
    assert done == {"a": "A"}
    assert str(failed["fails"]) == "the program failed: a mistake"
    assert "no answer" in str(failed["hangs"])
    done, failed = each_of({name: name for name in ("hangs", "fails")}, call, 60.0, together=True)
    assert list(failed) == ["fails"]
    over.set()
