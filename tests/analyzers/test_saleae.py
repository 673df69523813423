"""The analysers for Logic 2, driven through a stub of its interface; and the decoder they share with sigrok."""

from __future__ import annotations

import importlib
import json
import random
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.analyzers.lines import (
    OVERSAMPLING,
    RX,
    Sent,
    assembled,
    duration,
    in_turn,
    merged,
    readings_table,
    samples,
)

from hexwire.wire.servo_packet import make_read, make_status, make_write

STUB = Path(__file__).parent / "logic2"
NAMES = ("reading", "tables", "HighLevelAnalyzer", "saleae", "saleae.analyzers")
BAUD = 115200
TABLE = readings_table()


@pytest.fixture(scope="module")
def logic2() -> Iterator[Any]:
    """The extension as Logic 2 imports it: its folder alone on the path."""
    sys.path[:0] = [str(assembled() / "saleae"), str(STUB)]
    sys.dont_write_bytecode, before = True, sys.dont_write_bytecode
    try:
        yield importlib.import_module("HighLevelAnalyzer")
    finally:
        sys.dont_write_bytecode = before
        del sys.path[:2]
        for name in NAMES:
            sys.modules.pop(name, None)


def uart(traffic: Sequence[Sent]) -> list[tuple[float, float, int]]:
    """What Async Serial makes of bytes: start, end and value of each."""
    found = []
    for sent in traffic:
        for i, byte in enumerate(sent.data):
            start = sent.time + i * 10 / BAUD
            found.append((start, start + 10 / BAUD, byte))
    return found


def analyse(analyser: Any, logic2: Any, received: Sequence[tuple[float, float, int]]) -> list[Any]:
    results: list[Any] = []
    for start, end, byte in received:
        frame = logic2.AnalyzerFrame("data", start, end, {"data": bytes([byte])})
        results += analyser.decode(frame) or []
    return results


def test_the_extension_names_its_classes(logic2: Any) -> None:
    extension = json.loads((assembled() / "saleae/extension.json").read_text())
    for entry in extension["extensions"].values():
        module, _, name = entry["entryPoint"].partition(".")
        assert module == "HighLevelAnalyzer"
        analyser = getattr(logic2, name)()
        assert entry["type"] == "HighLevelAnalyzer"
        assert set(analyser.result_types) == {"frame", "packet", "bad", "garbage", "hazard", "line_fault"}
        assert type(analyser).series.choices[0] == "board"


def test_reads_as_the_table_says(logic2: Any) -> None:
    """All bytes on one line, as on a bus; the table's answers then find their requests."""
    for row in TABLE:
        cls = logic2.HexwireHost if row["line"] == "host" else logic2.HexwireServo
        traffic = in_turn([(RX, bytes.fromhex(data)) for _, data in row["transfers"]], BAUD, 0.0005)
        results = analyse(cls.chosen(series=row.get("series", "board")), logic2, uart(traffic))
        assert merged([result.data["text"] for result in results]) == merged(row["readings"]), row["name"]
        for result in results:
            assert ("!" in result.data["text"]) == (result.type == "hazard"), row["name"]
            took = duration(result.data["bytes"], BAUD)
            assert result.end_time - result.start_time == pytest.approx(took, abs=0.002), row["name"]


