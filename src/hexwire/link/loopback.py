"""Loopback test of a cable and adapter: with TX wired to RX, every byte sent must come back.

Owns the patterns, the deadlines and the count of errors. Must not know frames. This test is the chapter's first
advice when nothing works.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from .base import Link

__all__ = ["LoopbackResult", "loopback_patterns", "try_loopback"]

_BITS = 10
_CHUNK = 64
_SLACK = 1.0
"""Seconds beyond the time on the line, for a USB adapter and a busy machine."""


@dataclass(frozen=True, slots=True)
class LoopbackResult:
    """Result at one rate.

    Attributes:
        baud: The rate.
        sent: Bytes sent.
        returned: Bytes received.
        wrong: Bytes received that differ.
        wrong_bits: Bits that differ.
        seconds: Duration.
    """

    baud: int
    sent: int
    returned: int
    wrong: int
    wrong_bits: int
    seconds: float

    @property
    def lost(self) -> int:
        """Bytes that did not come back; negative if more came back than were sent."""
        return self.sent - self.returned

    @property
    def good(self) -> bool:
        """Whether every byte came back unchanged."""
        return not self.wrong and not self.lost

    @property
    def verdict(self) -> str:
        """Description, with what to check."""
        if self.good:
            return "good"
        if not self.returned:
            return "nothing came back: is TX wired to RX, and is this the right port?"
        if self.lost < 0:
            return f"{-self.lost} bytes too many: something else talks on this line"
        words = []
        if self.lost:
            words.append(f"{self.lost} bytes lost")
        if self.wrong:
            words.append(f"{self.wrong} bytes wrong ({self.wrong_bits} bits)")
        return ", ".join(words) + ": a long or loose cable, a missing ground, or a rate the adapter cannot keep"


def loopback_patterns(count: int) -> Iterator[bytes]:
    """Chunks of `count` bytes in total: every byte value, the hardest edges (55, AA, 00, FF), then random bytes."""
    fixed = bytes(range(256)) + b"\x55\xaa" * 32 + b"\x00\xff" * 32
    data = fixed + random.Random(0).randbytes(max(0, count - len(fixed)))
    for at in range(0, min(count, len(data)), _CHUNK):
        yield data[at : min(at + _CHUNK, count)]


def try_loopback(link: Link, baud: int, count: int, clock: Callable[[], float]) -> LoopbackResult:
    """Send patterns over an open link and compare the bytes that come back.

    Args:
        link: Open, at `baud`.
        baud: The rate, for the deadlines.
        count: Bytes to send.
        clock: The clock of the link's deadlines.

    Raises:
        LinkError: The line was lost or accepts no bytes.
    """
    start = clock()
    link.flush_input()
    sent = returned = wrong = wrong_bits = 0
    for chunk in loopback_patterns(count):
        line_time = len(chunk) * _BITS / baud
        link.write(chunk, clock() + line_time + _SLACK)
        sent += len(chunk)
        heard = b""
        deadline = clock() + line_time + _SLACK
        while len(heard) < len(chunk):
            data = link.read(deadline)
            if not data:
                break
            heard += data
        returned += len(heard)
        for a, b in zip(chunk, heard, strict=False):
            if a != b:
                wrong += 1
                wrong_bits += (a ^ b).bit_count()
        if not heard:
            # Nothing at all came back: further chunks would only wait as long again.
            break
    return LoopbackResult(baud, sent, returned, wrong, wrong_bits, clock() - start)
