"""The pages of ROS 2 say what is true: commands, files and tables, with emulated arms and a router of their own."""

from __future__ import annotations

import os
import re
import shlex
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
import zenoh
from tests.link.far_ends import free_port
from tests.ros2.strict_client.parameters import ParameterClient
from tests.ros2.strict_client.wire import Participant, router
from tests.ros2.strict_client.world import NODE, Arm, running
from tests.waits import until

pytestmark = pytest.mark.system

ROOT = Path(__file__).resolve().parents[2]
PAGE = "\n".join((ROOT / "docs" / page).read_text(encoding="utf-8") for page in ("ros2.md", "ros2-interface.md"))
BIN = Path(sys.executable).parent
WITNESSES = ROOT / "build" / "witnesses" / "bin"


def section(title: str) -> str:
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def blocks(text: str, kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def commands(title: str) -> list[str]:
    """The commands of a section; lines that are continued are one."""
    joined = "\n".join(blocks(section(title), "console")).replace("\\\n", " ")
    joined = re.sub(r"\n +", " ", joined)
    return [re.sub(r"\s+#.*$", "", line) for line in re.findall(r"^\$ (.*)$", joined, re.MULTILINE)]


class Shell:
    """Terminals on one machine, where 7447 is another port and every arm is emulated."""

    def __init__(self, folder: Path, port: int) -> None:
        clean = {name: text for name, text in os.environ.items() if not name.startswith(("ROS_", "ZENOH_"))}
        self.env = clean | {
            "PATH": f"{BIN}:{WITNESSES}:{os.environ['PATH']}",
            "HOME": str(folder),
            "XDG_RUNTIME_DIR": str(folder),
            "GIT_PYTHON_REFRESH": "quiet",
        }
        self.folder = folder
        self.port = port
        self._running: list[subprocess.Popen[str]] = []

    def words(self, command: str) -> tuple[list[str], dict[str, str]]:
        words = shlex.split(re.sub(r"port:=/dev/\S+", "port:=sim://hex7bot", command))
        env = dict(self.env)
        while "=" in words[0]:
            name, _, text = words.pop(0).partition("=")
            env[name] = text
        at = f"127.0.0.1:{self.port}"
        if words[0] == "hexwire-ros2" and "ZENOH_SESSION_CONFIG_URI" not in env:
            env["ZENOH_CONFIG_OVERRIDE"] = f'connect/endpoints=["tcp/{at}"]'
        if words[:3] == ["hexwire", "fleet", "router"] and "--listen" not in words:
            words += ["--listen", f"tcp/{at}"]
        if words[0] == "zenoh-ros2":
            words[1:1] = ["--router", at]
        return [word.replace("0.0.0.0:7447", at) for word in words], env

    def run(self, command: str) -> str:
        words, env = self.words(command)
        done = subprocess.run(
            words, cwd=self.folder, env=env, capture_output=True, text=True, timeout=100, check=False
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
        return done.stdout

    def start(self, command: str) -> None:
        words, env = self.words(command)
        with (self.folder / "said").open("a") as said:
            self._running.append(
                subprocess.Popen(
                    words, cwd=self.folder, env=env, stdin=subprocess.DEVNULL, stdout=said, stderr=said, text=True
                )
            )

    def close(self) -> None:
        for process in reversed(self._running):
            process.terminate()
        for process in self._running:
            try:
                process.wait(30)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait(30)


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    made = Shell(tmp_path, free_port())
    try:
        yield made
    finally:
        print((tmp_path / "said").read_text() if (tmp_path / "said").exists() else "")
        made.close()


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Arm]:
    poses = ("poses.home.J1:=0.0", "publish_tf:=true")
    with running(tmp_path_factory.mktemp("page"), *poses) as (port, node), Participant(port) as me:
        yield Arm(me, port, node)


# --- five minutes ---


@pytest.mark.slow
def test_five_minutes_without_ros(shell: Shell) -> None:
    install, router, node, topics, services = commands("Five minutes without ROS")
    assert install == "pip install '.[ros2]' ./packages/zenoh-ros2 zenoh-ros2-sdk"
    shell.start(router)
    shell.start(node)
    # `zenoh-ros2` asks once, and may miss what has not come yet.
    until(lambda: "/joint_states [sensor_msgs/msg/JointState]" in shell.run(topics), "the topics are listed")
    until(lambda: "/hardware_interface/stop [std_srvs/srv/Trigger]" in shell.run(services), "and the services")


def test_names_and_types_of_the_commands_of_ros_exist(arm: Arm) -> None:
    tokens = arm.me.graph.tokens(full_node=NODE)
    types = {token.topic: token.type.replace("::dds_", "").replace("::", "/").rstrip("_") for token in tokens}
    lines = commands("Five minutes with ROS")
    called = [shlex.split(line)[3:5] for line in lines if line.startswith("ros2 service call")]
    assert len(called) == 2
    assert all(types[name] == kind for name, kind in called)
    (goal,) = [shlex.split(line) for line in lines if line.startswith("ros2 action send_goal")]
    name, kind = goal[4:6]
    assert types[f"{name}/_action/send_goal"] == f"{kind}_SendGoal"
    (echoed,) = [line.split()[-1] for line in lines if line.startswith("ros2 topic hz")]
    assert echoed in types


def test_the_goal_of_the_page_succeeds(arm: Arm) -> None:
    (line,) = [line for line in commands("Five minutes with ROS") if "send_goal" in line]
    goal = yaml.safe_load(shlex.split(line)[-1])
    arm.rest()
    made = arm.send(goal)
    assert made.result().status == 4


def test_the_script_of_the_page_exists() -> None:
    for command in commands("Check it"):
        words = command.split()
        assert (ROOT / words[1]).is_file()
        done = subprocess.run(
            [sys.executable, ROOT / words[1], "--help"], capture_output=True, text=True, check=True
        )
        assert all(option in done.stdout for option in words[2:])


# --- MoveIt, several arms, certificates ---


def test_the_package_has_what_the_page_starts(shell: Shell) -> None:
    (made,) = commands("MoveIt, rviz2 and ros2_control")[:1]
    shell.run(made)
    package = shell.folder / "src" / "hexwire_hex7bot"
    for command in commands("MoveIt, rviz2 and ros2_control")[2:]:
        _, _, name, file, *arguments = command.split()
        text = (package / "launch" / file).read_text()
        assert f'PACKAGE = "{name}"' in text
        assert all(f'"{argument.partition(":=")[0]}"' in text for argument in arguments)
    assert (package / "README.md").is_file()


@pytest.mark.slow
def test_several_arms(shell: Shell) -> None:
    with router(shell.port), Participant(shell.port) as me, Participant(shell.port, domain=7) as seventh:
        for command in commands("Several arms"):
            shell.start(command)
        for name in ("/left/joint_states", "/right/js"):
            me.graph.one(kind="MP", topic=name, patience=60)
        seventh.graph.one(kind="MP", topic="/joint_states", patience=60)
        absolute = {t.topic for t in me.graph.tokens(kind="MP") if not t.topic.startswith(("/left", "/right"))}
        assert absolute <= {"/rosout", "/diagnostics", "/tf", "/tf_static", "/parameter_events"}


@pytest.mark.slow
def test_between_machines_with_certificates(shell: Shell) -> None:
    *make, start = commands("Between machines, with certificates")[:4]
    for command in make:
        shell.run(command.replace("--host lab-pc", "--host localhost"))
    shell.start(start)
    (text,) = blocks(section("Between machines, with certificates"), "json5")
    text = text.replace("lab-pc:7447", f"localhost:{shell.port}")
    for file in ("ca.pem", "ros-pc.pem", "ros-pc.key"):
        text = text.replace(f'"{file}"', f'"{shell.folder / "lab" / file}"')
    config = shell.folder / "session.json5"
    config.write_text(text)
    shell.env["ZENOH_SESSION_CONFIG_URI"] = str(config)
    shell.start(commands("Between machines, with certificates")[-1])
    # rmw_zenoh_cpp with the same file.
    until(lambda: listens(shell.port), "the router listens")
    with Participant(shell.port, config=zenoh.Config.from_file(str(config))) as me:
        me.graph.one(kind="SS", topic=f"{NODE}/reset", patience=60)
        me.subscribe("/joint_states", "sensor_msgs/msg/JointState").take()
        assert me.client(f"{NODE}/reset", "std_srvs/srv/Trigger").call().success


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_parameters_of_a_file(shell: Shell) -> None:
    (text,) = blocks(section("Parameters"), "yaml")
    (command,) = commands("Parameters")
    (shell.folder / "arm.yaml").write_text(text.replace("/dev/ttyUSB0", "sim://hex7bot"))
    with router(shell.port), Participant(shell.port) as me:
        shell.start(command)
        me.graph.one(kind="SS", topic=f"{NODE}/get_parameters", patience=60)
        me.graph.one(kind="SS", topic=f"{NODE}/go_to/home", patience=60)
        parameters = ParameterClient(me, NODE)
        assert parameters.get_all(["publish_rate", "constraints.goal_time", "constraints.J1.goal"]) == [
            50.0,
            2.0,
            0.05,
        ]


# --- names and words ---


def table(title: str) -> list[list[str]]:
    rows = [line.strip("| ").split(" | ") for line in section(title).splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in row] for row in rows[1:]]


