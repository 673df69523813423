from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.session.servo_answers import AnswerCollector, Outlook, is_read_echo
from hexwire.wire.servo_packet import make_ping, make_read, make_status, make_sync_read, make_write

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


READ = make_read(1, 56, 2)
ANSWER = make_status(1, 0, b"\x05\x06")


def read(data: bytes, *, sent: tuple[bytes, ...] = (), header: bytes | None = None) -> AnswerCollector:
    collector = AnswerCollector(READ, (1,), 2, sent=sent, header=header)
    collector.receive(data)
    return collector


@pytest.mark.parametrize("copies", [1, 2, 3])
@pytest.mark.parametrize("behind", [b"", READ, make_read(1, 42, 2)])
def test_no_copy_of_the_request_is_an_answer(copies: int, behind: bytes) -> None:
    assert read(READ * copies).answers == {}
    assert read(READ * copies).only_echo
    assert read(READ * copies + ANSWER + behind).answers[1].params == b"\x05\x06"


def test_the_echo_of_any_read_is_no_answer_but_says_that_one_may_have_come() -> None:
    for address in range(256):
        for count in (1, 2, 15, 244):
            assert read(make_read(1, address, count)).answers == {}
    assert read(READ).copies == {1}
    assert read(make_read(2, 56, 2)).copies == set()
    # Error 2 and a value whose second byte is 0 is nobody's read.
    assert read(make_status(1, 2, b"\x38\x00")).answers[1].error == 2


def test_a_recently_sent_packet_is_never_an_answer() -> None:
    ping, write = make_ping(1), make_write(1, 40, b"\x01")
    pinged = AnswerCollector(make_write(1, 42, b"\0\0"), (1,), 0, sent=(ping,))
    pinged.receive(ping)
    assert pinged.answers == {}
    assert pinged.copies == {1}
    assert read(write, sent=(write,)).answers == {}
    assert read(write).answers[1].error == 3
    # The second byte of the header is not in the checksum: damaged, it makes a legacy answer of an echo.
    assert read(b"\xff\xf5" + READ[2:]).answers == {}


def test_the_header_must_be_that_of_the_servo() -> None:
    legacy = make_status(1, 0, b"\x05\x06", legacy=True)
    assert read(legacy, header=b"\xff\xf5").answers
    assert not read(legacy, header=b"\xff\xff").answers
    assert not read(ANSWER, header=b"\xff\xf5").answers
    assert read(READ, header=b"\xff\xf5").copies == set()


def spliced(count: int) -> bytes:
    """Answers of servos 1 and 2, of which the first lacks so many bytes that the second makes up for by chance."""
    for value in range(1 << 16):
        first = make_status(1, 0, value.to_bytes(2, "little"))
        second = make_status(2, 0, b"\x07\x08")
        stream = first[: 8 - count] + second
        if sum(stream[2:8]) & 0xFF == 0xFF:
            return stream
    raise AssertionError("no such value")


@pytest.mark.parametrize("count", [1, 2])
def test_a_packet_that_took_in_the_beginning_of_the_next_is_murky(count: int) -> None:
    collector = AnswerCollector(make_sync_read(56, 2, (1, 2)), (1, 2), 2)
    collector.receive(spliced(count))
    assert 1 not in collector.answers
    assert 1 in collector.murky


def test_an_answer_before_a_damaged_one_is_sound() -> None:
    damaged = bytearray(b"".join(ANSWERS))
    damaged[13] ^= 1
    collector = AnswerCollector(REQUEST, IDS, 2)
    collector.receive(bytes(damaged))
    assert set(collector.answers) == {1, 3}


def test_two_answers_of_one_servo_that_differ_are_none() -> None:
    other = make_status(1, 0, b"\x05\x07")
    assert read(ANSWER + other).answers == {}
    assert read(ANSWER + ANSWER).answers[1].params == b"\x05\x06"


def test_answers_known_by_another_length_are_kept_apart() -> None:
    longer = make_status(1, 0, b"\x05\x06\x07")
    collector = read(longer)
    assert collector.answers == {}
    assert collector.others[1, 3].params == b"\x05\x06\x07"
    assert [status.servo_id for status in collector.strays] == [1]


