#!/usr/bin/env python3
"""Check the node `hexwire-ros2` from a machine with ROS 2, and print pass or fail, a line each.

    ros2_check.py --start
    ros2_check.py [--node /hardware_interface] [--controller NAME] [--move] [--only CHECK]

Needs Jazzy or later with `rmw_zenoh_cpp`, in a shell where ROS 2 is set up. With `--start` it starts a router and
the node with an emulated arm, moves that arm, and ends both; otherwise the node must be running. Everything goes
through the programs of ROS 2. Without `--move` nothing of a running node moves, and torque stays as it is. What is
not installed is left out. The exit status is 0 if nothing failed, 1 if something did, 2 if ROS 2 is not set up.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

PATIENCE = 30.0
"""Seconds for a program of ROS 2 that should end by itself."""
TOPICS = {
    "joint_states": "sensor_msgs/msg/JointState",
    "robot_description": "std_msgs/msg/String",
    "CONTROLLER/joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
    "CONTROLLER/controller_state": "control_msgs/msg/JointTrajectoryControllerState",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/rosout": "rcl_interfaces/msg/Log",
}
SERVICES = {
    "~/stop": "std_srvs/srv/Trigger",
    "~/reset": "std_srvs/srv/Trigger",
    "~/enable": "std_srvs/srv/SetBool",
    "~/list_parameters": "rcl_interfaces/srv/ListParameters",
    "~/get_state": "lifecycle_msgs/srv/GetState",
    "~/get_type_description": "type_description_interfaces/srv/GetTypeDescription",
    "CONTROLLER/query_state": "control_msgs/srv/QueryTrajectoryState",
}
ACTION = "control_msgs/action/FollowJointTrajectory"
JOINT_STATE_HASH = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"


class Failed(Exception):  # noqa: N818
    """A check did not pass; the text says why."""


class LeftOut(Exception):  # noqa: N818
    """A check cannot be made here; the text says why."""


def expect(condition: object, otherwise: str) -> None:
    """Fail with a text unless a condition holds."""
    if not condition:
        raise Failed(otherwise)


class Programs:
    """The programs of ROS 2 on this machine."""

    def run(self, *words: str, seconds: float | None = None, patience: float = PATIENCE) -> str:
        """Run `ros2 WORDS`; returns what it printed. With `seconds` it is interrupted after that time."""
        # PYTHONUNBUFFERED: `ros2 topic hz` would keep its lines in a buffer when its output is no terminal.
        env = {**os.environ, "PYTHONUNBUFFERED": "1"}
        process = subprocess.Popen(
            ["ros2", *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=env,
            start_new_session=True,
        )
        try:
            return process.communicate(timeout=seconds or patience)[0]
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
            try:
                said = process.communicate(timeout=10)[0]
            except subprocess.TimeoutExpired:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                said = process.communicate()[0]
            if seconds is None:
                raise Failed(f"ros2 {' '.join(words)} did not end in {patience:g} s: {first_line(said)}") from None
            return said

    def has(self, package: str) -> bool:
        """Whether a ROS 2 package is installed."""
        return shutil.which("ros2") is not None and package in self.run("pkg", "list").split()


def first_line(said: str) -> str:
    """The last line that a program printed: that is where a Python program says what is wrong."""
    lines = said.strip().splitlines()
    return lines[-1] if lines else "it printed nothing"


class Checks:
    """All checks of one node, in their order."""

    def __init__(self, ros2: Programs, node: str, controller: str, seconds: float) -> None:
        self.ros2 = ros2
        self.node = node
        self.controller = controller
        self.seconds = seconds
        self.namespace = node.rpartition("/")[0]
        self.joints: list[str] = []
        self.positions: list[float] = []

    def name(self, relative: str) -> str:
        """A name as the node resolves it."""
        if relative.startswith("/"):
            return relative
        if relative.startswith("~/"):
            return self.node + relative[1:]
        return f"{self.namespace}/{relative.replace('CONTROLLER', self.controller)}"

    def setting(self) -> str:
        chosen = os.environ.get("RMW_IMPLEMENTATION", "")
        expect(
            chosen == "rmw_zenoh_cpp", f"RMW_IMPLEMENTATION is {chosen or 'not set'}: export it as rmw_zenoh_cpp"
        )
        return f"{os.environ.get('ROS_DISTRO', '?')}, {chosen}, domain {os.environ.get('ROS_DOMAIN_ID', '0')}"

    def node_list(self) -> str:
        listed = self.ros2.run("node", "list", "--no-daemon", "--spin-time", "3").split()
        expect(
            self.node in listed, f"{self.node} is not among {', '.join(listed) or 'no nodes'}; is a router running?"
        )
        return self.node

    def topic_list(self) -> str:
        listed = self.ros2.run("topic", "list", "-t", "--no-daemon", "--spin-time", "3").splitlines()
        for relative, kind in TOPICS.items():
            expect(f"{self.name(relative)} [{kind}]" in listed, f"no {self.name(relative)} [{kind}]")
        return f"{len(listed)} topics"

    def topic_info(self) -> str:
        said = self.ros2.run("topic", "info", "-v", self.name("joint_states"))
        expect("Publisher count: 1" in said, "not one publisher")
        expect(f"Topic type hash: {JOINT_STATE_HASH}" in said, f"not the type hash {JOINT_STATE_HASH}")
        expect("Reliability: RELIABLE" in said, "not reliable")
        return "one publisher, type hash of sensor_msgs"

    def service_list(self) -> str:
        listed = self.ros2.run("service", "list", "-t", "--no-daemon", "--spin-time", "3").splitlines()
        for relative, kind in SERVICES.items():
            expect(f"{self.name(relative)} [{kind}]" in listed, f"no {self.name(relative)} [{kind}]")
        return f"{len(listed)} services"

    def topic_echo(self) -> str:
        said = self.ros2.run("topic", "echo", "--once", self.name("joint_states"))
        self.joints = sequence(said, "name")
        self.positions = [float(text) for text in sequence(said, "position")]
        expect(self.joints, f"no joint names: {first_line(said)}")
        expect(len(self.positions) == len(self.joints), "not one position for each joint")
        return ", ".join(self.joints)

    def topic_hz(self) -> str:
        said = self.ros2.run("topic", "hz", self.name("joint_states"), seconds=self.seconds + 3.0)
        rates = re.findall(r"average rate: ([\d.]+)", said)
        expect(rates, f"no rate: {first_line(said)}")
        expect(float(rates[-1]) > 1.0, f"{rates[-1]} Hz")
        return f"{float(rates[-1]):.1f} Hz"

    def late_joiner(self) -> str:
        said = self.ros2.run(
            "topic", "echo", "--once", "--full-length", "--qos-durability", "transient_local",
            "--qos-reliability", "reliable", self.name("robot_description"),
        )  # fmt: skip
        expect("<robot" in said, f"no URDF: {first_line(said)}")
        return f"URDF of {len(said)} characters"

    def diagnostics(self) -> str:
        said = self.ros2.run("topic", "echo", "--once", "/diagnostics")
        names = re.findall(r"name: '?([^'\n]+)", said)
        expect(
            any(self.node.rpartition("/")[2] in name for name in names), f"none of this node: {first_line(said)}"
        )
        return f"{len(names)} components"

    def param_list(self) -> str:
        listed = self.ros2.run("param", "list", self.node, "--no-daemon", "--spin-time", "3").split()
        expect("publish_rate" in listed, f"no publish_rate: {' '.join(listed[-8:])}")
        return f"{len(listed)} parameters"

    def param_get(self) -> str:
        said = self.ros2.run("param", "get", self.node, "diagnostics_rate")
        expect(re.search(r"Double value is: [\d.]+", said), first_line(said))
        return said.strip()

    def param_describe(self) -> str:
        said = self.ros2.run("param", "describe", self.node, "connect_timeout")
        expect("Type: double" in said and "Max value: 3600.0" in said, first_line(said))
        return "type and bounds"

    def param_set(self) -> str:
        said = self.ros2.run("param", "get", self.node, "diagnostics_rate")
        found = re.search(r"Double value is: ([\d.]+)", said)
        expect(found, first_line(said))
        assert found is not None
        refused = self.ros2.run("param", "set", self.node, "diagnostics_rate", "-1.0")
        expect("Setting parameter failed" in refused, f"-1.0 was not refused: {first_line(refused)}")
        taken = self.ros2.run("param", "set", self.node, "diagnostics_rate", found[1])
        expect("Set parameter successful" in taken, first_line(taken))
        return "a bad value refused, a good one taken"

    def lifecycle_get(self) -> str:
        said = self.ros2.run("lifecycle", "get", self.node)
        expect(re.search(r"\b(active \[3\]|inactive \[2\])", said), first_line(said))
        return said.strip()

    def service_call(self) -> str:
        said = self.ros2.run(
            "service", "call", self.name("CONTROLLER/query_state"), SERVICES["CONTROLLER/query_state"], "{}"
        )
        expect("success=True" in said, first_line(said))
        return "query_state"

    def action_list(self) -> str:
        listed = self.ros2.run("action", "list", "-t").splitlines()
        wanted = f"{self.name('CONTROLLER/follow_joint_trajectory')} [{ACTION}]"
        expect(wanted in listed, f"no {wanted}; {len(listed)} others")
        return wanted

    def control_msgs(self) -> str:
        """The feedback of control_msgs 6.3 and later has an index: both ends must be of one side."""
        said = self.ros2.run("interface", "show", ACTION)
        expect("error_code" in said, "control_msgs is not installed: sudo apt install ros-$ROS_DISTRO-control-msgs")
        local = "rolling" if re.search(r"^int32 index", said, re.MULTILINE) else "jazzy"
        told = self.ros2.run(
            "topic", "info", "-v", self.name("CONTROLLER/follow_joint_trajectory/_action/feedback")
        )
        found = re.search(r"Topic type hash: (\w+)", told)
        expect(found, first_line(told))
        assert found is not None
        remote = {"RIHS01_80398fcb": "jazzy", "RIHS01_95618cc7": "rolling"}.get(found[1][:15], found[1])
        expect(remote == local, f"here control_msgs is {local}'s, the node has {remote}'s: set its `distribution`")
        return f"as in {local}"

    def bag(self) -> str:
        if not self.ros2.has("rosbag2_storage_mcap"):
            raise LeftOut("rosbag2_storage_mcap is not installed")
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / "bag")
            self.ros2.run(
                "bag",
                "record",
                "-s",
                "mcap",
                "-o",
                path,
                "--topics",
                self.name("joint_states"),
                seconds=self.seconds + 3.0,
            )
            said = self.ros2.run("bag", "info", path)
        found = re.search(r"Messages:\s+(\d+)", said)
        expect(found and int(found[1]) > 1, first_line(said))
        assert found is not None
        return f"{found[1]} messages recorded"

    def transforms(self) -> str:
        """What rviz2 needs: the state publisher makes transforms of description and joint states."""
        if not self.ros2.has("robot_state_publisher"):
            raise LeftOut("robot_state_publisher is not installed")
        # It has the description only as a parameter; the topic has the same text.
        said = self.ros2.run(
            "topic", "echo", "--once", "--full-length", "--field", "data", "--qos-durability", "transient_local",
            "--qos-reliability", "reliable", self.name("robot_description"),
        )  # fmt: skip
        first, last = said.find("<"), said.rfind(">")
        expect(first >= 0, f"no URDF: {first_line(said)}")
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "robot.yaml"
            lines = "\n".join(f"      {line}" for line in said[first : last + 1].splitlines())
            file.write_text(f"/**:\n  ros__parameters:\n    robot_description: |\n{lines}\n", encoding="utf-8")
            publisher = start(
                "ros2", "run", "robot_state_publisher", "robot_state_publisher",
                "--ros-args", "--params-file", str(file),
                "-r", f"__ns:={self.namespace or '/'}", "-r", "__node:=ros2_check_state_publisher",
                "-r", "robot_description:=robot_description_check",
            )  # fmt: skip
            try:
                found = self.ros2.run("topic", "echo", "--once", "/tf", "tf2_msgs/msg/TFMessage")
            finally:
                end_all(publisher)
        frames = re.findall(r"child_frame_id: (\S+)", found)
        expect(frames, f"no transforms: {first_line(found)}")
        return f"{len(frames)} moving frames"

    def rviz2(self) -> str:
        if not self.ros2.has("rviz2"):
            raise LeftOut("rviz2 is not installed")
        if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise LeftOut("there is no screen")
        rviz = start("ros2", "run", "rviz2", "rviz2", "--fixed-frame", "base_link")
        try:
            ended = rviz.wait(self.seconds + 3.0)
        except subprocess.TimeoutExpired:
            return "it runs; add RobotModel and TF to see the arm"
        finally:
            end_all(rviz)
        raise Failed(f"it ended with status {ended}")

    def moveit(self) -> str:
        nodes = self.ros2.run("node", "list").split()
        groups = [node for node in nodes if node.rpartition("/")[2] == "move_group"]
        if not groups:
            raise LeftOut("move_group does not run; start it from the package of `hexwire model ros2-package`")
        said = self.ros2.run("param", "get", groups[0], "robot_description_semantic")
        expect("<robot" in said, f"{groups[0]} has no SRDF: {first_line(said)}")
        actions = self.ros2.run("action", "list").split()
        expect(any(name.endswith("move_action") for name in actions), "no move_action")
        return f"{groups[0]} has an SRDF and plans"

    # With --move only.

    def enable(self) -> str:
        said = self.ros2.run("service", "call", self.name("~/enable"), SERVICES["~/enable"], "{data: true}")
        expect("success=True" in said, first_line(said))
        return "torque is on"

    def goal(self, names: list[str], positions: list[float], seconds: int = 2) -> str:
        point = f"{{positions: {positions}, time_from_start: {{sec: {seconds}}}}}"
        goal = f"{{trajectory: {{joint_names: [{', '.join(names)}], points: [{point}]}}}}"
        return self.ros2.run(
            "action",
            "send_goal",
            "--feedback",
            self.name("CONTROLLER/follow_joint_trajectory"),
            ACTION,
            goal,
            patience=60.0,
        )

    def send_goal(self) -> str:
        if not self.joints:
            self.topic_echo()
        first = self.positions[0]
        there = [first - 0.1 if first > 0 else first + 0.1, *self.positions[1:]]
        for wanted in (there, self.positions):
            said = self.goal(self.joints, [round(position, 4) for position in wanted])
            expect("Goal finished with status: SUCCEEDED" in said, first_line(said))
            expect("Feedback:" in said, "no feedback")
        return f"{self.joints[0]} moved 0.1 there and back"

    def lifecycle_set(self) -> str:
        for change in ("deactivate", "activate"):
            said = self.ros2.run("lifecycle", "set", self.node, change)
            expect("Transitioning successful" in said, f"{change}: {first_line(said)}")
        found = self.ros2.run("lifecycle", "get", self.node)
        expect("active [3]" in found, first_line(found))
        return "deactivated and activated"

    def refused_goal(self) -> str:
        said = self.goal(["no_such_joint"], [0.0])
        refused = "Goal was rejected" in said or "Goal finished with status: ABORTED" in said
        expect(refused, first_line(said))
        return "a goal for an unknown joint"

    def stop(self) -> str:
        said = self.ros2.run("service", "call", self.name("~/stop"), SERVICES["~/stop"], "{}")
        expect("success=True" in said, first_line(said))
        again = self.ros2.run("service", "call", self.name("~/reset"), SERVICES["~/reset"], "{}")
        expect("success=True" in again, first_line(again))
        return "stop and reset"


def sequence(said: str, field: str) -> list[str]:
    """The items of a sequence in the YAML that `ros2 topic echo` prints."""
    found = re.search(rf"^{field}:[ \t]*\n((?:- .*\n?)*)", said, re.MULTILINE)
    return [line[2:].strip().strip("'") for line in found[1].splitlines()] if found else []


def start(*words: str) -> subprocess.Popen[bytes]:
    """Start a program, which runs until `end_all`."""
    none = subprocess.DEVNULL
    return subprocess.Popen(words, stdin=none, stdout=none, stderr=none, start_new_session=True)


def end_all(process: subprocess.Popen[bytes]) -> None:
    """End a program and what it started."""
    for how in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, how)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(5.0)
            return


LOOKING = (
    "setting", "node_list", "topic_list", "topic_info", "service_list", "topic_echo", "topic_hz", "late_joiner",
    "diagnostics", "param_list", "param_get", "param_describe", "param_set", "lifecycle_get", "service_call",
    "action_list", "control_msgs", "bag", "transforms", "rviz2", "moveit",
)  # fmt: skip
MOVING = ("enable", "send_goal", "refused_goal", "lifecycle_set", "stop")


@contextlib.contextmanager
def emulated(checks: Checks) -> Iterator[None]:
    """A router, which may run already, and the node with an emulated arm, until the checks are made."""
    os.environ["RMW_IMPLEMENTATION"] = "rmw_zenoh_cpp"
    # One that was started beside another router, or for another middleware, knows none of these nodes.
    with contextlib.suppress(Failed):
        checks.ros2.run("daemon", "stop")
    router = start("ros2", "run", "rmw_zenoh_cpp", "rmw_zenohd")
    node = start("hexwire-ros2", "--ros-args", "-p", "port:=sim://hex7bot", "-p", "enable_on_start:=true")
    try:
        deadline = time.monotonic() + PATIENCE
        with contextlib.suppress(Failed):
            while checks.node not in checks.ros2.run("node", "list", "--no-daemon", "--spin-time", "3").split():
                if time.monotonic() > deadline:
                    break
        yield
    finally:
        end_all(node)
        end_all(router)


def main(arguments: list[str] | None = None) -> int:
    """Make all checks; returns the exit status."""
    parser = argparse.ArgumentParser(description="Check hexwire-ros2 with the programs of ROS 2.")
    parser.add_argument("--node", default="/hardware_interface", help="full name of the node")
    parser.add_argument("--controller", default="joint_trajectory_controller", help="name of its controller")
    parser.add_argument("--move", action="store_true", help="switch torque on and move the first joint by 0.1")
    parser.add_argument("--start", action="store_true", help="start a router and the node with an emulated arm")
    parser.add_argument("--only", metavar="CHECK", action="append", help="make this check alone, as in 'topic hz'")
    parser.add_argument("--seconds", type=float, default=5.0, help="how long to listen for a rate")
    options = parser.parse_args(arguments)
    names = [name.replace("_", " ") for name in (*LOOKING, *(MOVING if options.move or options.start else ()))]
    if unknown := set(options.only or ()) - set(names):
        parser.error(f"no check {', '.join(sorted(unknown))}; there are {', '.join(names)}")
    if shutil.which("ros2") is None:
        sys.stderr.write("ROS 2 is not set up in this shell: source /opt/ros/jazzy/setup.bash\n")
        return 2
    if options.start and shutil.which("hexwire-ros2") is None:
        sys.stderr.write("hexwire-ros2 is not on the path: pip install 'hexwire[ros2]'\n")
        return 2
    node = "/hardware_interface" if options.start else "/" + options.node.strip("/")
    checks = Checks(Programs(), node, options.controller, options.seconds)
    with emulated(checks) if options.start else contextlib.nullcontext():
        return made(checks, options.only or names)


def made(checks: Checks, names: list[str]) -> int:
    """Make checks by name; returns the exit status."""
    counts = {"pass": 0, "FAIL": 0, "left out": 0}
    for name in names:
        check: Callable[[], str] = getattr(checks, name.replace(" ", "_"))
        try:
            outcome, text = "pass", check()
        except Failed as failure:
            outcome, text = "FAIL", str(failure)
        except LeftOut as reason:
            outcome, text = "left out", str(reason)
        counts[outcome] += 1
        sys.stdout.write(f"{outcome:8}  {name:14}  {' '.join(text.split())[:200]}\n")
        sys.stdout.flush()
    sys.stdout.write(f"{counts['pass']} passed, {counts['FAIL']} failed, {counts['left out']} left out\n")
    return 1 if counts["FAIL"] else 0


if __name__ == "__main__":
    sys.exit(main())
