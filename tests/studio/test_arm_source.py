"""An open arm: how soon a hold ends on its line, and what it counts as a stop."""

from __future__ import annotations

import math
import struct
import threading
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from tests.studio.running import PATIENCE, until

from hexwire.control.loop import holding
from hexwire.control.loop.known_state import KNOWN_FOR
from hexwire.control.motion import motion_run
from hexwire.control.motion.hold_to_run import HeldMotion
from hexwire.errors import DeviceError, UsageError
from hexwire.model.state import JointFlag, JointState, JointTarget, SentTarget
from hexwire.studio import arm_source
from hexwire.studio.access import Right
from hexwire.studio.frames import FrameBit
from hexwire.studio.source import ArmSource, Source
from hexwire.studio.tabs import Tab


@pytest.fixture
def source() -> Iterator[Source]:
    made = Source()
    try:
        yield made
    finally:
        made.close()


def controlled(source: Source, address: str, **settings: object) -> tuple[ArmSource, Tab]:
    """An arm with torque, and the page that has control; a machine that stalls ends nothing that it holds."""
    source.silence = 60.0
    arm = source.open(address, **settings)
    arm.arm.enable(True)
    tab = Tab("tab 1", "key", "session", Right.OPERATE)
    source.take(tab)
    return arm, tab


def held(arm: ArmSource, tab: Tab, number: int) -> HeldMotion:
    """What a page begins to hold, with the number that it gives it."""
    entry = arm.hold_to_run.begin(tab.key, number)
    assert entry is not None
    return entry


