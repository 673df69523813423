"""How the time to explain a file grows with its length, for files made to be slow: it must double with the length.

Every kind is explained as `hexwire trace decode` does it, printing left out. The times are the processor's, so that
other work on the machine does not show. The last column is the time of the
longest file over that of one half as long: 2 is linear, 4 would be the square.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable

from tests.frames import frame_bytes

from hexwire.trace.explain import Explainer
from hexwire.trace.sources import read_traffic
from hexwire.wire.command_frame import Command
from hexwire.wire.servo_packet import make_status

_MEGABYTES = (1, 2, 4, 8)
_SYNC = b"\x5a\xfa\xfa\x5a"


def run() -> list[str]:
    """Measure; returns the lines to print."""
    lines = [f"{'seconds for a file of':30}" + "".join(f"{f'{n} MB':>9}" for n in _MEGABYTES) + "    ratio"]
    for name, make in _kinds().items():
        spent = [_decode(make(n * 1_000_000)) for n in _MEGABYTES]
        lines.append(f"{name:30}" + "".join(f"{t:9.2f}" for t in spent) + f"{spent[-1] / spent[-2]:9.1f}")
    return lines


def _kinds() -> dict[str, Callable[[int], bytes]]:
    frame = frame_bytes(Command.STATS)
    return {
        "blanks": _filled(b" ", end=b"x"),
        "blanks in lines of 3 kB": _filled(b" " * 3000 + b"x\n"),
        "blanks behind hex": _filled(b" ", begin=b"FF FF", end=b"x"),
        "digits": _filled(b"1"),
        "a log with one huge line": _filled(b"5A ", begin=b"SerialPort sent - Length=999999999\n"),
        "hex in one huge line": _filled(b"5A FA FA 5A "),
        "words in lines": _filled(b"no hex, no log\n"),
        "sync words": _filled(_SYNC, end=b"\0"),
        "half headers": _filled(frame[:28] + _SYNC, end=b"\0"),
        "sound frames": _filled(frame),
        "frames that are cut": _filled(frame[:-1], end=b"\0"),
        "frames whose check lies": _filled(frame[:-4] + b"\1\2" + frame[-2:]),
        "lengths that lie": _filled(_lying(44)),
        "lengths that lie, nested": _filled(_lying(186 * 44)),
        "FF": _filled(b"\xff", end=b"\0"),
        "FF FF and a length that lies": _filled(b"\xff\xff\x01\xfa\x00\x00"),
        "FF F5": _filled(b"\xff\xf5", end=b"\0"),
        "FF F5 and nothing": _filled(b"\xff\xf5\x00\x00"),
        "sound servo packets": _filled(make_status(1, 0, bytes(20)), end=b"\0"),
        "noise": random.Random(1).randbytes,
        "noise on a bus": lambda n: b"\xff\xff\x01" + random.Random(1).randbytes(n - 3),
    }


def _filled(piece: bytes, *, begin: bytes = b"", end: bytes = b"") -> Callable[[int], bytes]:
    def make(size: int) -> bytes:
        room = size - len(begin) - len(end)
        return begin + piece * (room // len(piece)) + end

    return make


def _lying(size: int) -> bytes:
    """A frame's beginning whose length says `size`, and that is followed by the next one right away."""
    length = size - 44
    head = bytearray(frame_bytes(Command.STATS)[:40])
    head[28:32] = size.to_bytes(4, "little")
    head[36:38] = length.to_bytes(2, "little")
    # 44 bytes a piece: 0D 0A stands where a length of so many pieces has its tail.
    return bytes(head) + (b"\r\n" * 2)


def _decode(data: bytes) -> float:
    began = time.process_time()
    explainer = Explainer()
    for item in read_traffic(data):
        if not isinstance(item, str):
            for _ in explainer.feed(item):
                pass
    for _ in explainer.finish():
        pass
    return time.process_time() - began
