"""Runs the tests of a room in its copy under build/mutants, for tests/mutation.py: `python mutation_run.py ORDERS`.

Owns the two kinds of runs. One runs each test once, and notes how long it takes and which functions of the room are
called meanwhile, also in programs that it starts. The other judges mutants: it collects the tests once, and forks
for each mutant; the fork gives the function its mutated code and runs the tests that call it, until one notices.
The file of the function has the mutated code meanwhile, so that programs which a test starts have it, too. Must not
know which mutants count, nor what a share is.

Results are added to a file line by line, so that a run may be stopped at any time.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import inspect
import json
import os
import select
import signal
import sys
import textwrap
import time
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any, TextIO

import pytest

ARGUMENTS = ["-q", "--rootdir=.", "-p", "no:cacheprovider", "--disable-warnings", "--tb=no"]
_HANG, _TIMES = 10.0, 10.0
_NOTICED = frozenset({"failed", "hung", "crashed"})
_SUBREAPER = 36
_OWN_QUEUES = 0x08000000


class See:
    """Runs tests whose times and calls are not known.

    Args:
        known: Ids of tests that need not run.
        calls: The module that notes the calls; not imported before the tests are.
        out: Where a line for each test is added.
    """

    def __init__(self, known: set[str], calls: str, out: TextIO) -> None:
        self._known, self._calls, self._out = known, calls, out
        self._failed = False

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if item.nodeid not in self._known]
        # What is called before any test, that is, while modules are imported.
        self._note("", 0.0, slow=False, passed=True)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._failed |= report.failed

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self._failed = False
        self._take()
        start = time.monotonic()
        result = yield
        seconds = round(time.monotonic() - start, 3)
        slow = item.get_closest_marker("slow") is not None
        self._note(item.nodeid, seconds, slow=slow, passed=not self._failed)
        return result

    def _note(self, name: str, seconds: float, *, slow: bool, passed: bool) -> None:
        line = {"id": name, "seconds": seconds, "slow": slow, "passed": passed, "calls": sorted(self._take())}
        self._out.write(json.dumps(line) + "\n")
        self._out.flush()

    def _take(self) -> set[str]:
        called: set[str] = importlib.import_module(self._calls).take()
        return called


class Report:
    """Says which test begins and which fails.

    Args:
        say: A descriptor, to which lines are written.
        names: Ids of the tests that run, in their order; all, if there are none.
    """

    def __init__(self, say: int, names: list[str]) -> None:
        self._say, self._names = say, names

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        if self._names:
            place = {name: i for i, name in enumerate(self._names)}
            items[:] = sorted((item for item in items if item.nodeid in place), key=lambda item: place[item.nodeid])

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        os.write(self._say, f"start {nodeid}\n".encode())

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            os.write(self._say, f"failed {report.nodeid}\n".encode())


class Judge(Report):
    """Runs mutants instead of tests.

    What is called while modules are imported was called before the fork: if the tests that call it notice nothing,
    all of the room run in a new program.

    Args:
        mutants: Each with the ids and seconds of its tests, in their order, and a limit of seconds for all of them.
        orders: Where the tests are.
        out: Where a line for each mutant is added.
    """

    def __init__(self, mutants: list[dict[str, Any]], orders: dict[str, Any], out: TextIO) -> None:
        super().__init__(-1, [])
        self._mutants, self._orders, self._out = mutants, orders, out

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        items = {item.nodeid: item for item in session.items}
        for mutant in self._mutants:
            tests = {name: seconds for name, seconds in mutant["tests"] if name in items}
            start = time.monotonic()
            with _changed(Path(mutant["file"]), mutant["text"]):
                tried: tuple[str, str] | None = ("untested", "")
                if tests:
                    tried = self._try_again(self._try, mutant, tests)
                if tried and tried[0] in ("lives", "late", "untested") and mutant["all"]:
                    tried = self._try_again(self._try_anew, mutant, dict(mutant["all"]))
            if tried and tried[0] in _NOTICED and tried[1]:
                # And what it does on this machine now without the mutant is nothing that anybody noticed.
                by = tried[1]
                # It may take long, unless that is what was noticed.
                usual = dict(mutant["tests"] + mutant["all"])[by] if tried[0] == "hung" else mutant["limit"]
                without = self._try(mutant, {by: usual}, install=False)
                tried = without and (tried if without[0] == "lives" else ("unsure", by))
            if tried is None:
                session.items = [items[name] for name in self._names]
                return None
            self._note(mutant, *tried, round(time.monotonic() - start, 1))
        return True

    def _note(self, mutant: dict[str, Any], verdict: str, by: str, seconds: float) -> None:
        line = {"key": mutant["key"], "verdict": verdict, "by": by, "seconds": seconds}
        self._out.write(json.dumps(line) + "\n")
        self._out.flush()

    def _try_again(
        self, run: Callable[..., tuple[str, str] | None], mutant: dict[str, Any], tests: dict[str, float]
    ) -> tuple[str, str] | None:
        """As `run`; a busy machine makes a test fail or take long without any fault, so one has to do it twice."""
        tried, before = run(mutant, tests), ""
        while tried and tried[0] in _NOTICED and tried[1] not in ("", before):
            before, names = tried[1], list(tests)
            tests = {name: tests[name] for name in names[names.index(before) :]}
            tried = run(mutant, tests)
        return tried

    def _try(
        self, mutant: dict[str, Any], tests: dict[str, float], *, install: bool = True
    ) -> tuple[str, str] | None:
        """What came of a mutant, and the test that ran at the end; None in the fork that has to run the tests."""
        reading, self._say = os.pipe()
        child = os.fork()
        if child == 0:
            _part_from_others()
            if install:
                _install(mutant)
            self._names = list(tests)
            return None
        os.close(self._say)
        try:
            return self._watch(child, reading, tests, mutant["limit"])
        finally:
            os.close(reading)

    def _try_anew(self, mutant: dict[str, Any], tests: dict[str, float]) -> tuple[str, str]:
        reading, say = os.pipe()
        os.set_inheritable(say, True)
        path = Path(self._orders["out"] + ".anew")
        path.write_text(json.dumps({**self._orders, "mutants": None, "run": list(tests), "say": say}))
        child = os.fork()
        if child == 0:
            _part_from_others()
            os.execv(sys.executable, [sys.executable, "-m", "tests.mutation_run", str(path)])
        os.close(say)
        try:
            return self._watch(child, reading, tests, mutant["limit"])
        finally:
            os.close(reading)

    def _watch(self, child: int, reading: int, tests: dict[str, float], limit: float) -> tuple[str, str]:
        end, hang, test, rest = time.monotonic() + limit, float("inf"), "", b""
        try:
            while True:
                left = min(end, hang) - time.monotonic()
                if left <= 0:
                    return ("late" if time.monotonic() > end else "hung"), test
                if select.select([reading], [], [], min(left, 0.2))[0]:
                    data = os.read(reading, 65536)
                    *lines, rest = (rest + data).split(b"\n")
                    for what, _, name in (line.decode().partition(" ") for line in lines):
                        if what == "failed":
                            return "failed", name
                        test = name
                        hang = time.monotonic() + max(_HANG, _TIMES * tests[name])
                    if data:
                        continue
                pid, status = os.waitpid(child, os.WNOHANG)
                if pid:
                    child = 0
                    return ("lives" if os.waitstatus_to_exitcode(status) == 0 else "crashed"), test
        finally:
            if child:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
            _end_descendants()


def _part_from_others() -> None:
    """Let a mutant find nothing of those before it: where hexwire keeps what its programs share is a folder."""
    os.setpgid(0, 0)
    # A message queue outlives its program. Without the right to this they are those of the machine.
    ctypes.CDLL(None).unshare(_OWN_QUEUES)
    shared = Path(os.environ["XDG_RUNTIME_DIR"], str(os.getpid()))
    shared.mkdir(mode=0o700)
    os.environ["XDG_RUNTIME_DIR"] = os.environ["XDG_CONFIG_HOME"] = str(shared)


def _end_descendants() -> None:
    """End the programs that tests had started: they are this process's children now."""
    while children := _children():
        for pid in children:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        for pid in children:
            with contextlib.suppress(ChildProcessError):
                os.waitpid(pid, 0)


