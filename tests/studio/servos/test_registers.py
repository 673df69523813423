from __future__ import annotations

from typing import Any

import pytest
from tests.studio.running import until
from tests.studio.servos.conftest import Bench, servo_of

from hexwire.bus.backup import take_backup
from hexwire.bus.registers import make_table
from hexwire.errors import StoppedError, UsageError
from hexwire.studio.servos import registers
from hexwire.wire.registers import Series


def test_cells_say_value_range_and_what_differs() -> None:
    rows = {
        row.register.name: row
        for row in make_table(Series.STS_SMS, {"max_temperature": 65}, {"max_temperature": 70})
    }
    cells = registers._cells(rows["max_temperature"])
    assert (*cells[1:3], *cells[4:6], cells[9]) == ("65", "°C", "65", "0 … 100", "13")
    assert cells[6] == '<mark title="different">70 ≠</mark>' == cells[7]
    assert cells[8] == "stored"
    assert 'data-do="edit" data-value="max_temperature"' in cells[3]
    assert "Edit" not in registers._cells(rows["goal_position"])[3]
    assert "a wave moves it" in registers._cells(rows["goal_position"])[3]
    assert registers._cells(rows["mode"])[1] == "–"


@pytest.mark.parametrize(("shown", "kept"), [("all", 5), ("stored", 4), ("live", 1), ("factory", 1), ("backup", 2)])
def test_filters(shown: str, kept: int) -> None:
    raws = {"max_temperature": 65, "position_p": 32, "mode": 0, "id": 4, "status": 0}
    rows = make_table(Series.STS_SMS, raws, {"max_temperature": 70, "mode": 1})
    assert sum(registers._fits(row, shown) for row in rows if row.raw is not None) == kept


def test_the_newest_backup_counts(view: Any) -> None:
    assert registers._saved(view, 3) is None
    view.bus.backups += [take_backup(view.bus.bus, 3, taken="a"), take_backup(view.bus.bus, 3, taken="b")]
    found = registers._saved(view, 3)
    assert found is not None
    assert found.taken == "b"


def test_an_edit_is_refused_while_stopped_and_made_otherwise(view: Any) -> None:
    edit = registers._prepared(view, 2, "max_temperature", "60", False)
    registers._apply(view, edit)
    assert servo_of(view, 2).registers.stored("max_temperature") == 60
    with pytest.raises(UsageError, match="it would move the servo"):
        registers._prepared(view, 2, "goal_position", "100", True)
    view.bus.stop("enough")
    with pytest.raises(StoppedError):
        registers._prepared(view, 2, "max_temperature", "61", False)
    with pytest.raises(StoppedError):
        registers._apply(view, edit)


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