def expanded(name: str) -> str:
    name = name.replace("CONTROLLER", "joint_trajectory_controller").replace("POSE", "home")
    return re.sub("^~", NODE, name) if name.startswith(("~", "/")) else f"/{name}"


def test_the_table_has_every_name_of_the_node_with_its_type(arm: Arm) -> None:
    types = {token.topic: token.type for token in arm.me.graph.tokens(full_node=NODE)}
    told, seen = {"/tf", "/tf_static"}, 0
    for names, kind, _ in table("Topics, services, actions"):
        for name in re.findall(r"`(\S+)`", names):
            full = expanded(name)
            if kind.startswith("action "):
                found = types[f"{full}/_action/send_goal"].replace("_SendGoal", "")
            else:
                found = types[full]
            package, _, leaf = kind.removeprefix("action ").partition("/")
            assert found.startswith(f"{package}::"), name
            assert found.endswith(f"::{leaf}_") or not leaf, name
            seen += 1
            told.add(full)
    assert seen == 25
    standard = {"available_states", "available_transitions", "transition_graph", "parameters", "parameter_types"}
    rest = []
    for token in arm.me.graph.tokens(full_node=NODE):
        own = token.topic.partition("/_action/")[0]
        leaf = re.sub("^(get|set|list|describe)_", "", own.rpartition("/")[2])
        if token.kind != "NN" and own not in told and leaf not in standard | {"parameters_atomically"}:
            rest.append(token.topic)
    assert rest == []


