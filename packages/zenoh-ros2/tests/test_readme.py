"""The programs of README.md, as somebody types them: a router, a listener and a talker."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tests.link.far_ends import free_port

import zenoh_ros2

PACKAGE = Path(__file__).resolve().parents[1]
PAGE = (PACKAGE / "README.md").read_text(encoding="utf-8")
TEXTS = re.findall(r"```python notest\n(.*?)```", PAGE, re.DOTALL)
PROGRAMS = dict(zip(("listener.py", "talker.py"), TEXTS, strict=True))


@pytest.mark.system
def test_a_talker_and_a_listener(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    kept = {name: text for name, text in os.environ.items() if not name.startswith(("ROS_", "ZENOH_"))}
    override = f"connect/endpoints={json.dumps([endpoint])}"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "cwd": tmp_path}
    for name, text in PROGRAMS.items():
        assert len(text.splitlines()) <= 10
        (tmp_path / name).write_text(text)

    def run(*words: str) -> subprocess.Popen[str]:
        environment = kept | {"ZENOH_CONFIG_OVERRIDE": override}
        return subprocess.Popen([sys.executable, *words], env=environment, **pipes)  # type: ignore[call-overload]

    with run("-m", "zenoh_ros2", "--listen", endpoint) as router:
        assert "the router is at" in router.stdout.readline()
        with run("listener.py") as listener, run("talker.py") as talker:
            assert listener.stdout.readline() == "Enter ends it\n"
            assert re.fullmatch(r"hello \d+\n", listener.stdout.readline())
            listener.communicate("\n", timeout=30)
            talker.communicate(timeout=60)
            assert (listener.returncode, talker.returncode) == (0, 0)
        router.terminate()


def test_what_the_page_lists_is_there() -> None:
    table = PAGE.partition("## What it does\n")[2].partition("\n## ")[0]
    names = set(re.findall(r"`([A-Z]\w+)(?:\.\w+)?`", table)) - set(re.findall(r"`([A-Z]+_[A-Z_]+)`", table))
    assert {"ActionServer", "Node", "Types"} <= names <= set(zenoh_ros2.__all__)
    listed = set(re.findall(r"\w+", PAGE.partition("packages are included: ")[2].partition(";")[0]))
    folders = {path.name for path in (Path(zenoh_ros2.__file__).parent / "interfaces").iterdir()} - {"variants"}
    assert listed == folders
    for each in zenoh_ros2.Distribution:
        assert each.name.capitalize() in PAGE.partition("## Which ROS 2\n")[2]
