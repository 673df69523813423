from __future__ import annotations

import json
import threading
from typing import Any

import pytest
from tests.studio.running import until
from tests.studio.servos.conftest import servo_of

from hexwire.drivers.arm_file import load_profile
from hexwire.errors import ConfigError, HexwireError, UsageError
from hexwire.studio.servos.calibration_run import CalibrationRun, parse_file, store_in


def working(view: Any, run: CalibrationRun) -> tuple[threading.Thread, list[str]]:
    errors: list[str] = []

    def work() -> None:
        try:
            run.work()
        except HexwireError as error:
            errors.append(str(error))

    thread = threading.Thread(target=work)
    thread.start()
    until(lambda: view.told, "the first values")
    return thread, errors


def move(view: Any, servo_id: int, counts: float) -> None:
    servo_of(view, servo_id).motion.position = counts


def test_every_servo_is_moved_to_its_ends_and_the_result_stored(view: Any) -> None:
    run = CalibrationRun(view.studio, view.bus, view.tab, "servos")
    view.bus.switch_torque(True)
    thread, errors = working(view, run)
    assert not servo_of(view, 1).torque_on
    assert [row["missing"] for row in view.told[-1]["rows"]] == ["not moved yet"] * 6
    for step in range(11):
        for servo_id in range(1, 7):
            move(view, servo_id, 1500 + 100 * step)
        seen = len(view.told)
        # The first one may be of before.
        until(lambda seen=seen: len(view.told) > seen + 1, "a sample")  # type: ignore[misc]
    until(lambda: not any(row["missing"] for row in view.told[-1]["rows"]), "all of them")
    row = view.told[-1]["rows"][0]
    assert row["high"] - row["low"] > 80
    run.finish()
    thread.join(30)
    assert errors == []
    assert run.found is not None
    store_in(view.bus, run.found)
    low, high = (servo_of(view, 1).registers.stored(f"{end}_position_limit") for end in ("min", "max"))
    assert high - low == pytest.approx(1000, abs=60)
    assert view.bus.job is None


def test_a_stop_and_a_cancel_end_it_and_store_nothing(view: Any) -> None:
    before = servo_of(view, 2).registers.stored("position_offset")
    for end in (view.bus.bench.cancel, lambda: view.bus.stop("tab 2 stopped it")):
        view.told.clear()
        run = CalibrationRun(view.studio, view.bus, view.tab, "so101")
        assert run.hand.needs_middle
        thread, errors = working(view, run)
        assert run.mark_middle()
        end()
        thread.join(30)
        assert len(errors) == 1
        assert "nothing was stored" in errors[0]
        assert run.found is None
    assert servo_of(view, 2).registers.stored("position_offset") == before


def test_an_arm_that_is_not_there_is_refused(view: Any) -> None:
    with pytest.raises(UsageError, match="no arm 'puma'"):
        CalibrationRun(view.studio, view.bus, view.tab, "puma")
    view.bus.bench.servo_ids = (1, 2)
    with pytest.raises(UsageError, match="servo 3, 4, 5, 6 of this arm was not found"):
        CalibrationRun(view.studio, view.bus, view.tab, "so101")


def lerobot(**changed: int) -> bytes:
    names = load_profile("so101").model.names
    row = {"drive_mode": 0, "homing_offset": 15, "range_min": 900, "range_max": 3100, **changed}
    return json.dumps({name: {"id": i, **row} for i, name in enumerate(names, 1)}).encode()


def test_a_file_of_lerobot_is_stored_and_written_again(view: Any) -> None:
    found = parse_file(view.bus, "my_arm.json", lerobot(), "so101")
    assert store_in(view.bus, found) == load_profile("so101").model.names
    registers = servo_of(view, 3).registers
    assert [registers.stored(f"{end}_position_limit") for end in ("min", "max")] == [900, 3100]
    assert registers.stored("position_offset") == 15
    assert json.loads(found.to_lerobot()) == json.loads(lerobot())
    assert parse_file(view.bus, "my_arm.toml", found.serialize().encode(), "so101") == found


def test_a_file_of_other_servos_or_of_another_kind_is_refused(view: Any) -> None:
    with pytest.raises(UsageError, match="calibrated on servo 6"):
        parse_file(view.bus, "a.json", lerobot(id=6), "so101")
    for data in (b"\xff", b"{}", b"[1]"):
        with pytest.raises(ConfigError):
            parse_file(view.bus, "a.json", data, "servos")
    view.bus.bench.servo_ids = (1, 2, 3)
    with pytest.raises(UsageError, match="servo 4, 5, 6 of this file was not found"):
        parse_file(view.bus, "a.json", lerobot(), "so101")
