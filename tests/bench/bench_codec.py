"""Decoding rates, each beside a bare lower bound in the same run.

The bare loop unpacks and slices the same bytes at known places and checks nothing. Both take their turn in each
round, so that a stall of the machine hits both; the figures are medians over rounds.
"""

from __future__ import annotations

import random
import statistics
import struct
import time
from collections.abc import Callable

from hexwire.session.decoder import FrameDecoder
from hexwire.wire.command_frame import Command, Frame, serialize_frame
from hexwire.wire.commands import JointReport
from hexwire.wire.servo_packet import iter_status, make_read, make_status

_ROUNDS = 9
_FRAMES = 10_000
_PACKETS = 40_000
_NOISE = 2_000_000
_READ = 4096
"""Bytes of one read from a link."""
_SERVO_HEAD = struct.Struct("<HBBB")
_FRAME_HEAD = struct.Struct("<IIIIiiiIBBBBHBB")


def run() -> list[str]:
    """Measure; returns the lines to print."""
    dialect1 = _frame(1, Command.READ, make_read(0, 0x38, 2))
    seven = tuple(range(2047, 2054))
    report = JointReport(1000, 0, seven, (64,) * 7, *([(1,) * 7] * 6))
    dialect2 = _frame(2, Command.JOINT_STATE, report.serialize())
    # Every status packet a little different, as a bus has them.
    packets = [make_status(i % 7, 0, (2000 + i % 100).to_bytes(2, "little"), legacy=i % 7 < 4) for i in range(700)]
    noise = random.Random(1).randbytes(_NOISE)
    return [
        _frames("dialect-1 frames", dialect1),
        _frames("dialect-2 frames", dialect2),
        _servo_packets(b"".join(packets) * (_PACKETS // 700), len(packets[0])),
        _noise("pure noise", noise),
        _noise("nothing but sync words", b"\x5a\xfa\xfa\x5a" * (_NOISE // 40)),
    ]


def _frame(proto: int, cmd: int, body: bytes) -> bytes:
    return serialize_frame(
        Frame(
            proto=proto, cmd=cmd, body=body, seq=1, sn=1, src=8, dst=7, type=8, time_sec=14, time_nsec=356_000_000
        )
    )


def _frames(name: str, frame: bytes) -> str:
    size, stream = len(frame), frame * _FRAMES
    reads = [stream[i : i + _READ] for i in range(0, len(stream), _READ)]

    def decode() -> int:
        decoder = FrameDecoder()
        count = 0
        for data in reads:
            decoder.receive(data, 0.0)
            while decoder.next_event() is not None:
                count += 1
        return count

    def bare() -> int:
        count = 0
        for at in range(0, len(stream), size):
            head = _FRAME_HEAD.unpack_from(stream, at)
            body = stream[at + 40 : at + 40 + head[12]]
            count += bool(body)
        return count

    full, least = _measure(decode, bare, _FRAMES)
    return f"{name} of {size} bytes decoded: {_FRAMES / full:>12,.0f} /s, {full / least:.1f} x bare"


def _servo_packets(stream: bytes, size: int) -> str:
    total = len(stream) // size

    def parse() -> int:
        return sum(1 for _ in iter_status(stream))

    def bare() -> int:
        count = 0
        for at in range(0, len(stream), size):
            head = _SERVO_HEAD.unpack_from(stream, at)
            params = stream[at + 5 : at + 3 + head[2]]
            count += bool(params)
        return count

    full, least = _measure(parse, bare, total)
    return f"servo packets of {size} bytes parsed: {total / full:>12,.0f} /s, {full / least:.1f} x bare"


def _noise(name: str, noise: bytes) -> str:
    def scan() -> int:
        decoder = FrameDecoder()
        for at in range(0, len(noise), _READ):
            decoder.receive(noise[at : at + _READ], 0.0)
            while decoder.next_event() is not None:
                pass
        return decoder.counters.bytes_received

    def bare() -> int:
        return sum(len(noise[at : at + _READ]) for at in range(0, len(noise), _READ))

    full, least = _measure(scan, bare, len(noise))
    return f"bytes of {name} scanned: {len(noise) / full:>12,.0f} /s, {full / least:.1f} x bare"


def _measure(full: Callable[[], int], bare: Callable[[], int], expected: int) -> tuple[float, float]:
    """Median seconds of each, after one round to warm up; both must count what there is."""
    times: tuple[list[float], list[float]] = ([], [])
    for round_ in range(_ROUNDS + 1):
        for run_, kept in zip((full, bare), times, strict=True):
            start = time.perf_counter()
            count = run_()
            took = time.perf_counter() - start
            if count != expected:
                raise AssertionError(f"{count} counted, {expected} are there")
            if round_:
                kept.append(took)
    return statistics.median(times[0]), statistics.median(times[1])
