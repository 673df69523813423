from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.frames import frame_bytes

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.errors import (
    HexwireError,
    LinkClosedError,
    LinkLostError,
    LinkNotFoundError,
    LocalProtocolError,
    PreemptedError,
    ReplyTimeoutError,
    StoppedError,
)
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link.base import LinkKind
from hexwire.link.memory import MemoryLink, memory_pair
from hexwire.session.policy import ReconnectPolicy, RetryPolicy
from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Command, Status, parse_frame
from hexwire.wire.modules import IpcType, ModuleType
from hexwire.wire.servo_packet import make_read, make_status

LONG = 30.0


def over(link: BoardLink | MemoryLink, **options: object) -> Session:
    return Session(IpcHandle.from_link(link), **options)  # type: ignore[arg-type]  # the caller's keywords


def board_link(baud: int = 0, **options: object) -> BoardLink:
    clock = FakeClock(1000.0)
    return BoardLink(make_hex7bot_board(start=clock.time, baud=baud, **options), clock, baud=baud)  # type: ignore[arg-type]


@contextmanager
def served(dialect: int = 2) -> Iterator[tuple[Session, MemoryLink, threading.Event]]:
    """A session in real time, a board in another thread that can be made deaf."""
    near, far = memory_pair()
    far.open()
    deaf, ended = threading.Event(), threading.Event()
    board = make_hex7bot_board(dialect=dialect, start=time.monotonic())

    def serve() -> None:
        while not ended.is_set():
            with contextlib.suppress(LinkLostError):
                data = far.read(time.monotonic() + 0.01)
                now = time.monotonic()
                if data and not deaf.is_set():
                    board.receive(data, now)
                board.step(now)
                out = board.data_to_send()
                if out:
                    far.write(out)

    thread = threading.Thread(target=serve)
    thread.start()
    session = over(near, policy=RetryPolicy(attempts=3, window=3.0, dialect1_window=3.0))
    try:
        yield session, near, deaf
    finally:
        ended.set()
        thread.join(LONG)
        session.close()
        far.close()


# --- asking ----------------------------------------------------------------------------------------------------


def test_building_a_session_does_no_io() -> None:
    session = Session.from_url("serial:///dev/does-not-exist")
    assert not session.is_open
    with pytest.raises(LinkNotFoundError):
        session.open()


def test_a_request_gives_the_reply_with_its_round_trip() -> None:
    link = board_link(baud=115200)
    with over(link) as session:
        assert session.negotiate().dialect == 2
        reply = session.request(Command.STATS)
        assert (reply.status, len(reply.body), reply.attempts) == (Status.OK, 60, 1)
        assert session.rtts[-1] == reply.rtt
        assert 0.012 < reply.rtt < 0.030
        assert session.request(0x55).status == Status.UNKNOWN_COMMAND
    assert not session.is_open


@pytest.mark.parametrize("cmd", [-1, 256, 2**53])
def test_a_command_that_does_not_exist_is_refused_and_the_next_one_is_sent(cmd: int) -> None:
    link = board_link()
    with over(link) as session:
        with pytest.raises(LocalProtocolError, match=f"no command {cmd}"):
            session.request(cmd, bytes(4096))
        assert session.request(Command.PING).cmd == Command.PING


def test_header_fields_are_the_chapters_or_the_callers() -> None:
    for options, expected in (({}, (7, 8, 3)), ({"src": 0, "dst": 5, "type": IpcType.TCP}, (0, 5, 1))):
        link = board_link()
        session = over(link, wall=lambda: 1_752_865_499.25, **options)
        with session:
            session.send(Command.STATS)
        frame = parse_frame(link.written[0])
        assert (frame.src, frame.dst, frame.type) == expected
        assert frame.time_sec + frame.time_nsec * 1e-9 == pytest.approx(1_752_865_499.25, abs=1e-3)


def test_sequence_numbers_continue_after_a_reopening() -> None:
    link = board_link()
    session = over(link)
    for _ in range(3):
        with session:
            session.request(Command.STATS)
    numbers = [parse_frame(data).sn for data in link.written]
    assert numbers == sorted(set(numbers))


def test_no_answer_says_what_was_asked_how_often_and_what_came_instead() -> None:
    link = board_link(faults=["boot:1000"])
    with over(link) as session:
        begun = session.now()
        with pytest.raises(ReplyTimeoutError, match=r"no answer to STATS after 3 attempts; nothing") as info:
            session.request(Command.STATS)
        assert info.value.attempts == 3
        assert session.now() - begun == pytest.approx(0.6, abs=0.01)
        with pytest.raises(ReplyTimeoutError, match="after 1 attempt;"):
            session.request(Command.STATS, attempts=1, window=0.05)


