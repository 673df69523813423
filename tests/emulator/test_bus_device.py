from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.bus_device import BusDevice, make_servos
from hexwire.errors import UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import iter_status, make_ping, make_read, make_sync_read


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
    assert len(device._input) <= 4096


def test_a_servo_at_another_rate_does_not_hear() -> None:
    rate = [1_000_000]
    device = BusDevice(make_servos([Series.STS_SMS], [1], baud=115200), paced=True, host_baud=lambda: rate[0])
    device.receive(make_ping(1), 0.0)
    assert device.answer_due is None
    rate[0] = 115200
    device.receive(make_ping(1), 1.0)
    assert device.answer_due == pytest.approx(1.0 + 12 * 10 / 115200 + 250e-6, abs=1e-4)


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
    with pytest.raises(UsageError, match="115200"):
        make_servos([Series.SCS], [3], baud=9600)
