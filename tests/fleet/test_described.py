"""What a client knows of a shared arm from its server's description alone."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from hexwire.drivers.abilities import OwnWatchdog, StateReports, Watchdog
from hexwire.fleet import messages as m
from hexwire.fleet.remote import RemoteRobot

FACTS = m.Facts("own", (), 50.0, 12.0, 0.25, 0.5, "a program", "tcp://robot:1", "", "", 0.0, "lab-pc")


class Client(RemoteRobot):
    """Knows nothing but what a server says."""

    def __init__(self, **facts: Any) -> None:
        super(RemoteRobot, self).__init__()
        self._facts = msgspec.structs.replace(FACTS, **facts)


def test_a_server_watches_and_reports_for_every_robot() -> None:
    robot = Client()
    assert (robot.can(Watchdog), robot.can(StateReports), robot.command_rate) == (True, True, 12.0)


def test_a_server_of_an_older_version_says_nothing_of_a_watchdog_and_none_is_assumed() -> None:
    old = msgspec.convert(list(msgspec.to_builtins(FACTS))[:-2], m.Facts)
    assert (old.host, old.watchdog, old.kept) == ("lab-pc", False, "board")
    assert not Client().can(OwnWatchdog)
    assert Client(watchdog=True).can(OwnWatchdog)


@pytest.mark.parametrize(("kept", "by"), [("board", "board"), ("user", "server"), ("", "server")])
def test_a_stop_that_no_board_keeps_is_kept_by_the_server(kept: str, by: str) -> None:
    assert Client(kept=kept).stop_kept_by == by
