"""No thread of hexwire keeps a program from ending, whatever the thread waits for."""

from __future__ import annotations

import ast
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "src/hexwire"


def test_every_thread_is_a_daemon() -> None:
    found, others = 0, []
    for path in sorted(SOURCE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("threading.Thread", "Thread"):
                found += 1
                said = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
                if said.get("daemon") != "True":
                    others.append(f"{path.relative_to(SOURCE)}:{node.lineno}")
    assert found > 30
    assert others == []
