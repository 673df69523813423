from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from hexwire.errors import HexwireError
from hexwire.studio.access import Right
from hexwire.studio.calls import Asked, find_call
from hexwire.studio.servos.backup import keep
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


def test_a_backup_is_restored_behind_a_board_and_the_restore_is_taken_back(studio: RunningStudio) -> None:
    """All of it in maintenance, and nothing of it while a joint has torque."""
    tab = studio.studio.tabs.open("somebody", Right.OPERATE)
    arm = studio.studio.source.need_arm()
    studio.studio.take(tab)

    def ask(what: str, **args: Any) -> Any:
        call = find_call(what)
        return call.act(Asked(studio.studio, tab, arm, arm.mark()), call.read(args))

    def raw(name: str) -> int:
        rows = ask("board.registers", joint="J5")["rows"]
        return int(next(one["raw"] for one in rows if one["name"] == name))

    with pytest.raises(HexwireError, match="no backup of servo 4"):
        ask("board.restore", servo=4)
    saved = json.loads(ask("board.backup")["file"])
    assert [differences for one in ask("board.differences") if (differences := one["differences"])] == []
    before = {name: raw(name) for name in ("max_temperature", "id", "position_p", "baud_code")}
    servo = next(one for one in saved["servos"] if one["id"] == 4)
    servo["registers"] |= {"max_temperature": before["max_temperature"] - 7, "id": 9, "baud_code": 0}
    servo["registers"]["position_p"] = before["position_p"] + 1
    loaded = Asked(studio.studio, tab, arm, None)
    assert keep(loaded, json.dumps(saved).encode()) == [one["id"] for one in saved["servos"]]
    told = next(one["differences"] for one in ask("board.differences") if one["servo"] == 4)
    assert ("max_temperature", before["max_temperature"], before["max_temperature"] - 7) in told
    studio.torque()
    with pytest.raises(HexwireError, match="torque"):
        ask("board.restore", servo=4)
    assert raw("max_temperature") == before["max_temperature"]
    arm.arm.owner.torque(False, arm.settings.model.names)
    # Neither id nor rate: the servo would be lost.
    assert sorted(ask("board.restore", servo=4)) == ["max_temperature", "position_p"]
    assert (raw("max_temperature"), raw("position_p")) == (
        before["max_temperature"] - 7,
        before["position_p"] + 1,
    )
    assert "the restore of 2 settings of servo 4" in ask("board.registers", joint="J5")["undo"]
    assert "the restore of 2 settings" in ask("board.undo")
    assert {name: raw(name) for name in before} == before
    # A backup of a servo of another series, or beyond what a register takes, changes nothing.
    arm.backups.append(replace(arm.backups[-1], servo_id=4, series="scs"))
    with pytest.raises(HexwireError, match="this backup is of a scs servo"):
        ask("board.restore", servo=4)
    with pytest.raises(HexwireError, match="nothing to undo"):
        ask("board.undo")
    assert arm.arm.owner.newest().maintenance is False


def test_the_health_of_servos_behind_a_board_is_that_of_the_arms_states(studio: RunningStudio) -> None:
    tab = studio.studio.tabs.open("somebody", Right.OPERATE)
    arm = studio.studio.source.need_arm()

    def ask(what: str, **args: Any) -> Any:
        call = find_call(what)
        return call.act(Asked(studio.studio, tab, arm, arm.mark()), call.read(args))

    def worst() -> dict[str, str]:
        return dict(ask("health.worst", servo=4))

    studio.until(lambda: not worst()["Answers lost"].startswith("0 of 0"), "a sample")
    assert worst()["Lowest supply"].endswith("V")
    assert worst()["Faults seen"] == "none"
    studio.until(lambda: ask("health.rows", servo=4)["rows"], "a second of samples")
    json.dumps(ask("health.rows", servo=4), allow_nan=False)
    assert find_call("health.judge").control
    said = ask("health.judge")
    assert ("ok", "servo 0, 1, 2, 3, 4, 5, 6: no servo reports a fault") in said
    listeners = len(arm.listeners)
    studio.servos[4].supply = 3.0
    said = ask("health.judge")
    assert any(level == "error" and "servo 4" in words for level, words in said), said
    assert len(arm.listeners) == listeners
    assert "voltage" in worst()["Faults seen"]
    ask("health.forget", servo=4)


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
    page.get_by_role("button", name="J5, servo 4").click()
    page.get_by_role("heading", name="J5, servo 4").wait_for()
    page.get_by_role("tab", name="Registers", exact=True).click()
    page.get_by_role("region", name="Registers of servo 4").get_by_text("max_temperature").wait_for()
    page.get_by_role("button", name="Ping every servo").click()
    page.get_by_role("region", name="Servos of the arm").get_by_text("ping: ok").nth(6).wait_for()
    page.get_by_role("tab", name="Health", exact=True).click()
    page.get_by_text("Lowest supply").wait_for()
    page.get_by_role("tab", name="Backup", exact=True).click()
    page.get_by_text("No backup was taken or loaded here.").wait_for()
