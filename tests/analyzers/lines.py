"""The analysers' folders, captures of serial lines as a logic analyser makes them, the table of expected readings.

One sample is one byte: bit 0 is the line RX, bit 1 the line TX.
"""

from __future__ import annotations

import atexit
import functools
import json
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
OVERSAMPLING = 8
RX, TX = 0, 1


class Sent(NamedTuple):
    """Bytes on one line from a time on (seconds), at a rate that may be wrong by a factor."""

    way: int
    time: float
    data: bytes
    rate: float = 1.0


@functools.cache
def assembled() -> Path:
    """The analysers' folders as `make analyzers` makes them, from the files as they are now."""
    folder = tempfile.mkdtemp(prefix="hexwire-analyzers-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    command = [sys.executable, str(ROOT / "schema/assemble.py"), folder]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=60)
    return Path(folder)


def readings_table() -> list[dict[str, Any]]:
    return [json.loads(line) for line in (ROOT / "vectors/readings.jsonl").read_text().splitlines()]


def duration(data: bytes, baud: int) -> float:
    return len(data) * 10 / baud


def in_turn(transfers: Sequence[tuple[int, bytes]], baud: int, gap: float) -> list[Sent]:
    """One transfer after the other, `gap` seconds of silence between them."""
    sent, time = [], gap
    for way, data in transfers:
        sent.append(Sent(way, time, data))
        time += duration(data, baud) + gap
    return sent


def samples(traffic: Sequence[Sent], baud: int, *, noise: float = 0.0, seed: int = 1) -> bytes:
    """The capture: 8 samples a bit, the lines idle high. `noise` is the share of samples that are turned over."""
    rate = baud * OVERSAMPLING
    end = max(sent.time + duration(sent.data, baud) / sent.rate for sent in traffic)
    capture = bytearray(b"\x03" * (int(end * rate) + 30 * OVERSAMPLING))
    for sent in traffic:
        bits: list[int] = []
        for byte in sent.data:
            bits += [0, *(byte >> i & 1 for i in range(8)), 1]
        for i, bit in enumerate(bits):
            if bit:
                continue
            first = round(sent.time * rate + i * OVERSAMPLING / sent.rate)
            last = round(sent.time * rate + (i + 1) * OVERSAMPLING / sent.rate)
            for at in range(first, last):
                capture[at] &= ~(1 << sent.way)
    source = random.Random(seed)
    for _ in range(round(noise * len(capture))):
        capture[source.randrange(len(capture))] ^= 1 << source.randrange(2)
    return bytes(capture)


def merged(readings: Sequence[str]) -> list[str]:
    """Readings with neighbouring garbage as one: a tool that gets byte after byte shows it byte after byte."""
    result: list[str] = []
    for text in readings:
        both = [re.fullmatch(r"garbage: (\d+) bytes", each) for each in (*result[-1:], text)]
        if len(both) == 2 and all(both):
            result[-1] = f"garbage: {sum(int(match[1]) for match in both if match)} bytes"
        else:
            result.append(text)
    return result
