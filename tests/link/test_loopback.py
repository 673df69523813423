"""A plug that returns everything, one that damages it, and none at all; in simulated time."""

from __future__ import annotations

import pytest

from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.link.loopback import LoopbackResult, loopback_patterns, try_loopback


class Plug:
    """TX wired to RX, through `spoil`."""

    def __init__(self, spoil: object = None) -> None:
        self._spoil = spoil
        self._held = b""

    def receive(self, data: bytes, now: float) -> None:
        self._held += data if self._spoil is None else self._spoil(data)  # type: ignore[operator]  # a callable

    def step(self, now: float) -> None:
        pass

    def data_to_send(self) -> bytes:
        held, self._held = self._held, b""
        return held

    def next_event_time(self) -> float | None:
        return None

    def reset(self, now: float) -> None:
        pass


def run(plug: Plug, baud: int = 115200, count: int = 1000) -> LoopbackResult:
    clock = FakeClock()
    with BoardLink(plug, clock, baud=baud) as link:
        return try_loopback(link, baud, count, clock)


def test_patterns_hold_every_byte_and_the_asked_length() -> None:
    data = b"".join(loopback_patterns(1000))
    assert len(data) == 1000
    assert set(data) == set(range(256))
    assert len(b"".join(loopback_patterns(64))) == 64


def test_a_good_plug_at_the_lines_own_time() -> None:
    result = run(Plug())
    assert result.good
    assert (result.sent, result.returned, result.wrong, result.verdict) == (1000, 1000, 0, "good")
    # Out and back, 10 bits a byte each way.
    assert 1000 * 10 / 115200 <= result.seconds <= 2.2 * 1000 * 10 / 115200


def test_a_flipped_bit_in_every_chunk_is_counted() -> None:
    result = run(Plug(lambda data: bytes([data[0] ^ 0x10]) + data[1:]))
    assert not result.good
    assert result.wrong == result.wrong_bits > 0
    assert "bytes wrong" in result.verdict


def test_lost_and_surplus_bytes() -> None:
    lossy = run(Plug(lambda data: data[:-1]), count=256)
    assert lossy.lost > 0
    assert "lost" in lossy.verdict
    talker = run(Plug(lambda data: data + b"!"), count=256)
    assert talker.lost < 0
    assert "something else" in talker.verdict


def test_without_a_plug_it_ends_soon_and_says_so() -> None:
    result = run(Plug(lambda data: b""))
    assert (result.sent, result.returned) == (64, 0)
    assert "TX wired to RX" in result.verdict


def test_the_patterns_themselves() -> None:
    fixed = bytes(range(256)) + b"\x55\xaa" * 32 + b"\x00\xff" * 32
    for count in (1, 63, 64, 65, 256, 383, 384, 385, 1000):
        chunks = list(loopback_patterns(count))
        data = b"".join(chunks)
        assert len(data) == count
        assert data[:384] == fixed[:count]
        assert [len(chunk) for chunk in chunks[:-1]] == [64] * (len(chunks) - 1)
        assert 1 <= len(chunks[-1]) <= 64
    assert list(loopback_patterns(0)) == []
    assert list(loopback_patterns(1000)) == list(loopback_patterns(1000)), "the same every time"


@pytest.mark.parametrize(
    ("returned", "wrong", "bits", "good", "words"),
    [
        (100, 0, 0, True, "good"),
        (0, 0, 0, False, "nothing came back"),
        (101, 0, 0, False, "1 bytes too many"),
        (99, 0, 0, False, "1 bytes lost: a long"),
        (100, 1, 3, False, "1 bytes wrong (3 bits): a long"),
        (98, 1, 3, False, "2 bytes lost, 1 bytes wrong (3 bits): a long"),
    ],
)
def test_the_verdict(returned: int, wrong: int, bits: int, good: bool, words: str) -> None:
    result = LoopbackResult(115200, 100, returned, wrong, bits, 0.1)
    assert (result.lost, result.good) == (100 - returned, good)
    assert result.verdict.startswith(words)


def test_bytes_and_bits_that_differ_are_counted() -> None:
    clock = FakeClock()
    with BoardLink(Plug(lambda data: data[:-1] + bytes([data[-1] ^ 0b101])), clock, baud=115200) as link:
        result = try_loopback(link, 115200, 150, clock)
    assert (result.baud, result.sent, result.returned) == (115200, 150, 150)
    assert (result.wrong_bits / result.wrong, result.lost) == (2, 0)
