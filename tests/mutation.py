"""How strong the tests are: a sample of mutants of each room, and how many of them a test notices.

    python tests/mutation.py [--quick] [--count 40] [--seed 1 --seed 2] [--jobs N] [ROOM...]

Owns which mutants count, which tests judge them, and the table at the end. mutmut makes them; `mutation_run.py`
runs each against the tests that call the function it is in, the quickest first, for at most 30 s. A mutant counts
if it changes what code does; texts, `__repr__`, type hints and what a `raise` says do not count, and mutmut leaves
out properties and a module's constants. A test notices a mutant if it fails, or takes ten times as long, twice in
succession, and then passes without the mutant: what a busy machine does to a test is not the mutant's doing.

`mutation_survivors.toml` lists survivors that no test can notice or needs to, each with its reason. A mutant that
no test notices but mypy refuses is noticed too, since `make test` runs mypy; the table counts these apart. Ends
with status 1 if less than 95 % of a room's mutants are noticed by all tests, or less than 90 % by those that are
not slow, or a survivor has no reason. `--quick` runs only those that are not slow, and asks only their 90 %.

What is known is kept in build/mutants and is not found out again while a room's source and the tests that told it
are the same, so a run may be stopped, and the next one goes on.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import difflib
import fcntl
import functools
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import textwrap
import threading
import tomllib
import venv
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src/hexwire"
PACKAGES = {"zenoh_ros2": ROOT / "packages/zenoh-ros2/src/zenoh_ros2"}
"""Distributions of their own; each is a room, too."""
WORK = ROOT / "build/mutants"
REASONS = Path(__file__).with_name("mutation_survivors.toml")
ROOT_ROOM = "root"
"""The modules that are in no room."""
ROOMS = (
    "wire",
    "session",
    "link",
    "bus",
    "arm",
    "control",
    "setup",
    "motion",
    "model",
    "ipc",
    "trace",
    "drivers",
    "gateway",
    "joystick",
    "testing",
    "emulator",
    "fleet",
    "ros2",
    "ros1",
    "studio",
    "cli",
    *PACKAGES,
    ROOT_ROOM,
)
TESTS = {
    # What a session's requests and stops are to each other is proved with a session.
    ROOT_ROOM: (
        "tests/test_arguments.py",
        "tests/test_closing_links.py",
        "tests/test_epochs.py",
        "tests/test_errors.py",
        "tests/test_extras.py",
        "tests/test_folders.py",
        "tests/test_inputs.py",
        "tests/test_main.py",
        "tests/test_new_file.py",
        "tests/test_system.py",
        "tests/test_units.py",
        "tests/ipc/test_session.py",
    ),
    # hexwire's node uses all of the wire.
    "zenoh_ros2": ("packages/zenoh-ros2/tests", "tests/ros2"),
    # A link of each kind passes the suite for links.
    "testing": ("tests/testing", "tests/link/test_memory.py"),
}
"""What judges a room, if it is not the tests in the folder of its name."""
GENERATED = ("wire/tables.py",)
LEAST, LEAST_QUICK = 0.95, 0.90
LIMIT = 30.0
"""Seconds for the tests of a mutant."""
# Takes minutes where every call of the link is counted: hundreds of signals have to hit it in the middle.
_TOO_SLOW = "tests/link/test_poll_link.py::test_a_signal_handler_may_close_the_link_at_any_moment"
_NOTICED = frozenset({"failed", "hung", "crashed"})
# Tests as quick as each other run in the order of their files, which share what takes long to start.
_PACES = (0.05, 0.5, 2.0)
# Rooms share what it remembers.
_mypy = threading.Lock()


@dataclass
class Mutant:
    """One change to one function.

    Attributes:
        name: mutmut's, after the module's.
        place: Module and function.
        change: The lines that differ, as in a diff.
        verdict: What came of the tests; empty if none was run.
        by: The test that ended it.
        slow: That test is marked slow.
        seconds: That this took.
        typed: mypy refuses it; asked only if the tests let it live.
    """

    name: str
    place: str
    change: tuple[str, ...]
    verdict: str = ""
    by: str = ""
    slow: bool = False
    seconds: float = 0.0
    typed: bool = False

    @property
    def killed(self) -> bool:
        """A test noticed it."""
        return self.verdict in _NOTICED

    @property
    def killed_quickly(self) -> bool:
        """A test that is not slow noticed it."""
        return self.killed and not self.slow


@dataclass
class Timed:
    """What is known of a test: its time, whether it is slow, whether it passes, and what it calls."""

    seconds: float
    slow: bool
    passed: bool
    calls: frozenset[str]


@dataclass
class Score:
    """Of one room."""

    room: str
    total: int
    meaningful: int
    mutants: list[Mutant] = field(default_factory=list)

    @property
    def killed(self) -> int:
        """How many a test noticed."""
        return sum(mutant.killed for mutant in self.mutants)

    @property
    def killed_quickly(self) -> int:
        """How many a test that is not slow noticed."""
        return sum(mutant.killed_quickly for mutant in self.mutants)

    @property
    def typed(self) -> int:
        """How many more mypy noticed."""
        return sum(mutant.typed for mutant in self.mutants)

    @property
    def share(self) -> float:
        """Of those that all tests and mypy noticed."""
        return (self.killed + self.typed) / len(self.mutants)

    @property
    def quick_share(self) -> float:
        """Of those that the tests that are not slow and mypy noticed."""
        return (self.killed_quickly + self.typed) / len(self.mutants)


_Function = ast.FunctionDef | ast.AsyncFunctionDef


class _Meaning(ast.NodeTransformer):
    """Takes out of a function what does not change what it does."""

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        return ast.copy_location(ast.Constant(""), node) if isinstance(node.value, str) else node

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        return ast.copy_location(ast.Constant(""), node)

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        """A choice between two texts with values in them is what is said; one between plain words may be a key."""
        arms = node.body, node.orelse
        texts = all(isinstance(getattr(arm, "value", None), str) or isinstance(arm, ast.JoinedStr) for arm in arms)
        looks = any(isinstance(part, ast.Call | ast.NamedExpr | ast.Await) for part in ast.walk(node.test))
        if texts and not looks and any(isinstance(arm, ast.JoinedStr) for arm in arms):
            return ast.copy_location(ast.Constant(""), node)
        return self.generic_visit(node)

    def visit_FunctionDef(self, node: _Function) -> ast.AST:
        flags = _flags(node)
        for part in (part for part in ast.walk(node) if isinstance(part, ast.Assign)):
            falsy = isinstance(part.value, ast.Constant) and not part.value.value
            if falsy and all(isinstance(target, ast.Name) and target.id in flags for target in part.targets):
                part.value = ast.Constant(False)
        self.generic_visit(node)
        _return_at_the_end(node.body)
        return node

    visit_AsyncFunctionDef = visit_FunctionDef  # noqa: N815

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        if isinstance(node.exc, ast.Call):
            node.exc = node.exc.func
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Name("object")
        return self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        call = node.value
        logs = isinstance(call, ast.Call) and ast.unparse(call.func).startswith(("_log.", "logging."))
        return ast.Pass() if logs else self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        if isinstance(node.func, ast.Name) and node.func.id == "cast":
            return self.visit(node.args[-1])
        # Checks of the program against itself, and what the machine of the tests has but one of.
        node.keywords = [keyword for keyword in node.keywords if keyword.arg not in ("strict", "encoding")]
        return self.generic_visit(node)


def _flags(function: _Function) -> set[str]:
    """Local names of which is only asked whether they are true."""
    asked: set[int] = set()

    def ask(node: ast.expr) -> None:
        asked.add(id(node))
        if isinstance(node, ast.BoolOp):
            for value in node.values:
                ask(value)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            ask(node.operand)

    for part in ast.walk(function):
        if isinstance(part, ast.If | ast.While | ast.IfExp):
            ask(part.test)
        elif isinstance(part, ast.UnaryOp) and isinstance(part.op, ast.Not):
            ask(part.operand)
    names = [part for part in ast.walk(function) if isinstance(part, ast.Name)]
    outer = {
        name for part in ast.walk(function) if isinstance(part, ast.Global | ast.Nonlocal) for name in part.names
    }
    used = {name.id for name in names if isinstance(name.ctx, ast.Load) and id(name) not in asked}
    used |= {
        part.target.id
        for part in ast.walk(function)
        if isinstance(part, ast.AugAssign) and isinstance(part.target, ast.Name)
    }
    return {name.id for name in names if isinstance(name.ctx, ast.Store)} - used - outer


def _return_at_the_end(body: list[ast.stmt]) -> None:
    """Where a loop is the last thing that a function does, leaving the loop is leaving the function."""
    last = body[-1]
    if isinstance(last, ast.If):
        for branch in (last.body, last.orelse):
            if branch:
                _return_at_the_end(branch)
    elif isinstance(last, ast.For | ast.While) and not last.orelse:
        _return_for_break(last.body)


def _return_for_break(body: list[ast.stmt]) -> None:
    for i, statement in enumerate(body):
        if isinstance(statement, ast.Break):
            body[i] = ast.copy_location(ast.Return(None), statement)
        elif isinstance(statement, ast.If):
            _return_for_break(statement.body)
            _return_for_break(statement.orelse)


def is_meaningful(original: str, mutated: str) -> bool:
    """Whether two versions of a function differ in what they do."""
    try:
        before, after = ast.parse(original), ast.parse(mutated)
    except SyntaxError:
        return False
    if before.body and getattr(before.body[0], "name", "") in {"__repr__", "__str__"}:
        return False
    return ast.dump(_Meaning().visit(before)) != ast.dump(_Meaning().visit(after))


def changed_lines(original: str, mutated: str) -> tuple[str, ...]:
    """The lines that differ, with - and + before them."""
    diff = difflib.unified_diff(original.splitlines(), mutated.splitlines(), lineterm="", n=0)
    return tuple(line[0] + line[1:].strip() for line in diff if line[:1] in "+-" and line[:3] not in ("+++", "---"))


# A module with all its mutants has megabytes; a sample asks for one mutant of it after the other.
@functools.lru_cache(maxsize=2)
def functions_of(text: str) -> dict[str, str]:
    """Source of each function of a file that mutmut has written, by its name there, without that name."""
    lines = text.splitlines(keepends=True)
    found: dict[str, str] = {}
    for node in _functions(ast.parse(text)):
        source = "".join(lines[node.lineno - 1 : node.end_lineno])
        plain = textwrap.dedent(source)
        found[node.name] = plain.replace(node.name, _plain_name(node.name), 1)
    return found


def _functions(tree: ast.Module) -> Iterator[_Function]:
    for node in tree.body:
        for inner in node.body if isinstance(node, ast.ClassDef) else [node]:
            if isinstance(inner, _Function):
                yield inner


def _plain_name(name: str) -> str:
    return name.partition("__mutmut_")[0].removeprefix("x_").rpartition("ǁ")[2]


def files_of(room: str) -> list[Path]:
    """The modules of a room that have mutants."""
    found = SOURCE.glob("*.py") if room == ROOT_ROOM else PACKAGES.get(room, SOURCE / room).rglob("*.py")
    return sorted(path for path in found if short(path).as_posix() not in GENERATED)


def short(path: Path) -> Path:
    """The path of a module in the package hexwire, or that of another distribution with its name first."""
    return path.relative_to(next((source.parent for source in PACKAGES.values() if source in path.parents), SOURCE))


def source_of(relative: Path) -> Path:
    """The file of a module by its short path."""
    package = PACKAGES.get(relative.parts[0])
    return SOURCE / relative if package is None else package.parent / relative


def judges_of(room: str) -> tuple[str, ...]:
    """The files and folders whose tests judge a room."""
    return TESTS.get(room, (f"tests/{room}",))


def mutated(path: Path) -> str:
    """A module with all its mutants, as mutmut writes it; made once for each text of a module."""
    text = path.read_text()
    kept = WORK / "made" / (_digest(text) + ".py")
    if not kept.is_file():
        from mutmut.mutation.file_mutation import mutate_file_contents

        kept.parent.mkdir(parents=True, exist_ok=True)
        new = kept.with_suffix(f".{os.getpid()}")
        new.write_text(mutate_file_contents(str(path.relative_to(ROOT)), text).code)
        new.replace(kept)
    return kept.read_text()


def find_mutants(path: Path) -> tuple[int, list[Mutant]]:
    """All mutants of a module, and those that count."""
    relative = short(path)
    module = module_of(relative)
    functions = functions_of(mutated(path))
    total, found = 0, []
    for key, new in functions.items():
        start, mark, number = key.partition("__mutmut_")
        if not mark or number == "orig":
            continue
        total += 1
        original = functions[start + "__mutmut_orig"]
        if is_meaningful(original, new):
            place = f"{relative.as_posix()}:{_plain_name(key)}"
            found.append(Mutant(f"{module}.{key}", place, changed_lines(original, new)))
    return total, found


def module_of(relative: Path) -> str:
    """What a module is imported as, by its short path."""
    parts = (*(() if relative.parts[0] in PACKAGES else ("hexwire",)), *relative.with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def function_of(name: str) -> str:
    """The function of a mutant in its module, with its class."""
    key = name.rpartition(".")[2]
    owner = key.partition("ǁ")[2].partition("ǁ")[0]
    return f"{owner}.{_plain_name(key)}" if owner else _plain_name(key)


def draw(found: Iterable[Mutant], count: int, seed: int) -> list[Mutant]:
    """A random sample; other mutants stay drawn when some code changes."""

    def lot(mutant: Mutant) -> tuple[str, str]:
        what = json.dumps([seed, mutant.place, mutant.change])
        return hashlib.sha256(what.encode()).hexdigest(), mutant.name

    return sorted(found, key=lot)[:count]


def put_in(source: str, key: str, function: str) -> str:
    """A module with a mutated function in the place of its own."""
    place = key.partition("__mutmut_")[0].split("ǁ")
    body = ast.parse(source).body
    if len(place) > 1:
        body = next(node.body for node in body if isinstance(node, ast.ClassDef) and node.name == place[1])
    name = _plain_name(key)
    node = next(node for node in body if isinstance(node, _Function) and node.name == name)
    lines = source.splitlines(keepends=True)
    lines[node.lineno - 1 : node.end_lineno] = [textwrap.indent(function, " " * node.col_offset).rstrip() + "\n"]
    return "".join(lines)


class Copy:
    """The project in a folder of its own, with an environment in which programs have its source, too.

    Args:
        folder: Where it is.
        counted: Its functions of this room say that they are called; none if empty.
    """

    def __init__(self, folder: Path, counted: str = "") -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        changed = set(files_of(counted)) if counted else set()
        for path in ROOT.iterdir():
            target = folder / path.name
            if path.name in ("packages", "src", "tests"):
                _mirror(path, target, changed)
            elif path.name in ("pyproject.toml", "conftest.py"):
                _mirror_file(path, target)
            elif path.name[0] != "." and path.name != "__pycache__":
                target.unlink(missing_ok=True)
                target.symlink_to(path)
        if counted:
            package = PACKAGES.get(counted, SOURCE).relative_to(ROOT)
            _mirror_file(ROOT / "tests/mutation_calls.py", folder / package / "mutation_calls.py")
        self._make_environment()

    def _make_environment(self) -> None:
        real, own = Path(sys.prefix), self.folder / ".venv"
        if own.is_dir():
            return
        new = own.with_name(".venv.new")
        venv.create(new, clear=True, symlinks=True)
        packages = Path("lib", f"python{sys.version_info.major}.{sys.version_info.minor}", "site-packages")
        # The first line precedes the source that is installed there.
        own_packages = [str(self.folder / source.parent.relative_to(ROOT)) for source in PACKAGES.values()]
        lines = [str(self.folder / "src"), *own_packages, f"import site; site.addsitedir({str(real / packages)!r})"]
        (new / packages / "copy.pth").write_text("\n".join(lines) + "\n")
        for script in (real / "bin").iterdir():
            target = new / "bin" / script.name
            if not target.exists() and script.is_file() and script.read_bytes()[:2] == b"#!":
                target.write_text(script.read_text().replace(f"{real}/bin/python", f"{own}/bin/python"))
                target.chmod(0o755)
        new.rename(own)

    def run(self, orders: dict[str, object]) -> None:
        """Let `mutation_run.py` do something; what it adds to a file is its result."""
        path = self.folder / "orders.json"
        path.write_text(json.dumps(orders))
        with tempfile.TemporaryDirectory(prefix="mutants-") as scratch, (self.folder / "log").open("w") as log:
            environment = {
                **os.environ,
                "HYPOTHESIS_PROFILE": "ci",
                "TMPDIR": scratch,
                "PATH": f"{self.folder / '.venv/bin'}:{os.environ['PATH']}",
                # Python takes a compiled file for that of a source of the same second and length.
                **({"PYTHONDONTWRITEBYTECODE": "1"} if "mutants" in orders else {}),
            }
            environment.pop("PYTHONPATH", None)
            command = [str(self.folder / ".venv/bin/python"), "-m", "tests.mutation_run", str(path)]
            done = subprocess.run(
                command,
                cwd=self.folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                check=False,
            )
        # 1: tests failed; 5: all were known.
        if done.returncode not in (0, 1, 5):
            raise SystemExit(f"pytest failed with {done.returncode}: see {self.folder / 'log'}")

    def refused_by_mypy(self) -> bool:
        """Whether it refuses the source as it is in this copy."""
        command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(WORK / "mypy")]
        with _mypy:
            done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True, check=False)
        if done.returncode not in (0, 1):
            raise SystemExit(f"mypy failed in {self.folder}: {done.stdout}{done.stderr}")
        return done.returncode == 1


def _mirror(source: Path, target: Path, counted: set[Path]) -> None:
    """Make a folder like another one, except for the functions of some files, which note their calls."""
    target.mkdir(exist_ok=True)
    here = {path.name: path for path in source.iterdir() if path.name != "__pycache__"}
    for path in target.iterdir():
        if path.name not in here and path.name != "__pycache__":
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    for path in here.values():
        if path.is_dir():
            _mirror(path, target / path.name, counted)
        elif path in counted:
            text = count_calls(path.read_text(), module_of(short(path)))
            _write_if_new(target / path.name, text)
        else:
            _mirror_file(path, target / path.name)


def _mirror_file(source: Path, target: Path) -> None:
    if not target.is_file() or target.read_bytes() != source.read_bytes():
        shutil.copy(source, target)


def _write_if_new(path: Path, text: str) -> None:
    if not path.is_file() or path.read_text() != text:
        path.write_text(text)


def count_calls(text: str, module: str) -> str:
    """A module whose functions and methods note that they are called."""
    tree = ast.parse(text)
    for node in tree.body:
        for inner in node.body if isinstance(node, ast.ClassDef) else [node]:
            if isinstance(inner, _Function):
                owner = f"{node.name}." if isinstance(node, ast.ClassDef) else ""
                call = ast.parse(f"_note_call({f'{module}:{owner}{inner.name}'!r})").body
                inner.body[1 if ast.get_docstring(inner) is not None else 0 : 0] = call
    after = 1 if ast.get_docstring(tree) is not None else 0
    while after < len(tree.body) and getattr(tree.body[after], "module", None) == "__future__":
        after += 1
    notes = calls_module(module.partition(".")[0])
    tree.body[after:after] = ast.parse(f"from {notes} import note as _note_call").body
    return ast.unparse(tree)


def calls_module(package: str) -> str:
    """What the copy of `mutation_calls.py` is imported as; in the package, since some tests hide all but that."""
    return f"{package}.mutation_calls"


class Room:
    """One room: its mutants, its tests, and what is known of both.

    Args:
        name: One of `ROOMS`.
        quick: Only the tests that are not slow.
    """

    def __init__(self, name: str, quick: bool) -> None:
        self.name, self.quick = name, quick
        self.folder = WORK / name
        self.folder.mkdir(parents=True, exist_ok=True)
        self.source = _digest("".join(path.read_text() for path in files_of(name)))
        self._tests_now = {
            path.relative_to(ROOT).as_posix(): _digest(path.read_text())
            for start in judges_of(name)
            for path in ([ROOT / start] if (ROOT / start).is_file() else sorted((ROOT / start).rglob("*.py")))
        }
        self.tests = _digest(json.dumps(self._tests_now))

    def _select(self) -> list[str]:
        marks = ["-m", "not slow"] if self.quick else []
        return [*judges_of(self.name), *marks, "--deselect", _TOO_SLOW]

    def _file_digest(self, test: str) -> str:
        return self._tests_now.get(test.partition("::")[0], "")

    def see(self) -> dict[str, Timed]:
        """Run each test whose time and calls are not known: its file has changed, or the room's source."""
        kept, done = self.folder / "seen.jsonl", self.folder / "seen.done"
        state = f"{self.source} {self.tests} {self.quick}"
        if not done.is_file() or done.read_text() != state:
            copy = Copy(self.folder / "counted", self.name)
            known = self._seen(kept)
            new = self.folder / "seen.new"
            with contextlib.suppress(FileNotFoundError):
                # A run that was stopped: what it found was of the texts that it wrote beside.
                self._add_seen(new, kept)
                known = self._seen(kept)
            (self.folder / "seen.of").write_text(json.dumps([self.source, self._tests_now]))
            calls = calls_module(PACKAGES.get(self.name, SOURCE).name)
            orders = {"tests": self._select(), "known": sorted(known), "out": str(new), "limit": LIMIT}
            copy.run(orders | {"calls": calls})
            self._add_seen(new, kept)
            done.write_text(state)
        return self._seen(kept)

    def _add_seen(self, new: Path, kept: Path) -> None:
        source, files = json.loads((self.folder / "seen.of").read_text())
        with kept.open("a") as out:
            for line in new.read_text().splitlines():
                row = json.loads(line)
                file = files.get(row["id"].partition("::")[0], "")
                out.write(json.dumps(row | {"source": source, "file": file}) + "\n")
        new.unlink()

    def _seen(self, kept: Path) -> dict[str, Timed]:
        found: dict[str, Timed] = {}
        for row in _rows(kept):
            if row["source"] == self.source and row["file"] == self._file_digest(row["id"]):
                calls = frozenset(row["calls"])
                found[row["id"]] = Timed(row["seconds"], row["slow"], row["passed"], calls)
        return found

    def recall(self, mutants: Iterable[Mutant]) -> list[Mutant]:
        """Fill in the verdicts that are known, and return the mutants without one."""
        known = {
            row["key"]: row
            for row in _rows(self.folder / "verdicts.jsonl")
            if row["source"] == self.source and self._holds(row)
        }
        left = []
        for mutant in mutants:
            row = known.get(key_of(mutant))
            if row is None:
                left.append(mutant)
                continue
            mutant.verdict, mutant.by, mutant.seconds = row["verdict"], row["by"], row["seconds"]
            mutant.slow, mutant.typed = row["slow"], row["typed"]
        return left

    def _holds(self, row: dict[str, object]) -> bool:
        if row["verdict"] in _NOTICED and not (self.quick and row["slow"]):
            return row["file"] == self._file_digest(str(row["by"]))
        return (self.quick or not row["quick"]) and row["tests"] == self.tests

    def judge(self, mutants: list[Mutant]) -> None:
        """Run the tests for mutants whose verdicts are not known."""
        if not self.recall(mutants):
            return
        tests = self.see()
        for name, test in sorted(tests.items()):
            if not test.passed:
                print(f"  {self.name}: {name} fails or takes {LIMIT:.0f} s without a mutant, and judges none")
        copy = Copy(self.folder / "judged")
        out = self.folder / "verdicts.new"
        self._take_verdicts(copy, mutants, tests, out)
        left, orders = self.recall(mutants), []
        for mutant in left:
            relative = Path(mutant.place.partition(":")[0])
            key = mutant.name.rpartition(".")[2]
            source = functions_of(mutated(source_of(relative)))[key]
            called = f"{module_of(relative)}:{function_of(mutant.name)}"
            at_import = "" in tests and called in tests[""].calls
            chosen = [name for name in choose(tests, called) if not (self.quick and tests[name].slow)]
            orders.append(
                {
                    "key": key_of(mutant),
                    "module": module_of(relative),
                    "function": function_of(mutant.name),
                    "source": source,
                    "file": str(copy.folder / source_of(relative).relative_to(ROOT)),
                    "text": put_in(source_of(relative).read_text(), key, source),
                    "tests": [(name, tests[name].seconds) for name in chosen],
                    "all": [(name, tests[name].seconds) for name in choose(tests, "")] if at_import else [],
                    "limit": LIMIT,
                }
            )
        if orders:
            (self.folder / "verdicts.of").write_text(
                json.dumps([self.source, self.tests, self._tests_now, self.quick])
            )
            copy.run({"tests": self._select(), "mutants": orders, "out": str(out)})
            self._take_verdicts(copy, mutants, tests, out)
        self.recall(mutants)

    def _take_verdicts(self, copy: Copy, mutants: list[Mutant], tests: dict[str, Timed], new: Path) -> None:
        """Add what a run found to what is known; mypy is asked about what the tests let live."""
        if not new.is_file():
            return
        source, whole, files, quick = json.loads((self.folder / "verdicts.of").read_text())
        by_key = {key_of(mutant): mutant for mutant in mutants}
        rows = [row for row in _rows(new) if row["key"] in by_key and source == self.source]
        if any(row["verdict"] not in _NOTICED for row in rows) and copy.refused_by_mypy():
            raise SystemExit("mypy refuses the source as it is: see `make types`")
        with (self.folder / "verdicts.jsonl").open("a") as out:
            for row in rows:
                noticed, by = row["verdict"] in _NOTICED, row["by"]
                more = {
                    "source": source,
                    "tests": whole,
                    "quick": quick,
                    "file": files.get(by.partition("::")[0], ""),
                    "slow": noticed and by in tests and tests[by].slow,
                    "typed": not noticed and self._is_refused(copy, by_key[row["key"]]),
                }
                out.write(json.dumps(row | more) + "\n")
                out.flush()
        new.unlink()

    def _is_refused(self, copy: Copy, mutant: Mutant) -> bool:
        """Let mypy look at a mutant in the copy of the source."""
        relative = Path(mutant.place.partition(":")[0])
        key = mutant.name.rpartition(".")[2]
        source = source_of(relative)
        path, before = copy.folder / source.relative_to(ROOT), source.read_text()
        path.write_text(put_in(before, key, functions_of(mutated(source_of(relative)))[key]))
        try:
            return copy.refused_by_mypy()
        finally:
            shutil.copy2(source, path)


