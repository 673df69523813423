"""Message classes that Debian does not package, control_msgs and osrf_msgs, generated at run time.

Owns their fields, and the checksums by which an installed class is recognised as the same message. `message_files`
writes the same messages as packages.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from types import SimpleNamespace
from typing import Any

from hexwire.errors import HexwireError, UsageError

from .path import ROS_MISSING

__all__ = ["PACKAGES", "PARTS", "SERVICES", "control_msgs", "control_srvs", "definition", "osrf_msgs"]

_FEEDBACK = """\
Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
"""

# Name -> checksum, fields. The checksum covers names, types, order and constants: two nodes with the same checksum
# are compatible. All were compared with published headers or libraries, except those of FollowJointTrajectoryGoal
# and JointCommands, which are computed; the former is part of the published checksum of the ActionGoal.
_CONTROL: Mapping[str, tuple[str, str]] = {
    "FollowJointTrajectoryAction": (
        "bc4f9b743838566551c0390c65f1a248",
        """\
FollowJointTrajectoryActionGoal action_goal
FollowJointTrajectoryActionResult action_result
FollowJointTrajectoryActionFeedback action_feedback
""",
    ),
    "FollowJointTrajectoryActionGoal": (
        "cff5c1d533bf2f82dd0138d57f4304bb",
        """\
Header header
actionlib_msgs/GoalID goal_id
FollowJointTrajectoryGoal goal
""",
    ),
    "FollowJointTrajectoryActionResult": (
        "c4fb3b000dc9da4fd99699380efcc5d9",
        """\
Header header
actionlib_msgs/GoalStatus status
FollowJointTrajectoryResult result
""",
    ),
    "FollowJointTrajectoryActionFeedback": (
        "d8920dc4eae9fc107e00999cce4be641",
        """\
Header header
actionlib_msgs/GoalStatus status
FollowJointTrajectoryFeedback feedback
""",
    ),
    "FollowJointTrajectoryGoal": (
        "69636787b6ecbde4d61d711979bc7ecb",
        """\
trajectory_msgs/JointTrajectory trajectory
JointTolerance[] path_tolerance
JointTolerance[] goal_tolerance
duration goal_time_tolerance
""",
    ),
    "FollowJointTrajectoryResult": (
        "493383b18409bfb604b4e26c676401d2",
        """\
int32 SUCCESSFUL = 0
int32 INVALID_GOAL = -1
int32 INVALID_JOINTS = -2
int32 OLD_HEADER_TIMESTAMP = -3
int32 PATH_TOLERANCE_VIOLATED = -4
int32 GOAL_TOLERANCE_VIOLATED = -5
int32 error_code
string error_string
""",
    ),
    "FollowJointTrajectoryFeedback": ("10817c60c2486ef6b33e97dcd87f4474", _FEEDBACK),
    "JointTolerance": (
        "f544fe9c16cf04547e135dd6063ff5be",
        """\
