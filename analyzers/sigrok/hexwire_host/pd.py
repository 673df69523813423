# SPDX-License-Identifier: GPL-2.0-or-later
# ruff: noqa: RUF012  (class attributes as sigrok wants them)
"""sigrok decoder of the host link. Frames and their words are reading.py's; here are samples and annotations."""

# ruff: noqa: RUF012, UP031  (class attributes as sigrok wants them; formats as in reading.py)
import sigrokdecode as srd

from .reading import HEAD_SIZE, Reader, u16
from .tables import TABLES

SILENCE = 0.050  # seconds after which an unfinished frame is given up
FRAME, BAD, GARBAGE, HAZARD, TIME, PART, LINE = range(7)
MOST_OPEN = 64  # requests whose answer may still come
WAYS = ("RX", "TX")


class Decoder(srd.Decoder):
    api_version = 3
    id = "hexwire_host"
    name = "hexwire host"
    longname = "hexwire host link"
    desc = "Command frames between a host and a robot controller."
    license = "gplv2+"
    inputs = ["uart"]
    outputs = ["hexwire_host"]
    tags = ["Embedded/industrial"]
    options = (
        {
            "id": "series",
            "desc": "Servo series",
            "default": "board",
            "values": ("board", *TABLES["series"]),
        },
    )
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

    def __init__(self):
        self.reset()

    def reset(self):
        self.samplerate = None
        self.reader = None
        self.places = {0: [], 1: []}
        self.offsets = {0: 0, 1: 0}
        self.spurious = {}
        self.ends = {}

    def metadata(self, key, value):
        if key == srd.SRD_CONF_SAMPLERATE:
            self.samplerate = value

    def start(self):
        self.reader = Reader(TABLES, "host", self.options["series"])
        self.out_ann = self.register(srd.OUTPUT_ANN)
        self.out_binary = self.register(srd.OUTPUT_BINARY)

    def decode(self, ss, es, data):
        kind, way, value = data
        if kind in ("INVALID STOPBIT", "PARITY ERROR"):
            self.put(ss, es, self.out_ann, [LINE, [kind.lower() + ": noise, or another baud rate", "line fault"]])
        if kind == "INVALID STARTBIT":
            self.spurious[way] = True
        if kind == "FRAME" and self.spurious.pop(way, False):
            return  # a spike, no byte: uart says FRAME all the same
        if kind != "FRAME":  # a byte from its start bit to its stop bit, which DATA leaves out
            return
        places = self.places[way]
        if places and self.samplerate and (ss - places[-1][1]) / self.samplerate > SILENCE:
            self.show(self.reader.silence(way))
        places.append((ss, es))
        self.show(self.reader.feed(bytes([value[0] & 0xFF]), way))

    def span(self, reading, start=0, end=None):
        """Samples of bytes start..end of a reading."""
        places, offset = self.places[reading.way], reading.start - self.offsets[reading.way]
        last = len(reading.data) if end is None else end
        return places[offset + start][0], places[offset + last - 1][1]

    def show(self, readings):
        for reading in readings:
            ss, es = self.span(reading)
            words = "%s: %s" % (WAYS[reading.way], reading.text)
            kind = {"frame": FRAME, "bad": BAD}.get(reading.kind, GARBAGE)
            text, _, hazard = reading.text.partition(" ! ")
            self.put(ss, es, self.out_ann, [kind, [words, text, text[:16], text[:1]]])
            if hazard:
                self.put(ss, es, self.out_ann, [HAZARD, [hazard, "hazard", "!"]])
            if reading.kind == "frame":
                self.put(ss, es, self.out_binary, [0, reading.data])
                self.parts(reading)
                self.time(reading, ss, es)
            # What is behind a reading is never asked for again.
            keep = reading.end - self.offsets[reading.way]
            del self.places[reading.way][:keep]
            self.offsets[reading.way] = reading.end

    def parts(self, reading):
        data = reading.data
        length = u16(data, 36)
        parts = (
            (0, 4, "sync"),
            (4, 12, "time %d.%09d s" % (_u32(data, 4), _u32(data, 8))),
            (12, 16, "sn %d" % _u32(data, 12)),
            (16, 20, "from " + _module(data, 16)),
            (20, 24, "to " + _module(data, 20)),
            (24, 28, "type %d" % _u32(data, 24)),
            (28, 32, "size %d" % _u32(data, 28)),
            (32, HEAD_SIZE, "command header"),
            (HEAD_SIZE, HEAD_SIZE + length, "body"),
            (HEAD_SIZE + length, HEAD_SIZE + length + 2, "check %04X" % u16(data, HEAD_SIZE + length)),
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
            took = "%.3f ms" % ((ss - asked) / self.samplerate * 1000)
            self.put(asked, ss, self.out_ann, [TIME, ["answer after " + took, took]])


def _u32(data, at):
    return int.from_bytes(data[at : at + 4], "little")


def _module(data, at):
    number = int.from_bytes(data[at : at + 4], "little", signed=True)
    return TABLES["modules"].get(number, "module %d" % number)
