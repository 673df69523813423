from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import Any

import pytest
from click.testing import CliRunner
from tests.motion.arms import HOME

from hexwire.cli.main import cli
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.bus_arms import HEX7BOT_START, make_bus_arm
from hexwire.emulator.hand import Grip, HandOrder, Hands
from hexwire.emulator.physics import PhysicsTwin
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.errors import UsageError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link import open as ipc_open
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.state import JointState, JointTarget

MODEL = Hex7BotModel()


class Arm:
    """A driver on a board whose servos move a body, in simulated time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, payload: float = 0.0, table: bool = True) -> None:
        self.clock = FakeClock(1000.0)
        self.board = make_hex7bot_board(baud=115200, start=1000.0)
        self.twin = PhysicsTwin(self.board.wire.servos, MODEL, payload=payload, table=table)
        link = BoardLink(self.board, self.clock, baud=115200)
        monkeypatch.setattr(ipc_open, "make_link", lambda url: link)
        self.driver = Hex7BotDriver(Session(IpcHandle.from_url("/dev/ttyTEST")))
        self.driver.attach()

    def move(self, change: Mapping[str, float], seconds: float = 1.5) -> JointState:
        self.driver.torque(True)
        goal = {**HOME, **{name: HOME[name] + math.radians(deg) for name, deg in change.items()}}
        self.driver.write(JointTarget.of(goal, seconds))
        return self.wait(seconds + 1.0)

    def wait(self, seconds: float) -> JointState:
        """Let time pass while the board polls its servos; the state then."""
        for _ in range(round(seconds / 0.1)):
            self.clock.advance(0.1)
            self.driver.read()
        return self.driver.read()

    def torque(self, name: str) -> float:
        return self.board.wire.servos[MODEL.arm.index(name)].motion.torque

    def tip(self, state: JointState) -> tuple[float, ...]:
        return MODEL.forward(MODEL.from_joints(state.positions)).position


def test_at_rest_the_arm_stays_where_the_servos_stood(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = Arm(monkeypatch)
    arm.driver.torque(True)
    arm.wait(0.5)
    for servo, start in zip(arm.board.wire.servos, HEX7BOT_START, strict=True):
        # Gears and controller give way a little under the weight: under three degrees.
        assert servo.motion.position == pytest.approx(start, abs=32)


def test_weight_shows_as_load_and_sag_and_grows_with_the_payload(monkeypatch: pytest.MonkeyPatch) -> None:
    stretched = {"J2": -45.0, "J3": -10.0}
    light = Arm(monkeypatch)
    state = light.move(stretched)
    empty = light.torque("J2")
    height = light.tip(state)[2]
    assert empty > 0.05, "the shoulder holds the arm up"
    heavy = Arm(monkeypatch, payload=0.3)
    loaded = heavy.move(stretched)
    # 0.3 kg some 0.3 m out, shared by shoulder and elbow; drive is a share of 3 Nm.
    assert heavy.torque("J2") - empty > 0.08
    assert heavy.tip(loaded)[2] < height - 0.003, "and sags under it"


@pytest.mark.slow
def test_load_register_of_the_small_servos_shows_the_tools_weight(monkeypatch: pytest.MonkeyPatch) -> None:
    level = {"J5": -80.0}
    empty = Arm(monkeypatch).move(level)["J5"].load
    loaded = Arm(monkeypatch, payload=0.5).move(level)["J5"].load
    assert abs(loaded) > abs(empty) + 0.03


def test_the_body_is_where_the_kinematics_say(monkeypatch: pytest.MonkeyPatch) -> None:
    import mujoco

    arm = Arm(monkeypatch, payload=0.01)
    state = arm.move({"J1": 30.0, "J2": -20.0, "J3": 15.0, "J4": 25.0, "J5": 40.0, "J6": -50.0})
    ball = mujoco.mj_name2id(arm.twin._model, mujoco.mjtObj.mjOBJ_GEOM, "payload")
    mujoco.mj_forward(arm.twin._model, arm.twin._data)
    # A millimetre: half a count of each joint, and the give of the parallelogram.
    assert list(arm.twin._data.geom_xpos[ball]) == pytest.approx(arm.tip(state), abs=2e-3)


def test_the_table_stops_the_arm_and_the_load_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    # Without a table the tip would be well under the arm's foot.
    through = {"J2": -50.0, "J3": 70.0}
    free = Arm(monkeypatch, table=False)
    below = free.tip(free.move(through))[2]
    assert below < -0.02
    arm = Arm(monkeypatch)
    state = arm.move(through)
    assert arm.twin.contacts > 0
    assert arm.tip(state)[2] > -0.01
    pressed = abs(arm.torque("J2") - free.torque("J2")) + abs(arm.torque("J3") - free.torque("J3"))
    assert pressed > 0.3


def test_without_torque_a_heavy_arm_falls_onto_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = Arm(monkeypatch, payload=1.0)
    before = arm.tip(arm.move({"J2": -30.0}))[2]
    arm.driver.torque(False)
    after = arm.tip(arm.wait(3.0))[2]
    assert after < before - 0.05


@pytest.mark.slow
def test_obstacles_and_pushes_set_by_hand_work_as_with_the_usual_shafts(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = Arm(monkeypatch)
    shaft = arm.board.wire.servos[0].motion
    shaft.obstacle = (None, shaft.position + 100)
    state = arm.move({"J1": 30.0})
    assert shaft.blocked
    assert state["J1"].position < HOME["J1"] + math.radians(12)
    shaft.obstacle = (None, None)
    shaft.external_torque = -0.2
    pushed = arm.move({"J1": 0.0})["J1"].position
    assert pushed < HOME["J1"] - math.radians(0.5)


class SoBody:
    """An SO-101 whose servos move a body, with hands at it."""

    def __init__(self, table: bool = True, **options: Any) -> None:
        self.arm = make_bus_arm("so101", **options)
        self.twin = PhysicsTwin(self.arm.servos, self.arm.model, table=table)
        self.hands = Hands(self.arm.servos, self.arm.model)
        self.now = 0.0

    def run(self, seconds: float) -> dict[str, float]:
        """Let time pass; the joints' angles then, degrees."""
        self.now += seconds
        for servo in self.arm.servos:
            servo.step(self.now)
        return {
            joint.name: math.degrees(joint.counts_to_angle(servo.motion.position))
            for joint, servo in zip(self.arm.model.joints, self.arm.servos, strict=True)
        }

    def take(self, joint: str, degrees: float, hold: float = 0.0, force: float = 0.9) -> Grip:
        return self.hands.take(HandOrder(joint, degrees, 1.5, hold, force), self.now)


