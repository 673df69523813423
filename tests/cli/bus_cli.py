"""`hexwire bus` against emulated servos in this process, in simulated time."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner, Result
from tests.bus.bus_bench import make_bus

from hexwire.cli import bus_live
from hexwire.cli.main import cli
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.faults import FaultPlan
from hexwire.link import open as ipc_open
from hexwire.wire.registers import Series


class BusCli:
    """Runs `hexwire bus` commands against one emulated bus."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        ids: Sequence[int] = (1, 2, 3),
        series: Sequence[Series] = (Series.STS_SMS,),
        faults: Sequence[str] = (),
    ) -> None:
        bus, device = make_bus(ids, series, faults=FaultPlan(faults) if faults else None)
        bus.close()
        self.link: Any = bus.link
        self.device: BusDevice = device
        self.urls: list[str] = []
        monkeypatch.setattr(ipc_open, "make_link", self._make_link)
        clock = self.link.clock
        fake = SimpleNamespace(monotonic=clock, perf_counter=clock, sleep=clock.advance)
        monkeypatch.setattr(bus_live, "time", fake)

    def _make_link(self, url: str) -> Any:
        self.urls.append(url)
        return self.link

    def run(self, *words: str, answer: str | None = None) -> Result:
        return CliRunner().invoke(cli, ["bus", *words, "--port", "/dev/ttyTEST"], input=answer)

    def ok(self, *words: str, answer: str | None = None) -> str:
        result = self.run(*words, answer=answer)
        assert result.exit_code == 0, result.output
        return result.output
