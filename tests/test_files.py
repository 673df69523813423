"""Rules that every source file keeps."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SRC = ROOT / "src" / "hexwire"
MODULES = sorted(str(path.relative_to(SRC)) for path in SRC.rglob("*.py"))

# Written by schema/generate.py, whose own test covers them.
GENERATED = {"wire/tables.py"}
MAX_LINES = 500


def _tree(module: str) -> ast.Module:
    return ast.parse((SRC / module).read_text(encoding="utf-8"), filename=module)


def _talks_to_people(tree: ast.Module) -> list[str]:
    """Calls of print, input, exit and sys.exit, as `name:line`."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in {"print", "input", "exit", "quit", "sys.exit", "builtins.print"}:
                found.append(f"{name}:{node.lineno}")
    return found


def _mirror(module: str) -> Path:
    """The test file of a module: wire/checksum.py has tests/wire/test_checksum.py."""
    path = Path(module)
    return ROOT / "tests" / path.parent / f"test_{path.stem.strip('_')}.py"


def test_the_generated_files_exist() -> None:
    assert set(MODULES) >= GENERATED


@pytest.mark.parametrize("module", MODULES)
def test_module_has_a_docstring(module: str) -> None:
    assert ast.get_docstring(_tree(module)), "say what the module owns and what it must not know"


@pytest.mark.parametrize("module", sorted(set(MODULES) - GENERATED))
def test_module_is_short_or_says_why_not(module: str) -> None:
    lines = len((SRC / module).read_text(encoding="utf-8").splitlines())
    reason = f"{MAX_LINES} lines" in (ast.get_docstring(_tree(module)) or "")
    assert lines <= MAX_LINES or reason, (
        f"{lines} lines; split it, or give the reason in its docstring ('Over {MAX_LINES} lines because ...')"
    )


@pytest.mark.parametrize("module", [module for module in MODULES if not module.startswith("cli/")])
def test_only_the_command_line_talks_to_people(module: str) -> None:
    assert _talks_to_people(_tree(module)) == []


def test_talk_would_be_seen() -> None:
    tree = ast.parse("def f():\n    print('x')\n    return sys.exit(1)\nlog.print('x')\n")
    assert _talks_to_people(tree) == ["print:2", "sys.exit:3"]


@pytest.mark.parametrize(
    "module", [module for module in MODULES if Path(module).name != "__init__.py" and module not in GENERATED]
)
def test_module_has_a_test_file(module: str) -> None:
    assert _mirror(module).is_file(), f"expected {_mirror(module).relative_to(ROOT)}"


def test_tests_are_no_package() -> None:
    packages = [path for path in (ROOT / "tests").rglob("__init__.py") if "__pycache__" not in path.parts]
    assert packages == []