string name
float64 position
float64 velocity
float64 acceleration
""",
    ),
    "JointTrajectoryControllerState": ("10817c60c2486ef6b33e97dcd87f4474", _FEEDBACK),
}

_OSRF: Mapping[str, tuple[str, str]] = {
    "JointCommands": (
        "f298c98f3e9c7aae9376ac19f73bfba3",
        """\
Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
float64[] kp_position
float64[] ki_position
float64[] kd_position
float64[] kp_velocity
float64[] i_effort_min
float64[] i_effort_max
""",
    ),
}

_QUERY = "QueryTrajectoryState"
_QUERY_CHECKSUM = "ec93cdecbd8062d761aa52b7c90cd44b"
_QUERY_REQUEST = "time time\n"
_QUERY_RESPONSE = """\
string[] name
float64[] position
float64[] velocity
float64[] acceleration
"""

PACKAGES = {"control_msgs": _CONTROL, "osrf_msgs": _OSRF}
"""Package -> message -> checksum, fields."""
SERVICES = {"control_msgs": {_QUERY: (_QUERY_CHECKSUM, _QUERY_REQUEST, _QUERY_RESPONSE)}}
"""Package -> service -> checksum, fields of the request, fields of the response."""

# Packaged messages that the fields above contain, directly or indirectly.
_HEADER = ("std_msgs/Header",)
PARTS = (
    *_HEADER,
    "actionlib_msgs/GoalID",
    "actionlib_msgs/GoalStatus",
    "trajectory_msgs/JointTrajectory",
    "trajectory_msgs/JointTrajectoryPoint",
)

_SEPARATOR = "\n" + "=" * 80 + "\n"


@cache
def control_msgs() -> SimpleNamespace:
    """The classes of control_msgs that a trajectory controller needs, by name; every call returns the same classes.

    The classes of nested messages are not the packaged ones, but accept those as values.

    Raises:
        UsageError: ROS is not installed, or not found yet (`hexwire.ros1.path.find_ros`).
        HexwireError: There is no folder for temporary files.
    """
    return _installed("control_msgs", _CONTROL) or _generate("control_msgs", _CONTROL, PARTS)


@cache
def osrf_msgs() -> SimpleNamespace:
    """The class JointCommands of osrf_msgs; raises the same errors as `control_msgs`."""
    return _installed("osrf_msgs", _OSRF) or _generate("osrf_msgs", _OSRF, _HEADER)


@cache
def control_srvs() -> SimpleNamespace:
    """The service class QueryTrajectoryState of control_msgs, its request and its response; see `control_msgs`."""
    service = _installed_query() or _generated_query()
    return SimpleNamespace(
        **{
            _QUERY: service,
            f"{_QUERY}Request": service._request_class,
            f"{_QUERY}Response": service._response_class,
        }
    )


def _installed_query() -> Any:
    with suppress(ImportError, AttributeError):
        service = getattr(importlib.import_module("control_msgs.srv"), _QUERY)
        if service._md5sum == _QUERY_CHECKSUM:
            return service
    return None


def _generated_query() -> Any:
    fields = {f"{_QUERY}Request": ("", _QUERY_REQUEST), f"{_QUERY}Response": ("", _QUERY_RESPONSE)}
    # Neither message contains the other, so each is generated separately.
    request, response = (getattr(_generate("control_msgs", {name: row}, ()), name) for name, row in fields.items())
    attributes = {
        "_type": f"control_msgs/{_QUERY}",
        "_md5sum": _QUERY_CHECKSUM,
        "_request_class": request,
        "_response_class": response,
    }
    return type(_QUERY, (), attributes)


def _installed(package: str, messages: Mapping[str, tuple[str, str]]) -> SimpleNamespace | None:
    """The classes of an installed package; None if it is not installed or a message in it differs."""
    try:
        module = importlib.import_module(f"{package}.msg")
    except ImportError:
        return None
    classes = {name: getattr(module, name, None) for name in messages}
    if any(getattr(classes[name], "_md5sum", None) != checksum for name, (checksum, _) in messages.items()):
        return None
    return SimpleNamespace(**classes)


def _generate(package: str, messages: Mapping[str, tuple[str, str]], parts: Sequence[str]) -> SimpleNamespace:
    try:
        dynamic = importlib.import_module("genpy.dynamic")
        definitions = [(part, definition(part)) for part in parts]
    except ImportError as error:
        raise UsageError(f"{ROS_MISSING} ({error})") from None
    own = [(f"{package}/{name}", fields) for name, (_, fields) in messages.items()]
    (first, text), *others = own + definitions
    text += "".join(f"{_SEPARATOR}MSG: {name}\n{fields}" for name, fields in others)
    before = list(sys.path)
    try:
        made = dynamic.generate_dynamic(first, text)
    except OSError as error:
        raise HexwireError(
            f"cannot generate the message classes of {package}: {error}; set TMPDIR to a writable folder"
        ) from None
    finally:
        # genpy leaves the folder of its temporary file in sys.path, where every later import would search it.
        sys.path[:] = before
    return SimpleNamespace(**{name: made[f"{package}/{name}"] for name in messages})


def definition(name: str) -> str:
    """Fields of a packaged message, without those of nested messages."""
    package, _, message = name.partition("/")
    text: str = getattr(importlib.import_module(f"{package}.msg"), message)._full_text
    return text.partition(_SEPARATOR)[0]
