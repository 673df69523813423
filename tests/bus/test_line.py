from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.bus.bus_bench import BusLink, exchange_by, make_bus

from hexwire.bus.machine import BusCounters
from hexwire.bus.servo_bus import ServoBus
from hexwire.errors import StoppedError, UsageError
from hexwire.link.memory import memory_pair
from hexwire.wire.servo_packet import make_read, make_status, make_sync_write, make_write

SEVEN = (1, 2, 3, 4, 5, 6, 7)


def test_counters_tell_what_happened() -> None:
    bus, device = make_bus()
    bus.read(1, "id")
    bus.sync_read("present_position", SEVEN)
    assert bus.counters == BusCounters(requests=2, answers=8)
    device.wire.servos.pop()
    bus.read(7, "id")
    counted = bus.counters.as_dict()
    assert counted["repeats"] == 2
    assert counted["lost"] == 3
    assert counted["given_up"] == 1


def test_a_servo_bus_is_not_raised() -> None:
    with pytest.raises(UsageError, match="only a board's line can be raised"):
        ServoBus.from_url("/dev/ttyUSB0?raise=500000")


def test_windows_follow_the_line() -> None:
    quick, _ = make_bus((1,))
    slow, _ = make_bus((1,), baud=38400)
    windows = []
    for bus in (quick, slow):
        for _ in range(60):
            bus.read(1, "present_position")
        before = bus.now()
        bus.retries = 0
        bus.read(9, "present_position")
        windows.append(bus.now() - before)
    assert windows[0] < 0.003 < windows[1] < 0.008


def test_a_lost_answer_costs_one_window_and_one_repeat() -> None:
    bus, _device = make_bus()
    for _ in range(60):
        bus.sync_read("present_position", SEVEN)
    plain, lose = bus._line.exchange, [True]

    def lossy(data: bytes, window: float, rest: object = None) -> bytes:
        heard = plain(data, window, rest)
        if lose:
            lose.pop()
            while bus.link.read(bus.now() + window):
                pass
            return b""
        return heard

    start = bus.now()
    bus.sync_read("present_position", SEVEN)
    usual = bus.now() - start
    exchange_by(bus, lossy)
    start = bus.now()
    assert bus.sync_read("present_position", SEVEN).ok
    assert bus.now() - start < 2 * usual + 0.02


def test_bytes_still_on_the_line_are_waited_for() -> None:
    bus, _ = make_bus((1,), baud=115200)
    for _ in range(60):
        bus.read(1, "present_position")
    for _ in range(40):
        bus.sync_write_raw("goal_position", {1: 2048})
    assert bus.read(1, "present_position").ok
    assert bus.counters.lost == 0


def test_what_the_line_carries_first_is_no_time_that_an_answer_took() -> None:
    bus, _ = make_bus((1,), baud=38400)
    for _ in range(200):
        bus.sync_write_raw("goal_position", {1: 2048})
        bus.sync_write_raw("goal_position", {1: 2048})
        assert bus.sync_read("present_position", (1,)).ok
    assert bus.counters.lost == 0
    assert bus.timing.answers > 60
    # Two goals take 5.7 ms on this line.
    assert bus.timing.overhead < 0.001


@pytest.mark.parametrize(
    ("baud", "naps"),
    [(1_000_000, [360e-6]), (9600, [0.001, 0.001]), (0, [])],
    ids=["until the last one is about to come", "a millisecond at most", "not on a line of unknown speed"],
)
def test_a_read_wakes_up_for_its_first_and_last_answers(
    monkeypatch: pytest.MonkeyPatch, baud: int, naps: list[float]
) -> None:
    slept: list[float] = []
    monkeypatch.setattr("hexwire.bus.line.sleep", slept.append)
    monkeypatch.setattr("hexwire.bus.line.SLEEP_ERROR", 120e-6)
    bus = ServoBus(memory_pair()[0], baud=baud)
    answers = [make_status(servo_id, 0, b"\0\x08") for servo_id in SEVEN]
    pieces = [answers[0], *[b"".join(answers[:count]) for count in (6, 7)]]
    waits: list[float] = []

    def collect(window: float, rest: Callable[[bytes], float]) -> bytes:
        waits.extend(map(rest, pieces))
        return pieces[-1]

    bus._line.ask = lambda data: None
    bus._line.collect = collect  # type: ignore[assignment]  # as `transact` calls it
    assert bus.sync_read("present_position", SEVEN).raw == (2048,) * 7
    # After the first one 48 bytes are missing, then 8.
    assert slept == pytest.approx(naps)
    plan = bus._plans.newest_sync["present_position"]
    napped = [*slept, 0.0, 0.0, 0.0][:3]
    assert waits == pytest.approx([plan.rest(data) - nap for data, nap in zip(pieces, napped, strict=True)])
    assert waits[-1] == 0.0


