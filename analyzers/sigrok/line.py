# SPDX-License-Identifier: GPL-2.0-or-later
"""What both sigrok decoders share: the bytes of the UART with their samples, and the samples of a reading."""

import sigrokdecode as srd

from .reading import Reader
from .tables import TABLES

SERIES = {
    "id": "series",
    "desc": "Servo series",
    "default": "board",
    "values": ("board", *TABLES["series"]),
}


class Line(srd.Decoder):
    """A decoder on top of uart. It names `line`, `silence`, `fault` and `faults`, and has `show`."""

    api_version = 3
    license = "gplv2+"
    inputs = ["uart"]
    tags = ["Embedded/industrial"]
    options = (SERIES,)

    def __init__(self):
        self.reset()

    def reset(self):
        self.samplerate = None
        self.reader = None
        self.places = {0: [], 1: []}
        self.offsets = {0: 0, 1: 0}
        self.spurious = {}

    def metadata(self, key, value):
        if key == srd.SRD_CONF_SAMPLERATE:
            self.samplerate = value

    def start(self):
        self.reader = Reader(TABLES, self.line, self.options["series"])
        self.out_ann = self.register(srd.OUTPUT_ANN)
        self.out_binary = self.register(srd.OUTPUT_BINARY)

    def decode(self, ss, es, data):
        kind, way, value = data
        if kind in ("INVALID STOPBIT", "PARITY ERROR"):
            self.put(ss, es, self.out_ann, [self.fault, [f"{kind.lower()}: {self.faults}", "line fault", "!"]])
        if kind == "INVALID STARTBIT":
            self.spurious[way] = True
        if kind == "FRAME" and self.spurious.pop(way, False):
            return  # a spike, no byte: uart says FRAME all the same
        if kind != "FRAME":  # a byte from its start bit to its stop bit, which DATA leaves out
            return
        self.look(way, ss, es)
        places = self.places[way]
        if places and self.samplerate and (ss - places[-1][1]) / self.samplerate > self.silence:
            self.show_all(self.reader.silence(way))
        places.append((ss, es))
        self.show_all(self.reader.feed(bytes([value[0] & 0xFF]), way))

    def look(self, way, ss, es):
        """A byte has come."""

    def show_all(self, readings):
        for reading in readings:
            self.show(reading, *self.span(reading))
            # What is behind a reading is never asked for again.
            del self.places[reading.way][: reading.end - self.offsets[reading.way]]
            self.offsets[reading.way] = reading.end

    def span(self, reading, start=0, end=None):
        """Samples of bytes start..end of a reading."""
        places, offset = self.places[reading.way], reading.start - self.offsets[reading.way]
        last = len(reading.data) if end is None else end
        return places[offset + start][0], places[offset + last - 1][1]
