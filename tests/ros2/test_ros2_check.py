"""docs/ros2_check.py: what it makes of the words of ROS 2's programs; stand-ins print what real ones would.

The forms are those of ros2cli (Jazzy) and rclpy's `__str__` and `__repr__`. No real ROS 2 was here.
"""

# ruff: noqa: E501, ISC004 (texts of several lines, in a table)
from __future__ import annotations

import contextlib
import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.ros2.check_here import CHECK, load_check
from tests.waits import eventually

NODE = "/hardware_interface"
FOLLOW = "control_msgs/action/FollowJointTrajectory"
HASH = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
FEEDBACK_HASH = "RIHS01_80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71"

# A `ros2` that looks up what it is to print by the start of its arguments; `<wait>` at the end: until Ctrl-C.
STAND_IN = """#!{python} -IS
import signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
import json, sys, time
words = " ".join(sys.argv[1:])
with open({calls!r}, "a") as calls:
    calls.write(words + chr(10))
answers = json.load(open({answers!r}))
text = next((text for start, text in answers if words.startswith(start)), "ros2: error: " + words)
print(text.removesuffix("<wait>"), flush=True)
if text.endswith("<wait>"):
    # Only from here on: on a busy machine it may be interrupted before it has said what it is to say.
    signal.signal(signal.SIGINT, lambda *_: sys.exit(0))
    time.sleep(600)
"""
INFO = """Type: {kind}

Publisher count: 1

Node name: hardware_interface
Node namespace: /
Topic type: {kind}
Topic type hash: {hash}
Endpoint type: PUBLISHER
GID: 1d.4c.06.52.d0.8c.09.59.29.f5.02.d6.a7.5c.43.64
QoS profile:
  Reliability: RELIABLE
  History (Depth): KEEP_LAST (10)
  Durability: VOLATILE
  Lifespan: Infinite
  Deadline: Infinite
  Liveliness: AUTOMATIC
  Liveliness lease duration: Infinite

Subscription count: 0
"""
JOINT_STATE = """header:
  stamp:
    sec: 1780000000
    nanosec: 1000
  frame_id: ''
name:
- J1
- J2
position:
- 0.25
- -1.0e-05
velocity:
- 0.0
- 0.0
effort: []
---
"""
GOAL = """Waiting for an action server to become available...
Sending goal:
     trajectory:
Goal accepted with ID: 5b9a5d6a0e5a4d3b8f2d6c1b7a9e0f11

Feedback:
    header:
Result:
    error_code: 0
error_string: ''

Goal finished with status: SUCCEEDED
"""
TRIGGER = """requester: making request: std_srvs.srv.Trigger_Request()

response:
std_srvs.srv.Trigger_Response(success=True, message='')
"""
Answers = list[tuple[str, str]]
"""Start of the words, and what is printed then."""
WELL: Answers = [
    ("node list", f"/rviz\n{NODE}\n/move_group\n"),
    (
        "topic list",
        "/joint_trajectory_controller/controller_state [control_msgs/msg/JointTrajectoryControllerState]\n"
        "/diagnostics [diagnostic_msgs/msg/DiagnosticArray]\n"
        "/joint_states [sensor_msgs/msg/JointState]\n"
        "/joint_trajectory_controller/joint_trajectory [trajectory_msgs/msg/JointTrajectory]\n"
        "/parameter_events [rcl_interfaces/msg/ParameterEvent]\n"
        "/robot_description [std_msgs/msg/String]\n"
        "/rosout [rcl_interfaces/msg/Log]\n",
    ),
    ("topic info -v /joint_states", INFO.format(kind="sensor_msgs/msg/JointState", hash=HASH)),
    (
        "topic info -v /joint_trajectory_controller/follow_joint_trajectory/_action/feedback",
        INFO.format(kind=f"{FOLLOW}_FeedbackMessage", hash=FEEDBACK_HASH),
    ),
    (
        "service list",
        f"{NODE}/enable [std_srvs/srv/SetBool]\n"
        f"{NODE}/get_state [lifecycle_msgs/srv/GetState]\n"
        f"{NODE}/get_type_description [type_description_interfaces/srv/GetTypeDescription]\n"
        f"{NODE}/list_parameters [rcl_interfaces/srv/ListParameters]\n"
        f"{NODE}/reset [std_srvs/srv/Trigger]\n"
        f"{NODE}/stop [std_srvs/srv/Trigger]\n"
        "/joint_trajectory_controller/query_state [control_msgs/srv/QueryTrajectoryState]\n",
    ),
    ("topic echo --once /joint_states", JOINT_STATE),
    (
        "topic hz /joint_states",
        "average rate: 50.112\n\tmin: 0.009s max: 0.011s std dev: 0.00044s window: 76\n"
        "average rate: 75.003\n\tmin: 0.009s max: 0.016s std dev: 0.00051s window: 152\n<wait>",
    ),
    (
        "topic echo --once --full-length --field data",
        '<?xml version="1.0"?>\n<robot name="hex7bot">\n</robot>\n---\n',
    ),
    (
        "topic echo --once --full-length --qos",
        'data: \'<?xml version="1.0"?>\n\n  <robot name="hex7bot">\n\n  </robot>\'\n---\n',
    ),
    (
        "topic echo --once /diagnostics",
        "header:\nstatus:\n- level: \"\\0\"\n  name: 'hardware_interface: link'\n  message: ok\n  values: []\n---\n",
    ),
    ("param list", "  joints\n  port\n  publish_rate\n  use_sim_time\n"),
    ("param get /hardware_interface diagnostics_rate", "Double value is: 1.0\n"),
    ("param get /move_group robot_description_semantic", "String value is: <?xml?>\n<robot name='hex7bot'>\n"),
    (
        "param describe",
        "Parameter name: connect_timeout\n  Type: double\n  Description: how long to try\n  Constraints:\n"
        "    Min value: 0.0\n    Max value: 3600.0\n",
    ),
    (
        "param set /hardware_interface diagnostics_rate -1.0",
        "Setting parameter failed: diagnostics_rate must be above 0\n",
    ),
    ("param set /hardware_interface diagnostics_rate 1.0", "Set parameter successful\n"),
    ("lifecycle get", "active [3]\n"),
    ("lifecycle set", "Transitioning successful\n"),
    (
        "service call /joint_trajectory_controller/query_state",
        "requester: making request: ...\n\nresponse:\ncontrol_msgs.srv.QueryTrajectoryState_Response(success=True, "
        "message='', name=['J1'], position=[0.1], velocity=[0.0], acceleration=[0.0])\n",
    ),
    ("action list -t", f"/joint_trajectory_controller/follow_joint_trajectory [{FOLLOW}]\n"),
    ("action list", "/joint_trajectory_controller/follow_joint_trajectory\n/move_action\n"),
    (
        "interface show",
        "trajectory_msgs/JointTrajectory trajectory\n---\nint32 error_code\n---\nstring[] joint_names\n",
    ),
    ("pkg list", "rclpy\nrobot_state_publisher\nrosbag2_storage_mcap\nrviz2\n"),
    ("bag record", "[INFO] [1780000000.0] [rosbag2_recorder]: Recording...\n<wait>"),
    (
        "bag info",
        "Files:             bag_0.mcap\nMessages:          153\nTopic information: Topic: /joint_states\n",
    ),
    ("run robot_state_publisher", "<wait>"),
    ("run rviz2", "<wait>"),
    ("run rmw_zenoh_cpp rmw_zenohd", "<wait>"),
    ("hexwire-ros2", "<wait>"),
    (
        "topic echo --once /tf",
        "transforms:\n- header:\n    frame_id: base_link\n  child_frame_id: turntable\n---\n",
    ),
    ("service call /hardware_interface/enable", TRIGGER.replace("Trigger", "SetBool")),
    ("service call /hardware_interface/stop", TRIGGER),
    ("service call /hardware_interface/reset", TRIGGER),
    (
        f"action send_goal --feedback /joint_trajectory_controller/follow_joint_trajectory {FOLLOW} {{trajectory: {{joint_names: [no_such_joint]",
        "Waiting for an action server to become available...\nGoal was rejected.\n",
    ),
    ("action send_goal", GOAL),
]
CHECKS = 21
MOVES = 5


