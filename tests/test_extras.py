"""hexwire without any extra, or with one: every command and every address says in one line what to install.

The environment has the package's own dependencies as links, and nothing else of this one.
"""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import distribution
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from packaging.requirements import Requirement
from tests.few import few

import hexwire
import zenoh_ros2
from hexwire.extras import EXTRAS

ROOT = Path(__file__).resolve().parent.parent
SOURCE = Path(hexwire.__file__).parent
KNOWN = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
OF_THE_SYSTEM = {"actionlib", "diagnostic_msgs", "rosgraph", "rospy", "sensor_msgs", "std_srvs", "trajectory_msgs"}
"""ROS 1; `hexwire.ros1.path` finds it."""

IMPORTS = re.compile(r"^ *(?:import|from) +(.+?)(?: +import .*)?$", re.MULTILINE)
"""What a line imports, or a line of text that looks like it."""

WORDS = {
    "goto": ("0", "220", "150"),
    "line": ("0", "220", "150"),
    "grip": ("open",),
    "ioctl": ("1", "--yes"),
    "move": ("J1=1",),
    "play": ("waypoints.json",),
    "pump": ("off",),
    "registers": ("J1",),
    "teach": ("new.json",),
    "torque": ("on",),
}
"""Arguments without which a command does nothing."""

NO_SHARED_ARM = {"bus", "demo", "loopback", "sim", "studio"}
"""They refuse one first, or need another extra before."""

NEED = {
    ("serve",): "fleet",
    ("serve", "--robot", "sim"): "fleet",
    ("serve", "--config", "none.toml"): "fleet",
    ("fleet", "list"): "fleet",
    ("fleet", "watch"): "fleet",
    ("fleet", "stop", "--all"): "fleet",
    ("fleet", "record", "x.mcap"): "fleet",
    ("fleet", "play", "score.toml"): "fleet",
    ("fleet", "router"): "fleet",
    ("studio", "--demo", "--no-browser"): "studio",
    ("cert", "new", "lab"): "tls",
    ("cert", "issue", "lab", "anna", "--role", "operator", "--for", "lab/*"): "tls",
    ("--port", "sim://hex7bot", "--record", "x.mcap", "state"): "record",
    ("--port", "sim://hex7bot", "goto", "0", "220", "150", "--plot", "x.png"): "plots",
    ("state", "--port", "mq:///a"): "mq",
    ("record", "plot", "waypoints.json", "x.png"): "plots",
    ("sim", "board", "--queue", "a"): "mq",
    ("sim", "board", "--physics"): "sim",
    ("record", "info", "old.mcap"): "record",
}
"""Commands -> the extra that they need."""

ADDRESSES = {
    "zenoh:lab/arm1": "fleet",
    "mq:///hexwire-a": "mq",
    "tcp://127.0.0.1:1": "",
    "tcps://127.0.0.1:1?ca=ca.pem": "",
    "udp://127.0.0.1:1": "",
    "serial:///dev/hexwire-none": "",
    "loop://a": "",
    "sim://hex7bot": "works",
    "sim://so101": "works",
    "sim://puma260": "",
    "ipc_msg.conf": "",
    "nonsense://a": "",
}
"""An address of every scheme -> the extra that it needs."""

PROGRAM = """
import contextlib, io, json, sys, traceback
import click, hexwire
from hexwire.cli.main import cli
from hexwire.errors import HexwireError

def leaves(group, context, path=()):
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, click.Group):
            yield from leaves(command, click.Context(command, info_name=name, parent=context), (*path, name))
        else:
            words = asked["words"].get(name) or ["1" for each in command.params if each.required]
            yield (*path, name), {each for param in command.params for each in param.opts}, words

def run(words):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            cli.main(list(words), prog_name="hexwire")
            status = 0
        except SystemExit as end:
            status = end.code
        except BaseException:
            status = None
            traceback.print_exc()
    return [words, status, err.getvalue()]

asked = json.load(sys.stdin)
found = {"commands": [], "help": [], "remote": [], "addresses": {}}
for path, options, words in leaves(cli, click.Context(cli)):
    found["help"].append(run([*path, "--help"]))
    if "--port" in options:
        found["remote"].append(run([*path, *words, "--port", "zenoh:lab/arm1"]))
for words in asked["commands"]:
    found["commands"].append(run(words))
for address in asked["addresses"]:
    try:
        hexwire.connect(address).detach()
    except HexwireError as error:
        found["addresses"][address] = str(error)
    except BaseException:
        found["addresses"][address] = traceback.format_exc()
    else:
        found["addresses"][address] = "works"
json.dump(found, sys.__stdout__)
"""


