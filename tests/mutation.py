"""How strong the tests are: a sample of mutants of each room, and how many of them a test notices.

    python tests/mutation.py [--count 40] [--seed 1] [ROOM...]

Owns which mutants count and the table at the end. mutmut makes them and runs each against the tests that call the
function it is in. A mutant counts if it changes what code does; texts, `__repr__`, type hints and what a `raise`
says do not count, and mutmut leaves out properties and a module's constants. A test that takes a minute hangs, and
counts as one that fails; a run that takes too long as a whole is repeated alone.

`mutation_survivors.toml` lists survivors that no test can notice or needs to, each with its reason. A mutant that
no test notices but mypy refuses is noticed too, since `make test` runs mypy; the table counts these apart. Ends
with status 1 if less than 95 % of a room's mutants are noticed, or a survivor has no reason.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import hashlib
import json
import os
import shutil
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WORK = ROOT / "build/mutants"
REASONS = Path(__file__).with_name("mutation_survivors.toml")
ROOMS = ("wire", "session", "link", "bus", "control", "motion")
GENERATED = ("src/hexwire/wire/tables.py",)
LEAST = 0.95
# Exit codes of mutmut: no test calls it; a test noticed, that is, it failed, crashed or hung.
_UNTESTED = 33
_NOTICED = frozenset({1, 3, 24, 36, 152, 255, -9, -11, -24, -6})
_HUNG = frozenset({24, 36, 152, -9, -24})
# Takes minutes where every call of the link is counted: hundreds of signals have to hit it in the middle.
_TOO_SLOW = "tests/link/test_poll_link.py::test_a_signal_handler_may_close_the_link_at_any_moment"
# A test that takes ten times as long as the slowest one hangs, and fails: mutmut itself waits five times as long as
# all tests of the function take, which may be minutes.
_HANG = ["-o", "faulthandler_timeout=60", "-o", "faulthandler_exit_on_timeout=true"]

CONFIG = """
[tool.mutmut]
source_paths = ["src"]
only_mutate = ["src/hexwire/{room}/*.py"]
do_not_mutate = {generated}
also_copy = ["conftest.py", "vectors", "schema", "docs", "README.md", "PROTOCOL.md"]
pytest_add_cli_args = ["-q", "-p", "no:cacheprovider", "--deselect", "{too_slow}", {hang}]
pytest_add_cli_args_test_selection = ["tests/{room}"]
timeout_multiplier = 5.0
timeout_constant = 5.0
use_setproctitle = false
"""


@dataclass
class Mutant:
    """One change to one function.

    Attributes:
        name: mutmut's.
        place: Module and function.
        change: The lines that differ, as in a diff.
        exit_code: Of the tests; None if it was not run.
        typed: mypy refuses it; asked only if the tests let it live.
    """

    name: str
    place: str
    change: tuple[str, ...]
    exit_code: int | None = None
    typed: bool = False

    @property
    def killed(self) -> bool:
        """A test noticed it."""
        return self.exit_code in _NOTICED


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
    def typed(self) -> int:
        """How many more mypy noticed."""
        return sum(mutant.typed for mutant in self.mutants)


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

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        flags = _flags(node)
        for part in (part for part in ast.walk(node) if isinstance(part, ast.Assign)):
            falsy = isinstance(part.value, ast.Constant) and not part.value.value
            if falsy and all(isinstance(target, ast.Name) and target.id in flags for target in part.targets):
                part.value = ast.Constant(False)
        self.generic_visit(node)
        _return_at_the_end(node.body)
        return node

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


def _flags(function: ast.FunctionDef) -> set[str]:
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


def functions_of(path: Path) -> dict[str, str]:
    """Source of each function of a file that mutmut has written, by its name there, without that name."""
    text = path.read_text()
    lines = text.splitlines(keepends=True)
    found: dict[str, str] = {}
    for node in _functions(ast.parse(text)):
        source = "".join(lines[node.lineno - 1 : node.end_lineno])
        plain = textwrap.dedent(source)
        found[node.name] = plain.replace(node.name, _plain_name(node.name), 1)
    return found


def _functions(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    for node in tree.body:
        for inner in node.body if isinstance(node, ast.ClassDef) else [node]:
            if isinstance(inner, ast.FunctionDef):
                yield inner


def _plain_name(name: str) -> str:
    return name.partition("__mutmut_")[0].removeprefix("x_").rpartition("ǁ")[2]


def prepare(room: str) -> Path:
    """A folder of its own for a room, with the project as it is now."""
    folder = WORK / room
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in ("src", "tests", "vectors", "schema", "docs", "conftest.py", "README.md", "PROTOCOL.md"):
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder / name)
    generated, hang = json.dumps(list(GENERATED)), json.dumps(_HANG)[1:-1]
    config = CONFIG.format(room=room, generated=generated, too_slow=_TOO_SLOW, hang=hang)
    (folder / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text() + config)
    return folder


def mutmut(folder: Path, names: Iterable[str], jobs: int) -> None:
    """Run mutants, which first makes all of them; no names make them only."""
    environment = os.environ | {"HYPOTHESIS_PROFILE": "ci", "PYTHONPATH": ""}
    names = list(names)
    command = [sys.executable, "-m", "mutmut", "run", "--max-children", str(jobs), *(names or ["none"])]
    with (folder / "mutmut.log").open("w") as log:
        done = subprocess.run(command, cwd=folder, env=environment, stdout=log, stderr=log, check=False)
    # It refuses to run none, after it has made all.
    if names and done.returncode != 0:
        print((folder / "mutmut.log").read_text().replace("\r", "\n")[-2000:], file=sys.stderr)
        raise SystemExit(f"mutmut failed in {folder}")


def find_mutants(folder: Path, room: str) -> tuple[int, list[Mutant]]:
    """All mutants of a room, and those that count."""
    total, found = 0, []
    for path in sorted((folder / "mutants/src/hexwire" / room).glob("*.py")):
        meta = path.with_name(path.name + ".meta")
        codes = json.loads(meta.read_text())["exit_code_by_key"] if meta.is_file() else {}
        if not codes:
            continue
        functions = functions_of(path)
        for name in codes:
            total += 1
            key = name.rpartition(".")[2]
            original = functions.get(key.partition("__mutmut_")[0] + "__mutmut_orig")
            mutated = functions.get(key)
            if original is not None and mutated is not None and is_meaningful(original, mutated):
                place = f"{room}/{path.name}:{_plain_name(key)}"
                found.append(Mutant(name, place, changed_lines(original, mutated)))
    return total, found


def draw(found: Iterable[Mutant], count: int, seed: int) -> list[Mutant]:
    """A random sample; other mutants stay drawn when some code changes."""

    def lot(mutant: Mutant) -> tuple[str, str]:
        what = json.dumps([seed, mutant.place, mutant.change])
        return hashlib.sha256(what.encode()).hexdigest(), mutant.name

    return sorted(found, key=lot)[:count]


def take_codes(folder: Path, room: str, mutants: Iterable[Mutant]) -> None:
    """What came of them."""
    codes: dict[str, int | None] = {}
    for meta in (folder / "mutants/src/hexwire" / room).glob("*.py.meta"):
        codes |= json.loads(meta.read_text())["exit_code_by_key"]
    for mutant in mutants:
        mutant.exit_code = codes[mutant.name]


def ask_types(folder: Path, mutants: Iterable[Mutant]) -> None:
    """Let mypy look at mutants, one at a time, in the unchanged copy of the source."""
    for mutant in mutants:
        module, _, key = mutant.name.rpartition(".")
        relative = Path(*module.split(".")).with_suffix(".py")
        path = folder / "src" / relative
        before = path.read_text()
        path.write_text(put_in(before, key, functions_of(folder / "mutants/src" / relative)[key]))
        mutant.typed = _refused_by_mypy(folder)
        path.write_text(before)


def put_in(source: str, key: str, function: str) -> str:
    """A module with a mutated function in the place of its own."""
    place = key.partition("__mutmut_")[0].split("ǁ")
    body = ast.parse(source).body
    if len(place) > 1:
        body = next(node.body for node in body if isinstance(node, ast.ClassDef) and node.name == place[1])
    name = _plain_name(key)
    node = next(node for node in body if isinstance(node, ast.FunctionDef) and node.name == name)
    lines = source.splitlines(keepends=True)
    lines[node.lineno - 1 : node.end_lineno] = [textwrap.indent(function, " " * node.col_offset).rstrip() + "\n"]
    return "".join(lines)


def _refused_by_mypy(folder: Path) -> bool:
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(WORK / "mypy"), "src"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(f"mypy failed in {folder}: {done.stdout}{done.stderr}")
    return done.returncode == 1


def judge(room: str, count: int, seed: int, jobs: int) -> Score:
    """Make the mutants of a room and run a sample of those that count."""
    folder = prepare(room)
    mutmut(folder, [], jobs)
    total, found = find_mutants(folder, room)
    if not found:
        raise SystemExit(f"mutmut made no mutants of {room}: see {folder / 'mutmut.log'}")
    score = Score(room, total, len(found))
    score.mutants = sorted(draw(found, count, seed), key=lambda m: m.name)
    mutmut(folder, [mutant.name for mutant in score.mutants], jobs)
    take_codes(folder, room, score.mutants)
    hung = [mutant.name for mutant in score.mutants if mutant.exit_code in _HUNG]
    if hung:
        # On a busy machine a test may take too long without any fault: once more, one at a time.
        mutmut(folder, hung, 1)
        take_codes(folder, room, score.mutants)
    living = [mutant for mutant in score.mutants if not mutant.killed]
    if living and _refused_by_mypy(folder):
        raise SystemExit("mypy refuses the source as it is: see `make types`")
    ask_types(folder, living)
    return score


def load_reasons() -> dict[tuple[str, tuple[str, ...]], str]:
    """Reasons by place and change."""
    if not REASONS.is_file():
        return {}
    rows = tomllib.loads(REASONS.read_text()).get("survivor", [])
    return {(row["place"], tuple(row["change"])): row["reason"] for row in rows}


def main() -> int:
    """Judge the rooms that are named, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help=f"of {', '.join(ROOMS)}")
    parser.add_argument("--count", type=int, default=40, help="mutants a room")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    if unknown := set(arguments.rooms) - set(ROOMS):
        parser.error(f"no room {', '.join(sorted(unknown))}; there are {', '.join(ROOMS)}")
    reasons, bad = load_reasons(), False
    print(f"{'room':<10}{'mutants':>9}{'that count':>12}{'run':>6}{'killed':>8}{'by types':>10}{'share':>8}")
    for room in arguments.rooms or ROOMS:
        score = judge(room, arguments.count, arguments.seed, arguments.jobs)
        share = (score.killed + score.typed) / len(score.mutants)
        bad |= share < LEAST
        made = f"{score.total:>9}{score.meaningful:>12}{len(score.mutants):>6}"
        print(f"{room:<10}{made}{score.killed:>8}{score.typed:>10}{share:>8.1%}", flush=True)
        for mutant in score.mutants:
            if mutant.killed or mutant.typed:
                continue
            reason = reasons.get((mutant.place, mutant.change))
            bad |= reason is None
            what = "has no test" if mutant.exit_code == _UNTESTED else "lives"
            print(f"  {mutant.place} {what}: {reason or 'NO REASON'}")
            for line in mutant.change:
                print(f"      {line}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
