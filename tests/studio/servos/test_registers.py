from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.running import until
from tests.studio.servos.conftest import Bench, servo_of

from hexwire.bus.backup import take_backup
from hexwire.bus.registers import make_table
from hexwire.errors import StoppedError, UsageError
from hexwire.studio.servos import registers
from hexwire.studio.servos.backup import newest
from hexwire.wire.registers import Series

if TYPE_CHECKING:
    from playwright.sync_api import Page


def test_a_row_says_value_range_and_what_differs() -> None:
    rows = {
        row.register.name: registers.values(row)
        for row in make_table(Series.STS_SMS, {"max_temperature": 65}, {"max_temperature": 70})
    }
    row = rows["max_temperature"]
    shown = [row[name] for name in ("value", "unit", "raw", "range", "factory", "backup", "kept", "address")]
    assert shown == ["65", "°C", "65", "0 … 100", "70 °C", "70 °C", "stored", "13"]
    assert row["differs"] == ["factory", "backup"]
    assert (row["stored"], row["why_not"]) == (True, "")
    assert "a wave moves it" in rows["goal_position"]["why_not"]
    assert rows["mode"]["value"] == "–"


def test_rows_are_filtered_and_names_are_text(page: Page) -> None:
    raws = {"max_temperature": 65, "position_p": 32, "mode": 0, "id": 4, "status": 0}
    rows = make_table(Series.STS_SMS, raws, {"max_temperature": 70, "mode": 1})
    known = [registers.values(row) for row in rows if row.raw is not None]
    kept = page.evaluate(
        """(rows) => import("/static/servos_settings.js").then((m) => Object.fromEntries(
            ["all", "stored", "live", "factory", "backup"].map(
                (shown) => [shown, rows.filter((row) => m.fits(row, shown)).length])))""",
        known,
    )
    assert kept == {"all": 5, "stored": 4, "live": 1, "factory": 1, "backup": 2}
    cells = page.evaluate(
        """(row) => Promise.all([import("/static/servos_settings.js"), import("/static/servos_kit.js")]).then(
            ([m, kit]) => kit.table("<i>", ["Register", "#Value"], [m.cells({ ...row, name: "<b>" })]).text)""",
        known[0],
    )
    assert "<b>" not in cells
    assert "<i>" not in cells
    assert 'data-register="&#60;b&#62;"' in cells or "aria-label" in cells


def test_the_newest_backup_counts(view: Any) -> None:
    assert newest(view, 3) is None
    view.bus.backups += [take_backup(view.bus.bus, 3, taken="a"), take_backup(view.bus.bus, 3, taken="b")]
    found = newest(view, 3)
    assert found is not None
    assert found.taken == "b"


def test_an_edit_is_refused_while_stopped_and_made_otherwise(view: Any) -> None:
    edit = registers.prepared(view, 2, "max_temperature", "60", raw=False)
    registers.applied(view, edit)
    assert servo_of(view, 2).registers.stored("max_temperature") == 60
    with pytest.raises(UsageError, match="it would move the servo"):
        registers.prepared(view, 2, "goal_position", "100", raw=True)
    view.bus.stop("enough")
    with pytest.raises(StoppedError):
        registers.prepared(view, 2, "max_temperature", "61", raw=False)
    with pytest.raises(StoppedError):
        registers.applied(view, edit)


@pytest.mark.slow
def test_a_register_is_edited_and_the_edit_undone(bench: Bench) -> None:
    page, stored = bench.page, bench.servo(1).registers.stored
    page.get_by_role("button", name="Servo 3", exact=True).click()
    bench.part("Registers")
    page.get_by_label("Find a register").fill("max_temp")
    bench.button("Edit max_temperature").click()
    page.get_by_label("New value of max_temperature").fill("200")
    bench.button("Check and write").click()
    page.get_by_text("takes 0..100 °C, not 200").wait_for()
    bench.button("Edit max_temperature").click()
    page.get_by_label("New value of max_temperature").fill("60")
    bench.button("Check and write").click()
    page.get_by_text("survives power-off").wait_for()
    assert bench.servo(3).registers.stored("max_temperature") == 70, "it was asked first"
    bench.button("Write it").click()
    until(lambda: bench.servo(3).registers.stored("max_temperature") == 60, "the edit")
    assert stored("max_temperature") == 70
    bench.button("Undo").click()
    until(lambda: bench.servo(3).registers.stored("max_temperature") == 70, "the undo")
