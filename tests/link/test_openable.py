"""Open inside `with`, closed behind it, whatever happens."""

from __future__ import annotations

import pytest

from hexwire.link.base import Openable


class Door(Openable):
    def __init__(self) -> None:
        self.said: list[str] = []

    def open(self) -> None:
        self.said.append("open")

    def close(self) -> None:
        self.said.append("close")


def test_it_is_open_inside_and_closed_behind() -> None:
    with Door() as door:
        assert door.said == ["open"]
    assert door.said == ["open", "close"]


def test_it_is_closed_after_an_error_which_is_passed_on() -> None:
    door = Door()
    with pytest.raises(ValueError, match="mine"), door:
        raise ValueError("mine")
    assert door.said == ["open", "close"]
