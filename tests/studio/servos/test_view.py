from __future__ import annotations

import pytest

from hexwire.errors import LinkLostError
from hexwire.studio.servos.view import View, table


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