def test_send_does_not_wait_and_its_answer_is_thrown_away() -> None:
    link = board_link()
    with over(link) as session:
        session.send(Command.STATS)
        assert session.request(Command.RESUME).cmd == Command.RESUME
        assert session.connection.counters.stale == 1


def test_a_guard_refuses_before_anything_is_written() -> None:
    link = board_link()

    def guard() -> None:
        raise StoppedError("x", 5, "y")

    with over(link) as session:
        with pytest.raises(StoppedError):
            session.request(Command.STATS, guard=guard)
        assert link.written == []
        assert session.request(Command.STATS).status == 0


def test_a_request_that_cannot_be_sent_is_refused_and_the_session_continues() -> None:
    link = board_link(dialect=1)
    with over(link) as session:
        assert session.negotiate().dialect == 1
        for cmd, body in ((Command.READ, b"junk"), (Command.READ, sp.make_ping(0xFE)), (Command.JOINT_STATE, b"")):
            with pytest.raises(LocalProtocolError):
                session.request(cmd, body)
        assert session.request(Command.PING, sp.make_ping(0)).body == bytes.fromhex("FF F5 00 06 00 F9")


# --- unsolicited -----------------------------------------------------------------------------------------------


def test_stream_and_poll_reports() -> None:
    link = board_link()
    with over(link) as session:
        assert session.poll_reports() is None
        session.request(Command.REPORT, b"\x14\0\0")
        stream = session.stream(1.0)
        begun = session.now()
        frames = [next(stream) for _ in range(10)]
        assert session.now() - begun == pytest.approx(0.2, abs=0.021)
        assert all(f.is_unsolicited and f.cmd == Command.JOINT_STATE for f in frames)
        link.clock.advance(0.1)
        newest = session.poll_reports()
        assert newest is not None
        session.request(Command.REPORT, b"\0\0\0")
        session.poll_reports()
        begun = session.now()
        assert list(session.stream(0.5)) == []
        assert session.now() - begun == pytest.approx(0.5, abs=0.01)


def test_receive_gives_frames_that_answer_nothing() -> None:
    near, far = memory_pair()
    with far, over(near) as session:
        assert session.receive(0.0) is None
        data = frame_bytes(Command.STATS, seq=9, sn=1, src=8, dst=7, type=8, cmd_ext=0x80)
        far.write(data)
        frame = session.receive(LONG)
        assert frame is not None
        assert (frame.cmd, frame.seq) == (Command.STATS, 9)


# --- negotiation -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("baud", [0, 115200])
@pytest.mark.parametrize("dialect", [1, 2])
def test_negotiation_finds_the_dialect(dialect: int, baud: int) -> None:
    with over(board_link(dialect=dialect, baud=baud)) as session:
        outcome = session.negotiate()
        assert (outcome.dialect, session.dialect) == (dialect, dialect)
        assert (outcome.identity is None) == (dialect == 1)


def test_a_booting_board_is_waited_for() -> None:
    with over(board_link(faults=["boot:2.5"])) as session:
        begun = session.now()
        assert session.negotiate().dialect == 2
        assert 2.5 <= session.now() - begun < 3.2


def test_a_silent_port_and_its_text() -> None:
    with over(board_link(faults=["boot:1000"])) as session:
        begun = session.now()
        with pytest.raises(
            ReplyTimeoutError, match=r"no answer to IDENTIFY on serial:.*nothing arrived.*hexwire ports"
        ):
            session.negotiate(boot_window=3.0)
        assert session.now() - begun == pytest.approx(3.0, abs=0.5)


class NoisyDevice:
    """Says the same again and again."""

    def __init__(self, noise: bytes) -> None:
        self.noise = noise

    def receive(self, data: bytes, now: float) -> None:
        pass

    def step(self, now: float) -> None:
        pass

    def data_to_send(self) -> bytes:
        return self.noise

    def next_event_time(self) -> float | None:
        return None

    def reset(self, now: float) -> None:
        pass


class NoisyLink(BoardLink):
    """The noise comes at 10 ms intervals."""

    def read(self, deadline: float | None) -> bytes:
        self._check()
        self.clock.advance(0.01)
        return self.device.data_to_send()


