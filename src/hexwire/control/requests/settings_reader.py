"""Reads and checks the settings of an arm, and reports all mistakes together.

Owns the checks that involve several settings or the arm: joints, poses, tolerances, controllers. Builds the driver
and closes again what it opens.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

from hexwire.drivers.abilities import StoredCalibration
from hexwire.drivers.registry import DEFAULT_ROBOT, PORT_VARIABLE, is_address, load_driver, make_driver, robot_at
from hexwire.errors import HexwireError, LimitError, LinkError, UsageError
from hexwire.link.ports import find_only_board
from hexwire.model.arms import record_of
from hexwire.model.geometry import kinematics_for, kinematics_or_none
from hexwire.motion.safety import SafetyLimits

from ..motion.arrival import Tolerance
from ..motion.goals import Tolerances
from .setting import Faults, Setting
from .settings import CHANGEABLE, CONTROLLER_SETTINGS, SETTINGS, ControllerSettings, Settings

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.arm import ArmModel, JointModel
    from hexwire.model.kinematics import KinematicModel

__all__ = ["read_settings", "reread"]

_ROWS = {row.name: row for row in SETTINGS}
_JOINT_CONSTRAINTS = ("trajectory", "goal")
# Rows of numbers in tables. The defaults are those of the usual trajectory controller, except for the speed below
# which a joint counts as stopped: its 0.01 rad/s is less than the noise of one count of 4096 over the 0.1 s from
# which velocities are computed, so that a goal with goal_time 0 would never end.
_GOAL_TIME = Setting("goal_time", 0.0, "", "s", low=0.0, high=3600.0)
_STOPPED = Setting("stopped_velocity_tolerance", 0.05, "", "rad/s", low=0.0)
_TOLERANCE = Setting("tolerance", 0.0, "", "rad", low=0.0)
_ANGLE = Setting("angle", 0.0, "", "rad")
_THRESHOLD = Setting("threshold", 1.0, "", low=0.0, above=True)
_THRESHOLDS = tuple(field.name for field in fields(SafetyLimits) if field.name != "faults")


def read_settings(
    given: Mapping[str, object], faults: Faults, *, find_port: Callable[[], str] = find_only_board
) -> tuple[Settings, RobotDriver]:
    """Check settings and build the robot's driver. Nothing moves, and what was opened is closed again.

    Args:
        given: Values by name; tables are nested mappings.
        faults: Collects what is wrong.
        find_port: Finds the port if none is given, and only if nothing is wrong.

    Returns:
        The settings, and the driver, which is not attached.

    Raises:
        UsageError: Settings are wrong; the text lists the first faults.
        LinkNotFoundError: All settings are right, but no port is given and none is found.
    """
    values = {row.name: faults.read(row, given.get(row.name, row.default)) for row in SETTINGS}
    faults.only(given, _ROWS)
    driver, like = _make_driver(values, faults)
    if driver is not None and not faults.texts:
        _meet(driver)
    model = None if like is None else like.model
    values["kinematics"] = kinematics = None if like is None else _make_kinematics(values, like, faults)
    values["poses"] = _make_poses(values["poses"], model, kinematics, faults)
    values["safety"] = _make_thresholds(values["safety"], faults)
    values["controllers"] = _make_controllers(values, model, faults)
    _check_together(values, model, faults)
    faults.check()
    if driver is None:
        values["port"] = url = find_port()
        driver = load_driver(values["robot"]).from_url(url)
        _meet(driver)
    values["model"] = driver.model
    if kinematics is not None:
        driver.kinematics = kinematics
    checks_table = values["check_table"] and kinematics is not None
    values["table"] = values["table_height"] if checks_table else None
    return Settings(**{field.name: values[field.name] for field in fields(Settings)}), driver


def reread(settings: Settings, given: Mapping[str, object], faults: Faults) -> Settings:
    """Settings of an arm in use, with changed values of those in `CHANGEABLE`.

    Args:
        settings: The present ones.
        given: All values by name as for `read_settings`, changed ones among them; others than those are ignored.
        faults: Collects what is wrong; then the result is of no use.
    """
    values = {name: faults.read(_ROWS[name], given.get(name, _ROWS[name].default)) for name in CHANGEABLE}
    values["joints"] = faults.read(_ROWS["joints"], given.get("joints", ()))
    controllers = _make_controllers(values, settings.model, faults)
    before = {row.name: row for row in settings.controllers}
    if faults.texts:
        return settings
    if [(row.name, row.joints) for row in controllers] != [(row.name, row.joints) for row in settings.controllers]:
        faults.add("controllers", "the joints of a controller cannot change while the arm is in use")
        return settings
    controllers = tuple(replace(row, end_at_rest=before[row.name].end_at_rest) for row in controllers)
    return replace(settings, pose_speed=values["pose_speed"], controllers=controllers)


# -- the robot ------------------------------------------------------------------------------------------


def _make_driver(values: dict[str, Any], faults: Faults) -> tuple[RobotDriver | None, RobotDriver | None]:
    """The driver if robot and port are known; and one that tells of the arm if the robot is known."""
    url = values["port"] or os.environ.get(PORT_VARIABLE, "")
    if is_address(url):
        try:
            shared = make_driver(url, values["robot"] if values["robot"] != DEFAULT_ROBOT else None)
        except LinkError:
            # Nothing is wrong with the settings.
            raise
        except (HexwireError, ImportError) as error:
            faults.add("port", error)
            return None, None
        values["port"], values["robot"] = url, shared.model.name
        return shared, shared
    if values["robot"] == DEFAULT_ROBOT:
        values["robot"] = robot_at(url)
    try:
        robot = load_driver(values["robot"])
    except (HexwireError, ImportError) as error:
        faults.add("robot", error)
        return None, None
    if url:
        try:
            driver = robot.from_url(url)
            values["port"] = url
            return driver, driver
        except (HexwireError, ImportError) as error:
            faults.add("port", error if values["port"] else f"{error} (from {PORT_VARIABLE})")
    try:
        # The model does not depend on the port, and the other settings must be checked without one too.
        return None, robot.from_url("/dev/null")
    except (HexwireError, ImportError) as error:
        if not url:
            faults.add("port", f"{values['robot']} needs a port ({error})")
        return None, None


def _meet(driver: RobotDriver) -> None:
    """Let an arm take the calibration that its servos have stored: all that is read here depends on its angles."""
    arm = StoredCalibration.find(driver)
    if arm is not None and arm.may_change_model:
        # Why that fails is told when the arm is used.
        with suppress(HexwireError):
            driver.attach()
            driver.detach()


def _make_kinematics(values: dict[str, Any], like: RobotDriver, faults: Faults) -> KinematicModel | None:
    robot, links = values["robot"], values["links"]
    record = record_of(robot)
    if links != _ROWS["links"].default and (record is None or not record.link_sets):
        faults.add("links", f"only the hex7bot has link sets; omit it for {robot}")
        return None
    try:
        return like.kinematics if links == _ROWS["links"].default else kinematics_for(like.model, links)
    except HexwireError as error:
        faults.add("links", error)
    except OSError as error:
        faults.add("links", f"{links} cannot be read: {error.strerror or error}")
    return None


# -- poses and thresholds -------------------------------------------------------------------------------


def _known_joint(name: str, joint: str, model: ArmModel | None, faults: Faults) -> bool:
    """Whether the arm has a joint; also True if the arm is unknown."""
    if model is None or joint in model.names:
        return True
    faults.add(name, f"no joint {joint!r}, there are {', '.join(model.names)}")
    return False


def _make_poses(
    table: Mapping[str, object], model: ArmModel | None, kinematics: KinematicModel | None, faults: Faults
) -> dict[str, dict[str, float]]:
    poses = {}
    for name, value in table.items():
        path = f"poses/{name}"
        rows = faults.read(_ROWS["poses"], value, path)
        if isinstance(value, Mapping) and not rows:
            faults.add(path, "names no joint")
        before = len(faults.texts)
        pose = {}
        for joint, angle in rows.items():
            where, so_far = f"{path}/{joint}", len(faults.texts)
            if _known_joint(where, joint, model, faults):
                pose[joint] = faults.read(_ANGLE, angle, where)
                if model is not None and len(faults.texts) == so_far:
                    _check_limits(where, pose[joint], model.joint(joint), faults)
        if len(faults.texts) == before:
            _check_angles(path, pose, kinematics, faults)
        poses[name] = pose
    return poses


def _check_limits(path: str, angle: float, joint: JointModel, faults: Faults) -> None:
    try:
        joint.check(angle)
    except LimitError:
        hint = "; angles are radians" if abs(angle) > math.tau else ""
        faults.add(
            path, f"{angle:g} rad is outside its limits {joint.minimum:.4g} to {joint.maximum:.4g} rad{hint}"
        )


def _check_angles(path: str, pose: Mapping[str, float], kinematics: KinematicModel | None, faults: Faults) -> None:
    """Check limits and joint coupling limits, if the pose has all joints that this needs."""
    if kinematics is None:
        return
    try:
        angles = kinematics.from_joints(pose)
    except UsageError:
        # The positions of the omitted joints are known only when the arm moves there, which checks them.
        return
    for text in kinematics.violations(angles):
        faults.add(path, text)


def _make_thresholds(table: Mapping[str, object], faults: Faults) -> dict[str, float]:
    known = faults.only(table, _THRESHOLDS, "safety/")
    return {name: faults.read(_THRESHOLD, value, f"safety/{name}") for name, value in known.items()}


# -- controllers ----------------------------------------------------------------------------------------


def _make_controllers(
    values: dict[str, Any], model: ArmModel | None, faults: Faults
) -> tuple[ControllerSettings, ...]:
    several: dict[str, object] = values["controllers"]
    if not several:
        return (_make_controller("", values, model, faults),)
    both = [name for name in CONTROLLER_SETTINGS if values[name] != _ROWS[name].default]
    if both:
        faults.add("controllers", f"replaces {', '.join(both)}: give those inside each controller")
    controllers = []
    owners: dict[str, str] = {}
    for name, content in several.items():
        path = f"controllers/{name}"
        table = faults.read(_ROWS["controllers"], content, path)
        faults.only(table, CONTROLLER_SETTINGS, f"{path}/")
        rows = [_ROWS[key] for key in CONTROLLER_SETTINGS]
        read = {row.name: faults.read(row, table.get(row.name, row.default), f"{path}/{row.name}") for row in rows}
        if not table.get("joints", ()):
            faults.add(f"{path}/joints", "a controller needs at least one joint")
        controllers.append(_make_controller(name, read, model, faults))
        for joint in read["joints"]:
            if joint in owners:
                faults.add(f"{path}/joints", f"{joint} already belongs to the controller {owners[joint]}")
            owners.setdefault(joint, name)
    return tuple(controllers)


def _make_controller(
    name: str, values: Mapping[str, Any], model: ArmModel | None, faults: Faults
) -> ControllerSettings:
    """Make a controller from its three settings, whose types are checked already."""
    above = f"controllers/{name}/" if name else ""
    joints = tuple(joint for joint in values["joints"] if _known_joint(f"{above}joints", joint, model, faults))
    if not name and not values["joints"] and model is not None:
        joints = model.names
    complete = bool(joints) and model is not None and len(joints) >= len(values["joints"])
    tolerances = _make_tolerances(f"{above}constraints", values["constraints"], joints, complete, faults)
    return ControllerSettings(name, joints, values["allow_partial_joints_goal"], tolerances)


def _make_tolerances(
    path: str, table: Mapping[str, object], joints: tuple[str, ...], complete: bool, faults: Faults
) -> Tolerances:
    """Tolerances of a controller. If its joints are not `complete`, another joint's name is not a fault."""
    general = {}
    for row in (_GOAL_TIME, _STOPPED):
        general[row.name] = faults.read(row, table.get(row.name, row.default), f"{path}/{row.name}")
    rows = {joint: {"trajectory": 0.0, "goal": 0.0} for joint in joints}
    for joint, value in table.items():
        if joint in general:
            continue
        if joint not in joints and not isinstance(value, Mapping):
            faults.unknown(f"{path}/{joint}", (*general, *joints))
            continue
        if joint not in joints and complete:
            faults.add(f"{path}/{joint}", f"no joint {joint!r} here, there are {', '.join(joints)}")
            continue
        own = rows.setdefault(joint, {})
        given = faults.read(_ROWS["constraints"], value, f"{path}/{joint}")
        for key, number in faults.only(given, _JOINT_CONSTRAINTS, f"{path}/{joint}/").items():
            own[key] = faults.read(_TOLERANCE, number, f"{path}/{joint}/{key}")
    return Tolerances(
        path={joint: Tolerance(position=rows[joint]["trajectory"]) for joint in joints},
        goal={
            joint: Tolerance(position=rows[joint]["goal"], velocity=general["stopped_velocity_tolerance"])
            for joint in joints
        },
        goal_time=general["goal_time"],
    )


def _check_together(values: Mapping[str, Any], model: ArmModel | None, faults: Faults) -> None:
    robot = values["robot"]
    if (
        values["table_height"]
        and values["check_table"]
        and model is not None
        and values["kinematics"] is None
        and kinematics_or_none(model.geometry or robot) is None
    ):
        switch = f"{faults.mark}check_table"
        faults.add("table_height", f"{robot} has no geometry for this check; set {switch} to false")
    rate, watchdog = values["command_rate"], values["watchdog"]
    if rate and 0.0 < watchdog < 2.0 / rate:
        least = f"two periods of {faults.mark}command_rate {rate:g} Hz, {2.0 / rate:.3g} s"
        faults.add("watchdog", f"{watchdog:g} s is less than {least}: the board would stop the arm repeatedly")
