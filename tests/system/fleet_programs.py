"""Real programs around a shared arm: the watched board, the server, clients, each to be killed or stopped.

Owns their start and end, and where they run. Ends only what it has started.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

from tests.system.fleet_watch import TIMEOUT, BoardLog, ClientLog, Span, violations
from tests.system.programs import HEXWIRE, PATIENCE, environment
from tests.waits import eventually

ROOT = Path(__file__).resolve().parent.parent.parent
NAME = "lab/arm1"
STOPPED = 3.0
"""Seconds for which a program stays stopped that must miss something: far more than `TIMEOUT` of its lease."""
_AGE, _STALL = re.compile(r"the set-point is (\d+) ms old"), 1000
"""How old a refused set-point was, and the age up to which that is a stall, milliseconds."""


class Program:
    """A program with pipes to its input and output; its errors go to a file.

    Args:
        words: Command line.
        errors: File for its errors.
        where: What starts it in another place, such as ``ip netns exec``.
        extra: Further variables of its environment.
    """

    def __init__(
        self, words: Sequence[str], errors: Path, where: Sequence[str] = (), extra: dict[str, str] | None = None
    ) -> None:
        self.errors = errors
        with errors.open("ab") as file:
            self.process = subprocess.Popen(
                [*where, *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=file,
                text=True,
                env=environment() | (extra or {}),
                cwd=ROOT,
                start_new_session=True,
            )

    def line(self) -> str:
        """Its next line."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, f"{self.process.args}: {self.errors.read_text()[-2000:]}"
        return line.strip()

    @property
    def input(self) -> IO[str]:
        assert self.process.stdin is not None
        return self.process.stdin

    def kill(self) -> float:
        """End it by SIGKILL; returns when."""
        self.process.kill()
        self.process.wait(PATIENCE)
        return time.monotonic()

    @contextmanager
    def stopped(self) -> Iterator[float]:
        """SIGSTOP it during the block; yields from when on it does nothing."""
        self.process.send_signal(signal.SIGSTOP)
        try:
            # A thread that is at work stops when it is interrupted next.
            eventually(lambda: set(self._states()) == {"T"})
            yield time.monotonic()
        finally:
            self.process.send_signal(signal.SIGCONT)

    def _states(self) -> list[str]:
        """What each of its threads does, as Linux says it."""
        found = []
        for task in Path(f"/proc/{self.process.pid}/task").glob("*/stat"):
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has just ended
                found.append(task.read_text().rpartition(")")[2].split()[0])
        return found

    def cpu(self) -> float:
        """Seconds of processor time so far."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def memory(self) -> int:
        """Bytes that it occupies."""
        pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE")

    def terminate(self) -> None:
        """End it as a person would; by force if it does not. Its output can still be read."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
            try:
                self.process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self.process.wait(PATIENCE)

    def end(self) -> None:
        """As `terminate`, and close its pipes."""
        self.terminate()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()


class ClientProgram(Program):
    """A `fleet_client`."""

    def ask(self, name: str, *args: object, **named: object) -> dict[str, Any]:
        """Have it do something; returns the answer, with `value` or `error` and `text`."""
        self.send(name, *args, **named)
        return self.answer()

    def send(self, name: str, *args: object, **named: object) -> None:
        """As `ask`, without waiting."""
        self.input.write(json.dumps([name, args, named]) + "\n")
        self.input.flush()

    def answer(self) -> dict[str, Any]:
        """The next answer."""
        return dict(json.loads(self.line()))

    def do(self, name: str, *args: object, **named: object) -> Any:
        """Have it do something that must succeed; returns the value."""
        answer = self.ask(name, *args, **named)
        assert "error" not in answer, (name, answer)
        return answer["value"]


