"""Another robot than `--robot` says behind a real port: one line that names it, at every kind of address."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest
from click.testing import CliRunner

from hexwire.cli.main import cli
from hexwire.drivers import registry
from hexwire.errors import WrongDeviceError

# tests/cli/test_wrong_device.py proves what is said, in simulated time.
pytestmark = [pytest.mark.system, pytest.mark.slow]

HEXWIRE = (sys.executable, "-m", "hexwire.cli")


@contextmanager
def serving(*words: str, addresses: int = 1) -> Iterator[list[str]]:
    """An emulated device in a process of its own, and what it offers."""
    program = subprocess.Popen([*HEXWIRE, "sim", *words], stdout=subprocess.PIPE, text=True)
    try:
        assert program.stdout is not None
        yield [program.stdout.readline().strip() for _ in range(addresses)]
    finally:
        program.terminate()
        program.communicate()


@pytest.fixture(scope="module")
def there() -> Iterator[dict[str, list[str]]]:
    """Addresses of each robot."""
    with ExitStack() as stack:
        puma = ("puma260", "--tcp", "127.0.0.1:0", "--udp", "127.0.0.1:0")
        yield {
            "puma260": stack.enter_context(serving(*puma, addresses=2)),
            "hex7bot": [
                *stack.enter_context(serving("board", "--tcp", "127.0.0.1:0")),
                *stack.enter_context(serving("board")),
            ],
            "so101": [
                *stack.enter_context(serving("bus", "--tcp", "127.0.0.1:0")),
                *stack.enter_context(serving("bus")),
            ],
        }


@pytest.mark.parametrize("robot", ["hex7bot", "puma260", "so101"])
def test_another_robot_is_named(robot: str, there: dict[str, list[str]]) -> None:
    asked = 0
    for other, urls in there.items():
        for url in urls if other != robot else ():
            with pytest.raises(WrongDeviceError, match=rf"--robot {other}") as info:
                registry.connect(url, robot)
            assert url in str(info.value)
            asked += 1
    assert asked >= 3


@pytest.mark.parametrize("robot", ["hex7bot", "so101"])
def test_behind_a_queue_too(robot: str) -> None:
    # Not there longer than needed: the system has room for few queues.
    words = ("puma260", "--tcp", "127.0.0.1:0", "--queue", f"hexwire-wrong-{os.getpid()}")
    with (
        serving(*words, addresses=2) as urls,
        pytest.raises(WrongDeviceError, match=r"^mq:.* is a puma260, not .*: use --robot puma260"),
    ):
        registry.connect(urls[1], robot)


def test_the_command_says_it_in_one_line(there: dict[str, list[str]]) -> None:
    for robot, other in (("puma260", "hex7bot"), ("hex7bot", "puma260"), ("so101", "puma260")):
        done = CliRunner().invoke(cli, ["--robot", robot, "state", "--port", there[other][0]])
        said = [line for line in done.stderr.splitlines() if not line.startswith("warning: ")]
        assert (done.exit_code, len(said)) == (1, 1), done.stderr
        assert re.fullmatch(rf"error: {there[other][0]} is .*, not .*: use --robot {other}.*", said[0])
