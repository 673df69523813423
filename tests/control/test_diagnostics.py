from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from hexwire.control.requests.diagnostics import ChangeWatch, RobotFacts, Row, RowLevel, diagnose
from hexwire.drivers.base import JointProbe, ProbeReport
from hexwire.model.state import JointFlag, JointState

NAN = math.nan
PROBE = ProbeReport(
    robot="hex7bot",
    link="serial:///dev/ttyUSB0",
    dialect=2,
    firmware="2.0.1",
    boot_id=0x1234ABCD,
    capabilities=("watchdog", "report"),
    stopped=False,
    joints=(JointProbe("J1", 1, "seven_bot", True), JointProbe("J2", 7, "hls", True, "is scs, the model says hls")),
    counters={"board_bus_timeouts": 3, "retries": 1},
)
STATE = JointState(
    names=("J1", "J2"),
    position=(math.pi / 2, -1e-9),
    velocity=(0.1, -1e-9),
    load=(NAN, 0.125),
    current=(NAN, 0.4321),
    voltage=(NAN, 7.4),
    temperature=(NAN, 41.0),
    flags=(0, int(JointFlag.TORQUE_ON)),
    age=(0.004, 0.0),
    stamp=100.0,
)
FACTS = RobotFacts(
    robot="hex7bot",
    url="serial:///dev/ttyUSB0",
    connected=True,
    error="",
    reconnects=2,
    probe=PROBE,
    state=STATE,
    state_age=0.01,
    rate=99.7,
    wanted_rate=100.0,
    stopped="",
    counters={},
    controllers={"": "idle"},
    watchdog=1.0,
)


def rows(**changes: Any) -> dict[str, Row]:
    return {row.name: row for row in diagnose(replace(FACTS, **changes))}


def verdict(part: str, **changes: Any) -> tuple[RowLevel, str]:
    row = rows(**changes)[part]
    return row.level, row.text


def servo(**changes: Any) -> tuple[RowLevel, str]:
    """Verdict on the second joint, with these values in its place of the state."""
    state = replace(STATE, **{key: (getattr(STATE, key)[0], value) for key, value in changes.items()})
    return verdict("J2 (servo 7)", state=state)


def test_names_and_order() -> None:
    assert [row.name for row in diagnose(FACTS)] == [
        "link",
        "board",
        "J1 (servo 1)",
        "J2 (servo 7)",
    ]
    assert {(row.level, row.text) for row in diagnose(FACTS)} == {(RowLevel.OK, "ok")}
    assert sorted(RowLevel) == [RowLevel.OK, RowLevel.WARNING, RowLevel.ERROR, RowLevel.STALE]


def test_values_of_the_link() -> None:
    values = dict(rows(error="gone\nthen back")["link"].values)
    assert values == {
        "url": "serial:///dev/ttyUSB0",
        "connected": "yes",
        "reconnects": "2",
        "states wanted (Hz)": "100.0",
        "states (Hz)": "99.7",
        "age of the last state (s)": "0.010",
        "last error": "gone then back",
    }
    assert "states (Hz)" not in dict(rows(rate=NAN)["link"].values)


def test_the_link() -> None:
    assert verdict("link", connected=False) == (RowLevel.ERROR, "not connected")
    gone = verdict("link", connected=False, error="/dev/ttyUSB0 is gone\nplug it in")
    assert gone == (RowLevel.ERROR, "not connected: /dev/ttyUSB0 is gone plug it in")
    assert verdict("link", state=None, state_age=math.inf) == (RowLevel.STALE, "no state received yet")
    assert "age of the last state (s)" not in dict(rows(state=None, state_age=math.inf)["link"].values)
    assert verdict("link", state_age=1.01) == (RowLevel.STALE, "no new states")
    assert verdict("link", rate=79.9) == (RowLevel.WARNING, "states come too slowly")
    assert verdict("link", rate=80.1) == (RowLevel.OK, "ok")
    assert verdict("link", error="long ago") == (RowLevel.OK, "ok")
    assert verdict("link", rate=NAN) == (RowLevel.OK, "ok"), "not measured yet"
    assert verdict("link", rate=0.0, wanted_rate=0.0) == (RowLevel.OK, "ok")


def test_states_have_the_name_that_readers_know() -> None:
    link = diagnose(replace(FACTS, rate=79.9), states="joint_states")[0]
    assert link.text == "joint_states come too slowly"
    assert {"joint_states (Hz)", "joint_states wanted (Hz)"} <= dict(link.values).keys()


def test_a_slow_line_may_be_slow() -> None:
    slow = {"rate": 1.5, "wanted_rate": 1.5}
    assert verdict("link", state_age=1.4, **slow) == (RowLevel.OK, "ok")
    assert verdict("link", state_age=2.1, **slow)[0] is RowLevel.STALE
    assert verdict("J2 (servo 7)", state_age=1.4, **slow) == (RowLevel.OK, "ok")


