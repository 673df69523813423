"""What `import hexwire` loads, and what its lazy names lead to."""

from __future__ import annotations

import ast
import importlib
import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

import hexwire
import zenoh_ros2

HEAVY = {"rich", "click", "numpy", "serial", "cryptography"}


def _loaded_by(statement: str) -> set[str]:
    """Names of the modules that a fresh interpreter holds after `statement`."""
    program = f"import json, sys; {statement}; print(json.dumps(sorted(sys.modules)))"
    result = subprocess.run(
        [sys.executable, "-I", "-c", program], check=True, capture_output=True, text=True, timeout=60
    )
    return set(json.loads(result.stdout))


def _statements(path: Path) -> Iterator[ast.AST]:
    """All statements of a file, however deep; no expressions, which are most of a file and import nothing."""
    todo: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while todo:
        node = todo.pop()
        yield node
        for name in ("body", "orelse", "finalbody", "handlers", "cases"):
            todo += getattr(node, name, ())


def _imports(source: Path) -> dict[str, set[str]]:
    """Which modules below `source` each of them imports: at the top, in functions, for the type checker only."""
    files = {
        ".".join(path.relative_to(source).with_suffix("").parts).removesuffix(".__init__"): path
        for path in sorted(source.rglob("*.py"))
    }
    graph: dict[str, set[str]] = {}
    for module, path in files.items():
        package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
        found: set[str] = set()
        for node in _statements(path):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                above = package[: len(package) - node.level + 1] if node.level else []
                base = ".".join([*above, *([node.module] if node.module else [])])
                # What is imported from a package may be a module of it, or a name in its __init__.
                found |= {name if (name := f"{base}.{alias.name}") in files else base for alias in node.names}
        graph[module] = {name for name in found if name in files and name != module}
    return graph


def _circle(graph: Mapping[str, set[str]]) -> list[str]:
    """The modules of one circle, the first again at the end; empty if there is none."""
    done: set[str] = set()
    for start in sorted(graph):
        path: list[str] = []
        todo = [iter([start])]
        while todo:
            module = next(todo[-1], None)
            if module is None:
                todo.pop()
                if path:
                    done.add(path.pop())
            elif module in path:
                return [*path[path.index(module) :], module]
            elif module not in done:
                path.append(module)
                todo.append(iter(sorted(graph[module])))
    return []


def test_no_modules_import_each_other_in_a_circle() -> None:
    circle = _circle(_imports(Path(hexwire.__file__).parents[1])) or _circle(
        _imports(Path(zenoh_ros2.__file__).parents[1])
    )
    assert not circle, f"modules import each other in a circle: {' -> '.join(circle)}; move what they share"


def test_a_circle_would_be_seen(tmp_path: Path) -> None:
    texts = {
        "room/__init__.py": "",
        "room/a.py": "import os\nfrom . import b",
        "room/b.py": "def late():\n    from room.deep.c import name",
        "room/deep/__init__.py": "",
        "room/deep/c.py": "if TYPE_CHECKING:\n    from ..d import name",
        "room/d.py": "import room.a",
        "room/e.py": "from room import a, d",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert _circle(_imports(tmp_path)) == ["room.a", "room.b", "room.deep.c", "room.d", "room.a"]
    (tmp_path / "room/d.py").write_text("import room.deep")
    assert _circle(_imports(tmp_path)) == []


def _importers(source: Path, name: str) -> list[str]:
    """Files below `source` that import a module of this name or one inside it, at any line."""

    def modules(node: ast.AST) -> list[str]:
        if isinstance(node, ast.Import):
            return [alias.name for alias in node.names]
        return [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []

    return [
        str(path.relative_to(source))
        for path in sorted(source.rglob("*.py"))
        if name in path.read_text(encoding="utf-8")
        for node in _statements(path)
        if any(module.split(".")[0] == name for module in modules(node))
    ]


def test_one_module_of_a_distribution_imports_zenoh() -> None:
    assert _importers(Path(hexwire.__file__).parent, "zenoh") == ["fleet/node.py"]
    assert _importers(Path(zenoh_ros2.__file__).parent, "zenoh") == ["zenoh_session.py"]


def test_import_hexwire_loads_nothing_heavy() -> None:
    loaded = _loaded_by("import hexwire")
    assert not HEAVY & loaded


def test_import_hexwire_loads_no_layer() -> None:
    loaded = {name for name in _loaded_by("import hexwire") if name.split(".")[0] == "hexwire"}
    assert loaded == {"hexwire", "hexwire.errors"}


def test_a_heavy_import_would_be_seen() -> None:
    assert HEAVY & _loaded_by("import hexwire, click") == {"click"}


def test_every_public_name_resolves() -> None:
    for name in hexwire.__all__:
        assert getattr(hexwire, name) is not None, name
        assert name in dir(hexwire), name


def test_the_names_that_the_page_for_persons_lists_are_public() -> None:
    page = (Path(__file__).parents[1] / "docs" / "python.md").read_text(encoding="utf-8")
    table = page.partition("## Names\n")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    listed = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert len(listed) > 10
    assert set(listed) <= set(hexwire.__all__)


def test_lazy_names_are_those_the_type_checker_sees() -> None:
    tree = ast.parse(Path(hexwire.__file__).read_text(encoding="utf-8"))
    seen = {
        alias.asname or alias.name: node.module
        for block in tree.body
        if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == hexwire._LAZY
    assert set(seen) <= set(hexwire.__all__)


def test_a_lazy_name_is_the_object_of_its_module() -> None:
    for name, module in hexwire._LAZY.items():
        assert getattr(hexwire, name) is getattr(importlib.import_module(module), name), name


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        hexwire.nonsense  # noqa: B018
