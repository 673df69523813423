"""The program `hexwire-ros1`: the ROS 1 node `hardware_interface`, and the location of its ROS package.

Owns its command line except ROS's own remapping arguments, which are passed on unchanged. Must not know what the
node does, and loads ROS only to start it.
"""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from hexwire.errors import UsageError

from .exits import run_node
from .output import say, say_document, settings_text

__all__ = ["PROGRAM", "environment", "help_text", "main", "package_path"]

PROGRAM = "hexwire-ros1"

_HELP = """\
Usage: hexwire-ros1 [_PARAMETER:=VALUE | NAME:=OTHER | __name:=NAME | __ns:=NAMESPACE]...
       hexwire-ros1 --help | --version | --package-path | --env | --messages DIR

The ROS 1 node 'hardware_interface': publishes joint states of a robot arm and follows trajectories. Needs a master
(roscore). Starting or restarting the node does not move the arm, unless its board has the chapter's sketch: that
one moves it when the port is opened.

  hexwire-ros1 _port:=/dev/ttyUSB0
  eval "$(hexwire-ros1 --env)"; roslaunch hexwire hardware.launch sim:=true

Options:
  -h, --help      Show this text.
  -V, --version   Show the version of hexwire.
  --package-path  Show the folder with the ROS package 'hexwire', for ROS_PACKAGE_PATH.
  --env           Show shell lines for eval, with which roslaunch and rosrun find the package and this program.
  --messages DIR  Write control_msgs and osrf_msgs to DIR, for Python programs and rostopic: put DIR on PYTHONPATH.

Parameters, all private, with their defaults; tables are set in parameter files (see config/ in the package):
{parameters}

Publishes:
  joint_states              sensor_msgs/JointState
  state                     control_msgs/JointTrajectoryControllerState
  ~taught                   trajectory_msgs/JointTrajectory, latched
  /diagnostics              diagnostic_msgs/DiagnosticArray
Subscribes and serves:
  command                   trajectory_msgs/JointTrajectory; a trajectory without points means hold
  joint_commands            osrf_msgs/JointCommands; gains where the robot obeys them (puma260)
  follow_joint_trajectory   action control_msgs/FollowJointTrajectory
Services:
  ~stop, ~reset, ~go_to/POSE, ~teach/start, ~teach/stop, ~teach/play    std_srvs/Trigger
  ~enable                                                               std_srvs/SetBool
  query_state                                                           control_msgs/QueryTrajectoryState
With several controllers, state, command, query_state and follow_joint_trajectory are below each controller's name.
"""


def main() -> None:
    """Entry point of the program."""
    sys.exit(run_node(lambda: _main(sys.argv[1:])))


def package_path() -> Path:
    """The folder that contains the folder of the ROS package."""
    import hexwire.ros1

    return Path(hexwire.ros1.__file__).resolve().parent / "share"


def environment(variables: Mapping[str, str], program: Path | None) -> str:
    """Lines for a POSIX shell with which roslaunch finds the package, and the package finds this program.

    Args:
        variables: The present environment. Existing entries are kept.
        program: Path of this program; None if unknown.
    """
    lines = []
    known = [part for part in variables.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if part]
    folder = str(package_path())
    lines.append(_export("ROS_PACKAGE_PATH", known if folder in known else [folder, *known]))
    if program is not None:
        search = variables.get("PATH", os.defpath)
        found = shutil.which(program.name, path=search)
        # Another hexwire earlier in PATH would run with this one's launch files.
        if found is None or not Path(found).samefile(program):
            lines.append(_export("PATH", [str(program.parent), search]))
    return "\n".join(lines)


def _export(name: str, parts: Sequence[str]) -> str:
    return f"export {name}={shlex.quote(os.pathsep.join(parts))}"


def _main(args: Sequence[str]) -> int | None:
    options = [arg for arg in args if ":=" not in arg]
    if not options:
        return _start(list(args))
    if options[0] == "--messages":
        _write_messages(args)
        return None
    if len(args) > 1 and options[0] in _OPTIONS:
        raise UsageError(f"{options[0]} must be the only argument (see '{PROGRAM} --help')")
    if options[0] not in _OPTIONS:
        hint = "; a parameter is given as _port:=/dev/ttyUSB0" if not options[0].startswith("-") else ""
        raise UsageError(f"no option {options[0]!r}{hint} (see '{PROGRAM} --help')")
    say_document(_OPTIONS[options[0]]())
    return None


def _write_messages(args: Sequence[str]) -> None:
    if len(args) != 2 or args[0] != "--messages" or args[1].startswith("-"):
        raise UsageError(f"--messages takes a folder and nothing else (see '{PROGRAM} --help')")
    _find_ros()
    from hexwire.ros1.message_files import write_messages

    folder = Path(args[1])
    for package in write_messages(folder):
        say(package)
    # A trailing colon would put the current folder on the path of every Python.
    say_document(f"export PYTHONPATH={shlex.quote(str(folder.resolve()))}${{PYTHONPATH:+:$PYTHONPATH}}")


def _find_ros() -> None:
    from hexwire.ros1.path import ROS_MISSING, find_ros

    if not find_ros():
        raise UsageError(ROS_MISSING)


def _start(args: list[str]) -> int | None:
    _find_ros()
    # Only after ROS is found: this imports rospy.
    from hexwire.ros1.node import run as run_node

    return run_node(args)


def help_text() -> str:
    """The text of `--help`."""
    from hexwire.ros1.parameters import PARAMETERS

    return _HELP.format(
        parameters=settings_text((f"_{row.name}:={row.default_text}", row) for row in PARAMETERS)
    ).rstrip()


def _version() -> str:
    import hexwire

    return f"{PROGRAM} {hexwire.__version__}"


def _this_program() -> Path | None:
    """Path of this program: as it was called, otherwise next to the interpreter."""
    called = Path(sys.argv[0])
    for path in (called.absolute(), Path(sys.executable).parent / PROGRAM):
        if path.name == PROGRAM and path.is_file():
            return path
    return None


_OPTIONS: dict[str, Callable[[], str]] = {
    "-h": help_text,
    "--help": help_text,
    "-V": _version,
    "--version": _version,
    "--package-path": lambda: str(package_path()),
    "--env": lambda: environment(os.environ, _this_program()),
}


if __name__ == "__main__":
    main()
