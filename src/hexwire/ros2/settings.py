"""The node's parameters: the settings of every arm, those that only this node has, and which of them may change.

Owns the node's own parameters, their flat names (``constraints.J1.goal``), the ROS wording of errors, and the list
of ros2_control parameters without effect here. Values come in as plain ones, from wherever ROS takes them. Must not
know messages, services or Zenoh.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from hexwire.control.requests.setting import Faults, Setting
from hexwire.control.requests.settings import CHANGEABLE, REPORT_SETTINGS, SETTINGS, ControllerSettings, Settings
from hexwire.control.requests.settings_reader import read_settings, reread
from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.link.ports import find_only_board

from .package.releases import DEFAULT_RELEASE, RELEASES

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from zenoh_ros2 import Descriptor, Distribution

__all__ = [
    "DESCRIBES_TYPES",
    "DISTRIBUTION_VARIABLE",
    "FOREIGN",
    "OWN",
    "PARAMETERS",
    "NodeSettings",
    "changed",
    "descriptor_of",
    "load_settings",
]

_log = logging.getLogger(__name__)

DISTRIBUTION_VARIABLE = "ROS_DISTRO"

OWN = (
    *REPORT_SETTINGS,
    Setting(
        "distribution",
        "",
        f"distribution of the other nodes: {', '.join(RELEASES)}; empty means "
        f"{DISTRIBUTION_VARIABLE}, else {DEFAULT_RELEASE}",
    ),
    Setting("controller_name", "joint_trajectory_controller", "name of the only controller"),
    Setting(
        "allow_nonzero_velocity_at_trajectory_end",
        False,
        "accept a trajectory whose last point has a velocity; the arm stops there all the same",
    ),
    Setting("robot_description", "", "URDF to publish; empty means that of hexwire, if the arm has a geometry"),
    Setting("publish_robot_description", True, "publish robot_description"),
    Setting("publish_tf", False, "publish /tf and /tf_static, where no robot_state_publisher does"),
    Setting(
        "joint_states_topic", "robot_joint_states", "joint states for a controller manager elsewhere; empty: none"
    ),
    Setting("joint_commands_topic", "robot_joint_commands", "joint commands of a controller manager; empty: none"),
    Setting(
        "joint_commands_start_tolerance",
        0.1,
        "greatest distance of the first joint command from the arm; 0 means any",
        "rad",
        low=0.0,
        high=7.0,
    ),
)
"""Parameters that only this node has."""

PARAMETERS = (*SETTINGS, *OWN)
"""Every parameter of the node, in the order of the documentation."""

_ROWS = {row.name: row for row in PARAMETERS}
_CHANGEABLE_OWN = (
    "state_publish_rate",
    "action_monitor_rate",
    "diagnostics_rate",
    "frame_id",
    "hardware_id",
    "joint_commands_start_tolerance",
)
_POSE_NAME = re.compile(r"[A-Za-z](?:_?[A-Za-z0-9])*", re.ASCII)
_GRAPH_NAME = re.compile(r"[A-Za-z](?:_?[A-Za-z0-9])*(?:/[A-Za-z](?:_?[A-Za-z0-9])*)*", re.ASCII)
_SERVO_LOOP = "the servos close the loop themselves; their gains are registers, see `hexwire bus table`"
_POSITIONS = "the joints take positions, and report positions and velocities"

FOREIGN = {
    "type": "this node is the controller",
    "update_rate": "use command_rate",
    "command_interfaces": _POSITIONS,
    "state_interfaces": _POSITIONS,
    "command_joints": "use joints",
    "gains": _SERVO_LOOP,
    "open_loop_control": _SERVO_LOOP,
    "interpolate_from_desired_state": "a trajectory always begins at the last set-point",
    "interpolation_method": "the points decide: positions only, with velocities, or with accelerations too",
    "allow_integration_in_goal_trajectories": "positions are always needed",
    "allow_trajectory_replacement": "a new trajectory always blends in",
    "cmd_timeout": "the arm holds at the end of a trajectory; for set-points use command_timeout",
    "set_last_command_interface_value_as_state_on_activation": "a motion always begins where the arm is",
    "speed_scaling": "the arm always moves within its speed limits",
    "state_publish_rate": "use state_publish_rate, for the whole node",
    "action_monitor_rate": "use action_monitor_rate, for the whole node",
    "allow_nonzero_velocity_at_trajectory_end": "use it for the whole node",
}
"""Parameters of ros2_control and its trajectory controller without effect here, and what to use instead."""

DESCRIBES_TYPES = "start_type_description_service"
"""`zenoh_ros2.type_descriptions.PARAMETER`; `hexwire-ros2 --help` does without that package."""
_OF_ROS = ("use_sim_time", DESCRIBES_TYPES, "qos_overrides")
"""Parameters that ROS gives to every node; the node declares them itself, or does without."""
_SWITCHES = (Setting("use_sim_time", False, ""), Setting(DESCRIBES_TYPES, True, ""))


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """The node's parameters, checked.

    Attributes:
        arm: Settings of the arm; a single controller has the empty name there.
        own: Values of `OWN` by name.
        distribution: Of the other nodes.
        tables: Every value by name, with tables as nested mappings.
        warnings: One line for each given parameter that has no effect.
        use_sim_time: Stamps of others come from a simulation.
        describes_types: The node serves what its messages consist of (`start_type_description_service`).
    """

    arm: Settings
    own: Mapping[str, Any]
    distribution: Distribution
    tables: Mapping[str, object]
    warnings: tuple[str, ...]
    use_sim_time: bool
    describes_types: bool

    def topic(self, controller: str) -> str:
        """The name of a controller in topics."""
        return controller or str(self.own["controller_name"])

    @property
    def near(self) -> float:
        """Greatest distance of a first joint command from the arm, radians."""
        return float(self.own["joint_commands_start_tolerance"]) or float("inf")

    def flat(self) -> dict[str, Any]:
        """Every parameter by its flat name, those with defaults too; numbers, texts, switches, lists of texts."""
        values: dict[str, Any] = {}
        for name, value in self.tables.items():
            values.update(_flattened(name, value))
        for row in self.arm.controllers:
            at = f"controllers.{row.name}." if row.name else ""
            values.update(_of_controller(at, row))
        values["use_sim_time"] = self.use_sim_time
        return dict(sorted(values.items()))

    def row(self, name: str) -> Setting | None:
        """The row of a flat name; for one inside a table, that of the table, without bounds."""
        return _ROWS.get(name.partition(".")[0])

    def may_change(self, name: str) -> bool:
        """Whether a parameter may change while the node runs."""
        first, _, rest = name.partition(".")
        if first == "controllers":
            return not rest.endswith(".joints")
        return first in CHANGEABLE or first in _CHANGEABLE_OWN


def load_settings(given: Mapping[str, object], environ: Mapping[str, str]) -> tuple[NodeSettings, RobotDriver]:
    """Check the node's parameters and build the robot's driver, as `read_settings` does.

    Args:
        given: Values by flat name.
        environ: Environment variables.

    Returns:
        The settings, and the driver, which is not attached.

    Raises:
        UsageError: Parameters are wrong; the text lists the first ones.
        LinkNotFoundError: All parameters are right, but no port is given and no likely board is plugged in.
    """
    faults = _ParameterFaults()
    simulated, describes = (faults.read(row, given.get(row.name, row.default)) for row in _SWITCHES)
    tables = _nested({k: v for k, v in given.items() if k.partition(".")[0] not in _OF_ROS}, faults)
    warnings = _take_foreign(tables)
    tables = faults.only(tables, _ROWS)
    own = _read_own(tables, faults)
    distribution = _distribution(own["distribution"], environ, faults)
    _check_names(tables, own, faults)
    controllers = tables.get("controllers")
    if isinstance(controllers, Mapping):
        for name, table in controllers.items():
            if isinstance(table, dict):
                warnings += _take_foreign(table, f"controllers.{name}.")
    of_arm = {name: value for name, value in tables.items() if name not in own}
    settings, driver = read_settings(of_arm, faults, find_port=_find_port)
    if own["publish_tf"] and settings.kinematics is None:
        faults.add("publish_tf", f"{settings.model.name} has no geometry; set it to false")
        faults.check()
    values = {row.name: tables.get(row.name, row.default) for row in PARAMETERS}
    values |= {"port": settings.port, "distribution": distribution.value}
    settings = _with_ends(settings, own)
    return NodeSettings(settings, own, distribution, values, tuple(warnings), simulated, describes), driver


def changed(settings: NodeSettings, changes: Mapping[str, object]) -> NodeSettings:
    """Settings with changed values, all of them or none.

    Args:
        settings: The present ones.
        changes: Values by flat name, of the types that the parameters have.

    Raises:
        UsageError: A value is wrong, or may not change while the node runs; the text says which and why.
    """
    faults = _ParameterFaults()
    for name in changes:
        if not settings.may_change(name):
            faults.add(name, "it is read at the start only; restart the node with the new value")
    faults.check()
    given = settings.flat() | dict(changes)
    # An empty list of joints means all, where there is only one controller.
    given = {name: value for name, value in given.items() if value != [] and name not in _OF_ROS}
    tables = _nested(given, faults)
    own = _read_own(tables, faults)
    arm = reread(settings.arm, tables, faults)
    faults.check()
    return replace(settings, arm=arm, own=own, tables={**settings.tables, **tables})


class _ParameterFaults(Faults):
    """Words faults for ROS users."""

    noun = "parameter"
    # The shell and YAML take one pair of quotes away each.
    quoting = "in quotes, for example -p port:='\"5\"'"
    listing = "'hexwire-ros2 --help' lists them"
    separator = "."


def _read_own(tables: Mapping[str, object], faults: Faults) -> dict[str, Any]:
    return {row.name: faults.read(row, tables.get(row.name, row.default)) for row in OWN}


def _distribution(name: str, environ: Mapping[str, str], faults: Faults) -> Distribution:
    from zenoh_ros2 import Distribution

    known = {row.value: row for row in Distribution}
    if name and name not in known:
        faults.add("distribution", f"unknown: {name!r}; there are {', '.join(known)}")
    told = environ.get(DISTRIBUTION_VARIABLE, "")
    if not name and told and told not in known:
        _log.warning(
            "%s is %s, which is not known here: messages are those of %s; the parameter 'distribution' selects "
            "those of %s",
            DISTRIBUTION_VARIABLE,
            told[:40],
            DEFAULT_RELEASE,
            ", ".join(known),
        )
    return known.get(name or told, known[DEFAULT_RELEASE])


def _check_names(tables: Mapping[str, object], own: Mapping[str, Any], faults: Faults) -> None:
    rule = "a letter first, then letters and digits with single _ between them"
    if not _GRAPH_NAME.fullmatch(own["controller_name"]):
        faults.add("controller_name", f"not a ROS name: {rule}")
    for name in ("joint_states_topic", "joint_commands_topic"):
        if own[name] and not _GRAPH_NAME.fullmatch(own[name].removeprefix("/").removeprefix("~/")):
            faults.add(name, f"not a topic: {rule}, parts separated by /")
    poses, controllers = tables.get("poses"), tables.get("controllers")
    for name in poses if isinstance(poses, Mapping) else ():
        if not _POSE_NAME.fullmatch(name):
            faults.add(f"poses/{name}", f"not a service name: {rule}")
    for name in controllers if isinstance(controllers, Mapping) else ():
        if not _GRAPH_NAME.fullmatch(name):
            faults.add(f"controllers.{name}", f"not a ROS name: {rule}")


def _nested(given: Mapping[str, object], faults: Faults) -> dict[str, Any]:
    """Nested tables from flat names."""
    tables: dict[str, Any] = {}
    for name, value in given.items():
        *above, last = name.split(".")
        table = tables
        for part in above:
            inner = table.setdefault(part, {})
            if not isinstance(inner, dict):
                break
            table = inner
        else:
            if not isinstance(table.get(last), dict):
                table[last] = value
                continue
        faults.add(name, "a value, where another parameter has a table of names and values")
    return tables


def _flattened(name: str, value: object) -> Iterator[tuple[str, object]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flattened(f"{name}.{key}", inner)
        return
    row = _ROWS.get(name)
    is_number = isinstance(value, int) and not isinstance(value, bool)
    if is_number and (row is None or isinstance(row.default, float)):
        # Every number is a double, however it was written.
        value = float(value)  # type: ignore[arg-type]  # it is an int
    yield name, list(value) if isinstance(value, tuple) else value


def _of_controller(at: str, row: ControllerSettings) -> Iterator[tuple[str, object]]:
    """The parameters of a controller, with their defaults, as the usual trajectory controller declares them."""
    tolerances = row.tolerances
    yield f"{at}joints", list(row.joints)
    yield f"{at}allow_partial_joints_goal", row.allow_partial
    yield f"{at}constraints.goal_time", tolerances.goal_time
    speeds = [tolerances.goal[joint].velocity for joint in row.joints]
    yield f"{at}constraints.stopped_velocity_tolerance", speeds[0] if speeds else 0.0
    for joint in row.joints:
        yield f"{at}constraints.{joint}.trajectory", tolerances.path[joint].position
        yield f"{at}constraints.{joint}.goal", tolerances.goal[joint].position


def _with_ends(settings: Settings, own: Mapping[str, Any]) -> Settings:
    end_at_rest = not own["allow_nonzero_velocity_at_trajectory_end"]
    rows = tuple(replace(row, end_at_rest=end_at_rest) for row in settings.controllers)
    return replace(settings, controllers=rows)


def _take_foreign(table: dict[str, Any], above: str = "") -> list[str]:
    """Remove parameters without effect from a table; returns a warning for each."""
    foreign = [name for name in table if name in FOREIGN and (above or name not in _ROWS)]
    for name in foreign:
        del table[name]
    return [f"{above}{name}: a parameter of ros2_control without effect here; {FOREIGN[name]}" for name in foreign]


def _find_port() -> str:
    """Find the only likely board; reword errors, which name command-line options."""
    try:
        return find_only_board()
    except LinkNotFoundError as error:
        raise LinkNotFoundError(str(error).replace("--port", "-p port:=PORT")) from None
    except UsageError as error:
        raise UsageError(f"1 parameter is wrong: port: {str(error).replace('--port', '-p port:=PORT')}") from None


def descriptor_of(row: Setting, *, read_only: bool) -> Descriptor:
    """The descriptor of a setting."""
    from zenoh_ros2 import Descriptor

    unit = f", {row.unit}" if row.unit else ""
    bounds = f"{row.bounds}{f' {row.unit}' if row.unit else ''}" if row.bounds else ""
    # A range includes both ends, and has two of them.
    ranged = not row.zero and not row.above
    return Descriptor(
        f"{row.help}{unit}",
        "" if ranged and math.isfinite(row.low) and math.isfinite(row.high) else bounds,
        read_only,
        row.low if ranged else -math.inf,
        row.high if ranged else math.inf,
    )