class Stage:
    """A machine on which `ros2` prints what it is told to."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._calls = folder / "calls"
        self._answers = folder / "answers.json"
        self.env = {
            "PATH": f"{folder}:/usr/bin:/bin",
            "RMW_IMPLEMENTATION": "rmw_zenoh_cpp",
            "ROS_DISTRO": "jazzy",
            "DISPLAY": ":0",
        }
        program = folder / "ros2"
        text = STAND_IN.format(python=sys.executable, calls=str(self._calls), answers=str(self._answers))
        program.write_text(text, encoding="utf-8")
        program.chmod(0o755)

    def run(self, check: Path, answers: Answers, *arguments: str) -> tuple[int, dict[str, list[str]], str]:
        """Run it with real programs; returns its status, the names of the checks by outcome, and what it printed."""
        self._answers.write_text(json.dumps(answers), encoding="utf-8")
        words = [sys.executable, str(check), "--seconds", "-1.0", *arguments]
        done = subprocess.run(words, env=self.env, capture_output=True, text=True, timeout=110, check=False)
        return done.returncode, outcomes_of(done.stdout), done.stdout + done.stderr

    def running(self) -> list[str]:
        """The programs that run."""
        found = []
        for process in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                words = process.read_bytes()
                if os.fsencode(self.folder / "ros2") in words:
                    found.append(os.fsdecode(words))
        return found


def outcomes_of(said: str) -> dict[str, list[str]]:
    outcomes: dict[str, list[str]] = {"pass": [], "FAIL": [], "left out": []}
    for line in said.splitlines()[:-1]:
        outcomes[line[:8].strip()].append(line[10:24].strip())
    return outcomes


class Told:
    """The checks in this process; instead of a `ros2` that is started, the table answers at once."""

    def __init__(self, stage: Stage, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys
        self._monkeypatch = monkeypatch
        self.env = stage.env
        self.calls: list[str] = []
        self._answers: Answers = []
        self._module = load_check(monkeypatch, self._answer)

    def _answer(self, words: tuple[str, ...]) -> str:
        call = " ".join(words)
        self.calls.append(call)
        return next((text for start, text in self._answers if call.startswith(start)), "ros2: error: " + call)

    def check(self, *arguments: str, **changed: str) -> tuple[int, dict[str, list[str]], str]:
        """As `Stage.run`, with some of the answers changed."""
        self._answers = [(start, changed.pop(start, text)) for start, text in WELL]
        assert not changed, "what is changed is one of the answers"
        with self._monkeypatch.context() as patch:
            for name in set(os.environ) - {"PATH"}:
                patch.delenv(name)
            for name, value in self.env.items():
                patch.setenv(name, value)
            try:
                status = self._module.main([*arguments])
            except SystemExit as ended:
                status = ended.code
        said, error = self._capsys.readouterr()
        return status, outcomes_of(said), said + error


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(tmp_path)


@pytest.fixture
def told(stage: Stage, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Told:
    return Told(stage, monkeypatch, capsys)


def test_all_is_well_with_real_programs_and_none_is_left(stage: Stage) -> None:
    status, outcomes, said = stage.run(CHECK, WELL, "--move")
    assert (status, outcomes["FAIL"], outcomes["left out"]) == (0, [], []), said
    assert len(outcomes["pass"]) == CHECKS + MOVES
    assert said.endswith(f"{CHECKS + MOVES} passed, 0 failed, 0 left out\n")
    assert "75.0 Hz" in said
    assert "J1, J2" in said
    # One that was killed is in the list of processes until it is gone.
    eventually(lambda: not stage.running())


def test_without_move_nothing_is_ordered(told: Told) -> None:
    status, outcomes, _ = told.check()
    assert (status, len(outcomes["pass"])) == (0, CHECKS)
    assert not [call for call in told.calls if "send_goal" in call or "/enable" in call or "/stop" in call]


def test_the_goal_moves_the_first_joint_from_where_it_is_and_back(told: Told) -> None:
    told.check("--move")
    goals = [call for call in told.calls if call.startswith("action send_goal")]
    assert "joint_names: [J1, J2], points: [{positions: [0.15, -0.0], time_from_start: {sec: 2}}]" in goals[0]
    assert "positions: [0.25, -0.0]" in goals[1]
    assert len(goals) == 3


BROKEN = {
    "node list": ("node list", "/other\n"),
    "topic list": ("topic list", "/joint_states [sensor_msgs/msg/JointState]\n"),
    "topic info": ("topic info -v /joint_states", INFO.format(kind="sensor_msgs/msg/JointState", hash="RIHS01_00")),
    "service list": ("service list", "/hardware_interface/stop [std_srvs/srv/Trigger]\n"),
    "topic echo": (
        "topic echo --once /joint_states",
        "WARNING: topic [/joint_states] does not appear to be published yet\n",
    ),
    "topic hz": ("topic hz /joint_states", "<wait>"),
    "late joiner": ("topic echo --once --full-length --qos", "data: ''\n---\n"),
    "diagnostics": ("topic echo --once /diagnostics", "status:\n- name: 'other: link'\n"),
    "param list": ("param list", "Node not found\n"),
    "param get": ("param get /hardware_interface diagnostics_rate", "Parameter not set\n"),
    "param describe": ("param describe", "Parameter name: publish_rate\n  Type: string\n  Constraints:\n"),
    "param set": ("param set /hardware_interface diagnostics_rate -1.0", "Set parameter successful\n"),
    "lifecycle get": ("lifecycle get", "unconfigured [1]\n"),
    "lifecycle set": ("lifecycle set", "Transitioning failed\n"),
    "service call": (
        "service call /joint_trajectory_controller/query_state",
        "response:\nX_Response(success=False, message='no')\n",
    ),
    "action list": ("action list -t", ""),
    "control msgs": ("interface show", "---\nint32 error_code\n---\nstring[] joint_names\nint32 index\n"),
    "bag": ("bag info", "Messages:          0\n"),
    "transforms": ("topic echo --once /tf", "---\n"),
    "rviz2": ("run rviz2", "could not connect to display\n"),
    "moveit": ("param get /move_group robot_description_semantic", "Parameter not set\n"),
    "enable": ("service call /hardware_interface/enable", "X_Response(success=False, message='stopped')\n"),
    "send goal": ("action send_goal", GOAL.replace("SUCCEEDED", "ABORTED")),
    "refused goal": (next(start for start, _ in WELL if "no_such_joint" in start), GOAL),
    "stop": ("service call /hardware_interface/reset", "X_Response(success=False, message='x')\n"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_each_check_can_fail(told: Told, name: str) -> None:
    start, broken = BROKEN[name]
    well = told.check("--move", "--only", name)
    assert (well[0], well[1]["pass"]) == (0, [name]), well[2]
    status, outcomes, said = told.check("--move", "--only", name, **{start: broken})
    assert (status, outcomes["FAIL"]) == (1, [name]), said


def test_the_others_are_made_after_one_failed(told: Told) -> None:
    start, broken = BROKEN["node list"]
    status, outcomes, said = told.check("--move", **{start: broken})
    assert status == 1, said
    assert len([*itertools.chain(*outcomes.values())]) == CHECKS + MOVES


def test_with_start_it_starts_a_router_and_an_emulated_arm_and_ends_them(told: Told, stage: Stage) -> None:
    (stage.folder / "hexwire-ros2").touch(0o755)
    told.env["RMW_IMPLEMENTATION"] = ""
    status, outcomes, said = told.check("--start")
    assert status == 0, said
    assert len(outcomes["pass"]) == CHECKS + MOVES, said
    # A daemon that was started beside another router would know none of the nodes.
    daemon, first, second, *_ = told.calls
    assert daemon == "daemon stop"
    assert first == "run rmw_zenoh_cpp rmw_zenohd"
    assert second.startswith("hexwire-ros2 --ros-args -p port:=sim://hex7bot")
    # One that does not come up is a check that fails, not an end without a word.
    status, outcomes, _ = told.check("--start", **{"node list": "<wait>"})
    assert (status, outcomes["FAIL"][0]) == (1, "node list")
    assert "RMW_IMPLEMENTATION" not in os.environ, "it was set for the programs alone"
    (stage.folder / "hexwire-ros2").unlink()
    assert told.check("--start")[0] == 2


def test_a_check_that_does_not_exist(told: Told) -> None:
    status, outcomes, said = told.check("--only", "send goal")
    assert (status, [*itertools.chain(*outcomes.values())]) == (2, [])
    assert "no check send goal; there are setting, node list" in said, "without --move there is none"


def test_another_middleware_fails(told: Told) -> None:
    told.env["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
    status, outcomes, said = told.check()
    assert (status, outcomes["FAIL"]) == (1, ["setting"])
    assert "rmw_fastrtps_cpp" in said


def test_what_is_not_installed_is_left_out(told: Told) -> None:
    del told.env["DISPLAY"]
    status, outcomes, _ = told.check(**{"pkg list": "rclpy\nrviz2\n", "node list": f"{NODE}\n"})
    assert status == 0
    assert outcomes["left out"] == ["bag", "transforms", "rviz2", "moveit"]


def test_a_node_with_a_namespace(told: Told) -> None:
    status, _, said = told.check("--node", "/lab/hardware_interface")
    assert status == 1
    assert "no /lab/joint_states [sensor_msgs/msg/JointState]" in said


def test_without_ros_2_it_says_so(told: Told) -> None:
    told.env["PATH"] = "/usr/bin:/bin"
    status, outcomes, said = told.check()
    assert status == 2
    assert [*itertools.chain(*outcomes.values())] == []
    assert said == "ROS 2 is not set up in this shell: source /opt/ros/jazzy/setup.bash\n"


def test_a_program_that_hangs_is_interrupted(stage: Stage, tmp_path: Path) -> None:
    """With `PATIENCE` made short in a copy: 30 s are for real machines."""
    copy = tmp_path / "check.py"
    text = CHECK.read_text(encoding="utf-8").replace("PATIENCE = 30.0", "PATIENCE = 1.0")
    copy.write_text(text, encoding="utf-8")
    status, _, said = stage.run(copy, [("node list", "<wait>")], "--only", "node list")
    assert status == 1
    assert "FAIL      node list       ros2 node list --no-daemon --spin-time 3 did not end in 1 s" in said
    eventually(lambda: not stage.running())
