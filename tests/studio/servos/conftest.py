"""An emulated SO-101's servos, as the parts of the page Servos see them, with and without a browser."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.running import RunningStudio

from hexwire.emulator.servo import EmulatedServo
from hexwire.studio.source import Source

if TYPE_CHECKING:
    from playwright.sync_api import Page

    from hexwire.studio.bus_source import BusSource

_names = itertools.count(1)


@pytest.fixture
def view() -> Iterator[Any]:
    """What a part knows of its tab: the bus, whose servos were searched, and what was told to the page."""
    source = Source()
    source.silence = 5.0
    told: list[dict[str, Any]] = []
    try:
        bus = source.open_bus(f"sim://so101?name=parts{next(_names)}")
        bus.search((), range(1, 7))
        live = SimpleNamespace(tell=lambda message, key=None: told.append(message))
        tab = SimpleNamespace(key="k")
        studio = SimpleNamespace(live=live)
        yield SimpleNamespace(bus=bus, source=source, studio=studio, tab=tab, told=told, backups=bus.backups)
    finally:
        source.close()


def servo_of(view: Any, servo_id: int) -> EmulatedServo:
    """An emulated servo."""
    servo: EmulatedServo = view.bus.bus.link.device.wire[servo_id]
    return servo


class Bench:
    """A page that has control of an emulated SO-101's servos."""

    def __init__(self, running: RunningStudio, page: Page) -> None:
        self.running, self.page = running, page

    @property
    def bus(self) -> BusSource:
        return self.running.studio.source.need_bus()

    def servo(self, servo_id: int) -> EmulatedServo:
        link: Any = self.bus.bus.link
        servo: EmulatedServo = link.device.wire[servo_id]
        return servo

    def part(self, name: str) -> None:
        self.page.get_by_role("tab", name=name, exact=True).click()

    def button(self, name: str) -> Any:
        return self.page.get_by_role("button", name=name, exact=True)


@pytest.fixture
def bench(served: RunningStudio, blank: Page) -> Iterator[Bench]:
    served.studio.source.silence = 5.0
    served.studio.source.open_bus(f"sim://so101?name=servos{next(_names)}")
    page = blank
    page.goto(served.operate_url.replace("/?", "/servos?"))
    page.get_by_role("button", name="Take control").click()
    page.get_by_role("button", name="Give back").wait_for()
    page.get_by_label("Ids").fill("1-7")
    page.get_by_role("button", name="Search", exact=True).click()
    page.get_by_text("6 servos found").wait_for()
    # Only then they are listed, and the first one is chosen.
    page.get_by_role("heading", name="Servo 1", exact=True).wait_for()
    try:
        yield Bench(served, page)
    finally:
        served.studio.source.close()
