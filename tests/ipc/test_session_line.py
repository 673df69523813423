"""The line of a session by itself; with requests it is tested in test_session.py."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

import pytest
from tests.frames import frame_bytes

from hexwire.errors import LinkLostError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link.base import Link
from hexwire.link.memory import memory_pair
from hexwire.testing.link import PATIENCE, soon
from hexwire.wire.command_frame import Command


class Line(Session):
    def __init__(self, link: Link) -> None:
        super().__init__(IpcHandle.from_link(link))
        self.opened = 0

    def _reopen(self, lost: LinkLostError) -> None:
        self.opened += 1
        self.ipc.link.open()


@pytest.fixture
def ends() -> Iterator[tuple[Line, Link]]:
    near, far = memory_pair()
    line = Line(near)
    with far, near:
        yield line, far


def frame(number: int, ext: int) -> bytes:
    return frame_bytes(Command.JOINT_STATE, bytes([number]), seq=number, src=8, dst=7, type=8, cmd_ext=ext)


def test_reports_come_in_order_with_the_time_of_their_arrival(ends: tuple[Line, Link]) -> None:
    line, far = ends
    before = time.monotonic()
    for number in range(3):
        far.write(frame(number, 0x40), soon())
    came = list(itertools.islice(line.reports(PATIENCE), 3))
    assert [report.body for report, _ in came] == [b"\0", b"\1", b"\2"]
    assert all(before <= arrived <= time.monotonic() for _, arrived in came)
    assert list(line.stream(0.0)) == []


def test_the_newest_report_is_taken_without_waiting(ends: tuple[Line, Link]) -> None:
    line, far = ends
    assert line.poll_reports() is None
    for number in range(3):
        far.write(frame(number, 0x40), soon())
    newest = line.poll_reports()
    assert newest is not None
    assert newest.body == b"\2"
    assert line.poll_reports() is None


def test_unexpected_frames_are_kept_apart_and_only_the_last_256(ends: tuple[Line, Link]) -> None:
    line, far = ends
    for number in range(300):
        far.write(frame(number & 0xFF, 0x80), soon())
        found = line.poll_reports()
        assert found is None
    kept = []
    while (stale := line.receive(0.0)) is not None:
        kept.append(stale.seq)
    assert kept == [number & 0xFF for number in range(44, 300)]


def test_a_port_that_is_lost_is_opened_again_while_somebody_listens(ends: tuple[Line, Link]) -> None:
    line, far = ends
    far.close()
    assert line.receive(0.05) is None
    assert line.opened == 1
    far.open()
    far.write(frame(5, 0x40), soon())
    report, _ = next(line.reports(PATIENCE))
    assert report.body == b"\5"


def test_a_stop_over_one_line_is_known_at_the_other(ends: tuple[Line, Link]) -> None:
    line, _ = ends
    other = Line(memory_pair()[0])
    token = other.epochs.token("JOINT_MOVE")
    assert other.epochs.holds(token)
    line.share_stops(other)
    with line.epochs.stopping():
        pass
    assert not other.epochs.holds(token)
