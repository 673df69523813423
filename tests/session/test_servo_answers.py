from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hexwire.session.servo_answers import AnswerCollector, Outlook
from hexwire.wire.servo_packet import make_ping, make_read, make_status, make_sync_read

IDS = (1, 2, 3)
REQUEST = make_sync_read(56, 2, IDS)
ANSWERS = [make_status(i, 0, bytes((i, 9))) for i in IDS]


def test_answers_in_order_end_the_wait() -> None:
    collector = AnswerCollector(REQUEST, IDS, 2)
    assert collector.receive(ANSWERS[0]) is Outlook.WAIT
    assert collector.due == 2
    assert collector.receive(ANSWERS[1] + ANSWERS[2][:3]) is Outlook.WAIT
    assert collector.receive(ANSWERS[2][3:]) is Outlook.DONE
    assert {i: status.params[0] for i, status in collector.answers.items()} == {1: 1, 2: 2, 3: 3}


def test_the_last_answer_ends_the_wait_even_if_one_is_missing() -> None:
    collector = AnswerCollector(REQUEST, IDS, 2)
    assert collector.receive(ANSWERS[0] + ANSWERS[2]) is Outlook.DONE
    assert collector.missing == (2,)


def test_as_many_bytes_as_expected_but_not_all_answers() -> None:
    collector = AnswerCollector(REQUEST, IDS, 2)
    damaged = bytearray(b"".join(ANSWERS))
    damaged[-1] ^= 1
    assert collector.receive(bytes(damaged)) is Outlook.LINGER
    assert collector.missing == (3,)


def test_the_echo_of_a_read_is_no_answer() -> None:
    request = make_read(1, 56, 2)
    collector = AnswerCollector(request, (1,), 2)
    assert collector.receive(request[:5]) is Outlook.WAIT
    assert collector.receive(request[5:]) is Outlook.WAIT
    assert collector.only_echo
    assert collector.in_words() == "only the echo of the request"
    assert collector.receive(make_status(1, 0, b"\x05\x06")) is Outlook.DONE
    assert collector.answers[1].params == b"\x05\x06"


def test_an_answer_of_another_length_or_servo_is_no_answer() -> None:
    collector = AnswerCollector(make_read(1, 56, 2), (1,), 2)
    assert collector.receive(make_status(1, 0, b"\x05")) is Outlook.WAIT
    assert collector.receive(make_status(7, 0, b"\x05\x06")) is not Outlook.DONE
    assert "servo 7" in collector.in_words()
    assert collector.missing == (1,)


def test_nothing_in_words() -> None:
    collector = AnswerCollector(make_ping(1), (1,), 0)
    assert collector.in_words() == ""
    collector.receive(b"\x01\x02")
    assert "2 bytes" in collector.in_words()


@given(st.lists(st.integers(1, 23)), st.binary(max_size=20))
def test_any_split_and_noise_without_markers_gives_all_answers(cuts: list[int], noise: bytes) -> None:
    stream = noise.replace(b"\xff", b"") + b"".join(ANSWERS)
    collector = AnswerCollector(REQUEST, IDS, 2)
    at = 0
    for cut in [*cuts, len(stream)]:
        collector.receive(stream[at : at + cut])
        at += cut
    assert not collector.missing


@given(st.lists(st.binary(max_size=200), max_size=40))
def test_any_bytes_are_answers_or_nothing_and_memory_is_bounded(pieces: list[bytes]) -> None:
    collector = AnswerCollector(REQUEST, IDS, 2)
    for piece in pieces:
        assert collector.receive(piece) in Outlook
    assert set(collector.answers) <= set(IDS)
    assert isinstance(collector.in_words(), str)
    for _ in range(40):
        collector.receive(bytes(4096))
    assert len(collector._data) <= 16 * 1024