def test_time_that_is_simulated_is_not_slept_through(monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    monkeypatch.setattr("hexwire.bus.line.sleep", slept.append)
    bus, _ = make_bus()
    assert bus.sync_read("present_position", SEVEN).ok
    assert slept == []


def test_a_doubt_ends_by_itself() -> None:
    bus, device = make_bus((1,), retries=0)
    everyone, device.wire.servos = device.wire.servos, []
    bus.read(1, "present_voltage")
    assert bus._machine.doubtful
    device.wire.servos = everyone
    bus.pause(1.1)
    assert bus.read(1, "present_voltage").ok
    assert bus.counters.settled == 0


def test_a_mute_legacy_servo_is_left_alone_for_a_while() -> None:
    from hexwire.wire.registers import Series

    bus, device = make_bus((1,), (Series.SEVEN_BOT,))
    everyone, device.wire.servos = device.wire.servos, []
    for _ in range(3):
        assert bus.read(1, "present_position").error
        bus.ping(1)
    device.wire.servos = everyone
    bus.pause(1.1)
    assert bus.read(1, "present_position").ok


def test_a_request_by_hand() -> None:
    bus, _ = make_bus((1, 2))
    assert bus.raw(make_read(2, 5, 1), (2,), 1) == {2: b"\x02"}
    assert bus.raw(make_read(2, 5, 1)) == {}
    status, instead = bus.ask(make_read(9, 5, 1), 9, 1)
    assert status is None
    assert isinstance(instead, str)


def test_numbers_that_make_no_sense() -> None:
    bus, _ = make_bus((1,))
    with pytest.raises(UsageError, match="retries"):
        ServoBus(bus.link, retries=-1)


class LateLink(BusLink):
    """Bytes of before stay in the adapter until a given time."""

    held = b""
    until = 0.0

    def read(self, deadline: float | None) -> bytes:
        if self.held:
            if deadline is not None and deadline < self.until:
                return super().read(deadline)
            held, self.held = self.held, b""
            return held
        return super().read(deadline)


def _late(bus: ServoBus, held: bytes, seconds: float) -> None:
    link = bus.link
    assert isinstance(link, BusLink)
    link.__class__ = LateLink
    assert isinstance(link, LateLink)
    link.held, link.until = held, link.clock() + seconds


def test_an_adapter_is_emptied_where_the_host_stood_still_until_a_doubt_was_over() -> None:
    bus, _ = make_bus((1,))
    bus._machine.gave_up((1,), 2, make_read(1, 58, 2), bus.now(), bus.now())
    bus.pause(1.1)
    _late(bus, make_status(1, 0, b"\x34\x12"), 0.015)
    assert bus.read(1, "present_position").raw == 2048


def test_an_adapter_is_emptied_when_a_bus_is_opened() -> None:
    bus, _ = make_bus((1,))
    bus.close()
    _late(bus, make_status(1, 0, b"\x34\x12"), 0.015)
    bus.open()
    assert bus.read(1, "present_position").raw == 2048


def test_an_echo_with_a_wrong_byte_in_its_header_is_no_value_of_a_legacy_servo() -> None:
    from hexwire.wire.registers import Series

    bus, _ = make_bus((1,), (Series.SEVEN_BOT,))
    assert bus.read(1, "present_position").ok
    for _ in range(80):
        bus.write_raw(1, "target_position", 2048)
    bus.pause(1.1)
    exchange_by(bus, lambda *_: b"\xff\xf5" + make_read(1, 56, 2)[2:])
    assert bus.read(1, "present_speed").raw is None


def test_one_transaction_in_sixteen_is_timed_once_the_line_is_known() -> None:
    bus, _ = make_bus((1,))
    for _ in range(64):
        bus.read(1, "id")
    assert bus.timing.answers == 64
    for _ in range(160):
        bus.read(1, "id")
    assert bus.timing.answers == 74


def test_a_stop_names_what_it_voids() -> None:
    bus, _ = make_bus((1,))
    with bus.epochs.calling("a move"):
        bus.epochs.begin(object())
        for call in (lambda: bus.read_block(1, 56, 3), lambda: bus._line.send(make_write(1, 41, b"\x01"))):
            with pytest.raises(StoppedError, match="a servo packet"):
                call()


def test_a_rate_of_its_own_is_kept_until_another_is_followed() -> None:
    link = make_bus((1,))[0].link
    assert ServoBus(link).timing.baud == 1_000_000
    own = ServoBus(link, baud=250_000)
    assert own.timing.baud == 250_000
    link.close()
    own.open()
    assert own.timing.baud == 250_000
    own.set_baud(115_200)
    assert own.timing.baud == 115_200
    assert ServoBus(link, retries=0).retries == 0


def test_an_interrupted_fast_read_is_in_doubt_from_that_moment() -> None:
    bus, _ = make_bus((1, 2))

    def interrupted(data: bytes, window: float, rest: object = None) -> bytes:
        raise KeyboardInterrupt

    exchange_by(bus, interrupted)
    with pytest.raises(KeyboardInterrupt):
        bus.sync_read("present_position", (1, 2))
    for servo_id in (1, 2):
        assert bus._machine.late_replies.late(servo_id, 2) == bus.now()
        assert bus._machine.late_replies.holds(servo_id, 2, bus.now())


@pytest.mark.parametrize("packet", [make_write(1, 41, b"\x01"), make_sync_write(42, {1: b"\0\0"})])
def test_an_interrupted_packet_without_an_answer_may_have_been_sent(packet: bytes) -> None:
    bus, _ = make_bus((1,))
    at_the_link: list[bool] = []

    def interrupted(data: bytes) -> None:
        at_the_link.append(data in bus._machine.sent.packets(bus.now()))
        raise KeyboardInterrupt

    bus._line._post = interrupted
    with pytest.raises(KeyboardInterrupt):
        bus._line.send(packet)
    # The echo of a packet to all servos is no answer; that of any other must be known before it can arrive.
    assert at_the_link == [packet[2] != 0xFE]
    assert bus._machine.busy_until > bus.now()


def test_a_link_without_a_rate_costs_no_time() -> None:
    link, _ = memory_pair()
    assert ServoBus(link).timing.baud == 0
    assert ServoBus(link, baud=9600).timing.baud == 9600
