from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.bus_device import BusDevice, make_servos
from hexwire.errors import UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    BROADCAST_ID,
    iter_status,
    make_ping,
    make_read,
    make_status,
    make_sync_read,
    make_sync_write,
    make_write,
)


def _drain(device: BusDevice, until: float) -> list[tuple[float, bytes]]:
    heard = []
    while (due := device.answer_due) is not None and due <= until:
        device.step(due)
        heard.append((due, device.data_to_send()))
    return heard


def test_answers_come_when_their_last_bit_would() -> None:
    device = BusDevice(make_servos([Series.STS_SMS], [1, 2, 3]), paced=True)
    device.receive(make_sync_read(56, 2, (1, 2, 3)), 0.0)
    heard = _drain(device, 1.0)
    assert [len(data) for _, data in heard] == [8, 8, 8]
    line = (len(make_sync_read(56, 2, (1, 2, 3))) + 24) * 10e-6
    assert heard[-1][0] >= line
    times = [due for due, _ in heard]
    assert times == sorted(times)


@given(st.binary(max_size=40), st.lists(st.integers(1, 12), max_size=20))
def test_requests_in_any_pieces_behind_any_noise(noise: bytes, cuts: list[int]) -> None:
    device = BusDevice(make_servos([Series.STS_SMS], [1]))
    stream = noise.replace(b"\xff", b"\x00") + make_ping(1) + make_read(1, 5, 1)
    at = 0
    for cut in [*cuts, len(stream)]:
        device.receive(stream[at : at + cut], 0.0)
        at += cut
    device.step(0.0)
    assert [len(status.params) for status in iter_status(device.data_to_send())] == [0, 1]


@given(st.lists(st.binary(max_size=300), max_size=30))
def test_any_bytes_leave_it_alive_and_bounded(pieces: list[bytes]) -> None:
    device = BusDevice(make_servos([Series.STS_SMS], [1]), paced=True)
    for turn, piece in enumerate(pieces):
        device.receive(piece, turn * 0.01)
    device.receive(bytes(20000), 1.0)
    assert device.pending <= 4096


def test_a_servo_at_another_rate_does_not_hear() -> None:
    rate = [1_000_000]
    device = BusDevice(make_servos([Series.STS_SMS], [1], baud=115200), paced=True, host_baud=lambda: rate[0])
    device.receive(make_ping(1), 0.0)
    assert device.answer_due is None
    rate[0] = 115200
    device.receive(make_ping(1), 1.0)
    assert device.answer_due == pytest.approx(1.0 + 12 * 10 / 115200 + 250e-6, abs=1e-4)


class Line:
    """A host that changes its rate, and servos each at its own."""

    def __init__(self, bauds: Sequence[int], **options: bool) -> None:
        self.rate = 1_000_000
        servos = make_servos([Series.STS_SMS], range(1, 1 + len(bauds)), baud=bauds)
        self.device = BusDevice(servos, paced=True, host_baud=lambda: self.rate, **options)
        self.now = 0.0

    def ask(self, packet: bytes, wait: float = 0.05) -> bytes:
        self.device.receive(packet, self.now)
        heard = b"".join(data for _, data in _drain(self.device, self.now + wait))
        self.now += wait
        return heard


RATES = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)


def test_each_servo_answers_at_its_own_rate_only() -> None:
    line = Line(RATES)
    found = []
    for line.rate in (*RATES, *reversed(RATES)):
        answers = [line.ask(make_ping(servo_id), 0.01) for servo_id in range(12)]
        found += [(who, line.rate) for who, answer in enumerate(answers) if answer == make_status(who)]
    each = [(1 + place, rate) for place, rate in enumerate(RATES)]
    assert found == each + each[::-1]


@pytest.mark.parametrize("rate", RATES[1:])
def test_bytes_at_a_wrong_rate_do_not_spoil_the_next_packet(rate: int) -> None:
    line = Line([1_000_000])
    for junk in (make_sync_write(42, {i: bytes(4) for i in range(1, 8)}), bytes(range(256)), b"\xff" * 40):
        line.rate = rate
        assert line.ask(junk, 0.02) == b""
        line.rate = 1_000_000
        assert line.ask(make_ping(1), 0.02) == make_status(1)


