from __future__ import annotations

from pathlib import Path

import pytest

from hexwire.errors import LinkLostError, LinkTimeoutError
from hexwire.link.base import Link, LinkKind
from hexwire.link.memory import memory_pair
from hexwire.testing.link import LinkConformance, in_a_moment, soon


class TestMemoryStream(LinkConformance):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        return memory_pair()


class TestMemoryDatagram(LinkConformance):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        return memory_pair(LinkKind.DATAGRAM, max_message=2000)


def test_bytes_wait_for_the_end_that_opens_later() -> None:
    near, far = memory_pair()
    with near:
        near.write(b"early", soon())
        with far:
            assert far.read(soon()) == b"early"


def test_an_end_that_closes_unmet_leaves_no_half_open() -> None:
    near, far = memory_pair()
    with near:
        near.write(b"nobody hears this", soon())
    with far, near:
        assert far.read(in_a_moment()) == b""
        near.write(b"x", soon())
        assert far.read(soon()) == b"x"


def test_what_was_written_before_closing_still_arrives() -> None:
    near, far = memory_pair()
    with far:
        with near:
            near.write(b"last words", soon())
        # The other end was not open when near closed and opens onto a fresh line.
        assert far.read(soon()) == b"last words"
        with pytest.raises(LinkLostError):
            far.read(soon())


def test_capacity_bounds_what_waits() -> None:
    near, far = memory_pair(capacity=4096)
    with near, far:
        with pytest.raises(LinkTimeoutError, match="of 1000000 bytes"):
            near.write(bytes(1_000_000), in_a_moment())
        assert 0 < far.flush_input() < 100_000


def test_an_exchange_of_messages_goes_on_until_all_is_there() -> None:
    near, far = memory_pair(LinkKind.DATAGRAM)
    with near, far:
        for message in (b"ab", b"cd", b"ef"):
            far.write(message, soon())
        assert near.exchange(b"request", 5.0, lambda data: 5.0 if len(data) < 4 else 0.0) == b"abcd"
        assert far.read(soon()) == b"request"
        assert near.read(soon()) == b"ef"


def test_pairs_have_addresses_of_their_own() -> None:
    first, second = memory_pair(), memory_pair()
    assert len({link.url for link in (*first, *second)}) == 4