class Scene:
    """The programs around one arm, in a folder of their own. Use as context manager.

    Args:
        folder: Short, for the paths of sockets.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cuts: list[Span] = []
        self.others: list[Span] = []
        self._stack = ExitStack()
        self._logs: list[ClientLog] = []
        self._board = BoardLog(folder / "board.log")
        self._checked = -math.inf
        self._runtime = {"XDG_RUNTIME_DIR": str(folder / "run"), "XDG_STATE_HOME": str(folder / "state")}

    def __enter__(self) -> Scene:
        with ExitStack() as stack:
            self._stack = stack
            self.board = self._program(
                [sys.executable, "-m", "tests.system.watched_board", str(self._log("board"))]
            )
            self.port = self.board.line()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def serve(
        self, *words: str, where: Sequence[str] = (), port: str = "", extra: dict[str, str] | None = None
    ) -> Program:
        """Start `hexwire serve`; returns when it says that it shares the arm."""
        words = ("--port", port or self.port, "--name", NAME, "--lease", str(TIMEOUT), *words)
        server = self.begin("serve", *words, where=where, extra=extra)
        server.line()
        return server

    def begin(
        self,
        *words: str,
        where: Sequence[str] = (),
        extra: dict[str, str] | None = None,
        program: Sequence[str] = HEXWIRE,
    ) -> Program:
        """Start a command of hexwire, or another program of it."""
        return self._program([*program, *words], where, extra)

    def client(
        self,
        options: str = "",
        where: Sequence[str] = (),
        extra: dict[str, str] | None = None,
        *,
        attach: bool = True,
    ) -> ClientProgram:
        """Start a client; it is connected unless `attach` is False."""
        log = self._log(f"client{len(self._logs)}")
        log.touch()
        self._logs.append(ClientLog(log, len(self._logs)))
        words = [sys.executable, "-m", "tests.system.fleet_client", f"zenoh:{NAME}{options}", str(log)]
        client = self._started(ClientProgram(words, self._log("errors"), where, self._runtime | (extra or {})))
        assert client.line() == "ready"
        if attach:
            client.do("connect")
        return client

    def rows(self, client: int | None = None) -> list[dict[str, Any]]:
        """What the clients wrote down so far; of one of them, in the order of their start."""
        logs = self._logs if client is None else [self._logs[client]]
        return [row for log in logs for row in log.read()]

    def refused(self, since: float, until: float = math.inf, client: int | None = None) -> list[dict[str, Any]]:
        """Set-points of a stream that were refused in a time, of one client or of all.

        Without those that were late because the machine stalled, by less than a fault here would delay them.
        """
        rows = [row for row in self.rows(client) if row["e"] == "refused" and since < row["t"] < until]
        return [row for row in rows if not ((age := _AGE.search(row["text"])) and int(age[1]) < _STALL)]

    def states(self, since: float, client: int = 0) -> list[dict[str, Any]]:
        """The states that a client has received since a time."""
        return [row for row in self.rows(client) if row["e"] == "state" and row["t"] > since]

    def lost(self, since: float, client: int = 0) -> list[dict[str, Any]]:
        """Why a client that waited for a state since a time got an error."""
        return [row for row in self.rows(client) if row["e"] == "lost" and row["t"] > since]

    def check(self) -> None:
        """Check the promises on everything since the start."""
        assert self.board.process.poll() is None
        end = time.monotonic()
        time.sleep(0.05)
        found = violations(self._board.read(), self.rows(), end, self.cuts, self.others, self._checked)
        self._checked = end
        assert not found, "\n".join(found[:10])

    def errors(self) -> str:
        """What the programs wrote to their standard errors."""
        return self._log("errors").read_text()

    def second_board(self) -> str:
        """Another board, which nobody watches; returns its port."""
        return self._program([sys.executable, "-m", "tests.system.watched_board", os.devnull]).line()

    def position(self, number: int) -> float:
        """Where a servo is, in counts, as its log says."""
        return self._board.read()[number].positions[-1]

    def resting(self, number: int) -> float:
        """As `position`, when the servo has come to rest."""
        seen = [math.nan]

        def rests() -> bool:
            seen.append(self.position(number))
            time.sleep(0.3)
            return self.position(number) == seen[-1]

        eventually(rests)
        return seen[-1]

    def _program(
        self, words: Sequence[str], where: Sequence[str] = (), extra: dict[str, str] | None = None
    ) -> Program:
        return self._started(Program(words, self._log("errors"), where, self._runtime | (extra or {})))

    def _started(self, program: Any) -> Any:
        self._stack.callback(program.end)
        return program

    def _log(self, name: str) -> Path:
        return self.folder / f"{name}.log"


class Lab(Scene):
    """A scene with a server, an operator and a reader, each started again when it is gone."""

    server: Program
    operator: ClientProgram
    reader: ClientProgram

    def start_server(self) -> Program:
        return self.serve()

    def start_client(self, name: str) -> ClientProgram:
        return self.client()

    def begin_all(self) -> None:
        """Have all three, and an arm without stop, holder and motion."""
        if not hasattr(self, "server") or self.server.process.poll() is not None:
            self.server = self.start_server()
        if not hasattr(self, "reader"):
            self.reader = self.start_client("rd")
            self.reader.do("watch")
        if not hasattr(self, "operator") or self.operator.process.poll() is not None:
            self.operator = self.start_client("op")
        # All three again if the lease is lost in between, as on a machine that stalls.
        steps: tuple[tuple[str, dict[str, bool]], ...] = (
            ("take", {"force": True}),
            ("resume", {}),
            ("torque", {"on": True}),
        )
        eventually(lambda: all("error" not in self.operator.ask(name, **named) for name, named in steps))

    def last(self, kind: str = "state", client: int = 0) -> dict[str, Any]:
        """The last row of a kind, of the reader or of another client."""
        return next((row for row in reversed(self.rows(client)) if row["e"] == kind), {})

    def swinging(self) -> None:
        """The operator sends set-points from now on; returns when the arm moves."""
        before = self.position(0)
        self.operator.do("stream", 20.0, J1=0.3)
        eventually(lambda: abs(self.position(0) - before) > 10)

    def setting_out(self, operator: ClientProgram | None = None) -> float:
        """Set out for a far target, and wait until the arm moves; returns where its first servo was."""
        before = self.position(0)
        (operator or self.operator).do("move", 6.0, J1=-0.7 if before > 2300 else 0.7)
        eventually(lambda: abs(self.position(0) - before) > 10)
        return before