OWN_EXTRA = {
    "ros2": {
        ("hexwire-ros2", "--ros-args", "-p", "port:=zenoh:lab/arm1"): "fleet",
        ("hexwire", "state", "--port", "zenoh:lab/arm1"): "fleet",
        ("hexwire", "fleet", "list"): "fleet",
        ("hexwire", "serve", "--robot", "sim"): "fleet",
        ("hexwire", "--port", "sim://hex7bot", "--record", "x.mcap", "state"): "record",
        ("hexwire", "studio"): "studio",
    },
    "fleet": {
        ("hexwire", "fleet", "record", "x.mcap"): "record",
        ("hexwire", "studio"): "studio",
    },
    "studio": {("hexwire", "studio", "--demo", "--no-browser", "--camera", "all"): "camera"},
    "record": {
        ("hexwire", "record", "plot", "waypoints.json", "x.png"): "plots",
        ("hexwire-ros2",): "ros2",
        ("hexwire", "record", "ros2", "old.mcap", "bag"): "ros2",
    },
}
"""An extra -> commands of an environment that has only this one, and the extra that each needs besides."""

ONE_COMMAND = """
import sys
from hexwire.cli import __main__ as commands
name, *sys.argv[1:] = sys.argv[1:]
{"hexwire": commands.main, "hexwire-ros2": commands.ros2}[name]()
"""

STUDIO = """
import asyncio, json, sys, time
from hexwire.errors import HexwireError
from hexwire.studio.access import Access
from hexwire.studio.app import Studio

studio, limit = Studio(Access(frozenset())), time.monotonic() + 30
try:
    studio.source.open("zenoh:lab/arm1")
except HexwireError as error:
    opened = str(error)
studio.source.open("sim://hex7bot")
page = studio.arms()
while page["looking"] and time.monotonic() < limit:
    time.sleep(0.01)
    page = studio.arms()
found = {"opened": opened, "page": page}
calls = {"all": studio.stop_all, "own": studio.stop_own, "shared": lambda who: studio.fleet.stop(None, who)}
for name, call in calls.items():
    try:
        found[name] = [str(row) for row in asyncio.run(call("tab 1"))]
    except HexwireError as error:
        found[name] = str(error)
studio.close()
json.dump(found, sys.stdout)
"""


def closure(name: str, extra: str = "") -> set[str]:
    """A distribution with all that it requires, with one of its extras or without any."""
    found, new = set(), {name}
    while new:
        one = new.pop()
        found.add(one)
        for row in distribution(one).requires or ():
            requirement = Requirement(row)
            wanted = requirement.marker is None or requirement.marker.evaluate(
                {"extra": extra if one == name else ""}
            )
            if wanted and requirement.name.lower() not in found:
                new.add(requirement.name.lower())
    return found


def environment(folder: Path, extra: str = "") -> dict[str, str]:
    """The variables of an environment in a folder that has this extra only."""
    site = folder / "site"
    site.mkdir()
    for name in closure("hexwire", extra) - {"hexwire"}:
        files = distribution(name).files or ()
        for top in {Path(str(each)).parts[0] for each in files} - {"..", "__pycache__"}:
            # Some share a folder, such as that of Zope.
            if not (site / top).is_symlink():
                (site / top).symlink_to(Path(str(distribution(name).locate_file(top))))
    own = Path(str(distribution("hexwire")._path))  # type: ignore[attr-defined]  # there is no public name
    (site / own.name).symlink_to(own)
    (site / "hexwire").symlink_to(SOURCE)
    if "zenoh-ros2" in closure("hexwire", extra):
        (site / "zenoh_ros2").symlink_to(Path(zenoh_ros2.__file__).parent)
    (folder / "score.toml").write_text('[["lab/*"]]\n')
    (folder / "old.mcap").write_bytes(b"\x89MCAP0\r\n" * 2)
    (folder / "waypoints.json").write_text("[]")
    kept = {
        name: value for name, value in os.environ.items() if not name.startswith(("HEXWIRE_", "PYTHON", "XDG_"))
    }
    return kept | {"HOME": str(folder), "PYTHONPATH": str(site), "PYTHONDONTWRITEBYTECODE": "1"}