def test_noise_looks_like_a_wrong_baud_rate() -> None:
    link = NoisyLink(NoisyDevice(b"\xe1\x87\x99\xfe\x80"), FakeClock())
    with (
        over(link) as session,
        pytest.raises(ReplyTimeoutError, match=r"are not a frame.*baud rate may be wrong"),
    ):
        session.negotiate(boot_window=1.0)


def test_frames_that_answer_nothing_are_another_program() -> None:
    frame = frame_bytes(0x1B, seq=77, sn=1, src=8, dst=3, type=8, cmd_ext=0x80)
    with (
        over(NoisyLink(NoisyDevice(frame), FakeClock())) as session,
        pytest.raises(ReplyTimeoutError, match=r"frames that answer no request.*another program"),
    ):
        session.negotiate(boot_window=1.0)


# --- configuration ---------------------------------------------------------------------------------------------


def test_from_conf_takes_ends_and_kind_from_the_file(tmp_path: Path) -> None:
    conf = tmp_path / "ipc_msg.conf"
    conf.write_text("ARM_7BOT_SERIAL_TRX CLIENT_TRX ARM_7BOT_ARDUINO_TRX SERIAL /dev/no-such-port 9600\n")
    session = Session.from_conf(conf, ModuleType.ARM_7BOT_SERIAL_TRX)
    with pytest.raises(LinkNotFoundError, match="no-such-port"):
        session.open()
    assert session.ipc.link.url.endswith("baud=9600")


# --- the port goes away ----------------------------------------------------------------------------------------


def lose(link: BoardLink, for_seconds: float) -> None:
    """Unplug; the plug is back after a while of the link's clock."""
    link.lost = True
    back = link.clock.time + for_seconds
    plain = link.open

    def open_when_back() -> None:
        link.lost = link.clock.time < back
        plain()

    link.open = open_when_back  # type: ignore[method-assign]  # the plug comes back at its time


def test_repeatable_requests_are_repeated_after_a_reconnection() -> None:
    link = board_link()
    with over(link) as session:
        session.negotiate()
        lose(link, 3.0)
        assert session.request(Command.STATS, repeatable=True).status == 0
        assert (session.generation, session.reconnects) == (1, 1)
        assert session.dialect == 2


def test_a_request_that_moves_the_arm_is_not_repeated_and_the_error_says_so() -> None:
    link = board_link()
    with over(link) as session:
        session.negotiate()
        lose(link, 1.0)
        link.written.clear()
        with pytest.raises(LinkLostError, match="lost and is open again; TORQUE was not repeated"):
            session.request(Command.TORQUE, b"\0\1\0")
        assert Command.TORQUE not in [parse_frame(data).cmd for data in link.written]
        assert session.request(Command.TORQUE, b"\0\1\0").status == 0


def test_reconnecting_gives_up_after_its_time() -> None:
    link = board_link()
    with over(link, reconnect=ReconnectPolicy(give_up_after=7.0)) as session:
        session.negotiate()
        link.lost = True
        begun = session.now()
        with pytest.raises(LinkLostError, match="did not come back within 7 s"):
            session.request(Command.STATS, repeatable=True)
        assert session.now() - begun == pytest.approx(7.0, abs=0.5)


def test_without_reconnection_or_negotiation_a_loss_is_final_at_once() -> None:
    for policy in (ReconnectPolicy(enabled=False), ReconnectPolicy()):
        link = board_link()
        with over(link, reconnect=policy) as session:
            if not policy.enabled:
                session.negotiate()
            link.lost = True
            begun = session.now()
            with pytest.raises(LinkLostError, match="unplugged"):
                session.request(Command.STATS, repeatable=True)
            assert session.now() == begun


def test_a_plug_that_comes_and_goes_is_waited_for() -> None:
    link = board_link()
    with over(link) as session:
        session.negotiate()
        link.lost = True
        plain = link.open
        bad = iter([True, True, True])

        def flaky() -> None:
            link.lost = False
            plain()
            link.lost = next(bad, False)

        link.open = flaky  # type: ignore[method-assign]  # opens well, and is lost at the first write
        assert session.request(Command.STATS, repeatable=True).status == 0
        assert session.generation == 1


