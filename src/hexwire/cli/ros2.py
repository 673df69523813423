"""The program `hexwire-ros2`: the ROS 2 node `hardware_interface`.

Owns its help and its own options; ROS's arguments are passed on unchanged. Must not know what the node does, and
loads it only to start it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from hexwire.errors import UsageError

from .exits import run_node
from .output import say_document, settings_text

if TYPE_CHECKING:
    from hexwire.control.requests.setting import Setting

__all__ = ["PROGRAM", "help_text", "main"]

PROGRAM = "hexwire-ros2"

_HELP = """\
Usage: hexwire-ros2 [OPTIONS] [--ros-args [-r RULE | -p NAME:=VALUE | --params-file FILE | --log-level LEVEL]...]
       hexwire-ros2 --help | --version

The ROS 2 node 'hardware_interface': publishes joint states of a robot arm and follows trajectories. It needs no ROS
on this machine; other nodes use rmw_zenoh and its router (ros2 run rmw_zenoh_cpp rmw_zenohd, or hexwire fleet
router). Starting or restarting the node does not move the arm, unless its board has the chapter's sketch: that one
moves it when the port is opened.

  hexwire-ros2 --ros-args -p port:=/dev/ttyUSB0
  hexwire-ros2 --ros-args -r __ns:=/left -p port:=sim://hex7bot --params-file left.yaml

Options:
  --router ENDPOINT              The router, as in tls/lab-pc:7447; repeatable.  [default: tcp/localhost:7447]
  --ca FILE, --cert FILE, --key FILE
                                 Certificates for a router beyond this machine: 'hexwire cert issue --role ros'.
  -h, --help                     Show this text.
  -V, --version                  Show the version of hexwire.

ROS_DOMAIN_ID, ZENOH_SESSION_CONFIG_URI, ZENOH_CONFIG_OVERRIDE and ZENOH_ROUTER_CHECK_ATTEMPTS mean what they mean
to rmw_zenoh.

Parameters with their defaults:
{parameters}

Publishes:
  joint_states                          sensor_msgs/JointState
  robot_joint_states                    the same, for a controller manager (joint_state_topic_hardware_interface)
  robot_description                     std_msgs/String, latched
  CONTROLLER/controller_state           control_msgs/JointTrajectoryControllerState
  ~/taught                              trajectory_msgs/JointTrajectory, latched
  /diagnostics                          diagnostic_msgs/DiagnosticArray
  /tf, /tf_static                       tf2_msgs/TFMessage, if publish_tf is set
Subscribes and serves:
  CONTROLLER/joint_trajectory           trajectory_msgs/JointTrajectory; one without points means hold
  CONTROLLER/follow_joint_trajectory    action control_msgs/FollowJointTrajectory
  forward_position_controller/commands  std_msgs/Float64MultiArray: positions of all joints
  robot_joint_commands                  sensor_msgs/JointState of a controller manager elsewhere; NaN: no command
  joint_commands                        osrf_msgs/JointCommands; gains where the robot obeys them (puma260)
Services:
  ~/stop, ~/reset, ~/go_to/POSE, ~/teach/start, ~/teach/stop, ~/teach/play    std_srvs/Trigger
  ~/enable                                                                    std_srvs/SetBool
  CONTROLLER/query_state                                                      control_msgs/QueryTrajectoryState
CONTROLLER is joint_trajectory_controller, or each name in controllers.
"""

# How the values inside a table are given.
_TABLES = {
    "poses": "poses.POSE.JOINT:=ANGLE",
    "safety": "safety.NAME:=VALUE",
    "constraints": "constraints.NAME:=VALUE",
    "controllers": "controllers.CONTROLLER.NAME:=VALUE",
}


def main() -> None:
    """Entry point of the program."""
    sys.exit(run_node(lambda: _main(sys.argv[1:])))


def _main(args: Sequence[str]) -> int | None:
    own = args[0] if args else ""
    if own in _OPTIONS:
        if len(args) > 1:
            raise UsageError(f"{own} must be the only argument (see '{PROGRAM} --help')")
        say_document(_OPTIONS[own]())
        return None
    from hexwire.ros2.start import run as run_node

    return run_node(args, os.environ)


def help_text() -> str:
    """The text of `--help`."""
    return _HELP.format(parameters=settings_text(_rows())).rstrip()


def _rows() -> Iterator[tuple[str, Setting]]:
    from hexwire.ros2.settings import PARAMETERS

    for row in PARAMETERS:
        yield _TABLES.get(row.name, f"{row.name}:={row.default_text}"), row


def _version() -> str:
    import hexwire

    return f"{PROGRAM} {hexwire.__version__}"


_OPTIONS: dict[str, Callable[[], str]] = {
    "-h": help_text,
    "--help": help_text,
    "-V": _version,
    "--version": _version,
}


if __name__ == "__main__":
    main()
