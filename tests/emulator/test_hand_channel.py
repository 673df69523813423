"""Conversations about hands."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.hand import HandOrder, HandResult, Hands
from hexwire.emulator.hand_channel import HandConversation, parse_result, serialize_order
from hexwire.emulator.servo import EmulatedServo
from hexwire.errors import UsageError
from hexwire.wire.registers import Series

ORDER = HandOrder("3", 20.0, 0.3)
LINE = serialize_order(ORDER)


class Talk:
    def __init__(self) -> None:
        self.servo = EmulatedServo(Series.STS_SMS, 3, position=2048)
        self.hands = Hands([self.servo])
        self.talk = HandConversation(self.hands, 0.0)

    @property
    def error(self) -> str:
        return str(json.loads(self.talk.answer)["error"])


def test_an_order_moves_the_hand_and_its_result_follows() -> None:
    it = Talk()
    for byte in LINE:
        it.talk.receive(bytes([byte]), 0.0)
        it.talk.step(0.0)
    it.talk.step(0.2)
    assert it.talk.answer == b""
    it.talk.step(1.0)
    assert parse_result(it.talk.answer) == HandResult("servo 3", pytest.approx(20.0, abs=0.2), False, False)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (b"\n", "not JSON"),
        (b"[]\n", "table"),
        (b"{}\n", "joint"),
        (b"[" * 900 + b"\n", "nested|not JSON"),
        (b"\xff\n", "UTF-8"),
        (LINE.replace(b"20.0", b"NaN"), "finite"),
        (LINE.replace(b"20.0", b"3601"), "3600"),
        (LINE.replace(b"0.3", b"-1"), "seconds"),
        (LINE.replace(b"0.6", b"11"), "force"),
        (LINE.replace(b'"3"', b'"4"'), "no servo '4'; there are 3"),
        (LINE.replace(b'"3"', b"3"), "joint"),
        (LINE.replace(b'"hold"', b'"hodl"'), "hodl|hold"),
        (b"x" * 1001, "at most 1000 bytes"),
    ],
)
def test_anything_else_is_answered_with_one_line_and_moves_nothing(line: bytes, said: str) -> None:
    it = Talk()
    it.talk.receive(line, 0.0)
    it.talk.step(5.0)
    assert it.talk.answer.count(b"\n") == 1
    with pytest.raises(UsageError, match=said):
        parse_result(it.talk.answer)
    assert (it.servo.motion.hand, it.servo.motion.position) == (None, 2048.0)


@given(st.lists(st.binary(max_size=300), max_size=6))
def test_no_bytes_raise_or_move_a_joint(pieces: list[bytes]) -> None:
    it = Talk()
    for count, piece in enumerate(pieces):
        it.talk.receive(piece, count * 0.1)
        it.talk.step(count * 0.1)
    it.talk.step(10.0)
    assert it.error
    assert it.servo.motion.position == 2048.0


def test_a_silent_connection_is_closed() -> None:
    it = Talk()
    it.talk.receive(LINE[:-1], 0.0)
    it.talk.step(1.9)
    assert it.talk.answer == b""
    it.talk.step(2.0)
    assert it.error == "no order came"


def test_only_the_first_order_counts() -> None:
    it = Talk()
    it.talk.receive(LINE + serialize_order(HandOrder("3", -90.0, 0.3)), 0.0)
    it.talk.receive(LINE, 0.1)
    it.talk.step(3.0)
    it.talk.receive(LINE, 3.0)
    assert parse_result(it.talk.answer).moved == pytest.approx(20.0, abs=0.2)
    assert it.servo.motion.hand is None


def test_the_hand_lets_go_if_the_other_side_leaves() -> None:
    it = Talk()
    it.talk.receive(LINE, 0.0)
    it.talk.step(0.1)
    it.talk.end()
    assert it.servo.motion.hand is None
    HandConversation(it.hands, 0.0).end()


def test_orders_and_results_are_checked_on_this_side_too() -> None:
    for wrong in (HandOrder("3", 1e9, 1.0), HandOrder("3", float("nan"), 1.0), HandOrder("x" * 200, 1.0, 1.0)):
        with pytest.raises(UsageError):
            serialize_order(wrong)
    for line in (b"", b"{}", b"[1]", b'{"joint": 3, "moved": 1, "torque": false, "blocked": false}'):
        with pytest.raises(UsageError):
            parse_result(line)
