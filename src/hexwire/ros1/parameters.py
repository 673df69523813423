"""The node's private parameters: the settings of every arm, and those that only the ROS node has.

Owns the latter, the ROS wording of errors, and the list of ros_control parameters without effect here. Must not
import rospy: values come in as the parameter server returns them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.control.requests.setting import Faults, Setting
from hexwire.control.requests.settings import CONTROLLER_SETTINGS, REPORT_SETTINGS, SETTINGS, Settings
from hexwire.control.requests.settings_reader import read_settings
from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.link.ports import find_only_board

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver

__all__ = ["FOREIGN", "OWN", "PARAMETERS", "Parameters", "load_parameters"]

OWN = REPORT_SETTINGS
"""Parameters that only this node has."""

PARAMETERS = (*SETTINGS, *OWN)
"""Every parameter of the node, in the order of the documentation."""

_TABLE = Setting("", {}, "")
_POSE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_GRAPH_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*", re.ASCII)
_SERVO_LOOP = "the servos close the loop themselves; their gains are registers, see `hexwire bus table`"
_SLOWS_DOWN = "the arm always slows down within its speed limits"

FOREIGN = {
    "type": "this node is the controller",
    "hardware_interface": "the joints are those of the robot; list a controller's joints in joints",
    "loop_hz": "use ~command_rate",
    "loop_frequency": "use ~command_rate",
    "control_freq": "use ~command_rate",
    "control_frequency": "use ~command_rate",
    "cycle_time_error_threshold": "use ~watchdog",
    "state_publish_rate": "use ~state_publish_rate, for the whole node",
    "action_monitor_rate": "use ~action_monitor_rate, for the whole node",
    "joint_state_controller": "use ~publish_rate",
    "gains": _SERVO_LOOP,
    "velocity_ff": _SERVO_LOOP,
    "stop_trajectory_duration": _SLOWS_DOWN,
    "hold_trajectory_duration": _SLOWS_DOWN,
    "verbose": "set the level of the logger /rosout, see rosconsole",
    "robot_description": "set it in the namespace, not in the node",
}
"""Parameters of ros_control and its trajectory controller without effect here, and what to use instead."""


@dataclass(frozen=True, slots=True)
class Parameters:
    """The node's parameters, checked.

    Attributes:
        settings: Settings of the arm.
        state_publish_rate: Controller states per second.
        action_monitor_rate: Feedback messages per second.
        diagnostics_rate: Diagnostics per second.
        frame_id: Frame in the headers of joint states.
        hardware_id: Hardware id in the diagnostics; empty means the URL of the link.
        warnings: One line for each given parameter that has no effect.
    """

    settings: Settings
    state_publish_rate: float
    action_monitor_rate: float
    diagnostics_rate: float
    frame_id: str
    hardware_id: str
    warnings: tuple[str, ...]


def load_parameters(params: Mapping[str, object]) -> tuple[Parameters, RobotDriver]:
    """Check the node's private parameters and build the robot's driver, as `read_settings` does.

    Args:
        params: Values by name without the ``~``, tables as nested mappings, as the parameter server returns them.

    Returns:
        The parameters, and the driver, which is not attached.

    Raises:
        UsageError: Parameters are wrong; the text lists the first ones.
        LinkNotFoundError: All parameters are right, but no port is given and no likely board is plugged in.
    """
    faults = _ParameterFaults()
    given = faults.read(_TABLE, params)
    own = {row.name: faults.read(row, given.pop(row.name, row.default)) for row in OWN}
    warnings = _take_foreign(given)
    given = faults.only(given, [row.name for row in PARAMETERS])
    poses, controllers = given.get("poses"), given.get("controllers")
    for name in poses if isinstance(poses, Mapping) else ():
        if not _POSE_NAME.fullmatch(str(name)):
            faults.add(f"poses/{name}", "not a service name: a letter first, then letters, digits and _ only")
    if isinstance(controllers, Mapping):
        given["controllers"] = flat = _flattened(controllers, faults)
        for name, table in flat.items():
            if not _GRAPH_NAME.fullmatch(name):
                text = "not a ROS name: a letter first, then letters, digits, _ and / only"
                faults.add(f"controllers/{name}", text)
            warnings += _take_foreign(table, f"controllers/{name}/")
    settings, driver = read_settings(given, faults, find_port=_find_port)
    return Parameters(settings=settings, **own, warnings=tuple(warnings)), driver


class _ParameterFaults(Faults):
    """Words faults for ROS users."""

    noun = "parameter"
    mark = "~"
    # roslaunch converts everything that looks like a number.
    quoting = 'in quotes, or with type="str" in a launch file'
    listing = "'hexwire-ros1 --help' lists them"


def _take_foreign(table: dict[str, object], above: str = "") -> list[str]:
    """Remove parameters without effect from a table; returns a warning for each."""
    foreign = [name for name in table if name in FOREIGN]
    for name in foreign:
        del table[name]
    return [f"~{above}{name}: a parameter of ros_control without effect here; {FOREIGN[name]}" for name in foreign]


def _flattened(table: Mapping[str, object], faults: Faults, above: str = "") -> dict[str, dict[str, object]]:
    """Controllers by full name: the parameter server nests a table for each part of a name with slashes."""
    found: dict[str, dict[str, object]] = {}
    for key, value in table.items():
        name = f"{above}{key}"
        inner = faults.read(_TABLE, value, f"controllers/{name}")
        is_namespace = inner and not inner.keys() & set(CONTROLLER_SETTINGS) and _are_tables(inner)
        for full, content in (_flattened(inner, faults, f"{name}/") if is_namespace else {name: inner}).items():
            if full in found:
                faults.add(f"controllers/{full}", "given twice")
            found[full] = content
    return found


def _are_tables(table: Mapping[str, object]) -> bool:
    return all(isinstance(value, Mapping) for value in table.values())


def _find_port() -> str:
    """Find the only likely board; reword errors, which name command-line options."""
    try:
        return find_only_board()
    except LinkNotFoundError as error:
        raise LinkNotFoundError(str(error).replace("--port", "the parameter ~port")) from None
    except UsageError as error:
        raise UsageError(f"1 parameter is wrong: ~port: {str(error).replace('with --port', 'with it')}") from None
