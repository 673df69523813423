from __future__ import annotations

import itertools

from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.uart import heard_at, listen, same_rate
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import iter_packets, iter_status, make_ping, make_status

RATES = sorted(Series.STS_SMS.baud_codes.values())


@given(st.binary(max_size=40), st.sampled_from(RATES), st.floats(0.975, 1.025))
def test_a_rate_that_is_a_little_off_is_understood(data: bytes, sent: int, off: float) -> None:
    heard = round(sent * off)
    assert same_rate(sent, heard)
    assert heard_at(data, sent, heard) == data
    assert listen([(data, 3.0)], sent, heard) == data


def test_bytes_at_another_rate_are_the_wrong_bytes_of_a_real_line() -> None:
    # At half the rate each bit is seen twice, the start bit too: FF begins with one 0 more.
    assert heard_at(b"\xff", 500_000, 1_000_000) == b"\xfe"
    assert heard_at(b"\xff", 250_000, 1_000_000) == b"\xf8"
    # Nearly nine times slower: the byte is over before the start bit is.
    assert heard_at(b"\xff", 115_200, 1_000_000) == b"\x00"
    assert heard_at(b"\x00", 115_200, 1_000_000, whole=True) == b""
    # Much faster: pulses too short for a start bit, then nothing or little.
    assert len(heard_at(make_ping(1), 1_000_000, 115_200)) <= 1
    assert heard_at(b"", 1_000_000, 115_200) == b""


def test_no_ping_and_no_answer_survives_another_rate() -> None:
    """All the rates that servos have are far enough apart."""
    for sent, heard, servo_id in itertools.product(RATES, RATES, range(254)):
        request, answer = make_ping(servo_id), make_status(servo_id)
        where = f"servo {servo_id} at {sent} heard at {heard} baud"
        assert bool(list(iter_packets(heard_at(request, sent, heard, whole=True)))) is (sent == heard), where
        assert bool(list(iter_status(heard_at(answer, sent, heard, whole=True)))) is (sent == heard), where


@given(st.binary(min_size=1, max_size=20), st.binary(min_size=1, max_size=20))
def test_senders_in_step_overlay_bit_by_bit(one: bytes, other: bytes) -> None:
    short = min(len(one), len(other))
    both = bytes(a & b for a, b in zip(one, other, strict=False))
    assert listen([(one, 0.0), (other, 0.0)], 115_200) == both + one[short:] + other[short:]
    assert listen([(one, 0.0), (one, 0.0)], 115_200) == one


@given(st.binary(max_size=20), st.binary(max_size=20), st.floats(0, 1e-3))
def test_senders_out_of_step_are_survived(one: bytes, other: bytes, later: float) -> None:
    heard = listen([(one, 0.0), (other, later)], 115_200)
    assert len(heard) <= len(one) + len(other)