@given(
    st.lists(st.sampled_from([READ, make_read(1, 42, 2), make_ping(1), make_read(2, 56, 2)]), max_size=4),
    st.integers(0, 0xFFFF),
    st.lists(st.integers(1, 9), max_size=30),
    st.binary(max_size=6).filter(lambda b: 0xFF not in b),
)
def test_any_echoes_in_any_pieces_give_the_value_and_nothing_else(
    echoes: list[bytes], value: int, cuts: list[int], noise: bytes
) -> None:
    answer = make_status(1, 0, value.to_bytes(2, "little"))
    stream = noise + b"".join(echoes) + answer
    collector = AnswerCollector(READ, (1,), 2, sent=(make_ping(1),))
    at = 0
    for cut in [*cuts, len(stream)]:
        collector.receive(stream[at : at + cut])
        at += cut
        assert at >= len(stream) or collector.answers == {}
    assert collector.answers[1].params == value.to_bytes(2, "little")


@pytest.mark.parametrize("echo", [False, True])
def test_the_wait_lasts_until_there_are_enough_bytes_for_every_answer(echo: bool) -> None:
    """Without the echo that is expected, as many bytes more may be its damaged remains."""
    more = len(REQUEST) if echo else 0
    for heard, wanted in ((b"", 24 + more), (REQUEST, 24)):
        collector = AnswerCollector(REQUEST, IDS, 2, echo=echo)
        assert collector.receive(heard) is Outlook.WAIT
        assert collector.echoed == bool(heard)
        assert collector.receive(bytes(wanted - 1)) is Outlook.WAIT
        assert collector.receive(b"\0") is Outlook.LINGER
        assert collector.size == len(heard) + wanted


@pytest.mark.parametrize(
    ("heard", "due", "missing"),
    [((), 3, IDS), ((1,), 2, (2, 3)), ((1, 2), 1, (3,)), ((2,), 1, (1, 3)), ((3,), 0, (1, 2))],
)
def test_who_may_still_answer(heard: tuple[int, ...], due: int, missing: tuple[int, ...]) -> None:
    collector = AnswerCollector(REQUEST, IDS, 2)
    collector.receive(b"".join(ANSWERS[i - 1] for i in heard))
    assert (collector.due, collector.missing) == (due, missing)


def test_a_packet_to_no_servo_waits_for_no_answer() -> None:
    assert AnswerCollector(make_write(254, 40, b"\1"), (), 0).receive(b"") is Outlook.DONE


def test_what_came_instead_in_words() -> None:
    collector = read(make_status(7, 0, b"\1\2") + make_status(9, 0, b"\1\2") + make_status(7, 0, b""))
    assert collector.in_words() == "an answer of servo 7, 9"
    assert (
        read(bytes(range(1, 21))).in_words() == f"20 bytes that are not an answer: {bytes(range(1, 17)).hex(' ')}"
    )
    assert read(make_status(1, 0, b"\5")).in_words().startswith("7 bytes that are not an answer: ff ff 01")


def test_a_packet_to_all_servos_is_an_echo() -> None:
    collector = read(make_write(254, 40, b"\1"))
    assert collector.only_echo
    assert collector.strays == []


def test_if_every_sent_read_is_known_any_other_packet_is_an_answer() -> None:
    looks_like_a_read = make_read(1, 42, 2)
    for all_sent, found in ((True, {1}), (False, set())):
        collector = AnswerCollector(READ, (1,), 2, all_sent=all_sent)
        collector.receive(looks_like_a_read)
        assert set(collector.answers) == found
        assert collector.copies == {1} - found


@pytest.mark.parametrize(
    ("packet", "is_one"),
    [
        (make_read(1, 0, 1), True),
        (make_status(1, 2, b"\x38\0"), False),
        (make_status(1, 1, b"\x38\2"), False),
        (make_status(1, 2, b"\x38\2\0"), False),
        (make_status(1, 2, b"\x38"), False),
    ],
)
def test_what_may_be_the_echo_of_a_read(packet: bytes, is_one: bool) -> None:
    assert is_read_echo(packet) is is_one


@pytest.mark.parametrize(
    ("behind", "sound"),
    [
        (b"", True),
        (ANSWERS[1], True),
        (ANSWERS[1][:4], True),  # the next answer begins, whatever becomes of it
        (b"\xff\xf5" + ANSWERS[1][2:4], True),
        (ANSWERS[1][:3], False),
        (b"\xff\xfe" + ANSWERS[1][2:4], False),
        (ANSWERS[0][:4], False),  # its own once more
        (make_status(9, 0, b"\1\2")[:4], False),  # of one that was not asked
        (make_status(2, 0, b"\1")[:4], False),  # of another length
        (b"\0", False),
    ],
)
def test_an_answer_counts_by_what_stands_behind_it(behind: bytes, sound: bool) -> None:
    collector = AnswerCollector(REQUEST, IDS, 2)
    collector.receive(ANSWERS[0] + behind)
    assert (1 in collector.answers) is sound
    assert (1 in collector.murky) is not sound
