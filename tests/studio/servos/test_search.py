from __future__ import annotations

from typing import Any

from hexwire.studio.servos.search import _list


def test_servos_at_the_rate_of_the_bus_can_be_chosen_and_others_say_their_rate(view: Any) -> None:
    view.selected = 2
    *here, last = view.bus.servos
    view.bus._keep([*here, last._replace(found=last.found._replace(baud=500_000))])
    text = _list(view)
    assert 'data-value="2" aria-pressed="true"' in text
    assert 'data-value="3" aria-pressed="false"' in text
    assert "At 500000 baud: 6 " in text
    assert 'data-do="select" data-value="6"' not in text
    assert 'data-do="rate" data-value="500000"' in text


def test_an_empty_list_says_what_to_do(view: Any) -> None:
    view.bus._keep([])
    view.selected = None
    assert "Take control, then search" in _list(view)


def test_a_servo_that_cannot_be_chosen_says_why_in_its_row(view: Any) -> None:
    view.selected = 1
    first, second, *rest = view.bus.servos
    view.bus._keep([first, second._replace(found=second.found._replace(shared=True)), *rest])
    assert 'data-value="2"' not in _list(view)
    assert _list(view).count('class="sv-note"') == 1
