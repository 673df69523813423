"""The node's parameters as a table, and reading one value of the parameter server: strictly, noting every fault.

Owns names, defaults, units and bounds, and the wording of faults. Must not know arms, nor what a value is for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from types import MappingProxyType

from hexwire.errors import UsageError

__all__ = ["FOREIGN", "PARAMETERS", "Default", "Faults", "Parameter"]

Default = str | float | bool | tuple[str, ...] | Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One private parameter of the node.

    Attributes:
        name: Without the ``~``.
        default: What holds where it is not given; its type is that of the parameter. Numbers are floats.
        help: What it does, in one line.
        unit: Of a number; empty if it has none.
        low: Least value of a number.
        high: Greatest value of a number.
        above: The least value itself is not allowed.
        zero: 0 is allowed as well, below `low`.
    """

    name: str
    default: Default
    help: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    zero: bool = False

    @property
    def default_text(self) -> str:
        """The default as a parameter file has it."""
        if isinstance(self.default, bool):
            return str(self.default).lower()
        if isinstance(self.default, str):
            return f'"{self.default}"' if not self.default else self.default
        if isinstance(self.default, float):
            return str(self.default)
        return "{}" if isinstance(self.default, Mapping) else "[]"

    @property
    def bounds(self) -> str:
        """What a number must be, in words; empty where every one will do."""
        if self.high == math.inf:
            words = (
                "" if self.low == -math.inf else f"above {self.low:g}" if self.above else f"{self.low:g} or more"
            )
        elif self.above:
            words = f"above {self.low:g} and at most {self.high:g}"
        else:
            words = f"{self.low:g} to {self.high:g}"
        return f"0, or {words}" if self.zero else words

    def allows(self, value: float) -> bool:
        """Whether a number is within the bounds."""
        if self.zero and value == 0.0:
            return True
        return (self.low < value if self.above else self.low <= value) and value <= self.high


def _rate(name: str, default: float, text: str, high: float = 1000.0) -> Parameter:
    return Parameter(name, default, text, "Hz", low=0.0, high=high, above=True)


PARAMETERS = (
    Parameter("port", "", "URL or device of the robot; empty is HEXWIRE_PORT, else the only likely board"),
    Parameter("robot", "hex7bot", "name of the robot, or the TOML file of an arm on a servo bus"),
    Parameter(
        "connect_timeout", 10.0, "how long to try to reach the robot at the start", "s", low=0.0, high=3600.0
    ),
    _rate("publish_rate", 100.0, "joint states a second, where the link allows it"),
    Parameter(
        "command_rate",
        0.0,
        "set-points a second; 0 is what the robot's line allows",
        "Hz",
        low=1.0,
        high=200.0,
        zero=True,
    ),
    _rate("state_publish_rate", 50.0, "controller states a second"),
    _rate("action_monitor_rate", 20.0, "feedback messages a second while a goal is followed"),
    _rate("diagnostics_rate", 1.0, "diagnostics a second; a change is published at once", high=100.0),
    Parameter(
        "watchdog",
        1.0,
        "silence after which the board stops the arm by itself; 0 is never",
        "s",
        low=0.05,
        high=60.0,
        zero=True,
    ),
    Parameter(
        "command_timeout",
        0.5,
        "the arm holds when streamed set-points stay away for this long; 0 is never",
        "s",
        low=0.05,
        high=60.0,
        zero=True,
    ),
    Parameter("links", "A", "link set of the 7Bot: A, B, V1, or the TOML file of one's own"),
    Parameter("table_height", 0.0, "height of the table above the arm's base", "m", low=-2.0, high=2.0),
    Parameter("check_table", True, "refuse a trajectory that would touch the table"),
    Parameter("enable_on_start", False, "give torque when the node starts; nothing moves by it"),
    Parameter("torque_off_at_exit", False, "take the torque away when the node ends: the arm may fall"),
    Parameter("frame_id", "", "frame in the headers of joint states"),
    Parameter("hardware_id", "", "serial number in the diagnostics; empty is the URL of its link"),
    Parameter("poses", {}, "poses by name, each with angles by joint, for the services ~go_to/NAME", "rad"),
    Parameter(
        "pose_speed", 0.3, "speed on the way to a pose, as a share of the limits", low=0.0, high=1.0, above=True
    ),
    Parameter("teach_directory", "", "folder in which what was taught is saved; empty is not to save it"),
    Parameter("safety", {}, "thresholds at which the arm stops by itself, by name"),
    Parameter("joints", (), "joints of the only controller, in its order; empty is all"),
    Parameter("allow_partial_joints_goal", False, "a trajectory may leave joints out; they stay where they are"),
    Parameter("constraints", {}, "tolerances: goal_time, stopped_velocity_tolerance, JOINT/trajectory, JOINT/goal"),
    Parameter("controllers", {}, "several controllers by name, each with its own of the three above"),
)
"""Every parameter of the node, in the order in which people read of them."""


_SERVO_LOOP = "the servos close the loop themselves; their gains are registers, see `hexwire bus table`"
_SLOWS_DOWN = "what slows down does so within the speed limits"

