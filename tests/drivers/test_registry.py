from __future__ import annotations

import io
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.drivers.test_base import Guarded

from hexwire.drivers import registry
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.model.state import JointState


def test_the_hex7bot_is_there() -> None:
    assert "hex7bot" in registry.robot_names()
    assert registry.load_driver("hex7bot") is Hex7BotDriver


def test_an_unknown_robot_lists_the_known() -> None:
    with pytest.raises(UsageError, match=r"no robot 'r2d2'; installed are .*hex7bot"):
        registry.load_driver("r2d2")


def test_an_arm_on_a_servo_bus_loads_and_another_robot_is_refused() -> None:
    assert registry.load_bus_arm("so101") is registry.load_driver("so101")
    with pytest.raises(UsageError, match="puma260 is not an arm on a servo bus"):
        registry.load_bus_arm("puma260")


def test_connect_takes_the_port_given_then_that_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(registry.PORT_VARIABLE, "/dev/from-environment")
    with pytest.raises(LinkNotFoundError, match="from-environment"):
        registry.connect()
    with pytest.raises(LinkNotFoundError, match="given"):
        registry.connect("/dev/given")
    with pytest.raises(UsageError, match="no robot"):
        registry.connect("/dev/given", "r2d2")


def test_an_arm_that_is_traced_is_the_one_that_was_named(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[Any, ...]] = []

    def make(*given: Any, prepare: Any = None, **options: Any) -> Any:
        made.append((*given, options))
        return SimpleNamespace(attach=lambda: made.append(("attached",)))

    monkeypatch.setattr(registry, "make_driver", make)
    for trace in (None, io.StringIO()):
        registry.connect("/dev/given", "so101", trace=trace, overhead=0.1)
    assert made == [("/dev/given", "so101", {"overhead": 0.1}), ("attached",)] * 2


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"robot": 7}, "connect(robot) takes the name of a robot, as in 'so101'; this is 7"),
        ({"robot": Path("so101")}, "connect(robot) takes the name of a robot, as in 'so101'; this is PosixPath("),
        ({"trace": True}, "connect(trace) takes a stream of text, as in sys.stderr; this is True"),
        ({"trace": "log.txt"}, "connect(trace) takes a stream of text, as in sys.stderr; this is 'log.txt'"),
        ({"trace": io.BytesIO()}, "connect(trace) takes a stream of text, as in sys.stderr; this is <_io.BytesIO"),
        ({"baud": 9600, "attempts": 3}, "a Hex7BotDriver has no option attempts, baud"),
        ({"robot": "so101", "baud": 9600}, "an arm on a servo bus has no option baud"),
        ({"robot": "puma260", "baud": 9600}, "puma260 has no option baud"),
    ],
)
def test_connect_says_what_it_takes(given: dict[str, Any], text: str) -> None:
    with pytest.raises(UsageError) as told:
        registry.connect("/dev/given", **given)
    assert str(told.value).startswith(text)


@pytest.mark.parametrize("name", registry.robot_names())
def test_a_driver_under_observation_makes_robots_of_its_class(name: str) -> None:
    usual = registry.load_driver(name)
    watched = registry.observed(usual, lambda *_: None)
    robot = watched.from_url("tcp://127.0.0.1:9")
    assert type(robot) is watched
    assert isinstance(robot, usual)
    assert (watched.__name__, watched.__doc__) == (usual.__name__, usual.__doc__)


def test_an_observer_gets_every_state_that_the_robot_reads_and_no_other_robots() -> None:
    seen: list[tuple[RobotDriver, JointState]] = []
    robot, other = registry.observed(Guarded, lambda *each: seen.append(each))(), Guarded()
    state = robot.read()
    other.read()
    assert seen == [(robot, state)]
    with robot.watched(0.5):
        assert len(seen) == 2


@pytest.mark.parametrize(
    ("port", "robot"),
    [
        (None, "hex7bot"),
        ("/dev/ttyUSB0", "hex7bot"),
        ("sim://so101", "so101"),
        ("sim://so100?seed=3", "so100"),
        ("sim://so101/", "so101"),
        ("sim://hex7bot", "hex7bot"),
        ("sim://nothing", "hex7bot"),
        ("tcp://so101:1", "hex7bot"),
    ],
)
def test_an_emulated_arm_is_named_by_its_address(port: str | None, robot: str) -> None:
    assert registry.robot_at(port) == robot


def test_options_of_a_robot_reach_its_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, str, dict[str, object]]] = []

    class Recorded(Guarded):
        @classmethod
        def from_url(cls, port: str, **options: Any) -> Any:
            asked.append((cls.__name__, port, options))
            return cls()

    monkeypatch.setattr(registry, "load_driver", lambda name: Recorded)
    registry.make_driver("/dev/ttyUSB0", "swing", baud=9600, timeout=0.5)
    prepared = type("Prepared", (Recorded,), {})
    registry.make_driver("/dev/ttyUSB0", "swing", prepare=lambda driver: prepared)
    options = {"baud": 9600, "timeout": 0.5}
    assert asked == [("Recorded", "/dev/ttyUSB0", options), ("Prepared", "/dev/ttyUSB0", {})]
