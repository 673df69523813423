"""Nobody outside the drivers asks a robot what it is: what it can do is on `RobotDriver`."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from hexwire.drivers.base import RobotDriver
from hexwire.drivers.registry import load_driver, robot_names

SRC = Path(__file__).parents[2] / "src" / "hexwire"
# The emulator's boards are no drivers, and speak a dialect each; the other rooms know no robot.
ROOMS = ("control", "setup", "ros1", "ros2", "fleet", "studio", "cli")
ROBOTS = {"robot", "driver", "arm", "board", "probe", "report"}
KINDS = {"RobotDriver", "SessionDriver", "Board", "Board1", "Board2"}


def _kinds(kind: type) -> Iterator[str]:
    yield kind.__name__
    for below in kind.__subclasses__():
        yield from _kinds(below)


def _name(node: ast.expr) -> str:
    """The last name of an expression, without an underscore before it: `robot` of `self._robot`."""
    text = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
    return text.lstrip("_")


def _decides(node: ast.AST) -> Iterator[ast.AST]:
    """The expressions by which a program goes one way or the other."""
    if isinstance(node, ast.Compare):
        yield node
    elif isinstance(node, ast.If | ast.IfExp | ast.While):
        yield node.test
    elif isinstance(node, ast.Subscript):
        yield node.slice
    elif isinstance(node, ast.Match):
        yield node.subject
    elif isinstance(node, ast.BoolOp):
        yield from node.values


def faults(text: str) -> set[str]:
    for name in robot_names():
        load_driver(name)
    kinds = KINDS | set(_kinds(RobotDriver))
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) >= 2:
            asks, whom, what = node.func.id, node.args[0], node.args[1]
            if asks in {"hasattr", "getattr"} and _name(whom) in ROBOTS:
                found.add(f"{asks} of {_name(whom)}")
            if (
                asks in {"isinstance", "issubclass"}
                and {_name(n) for n in ast.walk(what) if isinstance(n, ast.expr)} & kinds
            ):
                found.add(f"{asks} of {_name(whom)}")
        if isinstance(node, ast.Attribute) and node.attr in {"session", "sessions"} and _name(node.value) in ROBOTS:
            found.add(f"{node.attr} of {_name(node.value)}")
        for test in _decides(node):
            for part in ast.walk(test):
                if isinstance(part, ast.Attribute) and part.attr == "dialect" and _name(part.value) in ROBOTS:
                    found.add(f"decides by {_name(part.value)}.dialect")
    return found


@pytest.mark.slow
def test_no_front_asks_a_robot_what_it_is() -> None:
    assert faults("") == set()
    assert {"BusArm", "So101Arm", "Hex7BotDriver", "Puma260Driver"} <= set(_kinds(RobotDriver))
    found = {
        f"{path.relative_to(SRC)}: {fault}"
        for room in ROOMS
        for path in sorted((SRC / room).rglob("*.py"))
        for fault in faults(path.read_text(encoding="utf-8"))
    }
    assert found == set(), "ask for what it can do: see hexwire.drivers.base"


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("hasattr(robot, 'stream')", "hasattr of robot"),
        ("getattr(self._robot, 'ping', None)", "getattr of robot"),
        ("isinstance(x, BusArm)", "isinstance of x"),
        ("isinstance(x, (int, bus_arm.So101Arm))", "isinstance of x"),
        ("issubclass(kind, Hex7BotDriver)", "issubclass of kind"),
        ("self.robot.session.now()", "session of robot"),
        ("if probe.dialect == 1: pass", "decides by probe.dialect"),
        ("a = 1 if report.dialect else 2", "decides by report.dialect"),
        ("a = RATES[robot.dialect]", "decides by robot.dialect"),
    ],
)
def test_the_rule_sees(line: str, fault: str) -> None:
    assert faults(line) == {fault}


@pytest.mark.parametrize(
    "line",
    [
        "print(f'dialect {probe.dialect}')",
        "getattr(file, 'name', None)",
        "isinstance(arm, Hex7BotModel)",
        "options.dialect == 1",
    ],
)
def test_the_rule_lets_pass(line: str) -> None:
    assert faults(line) == set()
