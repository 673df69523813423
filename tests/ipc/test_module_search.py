"""Another robot than the one that was asked for, or none at all, behind an address: known within two seconds."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

import pytest
from tests.emulator.loopback import Loopback
from tests.ipc.test_mistaken import SOON, board_link

from hexwire.drivers.base import RobotDriver
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.puma260 import Puma260Driver
from hexwire.drivers.registry import load_bus_arm
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.puma import EmulatedPuma
from hexwire.emulator.serve import BoardLink, FakeClock, ServedDevice
from hexwire.errors import ReplyTimeoutError, WrongDeviceError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.mistaken import find_robot
from hexwire.ipc.session import Session
from hexwire.link.base import Link
from hexwire.wire.modules import ModuleType

BOOTS = 5.0
"""For so long a board behind a bridge on the network may be booting."""


class Server(Loopback):
    """A program that is no robot's: it says something at once, or after a line, or never."""

    def __init__(self, says: bytes = b"", *, first: bool = False) -> None:
        super().__init__()
        self.says, self.out = says, says if first else b""

    def receive(self, data: bytes, now: float) -> None:
        if b"\n" in data:
            self.out, self.says = self.out + self.says, b""


DEVICES: dict[str, Callable[[float], ServedDevice]] = {
    "puma260": lambda start: EmulatedPuma(start=start).connect(),
    "board": lambda start: make_hex7bot_board(start=start),
    "chapter": lambda start: make_hex7bot_board(dialect=1, start=start),
    "servos": lambda start: BusDevice(make_bus_arm("so101", start=start).servos),
    "web": lambda start: Server(b"HTTP/1.1 400 Bad Request\r\nServer: x\r\n\r\n"),
    "page": lambda start: Server(b'<!DOCTYPE HTML>\n<html lang="en">'),
    "ssh": lambda start: Server(b"SSH-2.0-OpenSSH_9.6\r\n", first=True),
    "silent": lambda start: Server(),
    "noisy": lambda start: Server(b"\x00\x01\x02"),
}
NO_BOARD = "is a controller board (dialect {}"
SAID = {
    ("hex7bot", "puma260"): ("is a puma260, not a hex7bot", "--robot puma260"),
    ("hex7bot", "servos"): ("is a servo bus (servo 1 answers), not a board", "--robot so101"),
    ("puma260", "board"): ("is a controller board (dialect 2, firmware", "not a puma260: use --robot hex7bot"),
    ("puma260", "chapter"): ("is a controller board (dialect 1)", "not a puma260: use --robot hex7bot"),
    ("puma260", "servos"): ("is a servo bus (servo 1 answers), not a board", "--robot so101"),
    ("so101", "puma260"): ("is a puma260, not a servo bus", "--robot puma260"),
    ("so101", "board"): ("is a controller board (dialect 2, firmware", "not a servo bus: use --robot hex7bot"),
    ("so101", "chapter"): ("is a controller board (dialect 1)", "not a servo bus: use --robot hex7bot"),
    **{
        (robot, server): ("is no robot: it says ", text)
        for robot in ("hex7bot", "puma260", "so101")
        for server, text in (("web", "'HTTP/1.1 400 Bad Request'"), ("page", "'<!DOCTYPE HTML>'"), ("ssh", "'SSH-"))
    },
}
ALONE = {("hex7bot", "board"), ("hex7bot", "chapter"), ("puma260", "puma260"), ("so101", "servos")}


def network(device: str) -> BoardLink:
    """An address where such a device answers, without a rate that could be changed."""
    clock = FakeClock(time.monotonic())
    link = BoardLink(DEVICES[device](clock.time), clock)
    link.url = "tcp://192.0.2.1:15030"
    return link


def driver(robot: str, link: Link) -> RobotDriver:
    if robot == "hex7bot":
        return Hex7BotDriver(Session(IpcHandle.from_link(link)))
    if robot == "puma260":
        ends = ModuleType.PUMA260_HOST_IO_TRX, ModuleType.PUMA260_RBT_IO_SVR
        return Puma260Driver(Session(IpcHandle.from_link(link, *ends)))
    return load_bus_arm(robot)(link)