def test_a_board_that_does_not_come_back_leaves_a_closed_session_not_a_guess() -> None:
    link = board_link(dialect=1)
    with over(link) as session:
        session.negotiate(boot_window=1.0)
        lose(link, 1.0)
        link.device = NoisyDevice(b"")
        link.written.clear()
        with pytest.raises(ReplyTimeoutError, match="IDENTIFY"):
            session.request(Command.PING, sp.make_ping(0), repeatable=True)
        with pytest.raises(LinkClosedError):
            session.request(Command.PING, sp.make_ping(0), repeatable=True)


def test_a_stream_continues_after_a_reconnection() -> None:
    link = board_link()
    with over(link) as session:
        session.negotiate()
        session.request(Command.REPORT, b"\x14\0\0")
        stream = session.stream(1.0)
        next(stream)
        lose(link, 1.0)
        # The board's reports ended with the IDENTIFY; silence ends the stream, not an error.
        assert list(stream) == []
        assert session.generation == 1


def test_the_retries_of_a_noisy_line_are_counted_and_nothing_wrong_gets_through() -> None:
    link = board_link(faults=["flip:0.04", "drop:0.03", "dup:0.03", "junk:0.04", "cut:0.03"], seed=5)
    with over(link, policy=RetryPolicy(attempts=8)) as session:
        session.negotiate(boot_window=60)
        for i in range(1500):
            value = bytes((7, i & 7))
            assert session.request(Command.IO, value).body == value
        counters = session.connection.counters
        assert counters.retries > 100
        assert session.connection.decoder.counters.bytes_dropped > 100


# --- threads ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_an_urgent_request_interrupts_one_that_waits(dialect: int) -> None:
    with served(dialect) as (session, _, deaf):
        session.open()
        assert session.negotiate().dialect == dialect
        deaf.set()
        outcome: list[HexwireError] = []
        packet = (Command.STATS, b"") if dialect == 2 else (Command.PING, sp.make_ping(0))

        def wait() -> None:
            try:
                session.request(*packet, window=60.0)
            except HexwireError as error:
                outcome.append(error)

        thread = threading.Thread(target=wait)
        thread.start()
        while session._turn.owner == 0:
            time.sleep(0.005)
        time.sleep(0.1)
        with pytest.raises(ReplyTimeoutError):
            session.request(*packet, window=0.2, attempts=1, urgent=True)
        thread.join(LONG)
        assert not thread.is_alive()
        assert isinstance(outcome[0], PreemptedError)


def test_a_stop_that_no_call_made_voids_what_acts_and_not_a_read_under_way() -> None:
    with served() as (session, _, _deaf):
        session.open()
        session.negotiate()
        # Right before its bytes leave, as the path check or the board's latch may stop the arm in another thread.
        void = session.epochs.void
        assert session.request(Command.STATS, guard=void).status == Status.OK
        with pytest.raises(StoppedError, match="a stop came after the call"):
            session.request(Command.TORQUE, b"\1\x7f\0", guard=void)
        assert session.request(Command.TORQUE, b"\1\x7f\0").status == Status.OK


