# SPDX-License-Identifier: GPL-2.0-or-later
"""High Level Analyzers for Saleae Logic 2, on top of Async Serial. Frames and their words are reading.py's.

Logic 2 gives an analyser one Async Serial: one line. So an answer on the board's line is worded without its
request, unless both ways share a line, as they do on the servo bus.
"""

from reading import Reader
from saleae.analyzers import AnalyzerFrame, ChoicesSetting, HighLevelAnalyzer
from tables import TABLES

SERIES = ("board", *TABLES["series"])
WORDS = {"format": "{{data.text}}"}
FAULT = {"format": "line fault: {{data.text}}"}


class _Line(HighLevelAnalyzer):
    """What both lines share: bytes come one by one with their times, and leave as frames with theirs."""

    line = ""
    silence = 0.0
    result_types = {
        "frame": WORDS,
        "packet": WORDS,
        "bad": WORDS,
        "garbage": WORDS,
        "hazard": WORDS,
        "line_fault": FAULT,
    }

    def __init__(self):
        self._reader = Reader(TABLES, self.line, getattr(self, "series", "board"))
        self._times = []  # (start, end) of each byte that is in no result yet
        self._offset = 0  # where in the stream they begin
        self._asked_until = None

    def decode(self, frame):
        """Take one result of Async Serial; a list of our own, or None."""
        if frame.type != "data":
            return None
        results = []
        if "error" in frame.data:
            text = str(frame.data["error"]) + ": noise, a collision, or another baud rate"
            results.append(AnalyzerFrame("line_fault", frame.start_time, frame.end_time, {"text": text}))
        if self._times and float(frame.start_time - self._times[-1][1]) > self.silence:
            results += self._results(self._reader.silence())
        for byte in frame.data["data"]:
            self._times.append((frame.start_time, frame.end_time))
            results += self._results(self._reader.feed(bytes([byte])))
        return results or None

    def _results(self, readings):
        results = []
        for reading in readings:
            start = self._times[reading.start - self._offset][0]
            end = self._times[reading.end - self._offset - 1][1]
            del self._times[: reading.end - self._offset]
            self._offset = reading.end
            hazard = reading.text.partition(" ! ")[2]
            data = {"text": reading.text, "bytes": reading.data}
            if hazard:
                data["hazard"] = hazard
            if reading.kind in ("frame", "packet"):
                if reading.answers is not None and self._asked_until is not None:
                    data["after_us"] = round(float(start - self._asked_until) * 1e6, 1)
                self._asked_until = end
            kind = "hazard" if hazard else reading.kind
            results.append(AnalyzerFrame(kind, start, end, data))
        return results


class HexwireHost(_Line):
    """The line between host and board: session headers, command frames, servo packets inside."""

    line = "host"
    silence = 0.050  # seconds after which an unfinished frame is given up
    series = ChoicesSetting(choices=SERIES)


class HexwireServo(_Line):
    """The half-duplex servo bus."""

    line = "bus"
    silence = 0.003  # no servo pauses that long in a packet
    series = ChoicesSetting(choices=SERIES)
