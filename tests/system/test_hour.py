"""An hour around a shared arm: server, studio, node and recorder run on, while a client and a page come and go.

In real time, since programs, their threads and the kernel's buffers show only so what they keep. `make soak` takes
the hour, otherwise there are two visits. Then no program holds more than before, nothing is left over, and the
recording has every state.
"""

from __future__ import annotations

import contextlib
import json
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from types import SimpleNamespace
from typing import Any

import pytest
from tests.soak import SOAK, rounds
from tests.studio.running import Visitor
from tests.system.fleet_programs import NAME, Program, Scene
from tests.system.fleet_watch import TIMEOUT
from tests.system.programs import PATIENCE
from tests.waits import eventually
from zenoh_ros2_tests.router import Router

from hexwire.trace.capture import read_messages
from hexwire.trace.mcap_file import McapIndex
from hexwire.trace.recording import topic_of

pytestmark = [pytest.mark.system, pytest.mark.soak, pytest.mark.slow, pytest.mark.timeout(rounds(300, 5400))]

VISITS = rounds(2, 60)
MINUTE = 60.0
WARM, WINDOW = 15, 10
"""Visits after which each program has its size (the studio keeps ten minutes of states), and how many count."""
FLAT = 1.02
INDEX = 680e-6
"""MB of each part of a recording: the package mcap keeps where it is for the index at the end of the file."""
FRAMES = 20


class Watched:
    """A program that is to stay as it is.

    Attributes:
        memory: MB after each visit.
        held: Threads and open files after each visit.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        self.memory: list[float] = []
        self.held: list[tuple[int, ...]] = []

    def look(self) -> None:
        at = Path(f"/proc/{self.program.process.pid}")
        self.memory.append(round(self.program.memory() / 1e6, 1))
        self.held.append(tuple(len(list((at / what).iterdir())) for what in ("task", "fd")))

    def check(self, grows: float) -> None:
        """In the last minutes it holds no more than in the first ones with its size, and MB that it may grow by."""
        first, last = slice(WARM, WARM + WINDOW), slice(-WINDOW, None)
        assert median(self.memory[last]) <= FLAT * median(self.memory[first]) + grows, self.memory
        assert max(self.held[last]) <= max(self.held[first]), self.held


class Hour:
    """The programs, and what a visit does."""

    def __init__(self, scene: Scene, endpoint: str) -> None:
        self.scene, self.file = scene, scene.folder / "hour.mcap"
        server = scene.serve()
        recorder = scene.begin("fleet", "record", str(self.file), "--json")
        eventually(lambda: f"{NAME} recorded" in scene.errors())
        port = f"zenoh:{NAME}"
        studio = scene.begin(
            "studio", "--port", port, "--no-browser", "--recordings", str(scene.folder / "recordings")
        )
        url, _, self._token = studio.line().partition(": ")[2].strip().partition("/move?token=")
        self._page: Any = SimpleNamespace(url=url)
        node = scene.begin(
            *("--ros-args", "-p", f"port:={port}"),
            program=[str(Path(sys.executable).with_name("hexwire-ros2"))],
            extra={"ZENOH_CONFIG_OVERRIDE": f"connect/endpoints={json.dumps([endpoint])}"},
        )
        eventually(lambda: "is ready at" in scene.errors())
        # In the order in which they end.
        programs = {"recorder": recorder, "node": node, "studio": studio, "server": server}
        self.watched = {name: Watched(program) for name, program in programs.items()}

    def visit(self, number: int) -> None:
        """A client takes the arm, moves it and goes, every second one by being killed; a page is looked at."""
        client = self.scene.client()
        client.do("take")
        client.do("resume")
        client.do("torque", True)
        before = self.scene.position(0)
        client.do("move", 1.0, J1=-0.3 if number % 2 else 0.3)
        eventually(lambda: abs(self.scene.position(0) - before) > 10)
        if number % 2:
            client.kill()
            # The next one may take the arm when the lease has ended with the silence.
            time.sleep(2 * TIMEOUT)
        else:
            client.do("release", finish=True)
            client.do("close")
        client.end()
        visitor = Visitor(self._page, self._token)
        with visitor.socket(f"/live?tab={visitor.page()}") as live:
            frames = 0
            while frames < FRAMES:
                frames += isinstance(live.recv(timeout=PATIENCE), bytes)

    def look(self) -> None:
        """Note what each program holds."""
        for watched in self.watched.values():
            assert watched.program.process.poll() is None, self.scene.errors()[-2000:]
            watched.look()
        print({name: (watched.memory[-1], *watched.held[-1]) for name, watched in self.watched.items()}, flush=True)

    def end(self) -> dict[str, Any]:
        """End all programs as a person does; returns what the recorder said of the arm."""
        said = {}
        for name, watched in self.watched.items():
            process = watched.program.process
            process.send_signal(signal.SIGINT)
            assert process.stdout is not None
            said[name] = process.stdout.read()
            assert process.wait(PATIENCE) in (0, 130), (name, process.returncode)
        (row,) = json.loads(said["recorder"])["arms"]
        return dict(row)

    def left(self) -> list[str]:
        """Files of programs that have ended, and processes that they have begun."""
        files = [path.name for path in (self.scene.folder / "run").rglob("*") if not path.is_dir()]
        sessions = {watched.program.process.pid for watched in self.watched.values()}
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):  # it has just ended
                name, _, rest = stat.read_text().rpartition(")")
                files += [name] if int(rest.split()[3]) in sessions else []
        return files

    def parts(self) -> int:
        """Parts of the recording."""
        with self.file.open("rb") as data:
            return len(McapIndex(data, "hour").parts(topic_of(NAME)))

    def numbers(self) -> list[int]:
        """The server's number of each state in the recording."""
        with self.file.open("rb") as data:
            rows = (row for row in read_messages(data, "hour") if not isinstance(row, str))
            return [json.loads(row.data)["owner"]["sequence"] for row in rows if row.topic == topic_of(NAME)]


@pytest.fixture
def hour() -> Iterator[Hour]:
    router = Router()
    try:
        with tempfile.TemporaryDirectory(prefix="hw-", dir="/tmp") as name, Scene(Path(name)) as scene:
            yield Hour(scene, router.endpoint)
    finally:
        router.stop()


def test_after_an_hour_everything_is_as_it_was(hour: Hour) -> None:
    begun = time.monotonic()
    for number in range(VISITS):
        hour.visit(number)
        if SOAK:
            time.sleep(max(0.0, begun + (number + 1) * MINUTE - time.monotonic()))
        hour.look()
    row, numbers = hour.end(), hour.numbers()
    print(f"{len(numbers)} states in {hour.parts()} parts, {row}")
    # The file whose lock is a name stays: if it were removed, two servers could have one name.
    assert hour.left() == ["lab+arm1.name"]
    assert row["states"] == len(numbers)
    assert numbers == sorted(set(numbers))
    # A busy machine may lose a state, as the recorder says. What tells of no joints has a number, too.
    assert row["lost"] <= numbers[-1] - numbers[0] + 1 - len(numbers)
    hour.scene.check()
    if SOAK:
        assert row["lost"] == 0
        since = (VISITS - WARM - WINDOW) / VISITS
        for name, watched in hour.watched.items():
            watched.check(INDEX * hour.parts() * since if name == "recorder" else 0.0)