def test_values_of_the_board() -> None:
    values = dict(
        rows(counters={"retries": 5, "timeouts": 0}, controllers={"arm": "moving", "": "idle"})["board"].values
    )
    assert values == {
        "robot": "hex7bot",
        "dialect": "2",
        "firmware": "2.0.1",
        "boot id": "0x1234ABCD",
        "capabilities": "watchdog, report",
        "watchdog (s)": "1",
        "watchdog tripped": "no",
        "stopped": "no",
        "controller arm": "moving",
        "controller": "idle",
        "board bus timeouts": "3",
        "retries": "5",
        "timeouts": "0",
    }
    assert dict(rows(watchdog=0.0)["board"].values)["watchdog (s)"] == "off"


def test_what_a_board_does_not_tell_is_left_out() -> None:
    probe = replace(PROBE, dialect=0, firmware="", boot_id=None, capabilities=())
    values = dict(rows(probe=probe)["board"].values)
    assert values["dialect"] == "none: servo bus"
    assert not {"firmware", "boot id", "capabilities"} & values.keys()


@pytest.mark.parametrize(
    ("kind", "level"),
    [
        ("asked", RowLevel.WARNING),
        ("following", RowLevel.ERROR),
        ("overload", RowLevel.ERROR),
        ("collision", RowLevel.ERROR),
        ("fault", RowLevel.ERROR),
        ("lost", RowLevel.ERROR),
        ("board", RowLevel.ERROR),
        ("", RowLevel.ERROR),
    ],
)
def test_a_stop_that_was_asked_for_is_no_fault(kind: str, level: RowLevel) -> None:
    assert verdict("board", stopped="for this", stop_kind=kind) == (level, "stopped: for this")
    assert dict(rows(stopped="for this", stop_kind=kind)["board"].values)["stopped"] == "for this"


def test_a_stop_that_only_the_board_tells_of() -> None:
    stopped = replace(STATE, stopped=True)
    assert verdict("board", state=stopped) == (RowLevel.ERROR, "stopped: a stop is latched on the board")
    tripped = replace(stopped, watchdog_tripped=True)
    assert verdict("board", state=tripped) == (
        RowLevel.ERROR,
        "stopped: the board's watchdog: the host fell silent",
    )
    assert dict(rows(state=tripped)["board"].values)["watchdog tripped"] == "yes"
    # A watchdog that tripped is a fault even after somebody has asked for a stop.
    assert verdict("board", state=tripped, stopped="asked", stop_kind="asked")[0] is RowLevel.ERROR


def test_the_probe_tells_of_a_stop_until_there_is_a_state() -> None:
    probe = replace(PROBE, stopped=True)
    assert verdict("board", probe=probe, state=None)[1] == "stopped: a stop is latched on the board"
    assert verdict("board", probe=probe) == (RowLevel.OK, "ok"), "it was resumed since"


def test_boards_that_do_not_watch_over_the_arm() -> None:
    one = replace(PROBE, unprotected="no watchdog, no limits on this board")
    assert verdict("board", probe=one) == (RowLevel.WARNING, "no watchdog, no limits on this board")
    assert verdict("board", probe=one, stopped="lost J1", stop_kind="lost") == (
        RowLevel.ERROR,
        "stopped: lost J1; no watchdog, no limits on this board",
    )


def test_the_board_of_a_link_that_is_gone_or_new() -> None:
    assert verdict("board", connected=False, stopped="x") == (RowLevel.STALE, "not connected")
    assert verdict("board", probe=None) == (RowLevel.STALE, "not probed yet")


def test_values_of_a_servo() -> None:
    assert dict(rows()["J2 (servo 7)"].values) == {
        "id": "7",
        "series": "hls",
        "note": "is scs, the model says hls",
        "position (deg)": "0.00",
        "velocity (deg/s)": "0.0",
        "load (%)": "12.5",
        "current (A)": "0.432",
        "voltage (V)": "7.4",
        "temperature (C)": "41",
        "torque": "on",
        "flags": "torque on",
        "age (s)": "0.000",
    }


def test_what_a_servo_does_not_tell_is_left_out() -> None:
    values = dict(rows()["J1 (servo 1)"].values)
    assert values["position (deg)"] == "90.00"
    assert values["torque"] == "off"
    assert not {"load (%)", "current (A)", "voltage (V)", "temperature (C)", "note"} & values.keys()


def test_faults_of_a_servo() -> None:
    assert servo(flags=int(JointFlag.SILENT), age=2.1) == (RowLevel.ERROR, "silent")
    both = int(JointFlag.OVERLOAD | JointFlag.TEMPERATURE | JointFlag.TORQUE_ON)
    assert servo(flags=both) == (RowLevel.ERROR, "temperature, overload")
    assert servo(flags=both | int(JointFlag.CLAMPED), temperature=75.0)[0] is RowLevel.ERROR


