"""What is asked of every thread of hexwire: none keeps a program from ending, none waits for ever by mistake."""

from __future__ import annotations

import ast
import re
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


def test_no_queue_is_waited_for_with_a_limit_that_may_be_missed() -> None:
    """`next_within` says why: a `SimpleQueue` with a limit may be waited for without one."""
    users, wrong = [], []
    for path in sorted(SOURCE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if not re.search(r"import .*SimpleQueue|queue\.SimpleQueue", text) or path.name == "system.py":
            continue
        users.append(path.name)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "get":
                told = {keyword.arg for keyword in node.keywords}
                if "timeout" in told:
                    wrong.append(f"{path.relative_to(SOURCE)}:{node.lineno}")
    assert {"client_goals.py", "workers.py", "live.py"} <= set(users)
    assert wrong == []