def run(
    folder: Path, variables: dict[str, str], program: str, *words: str, asked: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run a program without the packages of this environment."""
    return subprocess.run(
        [sys.executable, "-S", "-c", program, *words],
        input=asked,
        cwd=folder,
        env=variables,
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """What a program says without any extra."""
    folder = tmp_path_factory.mktemp("base")
    asked = json.dumps({"words": WORDS, "commands": [*NEED], "addresses": [*ADDRESSES]})
    done = run(folder, environment(folder), PROGRAM, asked=asked)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_it_has_no_extra() -> None:
    assert closure("hexwire") >= {"hexwire", "click", "pyserial", "rich"}
    assert not closure("hexwire") & {"msgspec", "eclipse-zenoh", "numpy", "cryptography"}


@pytest.mark.system
def test_every_command_explains_itself(said: Any) -> None:
    assert len(said["help"]) > 70
    assert [row for row in said["help"] if row[1] != 0] == []


@pytest.mark.system
def test_every_command_for_a_robot_says_what_a_shared_arm_needs(said: Any) -> None:
    assert len(said["remote"]) > 30
    wrong = [row for row in said["remote"] if row[1] not in (1, 2) or len(row[2].splitlines()) != 1]
    assert wrong == []
    other = {row[0][0] for row in said["remote"] if "pip install 'hexwire[fleet]'" not in row[2]}
    assert other == NO_SHARED_ARM


@pytest.mark.system
def test_every_command_that_needs_an_extra_names_it(said: Any) -> None:
    for (words, status, text), extra in zip(said["commands"], NEED.values(), strict=True):
        assert status in (1, 2), (words, text)
        assert len(text.splitlines()) == 1, (words, text)
        assert f"pip install 'hexwire[{extra}]'" in text, words


@pytest.mark.system
def test_every_address_names_the_extra_that_it_needs(said: Any) -> None:
    for address, extra in ADDRESSES.items():
        text = said["addresses"][address]
        assert len(text.splitlines()) == 1, (address, text)
        assert (text == "works") == (extra == "works"), (address, text)
        assert ("pip install" in text) == (extra not in ("", "works")), (address, text)
        assert not extra or extra == "works" or f"pip install 'hexwire[{extra}]'" in text


@pytest.mark.system
@few("extra", OWN_EXTRA, "ros2")
def test_with_one_extra_what_needs_another_one_names_it(extra: str, tmp_path: Path) -> None:
    variables = environment(tmp_path, extra)
    for words, needed in OWN_EXTRA[extra].items():
        done = run(tmp_path, variables, ONE_COMMAND, *words)
        said = done.stdout + done.stderr
        assert done.returncode in (1, 2), (words, said)
        assert len(said.splitlines()) == 1, (words, said)
        assert f"pip install 'hexwire[{needed}]'" in said, words


@pytest.mark.system
def test_the_node_of_ros_2_explains_itself_without_its_extra(tmp_path: Path) -> None:
    done = run(tmp_path, environment(tmp_path), ONE_COMMAND, "hexwire-ros2", "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert "start" in done.stdout
    assert "jazzy" in done.stdout


@pytest.mark.system
def test_a_studio_without_the_fleet_says_so_and_stops_its_own_arm(tmp_path: Path) -> None:
    variables = environment(tmp_path, "studio")
    # Sockets of shared arms have short addresses only.
    with TemporaryDirectory() as home:
        done = run(tmp_path, variables | {"HOME": home}, STUDIO)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    found = json.loads(done.stdout)
    remedy = "pip install 'hexwire[fleet]'"
    assert remedy in found["opened"]
    assert remedy in found["page"]["error"]
    assert not found["page"]["looking"]
    assert [row["own"] for row in found["page"]["arms"]] == [True]
    own, shared = found["all"]
    assert "stopped, limp: J1" in own
    assert shared.startswith("the shared arms: NOT CONFIRMED: ")
    assert remedy in shared
    assert "stopped, limp: J1" in found["own"][0]
    assert remedy in found["shared"]


def test_every_package_that_is_imported_is_of_the_base_or_of_an_extra() -> None:
    """Whatever is imported where: without it, `hexwire` says which extra has it."""
    used: set[str] = set()
    base = {"click", "rich", "serial", "hexwire", *OF_THE_SYSTEM, *sys.stdlib_module_names}
    for path in sorted(SOURCE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        # To parse all of the source takes seconds.
        named = {name.partition(".")[0] for line in IMPORTS.findall(text) for name in re.findall(r"[\w.]+", line)}
        if named <= {*base, ""}:
            continue
        for node in ast.walk(ast.parse(text)):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [each.name for each in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            packages = {name.partition(".")[0] for name in names} - base
            assert packages <= EXTRAS.keys(), f"{path}: of which extra is it? (hexwire/extras.py)"
            used |= packages
    assert EXTRAS.keys() == used
    assert set(EXTRAS.values()) <= KNOWN.keys()
