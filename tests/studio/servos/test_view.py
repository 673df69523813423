from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from hexwire.errors import LinkLostError
from hexwire.studio.servos.view import View, table

if TYPE_CHECKING:
    from tests.studio.servos.conftest import Bench

_OFFLINE = {"Forget these values", "Load a backup", "Load a calibration", "Torque off"}
"""What can be pressed in a part while nobody knows how the servos are."""


def test_a_table_has_heads_a_caption_and_columns_of_numbers() -> None:
    text = table(("Name", "#Count"), [("a", "1"), ("b", "2")], caption='A "name" & more')
    assert '<th scope="col">Name</th><th scope="col" class="sv-num">Count</th>' in text
    assert '<tr><th scope="row">a</th><td class="sv-num">1</td></tr>' in text
    assert "A &quot;name&quot; &amp; more" in text
    with pytest.raises(ValueError, match="zip"):
        table(("Name", "#Count"), [("a",)], caption="too short")


def test_a_page_of_a_closed_bus_reaches_nothing() -> None:
    class Studio:
        class source:  # noqa: N801  # as in the studio
            bus = None

    view = View(Studio(), object(), object())  # type: ignore[arg-type]
    with pytest.raises(LinkLostError, match="was closed"):
        view._checked(lambda: 1)


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

    def lost(*_: Any, **__: Any) -> Any:
        raise LinkLostError("the cable is off")

    with monkeypatch.context() as patch:
        patch.setattr("hexwire.studio.bus_source.read_live", lost)
        page.wait_for_function("document.body.matches('.hw-unknown')")
        silenced = set()
        for part in parts:
            bench.part(part)
            page.locator(f'[role="tab"][aria-selected="true"]:has-text("{part}")').wait_for()
            page.wait_for_function(f"({seen})(false).every((words) => {sorted(_OFFLINE)}.includes(words))")
            silenced |= set(page.evaluate(seen, True))
        assert {
            "Torque on",
            "Hold to move servo 1",
            "Start",
            "Change",
            "Set the middle of servo 1 here",
        } <= silenced
        assert bench.button("STOP").is_enabled()
    page.wait_for_function("!document.body.matches('.hw-unknown')")
    page.wait_for_function(f"!({seen})(true).length")
