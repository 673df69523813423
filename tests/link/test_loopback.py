"""A plug that returns everything, one that damages it, and none at all; in simulated time."""

from __future__ import annotations

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
