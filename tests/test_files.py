"""Rules that every source file keeps."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SRC = ROOT / "src" / "hexwire"
MODULES = sorted(str(path.relative_to(SRC)) for path in SRC.rglob("*.py"))

# Written by schema/generate.py, whose own test covers them.
GENERATED = {"wire/tables.py"}


# What costs least comes first: to parse all of the source takes seconds.
_DOCSTRING = re.compile(r'"""\S')
_TALK = re.compile(r"\b(print|input|exit|quit)\b")


def _text(module: str) -> str:
    return (SRC / module).read_text(encoding="utf-8")


def _tree(module: str) -> ast.Module:
    return ast.parse(_text(module), filename=module)


def _talks_to_people(tree: ast.Module) -> list[str]:
    """Calls of print, input, exit and sys.exit, as `name:line`."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in {"print", "input", "exit", "quit", "sys.exit", "builtins.print"}:
                found.append(f"{name}:{node.lineno}")
    return found


def test_the_generated_files_exist() -> None:
    assert set(MODULES) >= GENERATED


def test_every_module_says_what_it_owns() -> None:
    unusual = [module for module in MODULES if not _DOCSTRING.match(_text(module))]
    silent = [module for module in unusual if not ast.get_docstring(_tree(module))]
    assert not silent, f"no docstring that says what it owns and what it must not know: {', '.join(silent)}"


def test_only_the_command_line_talks_to_people() -> None:
    others = [module for module in MODULES if not module.startswith("cli/") and _TALK.search(_text(module))]
    talk = {module: _talks_to_people(_tree(module)) for module in others}
    found = [f"{module}: {', '.join(calls)}" for module, calls in talk.items() if calls]
    assert not found, "\n".join(found)


def test_the_command_line_talks_through_the_one_place_that_cleans() -> None:
    """`cli/output.py` for what is written, `cli/draw.py` for what rich draws."""
    past = {"print", "click.echo", "click.secho", "sys.stdout.write", "sys.stderr.write"}
    drawn = {"Console", "Live", "Progress", "TextColumn"}
    found = []
    for module in MODULES:
        wrong = past if module == "cli/draw.py" else past | drawn
        if module.startswith("cli/"):
            calls = [node for node in ast.walk(_tree(module)) if isinstance(node, ast.Call)]
            found += [f"{module}:{call.lineno}" for call in calls if ast.unparse(call.func) in wrong]
    assert not found, f"say it with hexwire.cli.output: {', '.join(found)}"


def test_talk_would_be_seen() -> None:
    tree = ast.parse("def f():\n    print('x')\n    return sys.exit(1)\nlog.print('x')\n")
    assert _talks_to_people(tree) == ["print:2", "sys.exit:3"]


def test_no_test_skips_itself() -> None:
    """`make test` installs what the tests need: one that is skipped where something is missing would hide that."""
    skips = re.compile(r"\b(importorskip|skipif|pytest\.skip|mark\.skip|skipTest)\b")
    files = [path for path in (ROOT / "tests").rglob("*.py") if path != Path(__file__)]
    found = [str(path.relative_to(ROOT)) for path in files if skips.search(path.read_text(encoding="utf-8"))]
    assert not found, f"tests that may be skipped: {', '.join(found)}"


def test_tests_are_no_package() -> None:
    packages = [path for path in (ROOT / "tests").rglob("__init__.py") if "__pycache__" not in path.parts]
    assert packages == []
