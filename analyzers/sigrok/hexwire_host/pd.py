# SPDX-License-Identifier: GPL-2.0-or-later
"""sigrok decoder of the host link. Frames and their words are reading.py's; here are the annotations."""

from .line import Line
from .reading import HEAD_SIZE, u16
from .tables import TABLES

FRAME, BAD, GARBAGE, HAZARD, TIME, PART, LINE = range(7)
MOST_OPEN = 64  # requests whose answer may still come
WAYS = ("RX", "TX")


class Decoder(Line):
    id = "hexwire_host"
    name = "hexwire host"
    longname = "hexwire host link"
    desc = "Command frames between a host and a robot controller."
    outputs = ["hexwire_host"]
    annotations = (
        ("frame", "Frame"),
        ("bad", "Bad frame"),
        ("garbage", "Bytes of no frame"),
        ("hazard", "Hazard"),
        ("time", "Time to the answer"),
        ("part", "Part of a frame"),
        ("line", "Fault of the line"),
    )
    annotation_rows = (
        ("parts", "Parts", (PART,)),
        ("frames", "Frames", (FRAME, BAD, GARBAGE)),
        ("times", "Times", (TIME,)),
        ("warnings", "Warnings", (HAZARD, LINE)),
    )
    binary = (("frames", "Frames"),)

    line = "host"
    silence = 0.050  # seconds after which an unfinished frame is given up
    fault, faults = LINE, "noise, or another baud rate"

    def reset(self):
        super().reset()
        self.ends = {}

    def show(self, reading, ss, es):
        words = f"{WAYS[reading.way]}: {reading.text}"
        kind = {"frame": FRAME, "bad": BAD}.get(reading.kind, GARBAGE)
        text, _, hazard = reading.text.partition(" ! ")
        self.put(ss, es, self.out_ann, [kind, [words, text, text[:16], text[:1]]])
        if hazard:
            self.put(ss, es, self.out_ann, [HAZARD, [hazard, "hazard", "!"]])
        if reading.kind == "frame":
            self.put(ss, es, self.out_binary, [0, reading.data])
            self.parts(reading)
            self.time(reading, ss, es)

    def parts(self, reading):
        data = reading.data
        length = u16(data, 36)
        parts = (
            (0, 4, "sync"),
            (4, 12, f"time {_u32(data, 4)}.{_u32(data, 8):09d} s"),
            (12, 16, f"sn {_u32(data, 12)}"),
            (16, 20, "from " + _module(data, 16)),
            (20, 24, "to " + _module(data, 20)),
            (24, 28, f"type {_u32(data, 24)}"),
            (28, 32, f"size {_u32(data, 28)}"),
            (32, HEAD_SIZE, "command header"),
            (HEAD_SIZE, HEAD_SIZE + length, "body"),
            (HEAD_SIZE + length, HEAD_SIZE + length + 2, f"check {u16(data, HEAD_SIZE + length):04X}"),
            (len(data) - 2, len(data), "tail"),
        )
        for start, end, text in parts:
            if end > start:
                ss, es = self.span(reading, start, end)
                self.put(ss, es, self.out_ann, [PART, [text, text.split()[0]]])

    def time(self, reading, ss, es):
        if reading.answers is None:
            self.ends[reading.way, reading.start] = es
            while len(self.ends) > MOST_OPEN:
                del self.ends[next(iter(self.ends))]
            return
        asked = self.ends.pop((reading.answers.way, reading.answers.start), None)
        if asked is not None and self.samplerate and ss > asked:
            took = f"{(ss - asked) / self.samplerate * 1000:.3f} ms"
            self.put(asked, ss, self.out_ann, [TIME, ["answer after " + took, took]])


def _u32(data, at):
    return int.from_bytes(data[at : at + 4], "little")


def _module(data, at):
    number = int.from_bytes(data[at : at + 4], "little", signed=True)
    return TABLES["modules"].get(number, f"module {number}")
