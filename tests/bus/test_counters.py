from __future__ import annotations

from hexwire.bus.machine import BusCounters


def test_counters_start_at_0_and_have_names() -> None:
    counted = BusCounters(requests=3).as_dict()
    assert counted.pop("requests") == 3
    assert set(counted.values()) == {0}
    assert {"answers", "repeats", "settled", "stray_bytes"} <= set(counted)
