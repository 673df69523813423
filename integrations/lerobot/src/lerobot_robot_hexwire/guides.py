"""The keyboard and a game pad as teleoperators: they move the tip of the robot that the program has connected.

Owns which keys mean what, and LeRobot's contract of a teleoperator. How the tip moves within all limits is decided
by the rules of `hexwire teleop` (`hexwire.motion.teleop`). Must not know servos or links.

LeRobot gives a teleoperator no robot, and an action is where the joints are to be: so it looks for the robot.
"""

from __future__ import annotations

import importlib
import logging
import math
import time
from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from hexwire.control.motion.operator_control import Notes
from hexwire.joystick.device import open_joystick
from hexwire.motion.teleop import Action, JogMode, StickMap, Teleop, within_limits

from .config_hexwire import GuideFields, HexwireGamepadConfig, HexwireKeyboardConfig
from .connection import faults
from .joint_values import names_of
from .kinds import joints_of
from .robots import connected_robot

if TYPE_CHECKING:
    from hexwire.joystick.device import JoystickDevice

    from .robots import HexwireRobot

__all__ = ["HexwireGamepad", "HexwireKeyboard"]

logger = logging.getLogger(__name__)

_LEAD = 0.1
"""Seconds that an arm takes for an action at most."""
# What two keys move: ahead, to the left and up; about x and about y, to which an arm that points ahead rolls and
# pitches. The first six are those of LeRobot's own keyboard, and so are those of the gripper.
_KEYS = (("up", "down"), ("left", "right"), ("shift_r", "shift"), ("e", "q"), ("s", "w"), ("", ""))
_CLOSES, _OPENS = "ctrl_l", "ctrl_r"
_HELD, _CLOSE, _OPEN, _NEVER = 0, 1, 2, 31
_KEY_MAP = StickMap(axes=(0, 1, 2, 3, 4, 5), dead_man=_HELD, mode=_NEVER, close=_CLOSE, open=_OPEN, dead_zone=0.0)