def sampled_uart(capture: bytes) -> list[tuple[float, float, int, bool]]:
    """A UART decoder for line RX of a capture: start, end, value and whether the stop bit is there."""
    rate, found, at = BAUD * OVERSAMPLING, [], 1
    while at < len(capture) - 10 * OVERSAMPLING:
        if capture[at] & 1 or not capture[at - 1] & 1 or capture[at + OVERSAMPLING // 2] & 1:
            at += 1
            continue
        middles = [at + OVERSAMPLING // 2 + OVERSAMPLING * i for i in range(1, 10)]
        bits = [capture[middle] & 1 for middle in middles]
        value = sum(bit << i for i, bit in enumerate(bits[:8]))
        found.append((at / rate, (at + 10 * OVERSAMPLING) / rate, value, bool(bits[8])))
        at = middles[8] + 1
    return found


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_the_same_captures_as_sigrok_gets(logic2: Any, noise: float) -> None:
    pair = [(RX, make_read(4, 56, 2)), (RX, make_status(4, 0, b"\0\x08"))]
    wanted = ["read 4: present_position, 2 bytes", "status 4: present_position 2048 = 180 deg"]
    analyser, results = logic2.HexwireServo(), []
    for start, end, value, stop in sampled_uart(samples(in_turn(pair * 12, BAUD, 0.005), BAUD, noise=noise)):
        data = {"data": bytes([value])} | ({} if stop else {"error": "framing"})
        results += analyser.decode(logic2.AnalyzerFrame("data", start, end, data)) or []
    texts = [result.data["text"] for result in results]
    if not noise:
        assert texts == wanted * 12
        turns = [result.data["after_us"] for result in results if "after_us" in result.data]
        assert turns == [pytest.approx(5000, abs=2)] * 12
    else:
        assert sum(text in wanted for text in texts) >= 3
        assert {result.type for result in results} & {"bad", "garbage", "line_fault"}


def test_a_fault_of_the_line_is_shown_where_it_is(logic2: Any) -> None:
    frame = logic2.AnalyzerFrame("data", 1.0, 1.1, {"data": b"\x00", "error": "framing"})
    fault, garbage = logic2.HexwireServo().decode(frame)
    assert (fault.type, fault.start_time, fault.end_time) == ("line_fault", 1.0, 1.1)
    assert fault.data["text"].startswith("framing: ")
    assert garbage.type == "garbage"
    assert logic2.HexwireServo().decode(logic2.AnalyzerFrame("break", 0.0, 1.0, {})) is None


def test_an_unfinished_packet_is_given_up_after_silence(logic2: Any) -> None:
    block = make_write(4, 41, bytes(7))
    traffic = [Sent(RX, 0.0, block[:7]), Sent(RX, 0.1, make_read(4, 56, 2))]
    texts = [result.data["text"] for result in analyse(logic2.HexwireServo(), logic2, uart(traffic))]
    assert texts == ["bad packet: cut short, 7 of 14 bytes", "read 4: present_position, 2 bytes"]


@given(data=st.data())
def test_any_bytes_in_any_pieces(logic2: Any, data: st.DataObject) -> None:
    """Each byte is in exactly one reading or unfinished; the pieces make no difference; what is held is bounded."""
    line = data.draw(st.sampled_from(["host", "bus"]))
    known = [bytes.fromhex(hexed) for row in TABLE for _, hexed in row["transfers"] if row["line"] == line]
    heads = [b"\x5a\xfa\xfa\x5a", b"\xff\xff", b"\xff\xf5", b"\xff"]
    part = st.one_of(st.binary(max_size=12), st.sampled_from(known), st.sampled_from(heads))
    stream = b"".join(data.draw(st.lists(part, max_size=8)))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    reader = logic2.Reader(logic2.TABLES, line)
    found = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += reader.feed(stream[start:end])
    found += reader.silence()
    at = 0
    for reading in found:
        assert (reading.start, reading.data) == (at, stream[at : reading.end])
        at = reading.end
    assert at == len(stream)
    whole = logic2.Reader(logic2.TABLES, line)
    once = whole.feed(stream) + whole.silence()
    assert merged([reading.text for reading in found]) == merged([reading.text for reading in once])


def test_what_is_held_is_bounded(logic2: Any) -> None:
    source = random.Random(5)
    analyser = logic2.HexwireHost()
    for i in range(30000):
        byte = source.choice(b"\x5a\xfa\xfa\x5a\x82\x01") if source.random() < 0.9 else source.randrange(256)
        analyser.decode(logic2.AnalyzerFrame("data", i * 1e-4, i * 1e-4 + 8e-5, {"data": bytes([byte])}))
        assert len(analyser._times) <= logic2.TABLES["max_frame"]
