from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from hexwire.errors import LinkLostError
from hexwire.studio.calls import Asked

if TYPE_CHECKING:
    from tests.studio.servos.conftest import Bench

_OFFLINE = {"Forget these values", "Load a backup", "Load a calibration", "Torque off"}
"""What can be pressed in a part while nobody knows how the servos are."""
_SILENCED = {
    "Overview": "Torque on",
    "Wave": "Hold to move servo 1",
    "Stress test": "Start",
    "Id and rate": "Change",
    "Calibration": "Set the middle of servo 1 here",
}
"""And what cannot, in some of them."""


def test_a_page_of_a_closed_bus_reaches_nothing(view: Any) -> None:
    studio = SimpleNamespace(source=view.source)
    asked = Asked(studio, view.tab, view.bus, view.bus.mark())  # type: ignore[arg-type]  # as far as it is needed
    assert asked.bus is view.bus
    view.source.open_bus("sim://so101?name=another")
    with pytest.raises(LinkLostError, match="was closed"):
        _ = asked.bus


@pytest.mark.slow
def test_on_every_part_nothing_that_needs_a_servo_can_be_pressed_while_the_bus_is_lost(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = bench.page
    seen = """(inert) => [...document.querySelectorAll(".sv-right .hw-button")].filter(
      (each) => each.checkVisibility() && !each.disabled && each.inert === inert
    ).map((each) => each.textContent.trim())"""
    parts = page.get_by_role("tab").all_inner_texts()
    assert len(parts) == 9
    assert set(_SILENCED) <= set(parts)

    def lost(*_: Any, **__: Any) -> Any:
        raise LinkLostError("the cable is off")

    with monkeypatch.context() as patch:
        patch.setattr("hexwire.studio.bus_source.read_live", lost)
        page.wait_for_function("document.body.matches('.hw-unknown')")
        for part in parts:
            bench.part(part)
            page.locator(f'[role="tab"][aria-selected="true"]:has-text("{part}")').wait_for()
            if part in _SILENCED:
                page.wait_for_function(f"({seen})(true).includes({_SILENCED[part]!r})")
            page.wait_for_function(f"({seen})(false).every((words) => {sorted(_OFFLINE)}.includes(words))")
        assert bench.button("STOP").is_enabled()
    page.wait_for_function("!document.body.matches('.hw-unknown')")
    page.wait_for_function(f"!({seen})(true).length")