def test_an_so_arm_follows_hands_and_sinks_onto_the_table_when_they_let_go() -> None:
    body = SoBody()
    folded = body.run(1.0)
    assert folded["shoulder_lift"] == pytest.approx(-95.0, abs=3)
    grips = [body.take("shoulder_lift", 80.0, hold=1.0), body.take("elbow_flex", -80.0, hold=1.0)]
    lifted = body.run(2.0)
    assert lifted["shoulder_lift"] - folded["shoulder_lift"] == pytest.approx(80.0, abs=2.0)
    assert lifted["elbow_flex"] - folded["elbow_flex"] == pytest.approx(-80.0, abs=2.0)
    assert body.twin.contacts == 0
    body.run(1.0)
    assert all(grip.step(body.now) for grip in grips)
    sunk = body.run(3.0)
    assert sunk["shoulder_lift"] > lifted["shoulder_lift"] + 5.0, "forward"
    assert sunk["elbow_flex"] > lifted["elbow_flex"] + 5.0, "and down"
    assert body.twin.contacts > 0
    assert body.run(2.0) == pytest.approx(sunk, abs=1.0), "where it rests"


def test_the_gears_friction_holds_what_is_light() -> None:
    body = SoBody()
    assert body.take("gripper", 40.0, force=0.05).step(body.now) is None
    assert body.run(2.0)["gripper"] == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize("leader", [False, True])
def test_bodies_end_at_mechanical_stops(leader: bool) -> None:
    body = SoBody(leader=leader, any_horns=True, seed=3)
    for degrees, end in ((200.0, 115.0), (-300.0, -115.0)):
        grip = body.take("shoulder_pan", degrees)
        angles = body.run(2.0)
        result = grip.step(body.now)
        assert result is not None
        assert result.blocked
        assert angles["shoulder_pan"] == pytest.approx(end, abs=0.3)


def test_a_joint_with_torque_gives_way_to_a_hand_and_returns() -> None:
    body = SoBody()
    pan = body.arm.servos[0]
    pan._write(pan.series.registers["torque_enable"].address, b"\x01")
    grip = body.take("shoulder_pan", 40.0, force=0.6)
    body.run(2.0)
    result = grip.step(body.now)
    assert result is not None
    assert (result.torque, result.moved) == (True, pytest.approx(3.3, abs=0.5))
    assert body.run(1.0)["shoulder_pan"] == pytest.approx(0.0, abs=0.3)


def test_a_servo_that_counts_its_turns_anew_does_not_move_the_body() -> None:
    body = SoBody()
    grip = body.take("wrist_roll", 359.0, force=1.0)
    before = body.run(2.0)["wrist_roll"]
    assert grip.step(body.now) is not None
    roll = body.arm.servos[4]
    assert before > 180
    counts = roll.motion.position
    roll.power_cycle(body.now)
    assert roll.motion.position == pytest.approx(counts - 4096, abs=1)
    assert body.run(0.5)["wrist_roll"] == pytest.approx(before - 360, abs=1)
    assert math.degrees(body.twin._data.qpos[body.twin.shafts[4].place]) == pytest.approx(before, abs=1)


def test_an_so_arm_lifts_a_payload_and_sags_under_it() -> None:
    heights = []
    for payload in (0.0, 0.3):
        arm = make_bus_arm("so101")
        PhysicsTwin(arm.servos, arm.model, payload=payload)
        for servo in arm.servos:
            servo._write(servo.series.registers["torque_enable"].address, b"\x01")
        elbow = arm.servos[2]
        elbow._write(
            elbow.series.registers["goal_position"].address,
            round(elbow.motion.position - 600).to_bytes(2, "little"),
        )
        for servo in arm.servos:
            servo.step(3.0)
        heights.append(elbow.motion.position)
    assert heights[1] > heights[0] + 3


def test_an_invalid_payload_is_refused() -> None:
    with pytest.raises(UsageError, match="payload is -1 kg, but must be"):
        PhysicsTwin([], MODEL, payload=-1.0)


def test_without_the_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(UsageError, match=r"pip install 'hexwire\[sim\]'"):
        PhysicsTwin([], MODEL)


@pytest.mark.system
def test_on_the_command_line(monkeypatch: pytest.MonkeyPatch) -> None:
    result = CliRunner().invoke(cli, ["sim", "board", "--payload", "10"])
    assert result.exit_code == 2
    assert "--payload needs --physics" in result.stderr


@pytest.mark.parametrize(("leader", "sinks"), [(False, False), (True, True)])
def test_the_wrist_of_a_leader_sinks_and_that_of_a_follower_is_held_by_its_gears(leader: bool, sinks: bool) -> None:
    body = SoBody(table=False, leader=leader)
    start = body.run(0.001)["wrist_flex"]
    assert (body.run(1.0)["wrist_flex"] > start + 15.0) is sinks