def _rows(path: Path) -> Iterator[dict[str, object]]:
    if path.is_file():
        for line in path.read_text().splitlines():
            # The last line of a run that was stopped may be half of one.
            with contextlib.suppress(json.JSONDecodeError):
                yield json.loads(line)


def choose(tests: dict[str, Timed], called: str) -> list[str]:
    """The tests that judge a function, or all, in their order: not slow ones first, and of them the quickest."""

    def order(name: str) -> tuple[bool, int, str, float]:
        test = tests[name]
        return test.slow, sum(test.seconds > pace for pace in _PACES), name.partition("::")[0], test.seconds

    able = [name for name, test in tests.items() if name and test.passed and (not called or called in test.calls)]
    return sorted(able, key=order)


def key_of(mutant: Mutant) -> str:
    """What a mutant is known by between two runs."""
    return _digest(json.dumps([mutant.name, mutant.place, mutant.change]))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def judge(name: str, count: int, seeds: Iterable[int], quick: bool) -> Score:
    """Make the mutants of a room and run samples of those that count."""
    room = Room(name, quick)
    with (room.folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        total, found = 0, list[Mutant]()
        for path in files_of(name):
            more, those = find_mutants(path)
            total += more
            found += those
        drawn = {mutant.name: mutant for seed in seeds for mutant in draw(found, count, seed)}
        score = Score(name, total, len(found), [drawn[key] for key in sorted(drawn)])
        room.judge(score.mutants)
    return score


def load_reasons() -> dict[tuple[str, tuple[str, ...]], str]:
    """Reasons by place and change."""
    if not REASONS.is_file():
        return {}
    rows = tomllib.loads(REASONS.read_text()).get("survivor", [])
    return {(row["place"], tuple(row["change"])): row["reason"] for row in rows}


def report(score: Score, reasons: dict[tuple[str, tuple[str, ...]], str], quick: bool) -> bool:
    """Print a room's line and its survivors, and return whether it is as it should be."""
    good = score.quick_share >= LEAST_QUICK and (quick or score.share >= LEAST)
    made = f"{score.total:>9}{score.meaningful:>12}{len(score.mutants):>6}"
    seconds = sum(mutant.seconds for mutant in score.mutants) / len(score.mutants)
    killed = f"{score.killed:>8}{score.killed_quickly:>9}{score.typed:>10}"
    print(f"{score.room:<10}{made}{killed}{score.share:>8.1%}{score.quick_share:>9.1%}{seconds:>9.1f}", flush=True)
    for mutant in score.mutants:
        if mutant.killed or mutant.typed:
            continue
        reason = reasons.get((mutant.place, mutant.change))
        good &= reason is not None
        whats = {
            "untested": "has no test",
            "late": f"lives for {LIMIT:.0f} s",
            "unsure": f"lives, or {mutant.by} fails without it, too",
        }
        what = whats.get(mutant.verdict, "lives")
        print(f"  {mutant.place} {what}: {reason or 'NO REASON'}")
        for line in mutant.change:
            print(f"      {line}")
    return good


def main() -> int:
    """Judge the rooms that are named, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help=f"of {', '.join(ROOMS)}")
    parser.add_argument("--count", type=int, default=40, help="mutants a room and seed")
    parser.add_argument("--seed", type=int, action="append", help="may be given again; 1 and 2 if not at all")
    parser.add_argument("--quick", action="store_true", help="run only the tests that are not slow")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="rooms at a time")
    arguments = parser.parse_args()
    if unknown := set(arguments.rooms) - set(ROOMS):
        parser.error(f"no room {', '.join(sorted(unknown))}; there are {', '.join(ROOMS)}")
    reasons, good = load_reasons(), True
    killed = f"{'killed':>8}{'quickly':>9}{'by types':>10}"
    print(f"{'room':<10}{'mutants':>9}{'that count':>12}{'run':>6}{killed}{'share':>8}{'quickly':>9}{'seconds':>9}")
    with ThreadPoolExecutor(arguments.jobs) as pool:
        runs = [
            pool.submit(judge, room, arguments.count, arguments.seed or [1, 2], arguments.quick)
            for room in arguments.rooms or ROOMS
        ]
        for run in runs:
            good &= report(run.result(), reasons, arguments.quick)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
