from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from hexwire.bus.values import Reading
from hexwire.studio.servos.search import servos_of

if TYPE_CHECKING:
    from playwright.sync_api import Page


def listed(page: Page, view: Any, selected: int | None) -> str:
    """What a page draws."""
    text: str = page.evaluate(
        "([found, selected]) => import('/static/servos.js').then((m) => m.listMarkup({ found, selected }).text)",
        [servos_of(view), selected],
    )
    return " ".join(text.split())


def test_servos_at_the_rate_of_the_bus_can_be_chosen_and_others_say_their_rate(page: Page, view: Any) -> None:
    *here, last = view.bus.servos
    view.bus._keep([*here, last._replace(found=last.found._replace(baud=500_000))])
    text = listed(page, view, 2)
    assert 'data-value="2" aria-pressed="true"' in text
    assert 'data-value="3" aria-pressed="false"' in text
    assert "At 500000 baud: 6 " in text
    assert 'data-do="select" data-value="6"' not in text
    assert 'data-do="rate" data-value="500000"' in text
    # One that cannot be chosen says why in its row.
    first, second, *rest = here
    view.bus._keep([first, second._replace(found=second.found._replace(shared=True)), *rest])
    text = listed(page, view, 1)
    assert 'data-value="2"' not in text
    assert text.count('class="sv-note"') == 1


def test_an_empty_list_says_what_to_do(page: Page, view: Any) -> None:
    view.bus._keep([])
    assert "Take control, then search" in listed(page, view, None)


@pytest.mark.parametrize(
    ("lost", "told"),
    [
        ({"min_voltage"}, "7.4 V"),
        ({"max_voltage"}, "not reported"),
        ({"min_voltage", "max_voltage"}, "not reported"),
    ],
)
def test_a_limit_that_was_not_read_is_not_made_up(
    view: Any, monkeypatch: pytest.MonkeyPatch, lost: set[str], told: str
) -> None:
    bus = view.bus.bus
    read = bus.read

    def silent(servo_id: int, name: str) -> Reading:
        reading: Reading = read(servo_id, name)
        return reading._replace(raw=None) if name in lost else reading

    monkeypatch.setattr(bus, "read", silent)
    view.bus.search((), (1,))
    (servo,) = servos_of(view)["servos"]
    assert dict(servo["facts"])["Voltage class"] == told


def test_what_a_servo_is_is_told_in_words(view: Any) -> None:
    told = servos_of(view)
    assert [one["id"] for one in told["servos"]] == [1, 2, 3, 4, 5, 6]
    facts = dict(told["servos"][0]["facts"])
    assert facts["Rate"] == "1000000 baud"
    assert facts["Voltage class"] == "7.4 V (its limits: 4.0 to 8.0 V)"
    assert told["rates"][0] == (0, "1000000 baud (now)")