def _children() -> list[int]:
    tasks = Path("/proc/self/task").glob("*/children")
    return [int(pid) for task in tasks for pid in task.read_text().split()]


@contextlib.contextmanager
def _changed(path: Path, text: str) -> Iterator[None]:
    """A file with another text, and then the same as before, for those who look at its time, too."""
    before, status = path.read_text(), path.stat()
    path.write_text(text)
    try:
        yield
    finally:
        if os.getpid() == _JUDGE:
            path.write_text(before)
            os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def _install(mutant: dict[str, Any]) -> None:
    """Give a function its mutated code, for all who hold it; a module that is not imported has it from its file."""
    module = sys.modules.get(mutant["module"])
    if module is None:
        return
    owner, _, name = mutant["function"].rpartition(".")
    holder: Any = getattr(module, owner) if owner else module
    old = inspect.getattr_static(holder, name)
    raw = getattr(old, "__func__", old)
    source = textwrap.dedent(mutant["source"])
    if owner:
        source = f"class {owner}:\n" + textwrap.indent(source, "    ")
    code = compile("from __future__ import annotations\n" + source, mutant["file"], "exec", dont_inherit=True)
    space: dict[str, Any] = {}
    exec(code, vars(module), space)
    new = vars(space[owner])[name] if owner else space[name]
    new = getattr(new, "__func__", new)
    if len(new.__code__.co_freevars) == len(raw.__code__.co_freevars):
        raw.__code__, raw.__defaults__, raw.__kwdefaults__ = new.__code__, new.__defaults__, new.__kwdefaults__
    else:
        setattr(holder, name, type(old)(new) if isinstance(old, staticmethod | classmethod) else new)


_JUDGE = os.getpid()


def main() -> int:
    """Do what the orders say."""
    orders = json.loads(Path(sys.argv[1]).read_text())
    with Path(orders["out"]).open("a") as out:
        if "run" in orders:
            plugin: Any = Report(orders["say"], orders["run"])
            more = ["-x"]
        elif "mutants" in orders:
            # Programs of a test whose fork is gone become children of this process, not of the system's first.
            ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
            plugin = Judge(orders["mutants"], orders, out)
            more = ["-x"]
        else:
            plugin, more = See(set(orders["known"]), orders["calls"], out), ["-o", f"timeout={orders['limit']:.0f}"]
        code = int(pytest.main([*ARGUMENTS, *more, *orders["tests"]], plugins=[plugin]))
    if os.getpid() != _JUDGE:
        sys.stdout.flush()
        os._exit(code)
    return code


if __name__ == "__main__":
    sys.exit(main())
