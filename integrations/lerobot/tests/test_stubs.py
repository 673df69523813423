"""The stubs with which the type checker reads the plug-in, beside LeRobot itself."""

from __future__ import annotations

import ast
import inspect
from importlib import import_module
from pathlib import Path

import pytest

STUBS = Path(__file__).parents[1] / "stubs"
FILES = sorted(file for file in STUBS.rglob("*.pyi") if file.read_text().strip())


def parameters(function: ast.FunctionDef) -> list[str]:
    return [one.arg for one in function.args.args]


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(STUBS)))
def test_lerobot_has_what_the_stubs_say(file: Path) -> None:
    parts = file.relative_to(STUBS).with_suffix("").parts
    module = import_module(".".join(part for part in parts if part != "__init__"))
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.FunctionDef):
            assert list(inspect.signature(getattr(module, node.name)).parameters) == parameters(node)
        elif isinstance(node, ast.ClassDef):
            found = getattr(module, node.name)
            assert inspect.isclass(found)
            for one in node.body:
                if isinstance(one, ast.FunctionDef):
                    member = inspect.getattr_static(found, one.name)
                    if isinstance(member, property):
                        assert any(ast.unparse(word).endswith("property") for word in one.decorator_list)
                    elif not isinstance(member, classmethod):
                        assert list(inspect.signature(member).parameters) == parameters(one), one.name
                elif isinstance(one, ast.Assign):
                    assert hasattr(found, ast.unparse(one.targets[0]))