def test_many_threads_each_get_their_own_answers() -> None:
    with served() as (session, _, _deaf):
        session.open()
        session.negotiate()
        wrong: list[object] = []

        def work(bit: int, urgent: bool) -> None:
            for i in range(150):
                body = bytes((1 << bit, (i & 1) << bit))
                try:
                    reply = session.request(Command.IO, body, urgent=urgent)
                except PreemptedError:
                    continue
                if reply.body[0] != body[0] or (reply.body[1] ^ body[1]) & body[0]:
                    wrong.append((body, reply.body))

        threads = [threading.Thread(target=work, args=(bit, bit == 2)) for bit in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(60)
        assert not any(t.is_alive() for t in threads)
        assert wrong == []
        assert session._turn.urgent_waiting == 0


def test_an_urgent_request_during_a_reconnection_does_not_hang() -> None:
    near, far = memory_pair()
    far.open()
    board = make_hex7bot_board(start=time.monotonic())
    ended, drop = threading.Event(), threading.Event()

    def serve() -> None:
        while not ended.is_set():
            if drop.is_set():
                far.close()
                far.open()
                drop.clear()
            with contextlib.suppress(LinkLostError):
                data = far.read(time.monotonic() + 0.01)
                board.receive(data, time.monotonic())
                out = board.data_to_send()
                if out:
                    far.write(out)

    server = threading.Thread(target=serve)
    server.start()
    policy = RetryPolicy(attempts=3, window=3.0, dialect1_window=3.0)
    session = over(near, policy=policy, reconnect=ReconnectPolicy(interval=0.05))
    try:
        session.open()
        session.negotiate()
        original = session.negotiate
        reopening = threading.Event()

        def slow(**options: object) -> object:
            reopening.set()
            time.sleep(0.3)
            return original(**options)  # type: ignore[arg-type]  # handed through

        session.negotiate = slow  # type: ignore[method-assign]  # long enough for the stop to come meanwhile
        results: list[object] = []

        def reader() -> None:
            try:
                results.append(session.request(Command.STATS, repeatable=True))
            except PreemptedError as error:
                results.append(error)

        drop.set()
        while drop.is_set():
            time.sleep(0.005)
        thread = threading.Thread(target=reader)
        thread.start()
        assert reopening.wait(LONG)
        assert session.request(Command.STOP, b"\0", urgent=True, repeatable=True).status == 0
        thread.join(LONG)
        assert not thread.is_alive()
        assert results
    finally:
        ended.set()
        server.join(LONG)
        session.close()
        far.close()


def test_closing_from_another_thread_ends_a_request_and_a_reconnection() -> None:
    for lost in (False, True):
        near, far = memory_pair()
        far.open()
        session = over(near, reconnect=ReconnectPolicy(give_up_after=60, interval=0.05))
        session.open()
        outcome: list[HexwireError] = []
        if lost:
            session._negotiation = (60.0, (0,), None)
            far.close()

        def wait(session: Session = session, outcome: list[HexwireError] = outcome) -> None:
            try:
                session.request(Command.STATS, window=60.0, repeatable=True)
            except HexwireError as error:
                outcome.append(error)

        thread = threading.Thread(target=wait)
        thread.start()
        time.sleep(0.3)
        session.close()
        thread.join(LONG)
        assert not thread.is_alive()
        assert isinstance(outcome[0], LinkClosedError)
        far.close()


def test_a_datagram_link_ends_a_frame_with_its_message() -> None:
    near, far = memory_pair(LinkKind.DATAGRAM)
    with far, over(near) as session:
        far.write(b"\x5a\xfa\xfa\x5a\x01\x02")
        assert session.receive(0.0) is None
        assert session.connection.decoder.counters.bytes_dropped == 6


def test_another_stop_does_not_void_what_precedes_one_over_datagrams(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    near, far = memory_pair(LinkKind.DATAGRAM)
    held: list[bool] = []

    def wait(ticket: int, *_: object) -> None:
        session.connection.void()
        held.append(session.connection.holds(ticket))
        raise LinkLostError("enough", url=near.url)

    with far, over(near) as session:
        monkeypatch.setattr(session, "_await", wait)
        monkeypatch.setattr(session, "_reopen", lambda lost: None)
        with pytest.raises(LinkLostError):
            session.request(Command.STOP, b"\0")
    assert held == [True]


def test_a_reply_that_came_while_nobody_read_answers_no_later_request() -> None:
    link = board_link(dialect=1)
    with over(link) as session:
        assert session.negotiate().dialect == 1
        request = make_read(4, 0x38, 2)
        session.send(Command.READ, make_read(4, 0x2A, 2))
        other = session.request(Command.READ, request).body
        # A frame that the adapter held back, from the same servo and of the same length.
        link.clock.advance(1.0)
        link.device.connection.reply_dialect1(make_status(4, 0, b"\x11\x22"), link.clock())
        link.clock.advance(1.0)
        assert session.request(Command.READ, request).body == other


def test_a_request_is_sent_as_often_as_it_is_asked_for() -> None:
    link = board_link()
    with over(link) as session:
        session.negotiate()
        link.device = make_hex7bot_board(start=link.clock.time, faults=["boot:99"])
        for attempts in (1, 2):
            link.written.clear()
            with pytest.raises(ReplyTimeoutError, match=f"after {attempts} attempt") as info:
                session.request(Command.STATS, attempts=attempts)
            assert (info.value.attempts, len(link.written)) == (attempts, attempts)


def test_every_write_has_a_deadline() -> None:
    link, given = board_link(), list[float | None]()
    write = link.write

    def note(data: bytes, deadline: float | None = None) -> None:
        given.append(None if deadline is None else deadline - link.clock.time)
        write(data, deadline)

    link.write = note  # type: ignore[method-assign]
    with over(link) as session:
        session.negotiate()
        session.request(Command.STATS)
        session.send(Command.STATS)
    assert len(given) >= 3
    assert all(seconds is not None and 0.0 < seconds <= 2.0 for seconds in given), given
