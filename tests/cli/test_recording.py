"""What records while a command runs."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from tests.drivers.test_base import Guarded

from hexwire.cli.options import observed_driver
from hexwire.cli.record import capturing
from hexwire.drivers.base import RobotDriver
from hexwire.errors import UsageError
from hexwire.link.memory import memory_pair
from hexwire.link.tap import Direction, tapped
from hexwire.trace.capture import BYTES, FRAMES, CapturedMessage, read_messages
from hexwire.trace.recording import JOINT_STATES


def _read(path: Path) -> list[CapturedMessage]:
    with path.open("rb") as file:
        found = list(read_messages(file, str(path)))
    return [each for each in found if not isinstance(each, str)]


def test_traffic_and_states_are_recorded_at_the_wall_clock(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with capturing(str(path), force=False):
        observed_driver(Guarded)().read()
        host, board = memory_pair()
        with tapped(host) as link, board:
            link.write(b"abc")
    found = {each.topic: each for each in _read(path)}
    assert set(found) == {JOINT_STATES, BYTES[Direction.SENT], FRAMES}
    assert found[BYTES[Direction.SENT]].data == b"abc"
    assert all(abs(each.time - time.time()) < 600 for each in found.values())


def test_the_robot_is_shown_before_its_state_is_recorded(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    seen: list[RobotDriver] = []
    with capturing(str(path), lambda: str(path), observe=seen.append):
        robot = observed_driver(Guarded)()
        robot.read()
    assert seen == [robot]
    assert [each.topic for each in _read(path)] == [JOINT_STATES]


def test_a_recording_that_cannot_start_is_an_error_or_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("mine")
    with pytest.raises(UsageError, match="already exists"), capturing(str(path), force=False):
        pass
    done = []
    with capturing(str(path), force=False, optional=True):
        done.append(True)
    assert done
    assert "already exists" in capsys.readouterr().err
    assert path.read_text() == "mine"


def test_an_error_before_anything_was_recorded_leaves_no_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with pytest.raises(ZeroDivisionError), capturing(str(path), force=False):
        raise ZeroDivisionError
    assert not path.exists()
