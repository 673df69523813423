"""The keyboard and a game pad, which move the tip of the robot that the program has connected: simulated."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any
from weakref import WeakSet

import pytest
from lerobot.teleoperators import make_teleoperator_from_config
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_robot_hexwire import (
    HexwireGamepad,
    HexwireGamepadConfig,
    HexwireKeyboard,
    HexwireKeyboardConfig,
    HexwireSO101,
    guides,
    robots,
)
from simulated import PERIOD, Sim

from hexwire.errors import LinkLostError
from hexwire.wire.robot_bodies import JoystickState

DEAD_MAN = 1 << 4
Ready = Callable[[Any], "Loop"]
KEYS = {"up": (0, 1), "down": (0, -1), "left": (1, 1), "right": (1, -1), "shift_r": (2, 1), "shift": (2, -1)}
"""Axis and direction of each key."""


class Listener:
    """As that of pynput, for a test that presses the keys."""

    newest: Listener

    def __init__(self, on_press: Callable[[Any], object], on_release: Callable[[Any], object]) -> None:
        self.on_press, self.on_release, self.alive = on_press, on_release, False
        Listener.newest = self

    def start(self) -> None:
        self.alive = True

    def stop(self) -> None:
        self.alive = False

    def is_alive(self) -> bool:
        return self.alive

    def press(self, *names: str) -> None:
        for name in names:
            self.on_press(SimpleNamespace(char=name) if len(name) == 1 else SimpleNamespace(name=name))

    def release(self, *names: str) -> None:
        for name in names:
            self.on_release(SimpleNamespace(char=name) if len(name) == 1 else SimpleNamespace(name=name))


class Pad:
    """As a joystick device."""

    def __init__(self) -> None:
        self.axes, self.buttons = [0.0] * 8, 0
        self.lost = self.closed = False

    def read(self) -> JoystickState:
        if self.lost:
            raise LinkLostError("/dev/input/js0 was unplugged")
        return JoystickState(tuple(self.axes), self.buttons)

    def close(self) -> None:
        self.closed = True


class Loop:
    """The loop of `lerobot-teleoperate`, and where the tip is."""

    def __init__(self, sim: Sim, robot: HexwireSO101, guide: Any) -> None:
        self.sim, self.robot, self.guide = sim, robot, guide
        self.places: list[tuple[float, float, float]] = []
        self.tip()

    def tip(self) -> tuple[float, float, float]:
        """Millimetres ahead, to the left and up."""
        geometry = self.robot.driver.kinematics
        assert geometry is not None
        here = self.robot.driver.read().positions
        x, y, z = geometry.forward(geometry.from_joints(here)).position
        return 1000 * x, 1000 * y, 1000 * z

    def run(self, seconds: float) -> dict[str, float]:
        sent: dict[str, float] = {}
        for _ in range(round(seconds / PERIOD)):
            self.robot.get_observation()
            sent = self.robot.send_action(self.guide.get_action())
            self.sim.clock.advance(PERIOD)
            self.places.append(self.tip())
        return sent


@pytest.fixture
def listener(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pynput.keyboard", SimpleNamespace(Listener=Listener))


@pytest.fixture
def ready(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[Any], Loop]]:
    """Makes a robot in the middle of its reach, and the loop in which a guide moves it."""
    # Robots of other tests are none of this program.
    monkeypatch.setattr(robots, "_connected", WeakSet())
    made: list[HexwireSO101] = []

    def make(guide: Any) -> Loop:
        sim = Sim(monkeypatch)
        robot = sim.device()
        guide.connect()
        robot.connect()
        made.append(robot)
        start = {"shoulder_lift.pos": -20.0, "elbow_flex.pos": 40.0, "wrist_flex.pos": 40.0, "gripper.pos": 30.0}
        for _ in range(240):
            robot.get_observation()
            robot.send_action(start)
            sim.clock.advance(PERIOD)
        return Loop(sim, robot, guide)

    yield make
    for robot in made:
        robot.disconnect()


@pytest.mark.parametrize("key", KEYS)
def test_a_key_moves_the_tip_along_one_axis_at_its_speed_and_stops(ready: Ready, listener: None, key: str) -> None:
    axis, sign = KEYS[key]
    guide = make_teleoperator_from_config(HexwireKeyboardConfig(speed=60.0))
    assert type(guide) is HexwireKeyboard
    loop = ready(guide)
    loop.run(0.5)
    before = loop.tip()
    Listener.newest.press(key)
    loop.run(1.5)
    Listener.newest.release(key)
    loop.run(1.0)
    after = loop.tip()
    ways = [b - a for a, b in zip(before, after, strict=True)]
    assert 40.0 < sign * ways[axis] < 60.0 * 1.6
    assert all(abs(way) < 4.0 for i, way in enumerate(ways) if i != axis)
    fastest = max(math.dist(a, b) / PERIOD / 4 for a, b in zip(loop.places, loop.places[4:], strict=False))
    assert fastest < 60.0 * 1.25
    # It stands.
    loop.run(0.5)
    assert loop.tip() == pytest.approx(after, abs=0.5)
    assert {why.split()[1] for why in loop.robot.clipped} == {"meeting"}, "on the way to where it begins"


def test_a_key_that_is_held_ends_at_the_table(ready: Ready, listener: None) -> None:
    loop = ready(HexwireKeyboard(HexwireKeyboardConfig()))
    loop.run(0.1)
    Listener.newest.press("shift")
    loop.run(8.0)
    assert -2.0 < min(z for _, _, z in loop.places) < 25.0
    assert loop.places[-1][2] == pytest.approx(loop.places[-30][2], abs=0.5)


def test_the_gripper_and_the_turns(ready: Ready, listener: None) -> None:
    loop = ready(HexwireKeyboard(HexwireKeyboardConfig()))
    before = loop.run(0.2)
    Listener.newest.press("ctrl_r", "S")
    after = loop.run(0.5)
    assert after["gripper.pos"] > before["gripper.pos"] + 5.0
    assert abs(after["wrist_flex.pos"] - before["wrist_flex.pos"]) > 4.0
    Listener.newest.release("ctrl_r", "S")
    Listener.newest.press("ctrl_l")
    assert loop.run(0.5)["gripper.pos"] < after["gripper.pos"]


def test_a_key_that_is_held_from_before_moves_nothing_and_one_that_ends_brakes(
    ready: Ready, listener: None
) -> None:
    loop = ready(HexwireKeyboard(HexwireKeyboardConfig()))
    Listener.newest.press("up")
    before = loop.tip()
    loop.run(1.0)
    assert loop.tip() == pytest.approx(before, abs=1.0)
    Listener.newest.release("up")
    loop.run(0.1)
    Listener.newest.press("up")
    loop.run(0.5)
    Listener.newest.alive = False
    loop.run(1.0)
    there = loop.tip()
    loop.run(0.5)
    assert there[0] > before[0] + 10.0
    assert loop.tip() == pytest.approx(there, abs=0.5)


def test_a_pad_moves_only_while_its_button_is_held(monkeypatch: pytest.MonkeyPatch, ready: Ready) -> None:
    pad = Pad()
    monkeypatch.setattr(guides, "open_joystick", lambda device: pad)
    loop = ready(HexwireGamepad(HexwireGamepadConfig(speed=60.0)))
    loop.run(0.2)
    before = loop.tip()
    pad.axes[0] = 1.0
    loop.run(0.5)
    assert loop.tip() == pytest.approx(before, abs=0.5)
    pad.axes[0], pad.buttons = 0.0, DEAD_MAN
    loop.run(0.2)
    pad.axes[0] = 1.0
    loop.run(1.0)
    pad.axes[0], pad.buttons = 0.0, 0
    loop.run(1.0)
    assert loop.tip()[0] > before[0] + 20.0
    pad.lost = True
    with pytest.raises(ConnectionError, match="unplugged"):
        loop.run(0.1)
    loop.guide.disconnect()
    assert pad.closed


@pytest.mark.usefixtures("listener")
def test_the_contract_of_a_teleoperator(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robots, "_connected", WeakSet())
    guide = HexwireKeyboard(HexwireKeyboardConfig())
    assert guide.action_features == HexwireSO101(Sim(monkeypatch).device().config).action_features
    for call in (guide.get_action, guide.disconnect):
        with pytest.raises(DeviceNotConnectedError):
            call()
    guide.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        guide.connect()
    assert guide.is_calibrated
    with pytest.raises(RuntimeError, match="has connected no robot of hexwire with the joints shoulder_pan"):
        guide.get_action()
    guide.disconnect()
    assert not guide.is_connected
    with pytest.raises(ValueError, match="speed must be above 0, not -1"):
        HexwireKeyboard(HexwireKeyboardConfig(speed=-1.0))
    with pytest.raises(ValueError, match="share must be above 0 and at most 1, not 50"):
        HexwireKeyboard(HexwireKeyboardConfig(share=50.0))
    with pytest.raises(ValueError, match="no arm 'nobody'"):
        HexwireKeyboard(HexwireKeyboardConfig(arm="nobody"))


def test_a_computer_without_a_display_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pynput.keyboard", None)
    with pytest.raises(ConnectionError, match="the keyboard cannot be read here"):
        HexwireKeyboard(HexwireKeyboardConfig()).connect()
