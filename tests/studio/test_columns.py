from __future__ import annotations

import json
import math
from array import array
from dataclasses import replace
from typing import Any

from tests.recorded import make_positions

from hexwire.control.requests.history import BLOCK, History
from hexwire.studio.columns import history_columns, serialize_columns, series_columns
from hexwire.trace.series import PlotSeries


def parsed(data: bytes) -> tuple[dict[str, Any], array[float], dict[str, array[float]]]:
    """What `static/columns.js` finds."""
    assert data[:4] == b"HWC1"
    size = int.from_bytes(data[4:8], "little")
    head = json.loads(data[8 : 8 + size])
    at, n = 8 + size, head["count"]
    assert at % 8 == 0
    times = array("d", data[at : at + 8 * n])
    at += 8 * n
    columns = {}
    for name in head["columns"]:
        columns[name] = array("f", data[at : at + 4 * n])
        at += 4 * n
    assert at == len(data)
    return head, times, columns


def test_columns_come_back() -> None:
    data = serialize_columns({"x": "é"}, array("d", [1.0, 2.0, 3.0]), [("J1", array("f", [0.5, math.nan, -1.0]))])
    head, times, columns = parsed(data)
    assert head["x"] == "é"
    assert list(times) == [1.0, 2.0, 3.0]
    assert columns["J1"][0] == 0.5
    assert math.isnan(columns["J1"][1])


def test_a_history_has_a_column_for_each_signal() -> None:
    history = History(("J1", "J2"))
    for i in range(4):
        history.append(make_positions(("J1", "J2"), (i, -i)).__class__(**_at(i)), {"J2": 9.0}, rate=50.0)
    signals = [(joint, signal.name) for joint, signal in history.columns]
    assert history.count_after(1.5) == 2
    head, times, columns = parsed(history_columns({"offset": 100.0}, signals, history.rows(1.5)))
    assert head["offset"] == 100.0
    assert list(times) == [2.0, 3.0]
    assert list(columns["J1.position"]) == [2.0, 3.0]
    assert list(columns["J2.position"]) == [-2.0, -3.0]
    assert list(columns["J2.goal"]) == [9.0, 9.0]
    assert list(columns["rate"]) == [50.0, 50.0]
    _, _, some = parsed(history_columns({}, signals, history.rows(), (".goal", ".load")))
    assert list(some) == ["J1.goal", "J1.load", "J2.goal", "J2.load"]


def _at(i: int) -> dict[str, Any]:
    state = make_positions(("J1", "J2"), (float(i), float(-i)))
    return {name: getattr(state, name) for name in state.__slots__} | {"stamp": float(i)}


def test_a_recording_has_its_quantities_and_its_damage() -> None:
    series = PlotSeries(
        ("J1",), 1000.0, array("d", [0.0, 0.5]), {("J1", "load"): array("f", [0.1, 0.2])}, "truncated"
    )
    head, times, columns = parsed(series_columns(series))
    assert (head["begin"], head["problem"], head["names"]) == (1000.0, "truncated", ["J1"])
    assert list(times) == [0.0, 0.5]
    assert list(columns) == ["J1.load"]


def test_nothing_of_a_history_is_copied_in_larger_parts_than_blocks() -> None:
    history, state = History(("J1", "J2"), seconds=1000.0), make_positions(("J1", "J2"), (0.0, 0.0))
    for i in range(40_000):
        history.append(replace(state, stamp=0.01 * i), {})
    rows = history.rows()
    assert len(rows.blocks) >= 40_000 / BLOCK
    assert all(len(block) <= BLOCK * 4 * rows.width for block in rows.between(1.0, 350.0).blocks)
    cut = rows.between(100.0, 120.0)
    assert repr(list(cut)) == repr([row for row in rows if 100.0 <= row[0] <= 120.0])
    assert len(cut.blocks) > 2
