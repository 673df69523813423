"""A servo bus where a board was meant, and a board where servos were meant, in simulated time."""

from __future__ import annotations

import pytest
from tests.bus.bus_bench import BusLink, make_bus

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.board_chapter import SketchReceiver
from hexwire.emulator.faults import FaultPlan
from hexwire.emulator.serve import BoardLink, FakeClock, ServedDevice
from hexwire.emulator.servo_wire import heard_at
from hexwire.errors import ReplyTimeoutError, WrongDeviceError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.mistaken import find_servos
from hexwire.ipc.session import Session
from hexwire.wire.command_frame import Command, Frame, serialize_frame
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_board_error, make_ping
from hexwire.wire.tables import BOARD_ERRORS

BOARD_RATE = 115_200
SOON = 2.0


class _AtBoardRate:
    """A board that keeps to its rate, whatever the host's is."""

    def __init__(self, board: ServedDevice, rates: list[int], own: int) -> None:
        self.board = board
        self.own = own
        self.rates = rates
        self.heard = b""

    def receive(self, data: bytes, now: float) -> None:
        data = heard_at(data, self.rates[0], self.own)
        self.heard += data
        self.board.receive(data, now)

    def step(self, now: float) -> None:
        self.board.step(now)

    def data_to_send(self) -> bytes:
        return heard_at(self.board.data_to_send(), self.own, self.rates[0])

    def next_event_time(self) -> float | None:
        return self.board.next_event_time()

    def reset(self, now: float) -> None:
        self.board.reset(now)


def board_link(*faults: str, dialect: int = 2, rate: int = BOARD_RATE, board_rate: int = BOARD_RATE) -> BusLink:
    clock = FakeClock(1000.0)
    rates = [rate]
    board = make_hex7bot_board(dialect=dialect, baud=BOARD_RATE, faults=faults, start=clock.time)
    link = BusLink(_AtBoardRate(board, rates, board_rate), clock, baud=BOARD_RATE)
    link.rates = rates
    return link


def bus_link(ids: tuple[int, ...], *series: Series, rate: int = BOARD_RATE, **options: object) -> BusLink:
    bus, _ = make_bus(ids, series or (Series.STS_SMS,), **options)  # type: ignore[arg-type]
    bus.close()
    assert isinstance(bus.link, BusLink)
    bus.link.set_baud(rate)
    return bus.link


def pings_in(link: BoardLink) -> list[bytes]:
    return [data for data in link.written if data[:2] == b"\xff\xff"]


LEGACY = (Series.SEVEN_BOT,) * 4 + (Series.HLS,) * 3


@pytest.mark.parametrize(
    ("link", "ids"),
    [
        (bus_link((1, 2, 3, 4, 5, 6)), "servos 1, 2, 3, 4, 5, 6 answer"),
        (bus_link((1, 2, 3), echo=True), "servos 1, 2, 3 answer"),
        (bus_link((10, 11, 12)), "servos 10, 11, 12 answer"),
        (bus_link((200,)), "servo 200 answers"),
        (bus_link((1, 2), faults=FaultPlan(["overload:1"])), "servos 1, 2 answer"),
        (bus_link(tuple(range(7)), *LEGACY, baud=115200), "servo 0 answers"),
        (bus_link((1, 2), echo=True, baud=115200), "servo 1 answers"),
        (bus_link((1, 2), rate=1_000_000), "servo 1 answers"),
    ],
    ids=["sts", "echo", "ids from 10", "one", "faulty", "sevenbot", "at the board's rate", "at 1 Mbaud"],
)
def test_a_servo_bus_is_named_before_long(link: BusLink, ids: str) -> None:
    before, started = link.baud, link.clock.time
    with Session(IpcHandle.from_link(link)) as session:
        with pytest.raises(WrongDeviceError, match=rf"is a servo bus \({ids}\).*--robot so101.*hexwire bus scan"):
            session.negotiate(ping_ids=range(7))
        assert link.clock.time - started < SOON
        assert link.baud == before


@pytest.mark.parametrize("dialect", [1, 2])
def test_a_board_that_answers_is_never_looked_at(dialect: int) -> None:
    link = board_link(dialect=dialect)
    with Session(IpcHandle.from_link(link)) as session:
        assert session.negotiate().dialect == dialect
    assert pings_in(link) == []


