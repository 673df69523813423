# SPDX-License-Identifier: GPL-2.0-or-later
"""sigrok decoder of the servo bus. Packets and their words are reading.py's; here are the annotations."""

from .line import Line

REQUEST, STATUS, BAD, GARBAGE, HAZARD, TURN, LINE = range(7)


class Decoder(Line):
    id = "hexwire_servo"
    name = "hexwire servo"
    longname = "hexwire servo bus"
    desc = "Packets of Feetech and 7Bot bus servos."
    outputs = ["hexwire_servo"]
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

    line = "bus"
    silence = 0.003  # seconds after which an unfinished packet is given up: no servo pauses that long in one
    fault, faults = LINE, "a collision, noise, or another baud rate"

    def reset(self):
        super().reset()
        self.last = {}
        self.asked = None

    def look(self, way, ss, es):
        other = self.last.get(1 - way)
        if other and ss < other[1] and es > other[0]:
            begin, end = max(ss, other[0]), min(es, other[1])
            self.put(begin, end, self.out_ann, [LINE, ["collision: both sides send", "collision", "!"]])
        self.last[way] = (ss, es)

    def show(self, reading, ss, es):
        kind = {"bad": BAD, "garbage": GARBAGE}.get(reading.kind)
        if kind is None:
            kind = STATUS if reading.answer else REQUEST
            self.put(ss, es, self.out_binary, [0, reading.data])
            self.turn(reading, ss, es)
        text, _, hazard = reading.text.partition(" ! ")
        self.put(ss, es, self.out_ann, [kind, [reading.text, text[:16], text[:1]]])
        if hazard:
            self.put(ss, es, self.out_ann, [HAZARD, [hazard, "hazard", "!"]])

    def turn(self, reading, ss, es):
        """From the end of a request to the begin of its answer; of a sync read, from the answer before."""
        if reading.answers is None:
            self.asked = es
            return
        if self.asked is not None and self.samplerate and ss > self.asked:
            took = f"{(ss - self.asked) / self.samplerate * 1e6:.1f} us"
            self.put(self.asked, ss, self.out_ann, [TURN, ["turn-around " + took, took]])
        self.asked = es