def hints_on(link: BoardLink, caplog: pytest.LogCaptureFixture) -> list[tuple[float, str]]:
    """What is said to whoever waits, and when on the link's clock."""
    found: list[tuple[float, str]] = []

    def note(record: logging.LogRecord) -> bool:
        if "nothing has answered yet" in record.getMessage():
            found.append((link.clock.time, record.getMessage()))
        return True

    caplog.handler.addFilter(note)
    return found


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("robot", ["hex7bot", "puma260", "so101"])
def test_what_is_there_is_known_within_two_seconds(
    robot: str, device: str, caplog: pytest.LogCaptureFixture
) -> None:
    link = network(device)
    hints = hints_on(link, caplog)
    started = link.clock.time
    made = driver(robot, link)
    if (robot, device) in ALONE:
        made.attach()
        made.detach()
        return
    with pytest.raises(ReplyTimeoutError) as info:
        made.attach()
    text = str(info.value)
    took = link.clock.time - started
    if (said := SAID.get((robot, device))) is not None:
        assert isinstance(info.value, WrongDeviceError)
        assert all(part in text for part in (link.url, *said)), text
        assert took < SOON
    else:
        # Nobody knows what it is. A board may be booting behind a bridge, and no other robot.
        assert took < (BOOTS + 0.5 if robot == "hex7bot" else SOON), took
        assert "--robot" in text
        assert len(hints) == (robot == "hex7bot")
        for at, hint in hints:
            assert at - started < SOON
            assert all(part in hint for part in (link.url, "--robot puma260", "may be booting", "3 s more")), hint
    if (robot, device) in SAID:
        assert hints == []
    assert "\n" not in text
    assert not link.is_open


def test_a_board_that_boots_behind_a_bridge_is_found_all_the_same(caplog: pytest.LogCaptureFixture) -> None:
    for boot in (0.3, 0.55, 0.7, 1.0, 2.0, 4.0):
        link = network("silent")
        link.device = make_hex7bot_board(faults=[f"boot:{boot}"], start=link.clock.time)
        started = link.clock.time
        hints = hints_on(link, caplog)
        with Hex7BotDriver(Session(IpcHandle.from_link(link))) as robot:
            assert robot.read().positions
        assert len(hints) == (boot >= 2.0), boot
        assert link.clock.time - started < boot + 0.7


def test_a_board_that_answers_is_asked_nothing_else() -> None:
    link = network("board")
    with Session(IpcHandle.from_link(link)) as session:
        session.negotiate()
        assert len(link.written) == 1


def test_another_module_of_a_board_says_what_to_change() -> None:
    link = network("board")
    with (
        Session(IpcHandle.from_link(link, destination=ModuleType(9))) as session,
        pytest.raises(WrongDeviceError, match=r"module 9 does not answer, but ARM_7BOT_ARDUINO_TRX does.*\?to="),
    ):
        session.negotiate()


def test_it_only_asks() -> None:
    link = network("silent")
    link.open()
    assert find_robot(link, ModuleType.PUMA260_RBT_IO_SVR, pings=True) is None
    assert len(link.written) == 3


def test_it_does_not_wait_for_ever_for_a_line_that_takes_nothing() -> None:
    link, given = network("silent"), list[float | None]()
    write = link.write

    def note(data: bytes, deadline: float | None = None) -> None:
        given.append(None if deadline is None else deadline - link.clock.time)
        write(data, deadline)

    link.write = note  # type: ignore[method-assign]
    link.open()
    find_robot(link, ModuleType.PUMA260_RBT_IO_SVR, pings=True)
    assert [seconds is not None and 0.0 < seconds <= 1.0 for seconds in given] == [True] * 3, given


def test_a_serial_line_is_not_kept_waiting_for_a_robot_that_it_cannot_have() -> None:
    link = board_link("boot:99")
    link.open()
    before = link.clock.time
    assert find_robot(link, ModuleType.ARM_7BOT_ARDUINO_TRX) is None
    assert link.clock.time == before
    assert link.written == []