@pytest.mark.parametrize("dialect", [1, 2])
@pytest.mark.parametrize("boot", [0.3, 0.55, 0.62, 1.0, 2.0, 4.0])
def test_a_board_that_boots_is_found_as_soon(dialect: int, boot: float) -> None:
    took = []
    for look in (False, True):
        link = board_link(f"boot:{boot}", dialect=dialect)
        started = link.clock.time
        with Session(IpcHandle.from_link(link)) as session:
            assert session.negotiate(look=look).dialect == dialect
            assert session.request(Command.PING, make_ping(1)).body
        took.append(link.clock.time - started)
    assert took[1] - took[0] < 0.3


def test_a_board_that_was_there_is_not_looked_at_again() -> None:
    link = board_link()
    with Session(IpcHandle.from_link(link)) as session:
        session.negotiate()
        link.device.board = make_hex7bot_board(faults=["boot:1"], start=link.clock.time)  # type: ignore[attr-defined]
        session.negotiate()
    assert pings_in(link) == []


def test_a_silent_line_is_looked_at_twice_and_then_given_up() -> None:
    link = board_link("boot:99")
    with Session(IpcHandle.from_link(link)) as session, pytest.raises(ReplyTimeoutError) as info:
        session.negotiate(boot_window=3.0)
    assert not isinstance(info.value, WrongDeviceError)
    assert pings_in(link).count(make_ping(1)) == 2
    assert link.baud == BOARD_RATE


def test_a_line_that_only_hears_itself_is_named() -> None:
    link = bus_link((1,), echo=True, faults=FaultPlan(["silent:1"]))
    with (
        Session(IpcHandle.from_link(link)) as session,
        pytest.raises(ReplyTimeoutError, match="only echoes"),
    ):
        session.negotiate(boot_window=1.0)


def test_a_board_hears_next_to_nothing_of_the_look() -> None:
    link = board_link("boot:99")
    link.open()
    assert find_servos(link) == ()
    heard = link.device.heard  # type: ignore[attr-defined]
    assert len(heard) <= 2 * len(link.written)
    # And none of it could be a command, or the end of a frame, in what a sketch may have in its buffer.
    assert all(byte >= 0xF0 for byte in heard)
    # The chapter's sketch passes over what is outside a frame.
    sketch = SketchReceiver()
    for data in link.written:
        sketch.put(heard_at(data, 1_000_000, BOARD_RATE), busy=False)
        assert sketch.next_frame() is None
    numbers = {"seq": 1, "sn": 1, "src": 7, "dst": 8, "type": 3, "time_sec": 1, "time_nsec": 1}
    frame = serialize_frame(Frame(proto=1, cmd=Command.PING, body=make_ping(3), **numbers))
    sketch.put(frame, busy=False)
    found = sketch.next_frame()
    assert found is not None
    assert found.body == make_ping(3)
    assert not sketch.hung


def test_a_board_is_not_pinged_at_its_own_rate() -> None:
    link = board_link("boot:99", rate=1_000_000, board_rate=1_000_000)
    link.open()
    assert find_servos(link) == ()
    assert link.written == []


def test_links_without_a_rate_are_left_alone() -> None:
    clock = FakeClock()
    link = BoardLink(make_hex7bot_board(start=clock.time), clock)
    link.open()
    assert find_servos(link) == ()
    assert link.written == []


def test_servos_that_are_heard_in_pieces_are_all_found() -> None:
    link = bus_link((1, 2, 3))
    rest, read = b"", link.read

    def read_a_byte(deadline: float | None) -> bytes:
        nonlocal rest
        rest = rest or read(deadline)
        piece, rest = rest[:1], rest[1:]
        return piece

    link.read = read_a_byte  # type: ignore[method-assign]
    with link:
        assert find_servos(link) == (1, 2, 3)


def test_the_late_answer_of_a_board_is_not_taken_for_a_servos() -> None:
    """Where a line knows no rates, a board that stalled is heard during the look."""
    link = board_link("boot:99")
    late, read = [make_board_error(BOARD_ERRORS["command_unknown"])], link.read
    link.read = lambda deadline: late.pop() if late else read(deadline)  # type: ignore[method-assign]
    with link:
        assert find_servos(link) == ()
    assert not late