class HexwireGuide(Teleoperator):
    """A person who moves the tip of an arm; its values are those of `HexwireRobot`."""

    config: TeleoperatorConfig
    _fields: GuideFields
    _stick: StickMap

    def __init__(self, config: Any) -> None:
        super().__init__(config)
        for name in ("speed", "turn"):
            if not (math.isfinite(getattr(config, name)) and getattr(config, name) > 0.0):
                raise ValueError(f"{name} must be above 0, not {getattr(config, name):g}")
        if not 0.0 < config.share <= 1.0:
            raise ValueError(f"share must be above 0 and at most 1, not {config.share:g}")
        self.config = self._fields = config
        self._joints = [row[0] for row in joints_of(config.arm)]
        self._notes = Notes()
        self._robot: HexwireRobot | None = None
        self._rules: Teleop | None = None
        self._goal: dict[str, float] = {}

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(names_of(self._joints), float)

    @property
    def feedback_features(self) -> dict[str, type]:
        return {}

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None:
        """Do nothing: there is nothing to calibrate."""

    def configure(self) -> None:
        """Do nothing: there is nothing to set."""

    def connect(self, calibrate: bool = True) -> None:
        """Open the keyboard or the pad.

        Raises:
            DeviceAlreadyConnectedError: It is open.
            ConnectionError: It cannot be read.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        self._robot = self._rules = None
        self._open()

    def disconnect(self) -> None:
        """Close it.

        Raises:
            DeviceNotConnectedError: It is not open.
        """
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        self._close()

    def get_action(self) -> dict[str, float]:
        """Where the joints of the robot are to be now.

        Raises:
            DeviceNotConnectedError: It is not open.
            ConnectionError: It was unplugged, or the robot does not answer.
            RuntimeError: The program has connected no robot of this kind, or several.
        """
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected. Run `.connect()` first.")
        robot = connected_robot(self._joints)
        place = robot.place()
        if robot is not self._robot or self._rules is None:
            self._robot, self._goal = robot, dict(place)
            driver = robot.driver
            with faults():
                self._rules = Teleop(
                    driver.model,
                    driver.kinematics,
                    self._stick,
                    mode=JogMode.CARTESIAN,
                    share=self._fields.share,
                    linear=self._fields.speed / 1000.0,
                    angular=math.radians(self._fields.turn),
                    check=robot.check.guided(),
                )
            # A key or button that is held already moves nothing.
            state: tuple[tuple[float, ...], int, float] = (), 0, 0.0
        else:
            with faults():
                state = self._state()
        now = time.monotonic()
        jog = self._rules.update(*state, place, now, lead=_LEAD)
        if self._notes.is_new(jog.note, now):
            logger.warning("%s", jog.note)
        if jog.action is Action.MOVE:
            self._goal.update(within_limits(self._rules.arm, jog.positions))
        elif jog.action is Action.HOLD:
            self._goal = dict(place)
        return robot.named(self._goal)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Not supported.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError("there is nothing to feel")

    @abstractmethod
    def _open(self) -> None: ...

    @abstractmethod
    def _close(self) -> None: ...

    @abstractmethod
    def _state(self) -> tuple[tuple[float, ...], int, float]:
        """Axes, buttons, and their age in seconds, as `hexwire.control.motion.teleop.Stick`."""


class HexwireKeyboard(HexwireGuide):
    """The keyboard, which LeRobot's own keyboard teleoperators read in the same way: whatever window has it."""

    config_class: ClassVar[type[TeleoperatorConfig]] = HexwireKeyboardConfig
    name = "hexwire_keyboard"
    _stick = _KEY_MAP

    def __init__(self, config: HexwireKeyboardConfig) -> None:
        super().__init__(config)
        self._listener: Any = None
        self._down: set[str] = set()

    @property
    def is_connected(self) -> bool:
        return self._listener is not None

    def _open(self) -> None:
        try:
            keyboard = importlib.import_module("pynput.keyboard")
        except ImportError as error:
            raise ConnectionError(f"the keyboard cannot be read here: {str(error).splitlines()[0]}") from error
        self._down.clear()
        self._listener = keyboard.Listener(
            on_press=lambda key: self._down.add(_name(key)), on_release=lambda key: self._down.discard(_name(key))
        )
        self._listener.start()

    def _close(self) -> None:
        self._listener.stop()
        self._listener = None

    def _state(self) -> tuple[tuple[float, ...], int, float]:
        down = self._down
        axes = tuple([float((more in down) - (less in down)) for more, less in _KEYS])
        buttons = 1 << _HELD | (_CLOSES in down) << _CLOSE | (_OPENS in down) << _OPEN
        return axes, buttons, 0.0 if self._listener.is_alive() else math.inf


def _name(key: Any) -> str:
    """Name of a key of pynput: that of a special one, or its letter."""
    return getattr(key, "name", None) or (getattr(key, "char", None) or "").lower()


class HexwireGamepad(HexwireGuide):
    """A game pad, as `hexwire teleop --mode cartesian` has it: nothing moves unless the dead-man button is held."""

    config_class: ClassVar[type[TeleoperatorConfig]] = HexwireGamepadConfig
    name = "hexwire_gamepad"

    def __init__(self, config: HexwireGamepadConfig) -> None:
        super().__init__(config)
        self._device, self._stick = config.device, StickMap(dead_man=config.dead_man)
        self._pad: JoystickDevice | None = None

    @property
    def is_connected(self) -> bool:
        return self._pad is not None

    def _open(self) -> None:
        with faults():
            self._pad = open_joystick(self._device)

    def _close(self) -> None:
        assert self._pad is not None
        self._pad.close()
        self._pad = None

    def _state(self) -> tuple[tuple[float, ...], int, float]:
        assert self._pad is not None
        state = self._pad.read()
        return state.axes, state.buttons, 0.0
