from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from hexwire.bus.servo_bus import ServoBus
from hexwire.bus.setup import scan
from hexwire.emulator.bus_device import make_servos
from hexwire.emulator.serve_pty import serve_bus
from hexwire.link.serial import SerialLink
from hexwire.wire.registers import Series

pytestmark = pytest.mark.system

PATIENCE = 30.0
"""Seconds for which servos that hear us may be silent: the thread that serves them stalls with the machine."""


@contextmanager
def served(
    series: Series = Series.STS_SMS, baud: int | tuple[int, ...] = 1_000_000, **options: object
) -> Iterator[str]:
    paths: queue.Queue[str] = queue.Queue()
    ended = threading.Event()
    servos = make_servos([series], [1, 2, 3], baud=baud, start=time.monotonic())
    baud = servos[0].baud
    thread = threading.Thread(
        target=lambda: serve_bus(servos, baud=baud, stop=ended.is_set, announce=paths.put, **options)
    )
    thread.start()
    try:
        yield paths.get(timeout=30)
    finally:
        ended.set()
        thread.join(30)


@pytest.mark.parametrize("series", list(Series))
def test_a_bus_on_a_terminal(series: Series) -> None:
    baud = series.baud
    with served(series, baud) as path, ServoBus(SerialLink(path, baud), series=series) as bus:
        bus.timing.allowance = PATIENCE
        for _ in range(3):
            readings = bus.sync_read("present_position", (1, 2, 3))
            assert readings.missing == ()
        assert bus.ping(2).ok


def test_servos_hear_only_at_their_own_rate() -> None:
    with served(baud=115200) as path, ServoBus(SerialLink(path, 1_000_000), retries=0) as bus:
        assert bus.ping(1).error
        bus.set_baud(115200)
        bus.timing.allowance = PATIENCE
        assert bus.ping(1).ok
        assert bus.timing.baud == 115200


@pytest.mark.slow
def test_rates_without_a_name_are_told_apart() -> None:
    """A terminal's settings have names for some rates only; 250000 and 128000 have none."""
    rates = (250_000, 128_000, 76_800)
    with served(baud=rates) as path, ServoBus(SerialLink(path, 1_000_000), retries=1) as bus:
        rows = scan(bus, bauds=rates, ids=(1, 2, 3), allowance=1.0)
    assert [(row.servo_id, row.baud, row.shared) for row in rows] == [
        (servo_id, rate, False) for servo_id, rate in zip((1, 2, 3), rates, strict=True)
    ]