@pytest.mark.parametrize("junk", ["FF FF 01", "FF FF 01 F0 03", "FF FF FF FF 02 80", "00 FF"])
def test_an_unfinished_packet_does_not_swallow_the_next(junk: str) -> None:
    line = Line([1_000_000])
    assert line.ask(bytes.fromhex(junk)) == b""
    assert line.ask(make_ping(1)) == make_status(1)


def test_two_packets_behind_noise_that_looks_like_one_are_both_heard() -> None:
    line = Line([1_000_000, 1_000_000])
    # It begins as a packet of servo 1, and its checksum is wrong.
    spoilt = bytes.fromhex("FF FF 01 02 01 00")
    heard = line.ask(spoilt + make_ping(1) + make_ping(2))
    assert [status.servo_id for status in iter_status(heard)] == [1, 2]


def test_a_packet_may_come_in_pieces_with_pauses() -> None:
    line = Line([1_000_000])
    request = make_read(1, 56, 2)
    heard = b"".join(line.ask(request[at : at + 1]) for at in range(len(request)))
    assert [status.servo_id for status in iter_status(heard)] == [1]


def test_an_answer_is_heard_at_the_rate_the_host_has_when_it_comes() -> None:
    line = Line([1_000_000])
    line.device.receive(make_ping(1), 0.0)
    line.rate = 500_000
    heard = b"".join(data for _, data in _drain(line.device, 1.0))
    assert heard
    assert heard != make_status(1)


def test_a_new_rate_counts_at_once_and_is_acknowledged_at_the_old_one() -> None:
    line = Line([1_000_000])
    code = Series.STS_SMS.register("baud_code").address
    assert line.ask(make_write(1, code, b"\x03")) == make_status(1)
    assert line.ask(make_ping(1)) == b""
    line.rate = 128_000
    assert line.ask(make_ping(1)) == make_status(1)


def test_a_lone_servo_answers_a_broadcast_ping_and_several_collide() -> None:
    assert Line([1_000_000]).ask(make_ping(BROADCAST_ID)) == make_status(1)
    heard = Line([1_000_000] * 6).ask(make_ping(BROADCAST_ID))
    assert heard
    assert len(heard) < 6 * 6
    assert list(iter_status(heard)) == []
    # Whoever is at another rate does not take part.
    assert Line([1_000_000, 500_000]).ask(make_ping(BROADCAST_ID)) == make_status(1)


def test_an_adapter_that_hears_itself_repeats_what_is_no_packet() -> None:
    line = Line([1_000_000], echo=True)
    assert line.ask(b"hello") == b"hello"
    line.rate = 115_200
    assert line.ask(b"hello") == b"hello"


def test_echo_and_reset() -> None:
    device = BusDevice(make_servos([Series.STS_SMS], [1]), echo=True, paced=True)
    device.receive(make_ping(1), 0.0)
    heard = b"".join(data for _, data in _drain(device, 1.0))
    assert heard.startswith(make_ping(1))
    assert len(heard) == 12
    device.receive(make_ping(1), 2.0)
    device.reset(2.0)
    assert device.data_to_send() == b""
    assert device.next_event_time() is not None


def test_series_and_ids_must_agree() -> None:
    kinds = [servo.series for servo in make_servos([Series.SCS, Series.HLS], [3, 4])]
    assert kinds == [Series.SCS, Series.HLS]
    with pytest.raises(UsageError, match="2 series"):
        make_servos([Series.SCS, Series.HLS], [3, 4, 5])
    with pytest.raises(UsageError, match="2 rates"):
        make_servos([Series.SCS], [3, 4, 5], baud=[1_000_000, 500_000])
    with pytest.raises(UsageError, match="115200"):
        make_servos([Series.SCS], [3], baud=9600)
