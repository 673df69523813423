"""`Link.exchange`: a request and the first bytes that come back, over every kind of link."""

from __future__ import annotations

import threading
import time

import pytest

from hexwire.errors import LinkClosedError, LinkLostError
from hexwire.link.base import LinkKind
from hexwire.link.memory import memory_pair


@pytest.mark.parametrize("kind", list(LinkKind))
def test_a_request_and_its_answer(kind: LinkKind) -> None:
    one, other = memory_pair(kind)
    with one, other:
        answers = threading.Thread(target=lambda: other.write(b"<" + other.read(None) + b">"))
        answers.start()
        assert one.exchange(b"ask", 5.0) == b"<ask>"
        answers.join()


@pytest.mark.parametrize("kind", list(LinkKind))
def test_nothing_comes(kind: LinkKind) -> None:
    one, other = memory_pair(kind)
    with one, other:
        assert one.exchange(b"ask", 0.01) == b""
        assert other.read(0.0) == b"ask"


def test_what_had_come_before_comes_first() -> None:
    one, other = memory_pair()
    with one, other:
        other.write(b"old")
        assert one.exchange(b"ask", 1.0) == b"old"


def test_a_line_that_takes_its_time_to_be_written() -> None:
    one, other = memory_pair(capacity=4096)
    request = bytes(1 << 18)
    with one, other:
        got = bytearray()

        def drain() -> None:
            while len(got) < len(request):
                got.extend(other.read(None))
            other.write(b"done")

        reader = threading.Thread(target=drain)
        reader.start()
        assert one.exchange(request, 5.0) == b"done"
        reader.join()
        assert bytes(got) == request


def test_closed_and_lost() -> None:
    one, other = memory_pair()
    with pytest.raises(LinkClosedError):
        one.exchange(b"ask", 0.01)
    one.open()
    other.open()
    other.close()
    with pytest.raises(LinkLostError):
        one.exchange(b"ask", 5.0)
    assert not one.is_open
    one.close()


def test_closing_ends_it() -> None:
    one, other = memory_pair()
    one.open()
    with other:
        timer = threading.Timer(0.05, one.close)
        timer.start()
        with pytest.raises(LinkClosedError):
            one.exchange(b"ask", 30.0)
        timer.join()


def test_it_takes_its_turn_behind_another_reader() -> None:
    one, other = memory_pair()
    with one, other:
        first: list[bytes] = []
        reader = threading.Thread(target=lambda: first.append(one.read(None)))
        reader.start()
        while not one._reading.taken:
            time.sleep(0.001)
        threading.Timer(0.05, lambda: other.write(b"for the reader")).start()
        answer = one.exchange(b"ask", 0.2)
        reader.join()
        assert first == [b"for the reader"]
        assert answer == b""
