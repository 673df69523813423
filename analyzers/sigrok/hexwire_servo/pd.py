# SPDX-License-Identifier: GPL-2.0-or-later
# ruff: noqa: RUF012  (class attributes as sigrok wants them)
"""sigrok decoder of the servo bus. Packets and their words are reading.py's; here are samples and annotations."""

import sigrokdecode as srd

from .reading import Reader
from .tables import TABLES

GAP = 0.003  # seconds of silence after which an unfinished packet is given up: no servo pauses that long in one
REQUEST, STATUS, BAD, GARBAGE, HAZARD, TURN, LINE = range(7)


class Decoder(srd.Decoder):
    api_version = 3
    id = "hexwire_servo"
    name = "hexwire servo"
    longname = "hexwire servo bus"
    desc = "Packets of Feetech and 7Bot bus servos."
    license = "gplv2+"
    inputs = ["uart"]
    outputs = ["hexwire_servo"]
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
        ("request", "Request"),
        ("status", "Status packet"),
        ("bad", "Bad packet"),
        ("garbage", "Bytes of no packet"),
        ("hazard", "Hazard"),
        ("turn", "Turn-around time"),
        ("line", "Collision or fault of the line"),
    )
    annotation_rows = (
        ("packets", "Packets", (REQUEST, STATUS, BAD, GARBAGE)),
        ("turns", "Turn-around", (TURN,)),
        ("warnings", "Warnings", (HAZARD, LINE)),
    )
    binary = (("packets", "Packets"),)

    def __init__(self):
        self.reset()

    def reset(self):
        self.samplerate = None
        self.reader = None
        self.places = {0: [], 1: []}
        self.offsets = {0: 0, 1: 0}
        self.spurious = {}
        self.last = {}
        self.asked = None

    def metadata(self, key, value):
        if key == srd.SRD_CONF_SAMPLERATE:
            self.samplerate = value

    def start(self):
        self.reader = Reader(TABLES, "bus", self.options["series"])
        self.out_ann = self.register(srd.OUTPUT_ANN)
        self.out_binary = self.register(srd.OUTPUT_BINARY)

    def decode(self, ss, es, data):
        kind, way, value = data
        if kind in ("INVALID STOPBIT", "PARITY ERROR"):
            text = kind.lower() + ": a collision, noise, or another baud rate"
            self.put(ss, es, self.out_ann, [LINE, [text, "line fault", "!"]])
        if kind == "INVALID STARTBIT":
            self.spurious[way] = True
        if kind == "FRAME" and self.spurious.pop(way, False):
            return  # a spike, no byte: uart says FRAME all the same
        if kind != "FRAME":  # a byte from its start bit to its stop bit, which DATA leaves out
            return
        other = self.last.get(1 - way)
        if other and ss < other[1] and es > other[0]:
            begin, end = max(ss, other[0]), min(es, other[1])
            self.put(begin, end, self.out_ann, [LINE, ["collision: both sides send", "collision", "!"]])
        self.last[way] = (ss, es)
        places = self.places[way]
        if places and self.samplerate and (ss - places[-1][1]) / self.samplerate > GAP:
            self.show(self.reader.silence(way))
        places.append((ss, es))
        self.show(self.reader.feed(bytes([value[0] & 0xFF]), way))

    def show(self, readings):
        for reading in readings:
            places, offset = self.places[reading.way], self.offsets[reading.way]
            ss, es = places[reading.start - offset][0], places[reading.end - offset - 1][1]
            kind = {"bad": BAD, "garbage": GARBAGE}.get(reading.kind)
            if kind is None:
                kind = STATUS if reading.answer else REQUEST
                self.put(ss, es, self.out_binary, [0, reading.data])
                self.turn(reading, ss, es)
            text, _, hazard = reading.text.partition(" ! ")
            self.put(ss, es, self.out_ann, [kind, [reading.text, text[:16], text[:1]]])
            if hazard:
                self.put(ss, es, self.out_ann, [HAZARD, [hazard, "hazard", "!"]])
            # What is behind a reading is never asked for again.
            del places[: reading.end - offset]
            self.offsets[reading.way] = reading.end

    def turn(self, reading, ss, es):
        """From the end of a request to the begin of its answer; of a sync read, from the answer before."""
        if reading.answers is None:
            self.asked = es
            return
        if self.asked is not None and self.samplerate and ss > self.asked:
            took = "%.1f us" % ((ss - self.asked) / self.samplerate * 1e6)
            self.put(self.asked, ss, self.out_ann, [TURN, ["turn-around " + took, took]])
        self.asked = es
