from __future__ import annotations

from collections.abc import Callable
from typing import Any

from zenoh_ros2.keys import Endpoint, gid_of, parse_token
from zenoh_ros2.parts import Part

TOKEN = "@ros2_lv/0/ab/0/1/MP/%/%/node/%chatter/T_/H/::,10:,:,:,,"


class Owner:
    """Records what happens."""

    graph: Any = None
    callbacks: Any = None

    def __init__(self) -> None:
        self.events: list[str] = []

    def show(self, endpoint: Endpoint) -> Callable[[], None]:
        self.events.append("token")
        return lambda: self.events.append("no token")

    def forget(self, part: Part) -> None:
        self.events.append("forgotten")

    def warn(self, text: str) -> None:
        raise AssertionError(text)


class Example(Part):
    def __init__(self, owner: Owner) -> None:
        super().__init__(owner, parse_token(TOKEN))
        owner.events.append("works")
        self._begin(lambda: owner.events.append("ended"))


def test_a_token_appears_once_the_endpoint_works_and_vanishes_before_it_ends() -> None:
    owner = Owner()
    part = Example(owner)
    assert (part.gid, part.qos.depth) == (gid_of(TOKEN), 10)
    part.close()
    assert owner.events == ["works", "token", "no token", "ended", "forgotten"]


def test_it_ends_once() -> None:
    owner = Owner()
    part = Example(owner)
    part.close()
    part.close()
    assert owner.events.count("ended") == owner.events.count("no token") == 1
