"""examples/first_steps.ipynb: it runs from top to bottom, and is stored without what it shows."""

from __future__ import annotations

import ast
import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
NOTEBOOK = EXAMPLES / "first_steps.ipynb"


def cells(path: Path, kind: str) -> list[dict[str, Any]]:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    return [cell for cell in notebook["cells"] if cell["cell_type"] == kind]


def test_every_notebook_is_listed_and_tried_here() -> None:
    assert NOTEBOOKS == [NOTEBOOK]
    assert f"({NOTEBOOK.name})" in (EXAMPLES / "README.md").read_text(encoding="utf-8")


def test_a_notebook_is_stored_without_outputs() -> None:
    """They differ in each run, and a picture in them is larger than the notebook."""
    for path in NOTEBOOKS:
        for cell in cells(path, "code"):
            assert (cell["outputs"], cell["execution_count"], cell["metadata"]) == ([], None, {}), cell["id"]


def test_it_needs_nothing_deeper_than_hexwire() -> None:
    code = "\n".join("".join(cell["source"]) for cell in cells(NOTEBOOK, "code"))
    modules = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            modules.add(node.module or "")
    assert modules == {"hexwire", "math", "matplotlib.pyplot"}


@pytest.mark.slow
@pytest.mark.system
def test_it_runs_from_top_to_bottom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import nbformat
    from nbclient import NotebookClient

    # That of a person, not that of a test; and no kernel but ours.
    for name in ("HOME", "XDG_RUNTIME_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.delenv("HEXWIRE_PORT", raising=False)
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    client = NotebookClient(
        notebook, timeout=60, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    shown, said = [], ""
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            shown += [kind for kind in output.get("data", {}) if kind != "text/plain"]
            said += output.get("text", "")
    assert shown == ["text/html", "image/svg+xml", "image/svg+xml", "image/png"]
    for words in ("there after", "is outside its limits", "the tip is at", "a stop command has stopped the arm"):
        assert words in said, said
    assert (tmp_path / "first_steps.mcap").is_file()


MOVES = """
import hexwire
from hexwire import deg
arm = hexwire.connect("sim://so101", speed=1.0)
motion = arm.move({arm.model.names[0]: deg(40)}, relative=True, duration=60.0, wait=False)
"""
SAYS = """
try:
    motion.wait(30)
except hexwire.StoppedError:
    print("stopped", arm.read().stopped)
"""


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.parametrize("where", ["between cells", "in another cell"])
def test_the_stop_button_stops_what_an_earlier_cell_has_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    for name in ("HOME", "XDG_RUNTIME_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path))
    asyncio.run(pressed(where))


async def pressed(where: str) -> None:
    """Begin a motion in one cell, and press the button."""
    from jupyter_client.manager import start_new_async_kernel

    manager, kernel = await start_new_async_kernel(kernel_name="python3")
    said: list[str] = []
    inside = asyncio.Event()

    def hear(message: dict[str, Any]) -> None:
        said.append(message["content"].get("text", ""))
        if said[-1] == "inside\n":
            inside.set()

    async def run(code: str) -> str:
        answer = await kernel.execute_interactive(code, timeout=60, output_hook=hear)
        return str(answer["content"].get("ename", "ok"))

    try:
        assert await run(MOVES) == "ok"
        if where == "in another cell":
            cell = asyncio.create_task(run("import time; print('inside', flush=True); time.sleep(50)"))
            await inside.wait()
        await manager.interrupt_kernel()
        if where == "in another cell":
            assert await cell == "KeyboardInterrupt"
        assert await run(SAYS) == "ok"
        assert "stopped True" in "".join(said)
        # A button that has nothing to end does nothing.
        await manager.interrupt_kernel()
        assert await run("arm.detach(); print('detached')") == "ok"
        assert "detached" in "".join(said)
    finally:
        kernel.stop_channels()
        await manager.shutdown_kernel(now=True)