def angles_sent(arm: ArmSource, joint: str, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The angles that a joint is sent to from now on, radians."""
    told: list[float] = []
    write = arm.driver.write

    def noted(target: JointTarget) -> SentTarget:
        told.extend(angle for name, angle in target.positions if name == joint)
        return write(target)

    monkeypatch.setattr(arm.driver, "write", noted)
    return told


def test_on_a_slow_line_less_silence_ends_a_hold(source: Source) -> None:
    arm = source.open("sim://hex7bot?name=slow&dialect=1")
    assert arm.hold_to_run.silence == arm.jog.silence == 0.15


def test_on_a_slow_line_less_silence_ends_a_motion_to_a_goal_too(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = source.open("sim://hex7bot?name=slower&dialect=1")
    given: dict[str, Any] = {}

    def begin(orders: Any, args: Any, **more: Any) -> None:
        given.update(more)
        raise UsageError("that is enough")

    monkeypatch.setattr(arm.motions, "begin", begin)
    entry = arm.hold_to_run.begin("somebody", 1)
    assert entry is not None
    tab: Any = None
    with pytest.raises(UsageError, match="enough"):
        arm.begin_run(tab, entry, {}, arm.mark())
    assert given["silence"] == 0.15


def test_questions_of_pages_cannot_keep_the_line_busy(source: Source) -> None:
    arm = source.open("sim://hex7bot?name=asked")
    now, asked = 0.0, list[str]()
    arm.arm.owner.now = lambda: now  # type: ignore[method-assign]

    def call(said: str) -> str:
        asked.append(said)
        if said == "it hangs":
            raise UsageError(said)
        return said

    found = list[str]()

    def burst() -> None:
        found.extend(arm.ask("pings", lambda: call("there")) for _ in range(50))

    threads = [threading.Thread(target=burst) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (found, asked) == (["there"] * 400, ["there"])
    # Another question has another answer, and a fault is one for all, too.
    for _ in range(3):
        with pytest.raises(UsageError, match="it hangs"):
            arm.ask("probe", lambda: call("it hangs"))
    assert asked == ["there", "it hangs"]
    now = 2.1
    assert [arm.ask("probe", lambda: call("again")), arm.ask("pings", lambda: call("again"))] == ["again"] * 2


def test_every_stop_counts_whoever_makes_it(source: Source) -> None:
    arm = source.open("sim://hex7bot?name=stops")
    before = arm.stops
    arm.stop("a test")
    by_page = arm.stops
    assert by_page > before
    arm.arm.owner.reset()
    assert arm.stops == by_page
    arm.driver.stop()
    assert arm.stops > by_page


def test_a_motion_ends_because_its_page_was_closed_not_for_its_lease(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(motion_run, "_FAREWELL", 60.0)
    arm, tab = controlled(source, "sim://hex7bot?name=leaves", watchdog=5.0)
    entry = held(arm, tab, 1)
    arm.begin_run(tab, entry, {"what": "joints", "goals": {"J1": 1.0}, "speed": 0.05}, arm.mark())
    # The thread that ends motions is late; the one that gives control back is not.
    late = threading.Event()
    arm._ender.submit(late.wait, 10.0)
    arm.hold_to_run.end(tab.key, "its page was closed")
    leaving = threading.Thread(target=source.leave, args=(tab,))
    leaving.start()
    leaving.join(0.2)
    late.set()
    leaving.join()
    progress = arm.motions.progress
    assert progress is not None
    assert (progress.outcome, progress.text) == ("preempted", "its page was closed")
    assert arm.holder is None


def test_a_released_jog_brakes_instead_of_going_back_to_where_it_was_measured(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, tab = controlled(source, "sim://hex7bot?name=brakes", watchdog=5.0)
    told = angles_sent(arm, "J1", monkeypatch)
    entry = held(arm, tab, 1)
    arm.begin_jog(tab, entry, "joint", {"directions": {"J1": 1.0}, "speed": 0.4}, arm.mark())
    until(lambda: any(b - a > 0.02 for a, b in pairwise(told[:])), "it moves")
    arm.hold_to_run.end(tab.key, "released")
    released = len(told)
    until(lambda: not arm.jog.busy, "it rests")
    # How evenly it brakes is for simulated time: after a stall of the machine nothing more is sent.
    steps = [after - before for before, after in pairwise(told[released - 1 :])]
    assert all(step >= -1e-9 for step in steps), f"it never goes back: {steps}"


def test_a_jog_that_begins_during_a_motion_begins_where_its_joints_have_braked(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, tab = controlled(source, "sim://so101?name=takes_over")
    told = angles_sent(arm, "shoulder_pan", monkeypatch)
    first = held(arm, tab, 1)
    far = {"what": "joints", "goals": {"shoulder_pan": 1.5}, "speed": 1.0}
    arm.begin_run(tab, first, far, arm.mark())
    # At any time: it may have arrived when this looks.
    until(lambda: any(b - a > 0.1 for a, b in zip(told[:], told[3:], strict=False)), "it moves")
    arm.hold_to_run.end(tab.key, "released")
    second = held(arm, tab, 2)
    ended = len(told)
    arm.begin_jog(tab, second, "joint", {"directions": {"shoulder_pan": 1.0}, "speed": 0.1}, arm.mark())
    until(lambda: len(told) > ended + 5, "it brakes and jogs")
    # Nothing is sent between the last target of the brake and the first of the jog.
    steps = [b - a for a, b in pairwise(told)]
    # After a stall of the machine it begins where the servo stands, by its counts.
    assert all(step >= -2 * math.pi / 4096 for step in steps[ended - 2 :]), f"it never goes back: {steps}"
    assert steps[-1] < 0.5 * max(steps[: ended - 1]), f"it jogs at its own speed: {steps}"


def test_a_jog_that_begins_after_another_lets_its_joints_brake_first(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    # However long a busy machine takes for it.
    monkeypatch.setattr(arm_source, "_BRAKES", PATIENCE)
    arm, tab = controlled(source, "sim://so101?name=jogs_again")
    cut: list[bool] = []
    release = arm.jog.release

    def noted(why: str) -> None:
        cut.append(arm.jog.busy)
        release(why)

    monkeypatch.setattr(arm.jog, "release", noted)
    for number in (1, 2):
        entry = held(arm, tab, number)
        before = arm.goals.get("shoulder_pan", 0.0)
        arm.begin_jog(tab, entry, "joint", {"directions": {"shoulder_pan": 1.0}, "speed": 1.0}, arm.mark())
        until(lambda before=before: arm.goals.get("shoulder_pan", 0.0) - before > 0.05, "it moves")  # type: ignore[misc]  # bound now
        arm.hold_to_run.end(tab.key, "released")
    # A jog takes the joints over from whatever moves them: here they rest already.
    assert cut
    assert not any(cut)


def test_on_a_slow_line_a_released_jog_holds_though_the_owner_is_late(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Any line is as slow as that.
    for module in (arm_source, holding):
        monkeypatch.setattr(module, "SOON", 0.0)
    arm, tab = controlled(source, "sim://hex7bot?name=holds", watchdog=5.0)
    told: list[JointTarget] = []
    write = arm.driver.write

    def noted(target: JointTarget) -> SentTarget:
        told.append(target)
        if arm.hold_to_run.entry is None:
            raise DeviceError("it cannot be sent")
        return write(target)

    monkeypatch.setattr(arm.driver, "write", noted)
    entry = held(arm, tab, 1)
    arm.begin_jog(tab, entry, "joint", {"directions": {"J1": 1.0}, "speed": 0.4}, arm.mark())
    until(lambda: told, "it moves")
    with arm.arm.owner.deciding():
        # The thread that asks the jog for its targets does not see its end, while J1 is still on its way.
        monkeypatch.setattr(arm.jog, "cycle", lambda *_: None)
        monkeypatch.setattr(arm.arm.owner, "running", lambda: ("J1",))
        moved = len(told)
        arm.hold_to_run.end(tab.key, "released")
    until(lambda: arm.facts()["stopped"], "what cannot hold is stopped")
    assert [[name for name, _ in target.positions] for target in told[moved:]] == [["J1"]]
    assert "released" in str(arm.facts()["stopped"])
    assert not arm.jog.busy


def test_a_held_jog_says_why_it_does_not_move_and_a_stop_is_in_the_frame(source: Source) -> None:
    source.silence = 60.0
    arm = source.open("sim://hex7bot?name=says")
    until(lambda: len(arm.driver.round_trips) > 0 and arm.arm.owner.state is not None, "a state")
    state = arm.arm.owner.state
    assert state is not None

    def bits() -> int:
        return int(struct.unpack_from("<H", arm.frame(state), 2)[0])

    arm.jog.note = "J1 is at its limit"
    assert arm.facts()["note"] == ""
    assert not bits() & (FrameBit.STOPPED | FrameBit.HELD)
    assert arm.hold_to_run.begin("somebody", 1) is not None
    assert arm.facts()["note"] == "J1 is at its limit"
    arm.stop("a test")
    assert bits() & FrameBit.STOPPED
    arm.arm.owner = Seen(arm.arm.owner, state)  # type: ignore[assignment]  # at the time of that state
    arm.driver = Seen(arm.driver, state, round_trips=(0.001, 0.0012345))  # type: ignore[assignment]
    assert arm.facts()["round_trip_ms"] == 1.23
    arm.arm.owner, arm.driver = arm.arm.owner._owner, arm.driver._owner


class Seen:
    """An owner as it is at some time after a state."""

    def __init__(self, owner: Any, state: JointState, later: float = 0.0, **more: Any) -> None:
        self.__dict__.update(more, state=state, now=lambda: state.stamp + later, _owner=owner)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._owner, name)

    @property  # type: ignore[misc]  # a driver is asked for its abilities by their classes
    def __class__(self) -> Any:
        return type(self._owner)


MEASURED = {"known": False, "dialect": 0, "rate": None, "round_trip_ms": None, "faults": None, "torque": "unknown"}
"""What the facts say once nothing is known any more."""
LASTING = {"robot", "url", "connected", "error", "last", "missing", "unready"}
LASTING |= {"holder", "lost", "stopped", "stops", "note", "uncalibrated", "teaching", "taught"}
"""What the studio knows by itself."""


def test_every_field_that_is_not_known_is_unknown_within_a_second(source: Source) -> None:
    arm = source.open("sim://hex7bot?name=grey")
    arm._wall = lambda: 1000.0
    owner = arm.arm.owner
    arm.driver.torque(True)
    until(
        lambda: owner.state is not None and len(owner.state.torque_on) == 7 and owner.rate > 1, "torque in a state"
    )
    state, joints = owner.state, 7
    assert state is not None

    def at(later: float, seen: JointState = state, **more: Any) -> dict[str, Any]:
        arm.arm.owner = Seen(owner, seen, later, **more)  # type: ignore[assignment]  # as it is at another time
        return arm.facts()

    known = at(0.0)
    # A field that is added is a question that somebody has to answer here.
    assert set(known) == set(MEASURED) | LASTING
    for later, fresh in (
        (0.5, True),
        (KNOWN_FOR - max(state.age) - 0.01, True),
        (KNOWN_FOR + 0.05, False),
        (30.0, False),
    ):
        facts = at(later)
        for name, unknown in MEASURED.items():
            # The rate is the owner's own, and ends with the state.
            assert (facts[name] != unknown) is fresh, (name, later)
        assert (facts["last"] is None, facts["unready"] == "") == (fresh, fresh), later
        assert len(facts["missing"]) == (0 if fresh else joints), later
        bits = struct.unpack_from("<H", arm.frame(state), 2)[0]
        flags = struct.unpack(f"<{joints}H", arm.frame(state)[-2 * joints :])
        assert bool(bits & FrameBit.KNOWN) is fresh, later
        assert [bool(each & JointFlag.SILENT) for each in flags] == [not fresh] * joints
        assert (arm.row()["known"], arm.row()["torque"]) == (fresh, "on" if fresh else "")
    assert at(30.0)["last"] == 970
    # A lost connection, at once.
    lost = at(0.0, connected=False, error="unplugged")
    assert {name: lost[name] for name in MEASURED} == MEASURED
    assert lost["unready"] == "the arm is not connected: unplugged"
    # Each joint for itself: by its servo's silence, and by the age of its sample.
    for i, name in enumerate(state.names):
        flags_of = [*state.flags]
        flags_of[i] |= JointFlag.SILENT
        ages = [*state.age]
        ages[i] = 1.0
        for part in (replace(state, flags=tuple(flags_of)), replace(state, age=tuple(ages))):
            facts = at(0.0, part)
            assert facts["missing"] == [name]
            assert facts["unready"] == f"{name} does not answer: nobody knows where the arm is"
            assert facts["torque"] == f"unknown: {name}"
            assert facts["faults"] == [f"{name}: silent"]
            silent = struct.unpack(f"<{joints}H", arm.frame(part)[-2 * joints :])
            assert [bool(each & JointFlag.SILENT) for each in silent] == [other == name for other in state.names]
    arm.arm.owner = owner