def test_words_in_code_are_names_of_the_node(arm: Arm) -> None:
    said = set(re.findall(r"`(?:-p )?([a-z_]{8,})(?::=\w+)?`", PAGE))
    parameters = set(arm.parameters.list().names)
    topics = {token.topic.rpartition("/")[2] for token in arm.me.graph.tokens()}
    known = (
        parameters | topics | {"distribution", "poses", "controllers", "allowed_start_tolerance", "use_sim_time"}
    )
    others = {
        "hardware_interface", "rmw_zenoh", "rmw_zenohd", "rmw_zenoh_cpp", "robot_state_publisher", "send_goal",
        "topic_based_ros2_control", "joint_state_topic_hardware_interface", "joint_trajectory_controller",
    }  # fmt: skip
    assert said
    assert said - known - others == set()


def test_messages_of_the_page_are_those_of_the_program() -> None:
    rooms = ["packages/zenoh-ros2/src", *(f"src/hexwire/{room}" for room in ("ros2", "control", "cli"))]
    files = [path.read_text(encoding="utf-8") for room in rooms for path in (ROOT / room).rglob("*.py")]
    for words in (
        "Unable to connect to a Zenoh router",
        "the arm is stopped (",
        "no torque on ",
        "incompatible QoS",
    ):
        assert words in section("Troubleshooting"), words
        assert any(words in text for text in files), words


def test_it_says_what_no_ros_2_has_seen() -> None:
    assert "**No whole ROS 2 installation has seen this node yet" in PAGE