def test_warnings_of_a_servo() -> None:
    assert servo(flags=int(JointFlag.CLAMPED)) == (RowLevel.WARNING, "target clamped to the limits")
    assert servo(flags=int(JointFlag.CLAMPED), temperature=60.0)[1] == "target clamped to the limits, hot"


@pytest.mark.parametrize(
    ("series", "cut_off"), [("hls", 70), ("sts_sms", 70), ("scs", 80), ("seven_bot", 70), ("unknown", 70)]
)
def test_hot_is_ten_degrees_below_the_factory_cut_off(series: str, cut_off: int) -> None:
    joints = (PROBE.joints[0], replace(PROBE.joints[1], series=series))
    for temperature, expected in ((cut_off - 11.0, "ok"), (cut_off - 10.0, "hot"), (cut_off + 5.0, "hot")):
        state = replace(STATE, temperature=(NAN, temperature))
        assert verdict("J2 (servo 7)", probe=replace(PROBE, joints=joints), state=state)[1] == expected


def test_servos_that_nobody_has_seen() -> None:
    assert servo(flags=int(JointFlag.SILENT), age=math.inf, position=NAN) == (RowLevel.STALE, "never seen")
    assert verdict("J2 (servo 7)", state=None) == (RowLevel.STALE, "never seen")
    other = replace(PROBE, joints=(JointProbe("J9", 9, "hls", False),))
    assert verdict("J9 (servo 9)", probe=other) == (RowLevel.STALE, "never seen")


def test_servos_of_old_states() -> None:
    assert verdict("J2 (servo 7)", state_age=1.5) == (RowLevel.STALE, "no new states")
    assert verdict("J2 (servo 7)", state_age=NAN)[0] is RowLevel.STALE
    assert verdict("J2 (servo 7)", connected=False) == (RowLevel.STALE, "not connected")


def test_without_a_probe_the_state_tells_the_joints() -> None:
    found = rows(probe=None)
    assert list(found) == ["link", "board", "J1", "J2"]
    assert found["J2"].level is RowLevel.OK
    assert list(rows(probe=None, state=None)) == ["link", "board"]


def test_texts_do_not_change_with_figures() -> None:
    """Otherwise a change would be published in every cycle."""
    ill = replace(STATE, flags=(int(JointFlag.SILENT), int(JointFlag.CLAMPED)), temperature=(NAN, 65.0))
    worse = replace(ill, age=(7.3, 0.1), temperature=(NAN, 66.0), position=(1.0, 2.0), stamp=107.0)
    before = diagnose(replace(FACTS, state=ill, rate=50.0))
    after = diagnose(replace(FACTS, state=worse, rate=51.0, state_age=0.2, counters={"retries": 99}))
    assert [(r.name, r.level, r.text) for r in before] == [(r.name, r.level, r.text) for r in after]
    assert before != after


def row(text: str = "ok", level: RowLevel = RowLevel.OK, value: str = "1", name: str = "link") -> Row:
    return Row(level, name, text, (("x", value),))


def test_rows_are_due_once_a_second() -> None:
    watch = ChangeWatch()
    due = [t for t in range(100, 1100) if watch.due([row(value=str(t))], t / 100)]
    assert due[:3] == [100, 190, 290], "a tenth of a period early is in time"
    assert len(due) == 11


def test_a_caller_that_asks_once_per_period_is_always_due() -> None:
    watch = ChangeWatch(0.5)
    assert all(watch.due([row()], 0.5 * i + (0.02 if i % 2 else -0.02)) for i in range(100))


def test_a_change_is_due_at_once_but_a_value_is_no_change() -> None:
    watch = ChangeWatch()
    assert watch.due([row()], 5.0)
    assert not watch.due([row(value="2")], 5.2)
    assert watch.due([row("hot")], 5.3)
    assert not watch.due([row("hot")], 5.41)
    assert watch.due([row("hot", RowLevel.ERROR)], 5.5)
    assert watch.due([row("hot", RowLevel.ERROR), row(name="J1")], 5.7)
    assert not watch.due([row(name="J1"), row("hot", RowLevel.ERROR)], 5.85), "the order does not matter"
    assert watch.due([row("hot", RowLevel.ERROR)], 5.86)


def test_a_change_for_a_moment_does_not_flood() -> None:
    watch = ChangeWatch()
    due = sum(watch.due([row("ok" if i % 2 else "silent")], 5.0 + 0.01 * i) for i in range(1000))
    assert 10 <= due <= 101


def test_a_change_within_a_tenth_of_a_second_is_reported_after_it() -> None:
    watch = ChangeWatch()
    assert watch.due([row()], 5.0)
    assert not watch.due([row("silent")], 5.05)
    assert watch.due([row("silent")], 5.11)


def test_after_a_long_silence_it_does_not_catch_up() -> None:
    watch = ChangeWatch()
    assert watch.due([row()], 5.0)
    assert watch.due([row()], 50.0)
    assert not watch.due([row()], 50.5)
    assert watch.due([row()], 51.0)
