from __future__ import annotations

from itertools import islice

from hypothesis import given
from hypothesis import strategies as st

from hexwire.bus.questions import BlockAnswers, places
from hexwire.session.servo_answers import AnswerCollector
from hexwire.wire.servo_packet import make_read, make_status


@given(st.integers(0, 86), st.integers(1, 20), st.integers(1, 100))
def test_places_hold_what_is_wanted_in_every_length_once(address: int, count: int, most: int) -> None:
    found = list(places(address, count, 87, most))
    assert found[0] == (address, count)
    lengths = [length for _, length in found]
    assert lengths == sorted(set(lengths))
    for first, length in found:
        assert 0 <= first <= address
        assert first + length >= address + count
        assert length == count or length <= most
        assert first + length <= max(87, address + count)


def test_places_start_where_the_register_does_while_they_can() -> None:
    assert list(islice(places(56, 2, 71, 246), 3)) == [(56, 2), (56, 3), (56, 4)]
    assert list(islice(places(69, 2, 71, 246), 3)) == [(69, 2), (68, 3), (67, 4)]
    assert list(places(56, 2, 66, 2)) == [(56, 2)]


def attempt(address: int, count: int, heard: bytes) -> AnswerCollector:
    collector = AnswerCollector(make_read(1, address, count), (1,), count)
    collector.receive(heard)
    return collector


def test_a_longer_answer_is_cut_to_what_is_wanted() -> None:
    block = BlockAnswers(56, 2)
    found = block.take(attempt(54, 5, make_status(1, 0x20, b"abcde")), (54, 5))
    assert (found[1].params, found[1].error) == (b"cd", 0x20)


def test_the_answer_to_an_earlier_attempt_will_do_but_that_to_no_attempt_will_not() -> None:
    block = BlockAnswers(56, 2)
    assert block.take(attempt(56, 2, make_status(1, 0, b"abcd")), (56, 2)) == {}
    assert block.take(attempt(56, 3, make_status(1, 0, b"abcd")), (56, 3)) == {}
    assert block.take(attempt(56, 4, make_status(1, 0, b"ab")), (56, 4))[1].params == b"ab"


def test_a_doubtful_answer_must_come_twice() -> None:
    block = BlockAnswers(56, 2)
    assert block.take(attempt(56, 2, make_status(1, 0, b"ab") + b"\0"), (56, 2)) == {}
    assert block.take(attempt(56, 3, make_status(1, 0, b"axy") + b"\0"), (56, 3)) == {}
    assert block.take(attempt(56, 4, make_status(1, 0, b"axcd") + b"\0"), (56, 4))[1].params == b"ax"


def test_an_answer_left_by_an_echoed_attempt_is_taken_from_the_place_of_its_request() -> None:
    block = BlockAnswers(56, 2)
    assert block.take(attempt(54, 4, b""), (54, 4)) == {}
    found = block.take(attempt(56, 2, make_status(1, 0x20, b"wxyz")), (56, 2))
    assert (found[1].params, found[1].error) == (b"yz", 0x20)


def test_murky_bytes_that_differ_count_as_the_first_of_their_kind() -> None:
    block = BlockAnswers(56, 2)
    for heard, sure in ((b"ab", False), (b"cd", False), (b"ab", False), (b"ab", True)):
        assert bool(block.take(attempt(56, 2, make_status(1, 0, heard) + b"\0"), (56, 2))) is sure