FOREIGN = {
    "type": "this node is the controller",
    "hardware_interface": "joints are those of the robot; a controller names its own in joints",
    "loop_hz": "ours is ~command_rate",
    "loop_frequency": "ours is ~command_rate",
    "control_freq": "ours is ~command_rate",
    "control_frequency": "ours is ~command_rate",
    "cycle_time_error_threshold": "ours is ~watchdog",
    "state_publish_rate": "ours is ~state_publish_rate, of the whole node",
    "action_monitor_rate": "ours is ~action_monitor_rate, of the whole node",
    "joint_state_controller": "ours is ~publish_rate",
    "gains": _SERVO_LOOP,
    "velocity_ff": _SERVO_LOOP,
    "stop_trajectory_duration": _SLOWS_DOWN,
    "hold_trajectory_duration": _SLOWS_DOWN,
    "verbose": "ours is the level of the logger /rosout, see rosconsole",
    "robot_description": "it is a parameter of the namespace, not of the node",
}
"""Parameters of ros_control and its trajectory controller without effect here, and what stands in their place."""


@dataclass(slots=True)
class Faults:
    """Collects what is wrong, so that all of it can be told at once.

    Attributes:
        texts: Each as in ``~watchdog: -1 must be 0, or 0.05 to 60``.
        warnings: What was given to no effect, in the same form.
    """

    texts: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def add(self, name: str, text: object) -> None:
        """Note a fault of the parameter `name`; for one deep in a table, names with slashes between."""
        # Texts of other origin may have several lines.
        self.texts.append(f"~{name}: {' '.join(str(text).split())}")

    def check(self) -> None:
        """Tell all faults.

        Raises:
            UsageError: There are some.
        """
        if self.texts:
            n = len(self.texts)
            raise UsageError(f"{n} parameter{'s are' if n > 1 else ' is'} wrong: {'; '.join(self.texts)}")

    # -- one value each; what is wrong becomes a fault, and the default is returned in its place ---------

    def number(self, name: str, value: object, row: Parameter) -> float:
        """A finite number within the row's bounds; no text, no switch."""
        default = row.default if isinstance(row.default, float) else 0.0
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.wrong_kind(name, value, "a number")
            return default
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.add(name, f"{number} is not a number that makes sense here")
            return default
        if not row.allows(number):
            self.add(name, f"{number:g} must be {row.bounds}{f' {row.unit}' if row.unit else ''}")
            return default
        return number

    def text(self, name: str, value: object, default: str = "") -> str:
        """A text."""
        if isinstance(value, str):
            return value
        if isinstance(value, int | float) and not isinstance(value, bool):
            # roslaunch makes numbers of all that looks like one.
            self.add(name, f'{value} must be text: in quotes, or with type="str" in a launch file')
        else:
            self.wrong_kind(name, value, "text")
        return default

    def switch(self, name: str, value: object, default: bool = False) -> bool:
        """True or false; no 0 or 1."""
        if isinstance(value, bool):
            return value
        self.wrong_kind(name, value, "true or false")
        return default

    def names(self, name: str, value: object) -> tuple[str, ...]:
        """A list of texts, none of them twice."""
        if not isinstance(value, list | tuple) or not all(isinstance(item, str) for item in value):
            self.wrong_kind(name, value, "a list of names")
            return ()
        twice = [item for i, item in enumerate(value) if item in value[:i]]
        for item in dict.fromkeys(twice):
            self.add(name, f"{item} is there twice")
        return tuple(dict.fromkeys(value))

    def table(self, name: str, value: object) -> dict[str, object]:
        """Values by name."""
        if not isinstance(value, Mapping):
            self.wrong_kind(name, value, "a table of names and values")
            return {}
        return {str(key): item for key, item in value.items()}

    def unknown(self, name: str, known: Iterable[str], foreign: Mapping[str, str] = MappingProxyType({})) -> None:
        """A name that is none of the `known` ones, which lie at the same depth.

        Args:
            name: With slashes between, as in ``safety/patience``.
            known: Names there are.
            foreign: Names of ros_control that only get a warning, each with what stands in its place.
        """
        above, slash, last = name.rpartition("/")
        if last in foreign:
            self.warnings.append(f"~{name}: a parameter of ros_control without effect here; {foreign[last]}")
            return
        others = tuple(known)
        near = get_close_matches(last, others, n=1)
        if near:
            self.add(name, f"unknown, did you mean ~{above}{slash}{near[0]}?")
        elif slash:
            self.add(name, f"unknown, there are {', '.join(others)}")
        else:
            self.add(name, "unknown, 'hexwire-ros1 --help' lists them")

    def wrong_kind(self, name: str, value: object, wanted: str) -> None:
        """A value of another type than is wanted."""
        if isinstance(value, bool):
            got = str(value).lower()
        elif isinstance(value, str):
            got = f"the text {_short(repr(value))}"
        elif isinstance(value, Mapping):
            got = "a table"
        elif isinstance(value, list | tuple):
            got = f"the list {_short(str(list(value)))}"
        else:
            got = _short(str(value))
        self.add(name, f"must be {wanted}, not {got}")


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."
