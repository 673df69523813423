from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from hexwire.errors import HexwireError
from hexwire.studio.access import Right
from hexwire.studio.calls import Asked, find_call
from hexwire.wire.registers import Series

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio


def test_registers_behind_a_board_are_read_written_and_put_back(studio: RunningStudio) -> None:
    """Reads always, writes in maintenance, which the board refuses while a joint has torque."""
    tab = studio.studio.tabs.open("somebody", Right.OPERATE)
    arm = studio.studio.source.need_arm()

    def ask(what: str, **args: Any) -> Any:
        call = find_call(f"board.{what}")
        if call.control:
            studio.studio.need_control(tab)
        return call.act(Asked(studio.studio, tab, arm, arm.mark()), call.read(args))

    def row(name: str, joint: str = "J5") -> Any:
        return next(one for one in ask("registers", joint=joint)["rows"] if one["name"] == name)

    before = row("max_temperature")
    assert (before["unit"], before["stored"]) == ("°C", True)
    edit = {"joint": "J5", "register": "max_temperature", "text": str(int(before["raw"]) - 5), "raw": True}
    with pytest.raises(HexwireError, match="control"):
        ask("edit", **edit)
    studio.studio.take(tab)
    saved = json.loads(ask("backup")["file"])
    assert len(saved["servos"]) == 7
    # Nothing is written before the question is answered.
    assert "survives power-off" in ask("edit", **edit)["question"]
    assert row("max_temperature") == before | {"backup": f"{before['value']} °C"}
    studio.torque()
    with pytest.raises(HexwireError, match="torque"):
        ask("edit", **edit, sure=True)
    arm.arm.owner.torque(False, arm.settings.model.names)
    assert "°C → " in ask("edit", **edit, sure=True)["told"]
    changed = row("max_temperature")
    assert (int(changed["raw"]), changed["differs"]) == (int(before["raw"]) - 5, ["factory", "backup"])
    with pytest.raises(HexwireError, match="it would move the servo"):
        ask("edit", joint="J5", register="goal_position", text="100", raw=True, sure=True)
    assert "again" in ask("undo")
    assert row("max_temperature")["raw"] == before["raw"]
    with pytest.raises(HexwireError, match="nothing to undo"):
        ask("undo")
    # Who only watches takes no time of the line. A setting that is refused leaves its servo locked.
    assert {find_call(f"board.{what}").right for what in ("registers", "backup")} == {Right.OPERATE}
    rows = Series.HLS.registers
    lock, moving = rows["lock"], rows["goal_position"]
    parts = [(lock.address, lock.encode(0)), (moving.address, moving.encode(0)), (lock.address, lock.encode(1))]
    with pytest.raises(HexwireError):
        arm.shared.write_registers(arm.order(tab, arm.mark()), "J5", parts)
    arm.written += 1
    assert row("lock")["raw"] == "1"
    # Maintenance has ended each time.
    assert arm.arm.owner.newest().maintenance is False


@pytest.mark.slow
def test_a_board_tells_what_it_knows_and_shows_registers(page: Page) -> None:
    page.get_by_role("link", name="Servos", exact=True).click()
    page.get_by_role("heading", name="Servos", level=1).wait_for()
    page.get_by_text("ids and rates need an adapter").wait_for()
    row = page.get_by_role("row").filter(has_text="J5").first
    page.wait_for_function(
        "[...document.querySelectorAll('[data-frame=position]')].every((c) => c.textContent !== '–')"
    )
    # A busy machine is taken for a silent arm meanwhile.
    row.filter(has_text="ok").wait_for()
    page.get_by_label("Servo", exact=True).select_option("J5")
    page.get_by_role("region", name="Registers of servo 4").get_by_text("max_temperature").wait_for()
    page.get_by_role("button", name="Ping every servo").click()
    page.get_by_role("region", name="Pings").get_by_text("ok").nth(6).wait_for()
