"""What answers a packet, and which bytes are that answer."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.session.servo_answers import Expected, expected_answer, match_answer
from hexwire.wire import servo_packet as sp


@pytest.mark.parametrize(
    ("packet", "ids", "params"),
    [
        (sp.make_ping(3), (3,), 0),
        (sp.make_ping(0xFE), (0xFE,), 0),
        (sp.make_read(3, 56, 2), (3,), 2),
        (sp.make_read(0xFE, 56, 2), (), 0),
        (sp.make_packet(3, 2), (3,), 0),
        (sp.make_write(3, 42, b"12"), (3,), 0),
        (sp.make_write(0xFE, 40, b"\0"), (), 0),
        (sp.make_reg_write(3, 42, b"12"), (3,), 0),
        (sp.make_action(), (), 0),
        (sp.make_reboot(3), (), 0),
        (sp.make_restore(3), (3,), 0),
        (sp.make_sync_read(56, 2, (4, 5, 6)), (4, 5, 6), 2),
        (sp.make_packet(0xFE, 0x82), (), 0),
        (sp.make_sync_write(42, {1: b"12"}), (), 0),
    ],
)
def test_who_answers(packet: bytes, ids: tuple[int, ...], params: int) -> None:
    expected = expected_answer(sp.parse_packet(packet))
    assert expected == Expected(ids, params)
    assert expected.length == len(ids) * (6 + params)


def test_a_legacy_servo_answers_no_write_but_reads_and_pings() -> None:
    def ids(packet: bytes) -> tuple[int, ...]:
        return expected_answer(sp.parse_packet(packet), acknowledges_writes=False).servo_ids

    assert ids(sp.make_write(3, 42, b"12")) == ids(sp.make_reg_write(3, 42, b"12")) == ids(sp.make_restore(3)) == ()
    assert ids(sp.make_read(3, 56, 2)) == ids(sp.make_ping(3)) == (3,)


READ = sp.make_read(0, 56, 2)
ANSWER = sp.make_status(0, 0, b"\x08\x05", legacy=True)
EXPECTED = Expected((0,), 2)


@given(st.binary(max_size=20).filter(lambda b: 0xFF not in b), st.binary(max_size=20), st.booleans())
def test_the_answer_is_found_behind_noise_and_echo(before: bytes, after: bytes, echo: bool) -> None:
    data = before + (READ if echo else b"") + ANSWER + after
    assert match_answer(data, READ, EXPECTED) == sp.parse_status(ANSWER)


def test_an_echo_alone_is_no_answer() -> None:
    assert match_answer(READ, READ, EXPECTED) is None
    assert match_answer(READ + ANSWER[:-1], READ, EXPECTED) is None
    # Nor is the echo of another read, which may come late.
    assert match_answer(READ, sp.make_read(0, 60, 2), EXPECTED) is None
    assert match_answer(READ + READ + ANSWER, READ, EXPECTED) == sp.parse_status(ANSWER)


def test_wrong_id_length_or_sum_is_no_answer() -> None:
    for data in (
        sp.make_status(1, 0, b"\x08\x05"),
        sp.make_status(0, 0, b"\x08"),
        ANSWER[:-1] + bytes((ANSWER[-1] ^ 1,)),
    ):
        assert match_answer(data, READ, EXPECTED) is None
    assert match_answer(ANSWER, sp.make_action(), Expected((), 0)) is None


@given(st.binary(max_size=60), st.binary(max_size=12), st.integers(0, 255), st.integers(0, 20))
def test_never_raises(data: bytes, request_: bytes, servo_id: int, params: int) -> None:
    found = match_answer(data, request_, Expected((servo_id,), params))
    assert found is None or (found.servo_id, len(found.params)) == (servo_id, params)


@given(st.integers(0, 254), st.integers(0, 255), st.binary(max_size=30))
def test_any_packet_has_an_expectation(servo_id: int, instruction: int, params: bytes) -> None:
    expected = expected_answer(sp.ServoPacket(servo_id, instruction, params))
    assert expected.length >= 0


@pytest.mark.parametrize(
    "request_", [sp.make_ping(1), sp.make_write(1, 40, b"\1"), sp.make_packet(1, 3, bytes(4)), sp.make_restore(1)]
)
def test_the_request_itself_is_no_answer_to_it(request_: bytes) -> None:
    params = len(request_) - 6
    assert match_answer(request_, request_, Expected((1,), params)) is None
    answer = sp.make_status(1, 0, bytes(params))
    assert match_answer(request_ + answer, request_, Expected((1,), params)) == sp.parse_status(answer)


def test_what_a_short_packet_asks_for() -> None:
    assert expected_answer(sp.ServoPacket(3, 2, b"\x38\5")) == Expected((3,), 5)
    assert expected_answer(sp.ServoPacket(3, 2, b"\x38")) == Expected((3,), 0)
    assert expected_answer(sp.ServoPacket(254, 0x82, b"\x38\5")) == Expected((), 5)
    assert expected_answer(sp.ServoPacket(254, 0x82, b"\x38")) == Expected((), 0)
    assert expected_answer(sp.ServoPacket(254, 0x82, b"\x38\5\1")) == Expected((1,), 5)
