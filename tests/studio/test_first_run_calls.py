"""The first run as a page asks for it, without a browser: its steps, each way out of them, and who may."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.studio.running import until

from hexwire.drivers.registry import load_bus_arm
from hexwire.drivers.stored_calibration import stored_calibration
from hexwire.errors import HexwireError, LeaseError, StoppedError, UsageError
from hexwire.model.arm import ArmModel
from hexwire.studio.access import Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.calls import find_call
from hexwire.studio.tabs import Tab
from hexwire.wire.servo_packet import Instruction, ServoPacket

_names = itertools.count(1)


class Desk:
    """A studio, the page of somebody who may operate, and what all pages were told."""

    def __init__(self, folder: Path) -> None:
        self.studio = Studio(Access(frozenset()), folder)
        self.studio.source.silence = 5.0
        self.first, self.source = self.studio.first, self.studio.source
        self.tab = self.studio.tabs.open("session", Right.OPERATE)
        self.told: list[dict[str, Any]] = []
        self.studio.live.tell = lambda message, tab=None: self.told.append(  # type: ignore[method-assign]
            message() if callable(message) else message
        )

    def begin(self, kind: str = "so101", tab: Tab | None = None) -> None:
        self.first.begin(tab or self.tab, f"sim://{kind}?name=first{next(_names)}", kind)

    @property
    def servos(self) -> list[Any]:
        link: Any = self.source.need_bus().bus.link
        servos: list[Any] = link.device.wire.servos
        return servos

    def stored(self) -> list[tuple[int, ...]]:
        names = ("position_offset", "min_position_limit", "max_position_limit")
        return [tuple(servo.registers.stored(name) for name in names) for servo in self.servos]

    def measure(self) -> tuple[threading.Thread, list[str]]:
        """Begin to measure, in a thread, as a call of a page does; why it failed."""
        errors: list[str] = []

        def work() -> None:
            try:
                self.first.measure()
            except HexwireError as error:
                errors.append(str(error))

        thread = threading.Thread(target=work)
        thread.start()
        self.sampled()
        return thread, errors

    def sampled(self) -> None:
        """Wait until what a hand has done was seen."""
        seen = len(self.told)
        until(lambda: any(row["kind"] == "range" for row in self.told[seen + 1 :]), "a sample")

    def calibrate(self) -> None:
        """Move every joint to its ends, as a hand does, and finish."""
        thread, errors = self.measure()
        self.first.middle()
        # Not by more than half a turn at once, which would be taken for a smaller one the other way.
        for share in (0.5, 0.0, 0.5, 1.0):
            for servo in self.servos:
                low, high = servo.motion.stops or (servo.motion.position,) * 2
                servo.motion.position = low + share * (high - low)
            self.sampled()
        assert self.first.finish(sure=False) == ""
        thread.join(30)
        assert not thread.is_alive()
        assert not errors

    def step(self, joint: str, number: int) -> Any:
        """Hold a button of the first jog; what is held."""
        arm = self.source.need_arm()
        entry = arm.hold_to_run.begin(self.tab.key, number)
        assert entry is not None
        self.studio.holds.begin(self.tab, entry, "first", {"joint": joint, "way": 1}, arm.mark())
        return entry

    def goal(self) -> float:
        """Where J1 is."""
        state = self.source.need_arm().arm.owner.state
        assert state is not None
        return float(state.positions["J1"])

    def to(self, stage: str) -> None:
        while self.first.values()["stage"] != stage:
            self.first.forward(self.tab)


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(tmp_path)
    try:
        yield made
    finally:
        made.studio.close()


def test_an_uncalibrated_arm_says_so_and_is_led_to_its_first_jog(desk: Desk) -> None:
    desk.source.open(f"sim://so101?name=first{next(_names)}")
    assert "not calibrated" in str(desk.studio.facts()["uncalibrated"])
    # What is open goes on, so the emulated arm is still the same.
    desk.first.begin(desk.tab, "", "")
    before = desk.stored()
    desk.to("ranges")
    with pytest.raises(UsageError, match="measure the ranges first"):
        desk.first.forward(desk.tab)
    desk.calibrate()
    # Nothing is stored before somebody has said so, having seen what.
    assert desk.stored() == before
    told = desk.first.values()
    assert "→" in told["rows"][0][1]
    assert told["measured"]["lerobot"]
    desk.first.store()
    after = desk.stored()
    assert after != before
    assert not any(servo.torque_on for servo in desk.servos)
    desk.to("jog")
    arm = desk.source.need_arm()
    assert arm.uncalibrated == ""
    # With the calibration that is in the servos: the measured ends are its limits.
    gripper = arm.settings.model.joint("gripper")
    assert gripper.minimum == pytest.approx(-gripper.maximum, abs=0.01)
    with pytest.raises(UsageError, match="no torque"):
        desk.step("gripper", 1)
    desk.first.back(desk.tab)
    assert desk.source.mode == "bus"
    assert desk.stored() == after
    assert desk.first.values()["missing"] == ""
    desk.first.undo()
    assert desk.stored() == before
    with pytest.raises(UsageError):
        desk.first.undo()


def test_each_way_out_of_measuring_leaves_the_arm_limp_and_its_servos_as_they_were(desk: Desk) -> None:
    desk.begin()
    before = desk.stored()
    desk.to("ranges")
    ways = {
        "cancelled": desk.source.need_bus().bench.cancel,
        "stopped it": lambda: desk.source.need_bus().stop("somebody stopped it"),
        "given back": lambda: desk.studio.gone(desk.tab),
    }
    for words, end in ways.items():
        thread, errors = desk.measure()
        with pytest.raises(UsageError, match="shoulder_pan not moved yet"):
            desk.first.finish(sure=True)
        with pytest.raises(UsageError, match="finish or cancel"):
            desk.first.forward(desk.tab)
        end()
        thread.join(30)
        assert not thread.is_alive()
        assert len(errors) == 1, words
        assert words in errors[0]
        told = desk.first.values()
        assert (told["stage"], told["measuring"], told["measured"]) == ("ranges", False, None), words
        assert not any(servo.torque_on for servo in desk.servos), words
        assert desk.stored() == before, words
    # A stop lasts, and refuses what would be written.
    desk.first.leave()
    assert "stage" not in desk.first.values()


def test_a_joint_that_moved_less_than_usual_is_asked_about_and_a_stop_refuses_to_store(desk: Desk) -> None:
    desk.begin()
    before = desk.stored()
    desk.to("ranges")
    thread, errors = desk.measure()
    desk.first.middle()
    for _ in range(2):
        for servo in desk.servos:
            servo.motion.position -= 50
        desk.sampled()
    assert "shoulder_pan 9 of 220 deg" in desk.first.finish(sure=False)
    assert desk.first.values()["measuring"]
    assert desk.first.finish(sure=True) == ""
    thread.join(30)
    assert not errors
    assert desk.first.values()["measured"]
    desk.source.need_bus().stop("somebody stopped it")
    with pytest.raises(StoppedError):
        desk.first.store()
    assert desk.stored() == before


def test_an_arm_that_is_opened_by_its_name_has_the_ranges_that_its_servos_store(
    desk: Desk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.begin()
    desk.to("ranges")
    desk.calibrate()
    desk.first.store()
    measured = [(joint.minimum, joint.maximum) for joint in _stored_arm(desk).joints]
    usual = [(joint.minimum, joint.maximum) for joint in load_bus_arm("so101").described().model.joints]
    assert measured != usual
    desk.first.leave()
    link, opened = desk.source.need_bus().bus.link, list[list[tuple[float, float]]]()
    desk.source.close()
    # The same servos again, as when their cable is plugged in another day.
    monkeypatch.setattr("hexwire.link.open.make_link", lambda url: link)
    own = tmp_path / "own.toml"
    own.write_text('name = "own"\nbase = "so101"\n', encoding="utf-8")
    for robot in ("so101", str(own), None):
        arm = desk.source.open("sim://so101?name=again", robot)
        assert arm.uncalibrated == ""
        opened.append([(joint.minimum, joint.maximum) for joint in arm.settings.model.joints])
        assert arm.driver.model.name == ("own" if robot == str(own) else "so101")
        assert not any(servo.torque_on for servo in link.device.wire.servos)  # type: ignore[attr-defined]
        desk.source.close()
    assert opened == [measured, usual, measured]


def _stored_arm(desk: Desk) -> ArmModel:
    """The arm with what its servos have stored."""
    model = load_bus_arm("so101").described().model
    return stored_calibration(desk.source.need_bus().bus, model).apply(model)


def test_after_storing_failed_nobody_goes_on_with_what_the_servos_had_before(desk: Desk) -> None:
    desk.begin()
    desk.to("ranges")
    desk.calibrate()
    desk.first.store()
    assert desk.first.values()["missing"] == ""
    lift = desk.servos[1]
    receive, alive = lift.receive, True

    def dying(packet: ServoPacket, now: float) -> bytes | None:
        nonlocal alive
        alive = alive and packet.instruction != Instruction.WRITE
        answer: bytes | None = receive(packet, now) if alive else None
        return answer

    lift.receive = dying
    with pytest.raises(HexwireError, match="shoulder_lift may have new values"):
        desk.first.undo()
    assert desk.first.values()["missing"] == "measure the ranges first"
    with pytest.raises(UsageError, match="measure the ranges first"):
        desk.first.forward(desk.tab)


def test_a_hex7bot_is_led_past_the_calibration(desk: Desk) -> None:
    desk.begin("hex7bot")
    told = desk.first.values()
    assert (told["bare"], told["missing"]) == (False, "")
    # Begun again with what is open, it does not follow the arm twice.
    followers = len(desk.source.need_arm().listeners)
    desk.first.begin(desk.tab, "", "")
    assert len(desk.source.need_arm().listeners) == followers
    desk.to("ranges")
    with pytest.raises(UsageError, match="not calibrated at this step"):
        desk.first.measure()
    until(lambda: any(row["kind"] == "range" for row in desk.told), "what a hand moves")
    desk.to("jog")
    arm = desk.source.need_arm()
    arm.arm.owner.torque(True, arm.settings.model.names)
    until(lambda: not arm.torques().limp, "torque")
    start = desk.goal()
    entry = desk.step("J1", 1)
    # Held for as long as it takes, it ends by itself after one small step.
    until(lambda: entry.ended or not arm.hold_to_run.beat(desk.tab.key, 1), "its end")
    assert entry.ended == "arrived"
    # It has arrived as closely as a goal asks for.
    until(lambda: abs(math.degrees(desk.goal() - start) - 5.0) < 0.2, "the end of the step")
    until(lambda: desk.first.values()["missing"] == "", "the step")
    desk.to("done")


def test_another_page_can_neither_end_nor_take_over_a_run(desk: Desk) -> None:
    desk.begin()
    desk.to("calibrated")
    other = desk.studio.tabs.open("other", Right.OPERATE)
    with pytest.raises(LeaseError):
        desk.begin("so101", other)
    with pytest.raises(LeaseError):
        desk.first.begin(other, "", "so101")
    assert desk.first.values()["stage"] == "calibrated"
    for name in ("again", "next", "back", "leave", "measure", "middle", "finish", "store", "undo"):
        assert find_call(f"first.{name}").control, name
    assert find_call("first.begin").right is Right.OPERATE
    # Whatever else is opened ends it.
    desk.source.close()
    assert "stage" not in desk.first.values()
    with pytest.raises(UsageError, match="begin again"):
        desk.first.forward(desk.tab)
