"""`make try-wheel`: the built wheels do what they promise, alone, in environments outside of the sources.

    python release/try_wheel.py --uv PATH WHEEL

Owns the list of what somebody tries first: versions, an emulated arm, the firmware, the analysers, and with extras
a shared arm, the pages and the node of ROS 2; of zenoh-ros2 alone, its talker and listener.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Seconds; an emulated processor is ten times slower.
PATIENCE = 300


class Trial:
    """An environment with the wheel, and a user's empty home."""

    def __init__(self, folder: Path) -> None:
        self.bin = folder / "venv/bin"
        self.folder = folder
        self._outputs = 0
        kept = {
            name: value for name, value in os.environ.items() if not name.startswith(("HEXWIRE_", "PYTHON", "XDG_"))
        }
        self.environment = kept | {
            "HOME": str(folder),
            "PATH": f"{self.bin}:{os.environ['PATH']}",
            "COLUMNS": "200",
        }

    def run(self, *words: str, status: int = 0, says: str = "") -> str:
        """Run a command, which must end with this status and say this.

        Raises:
            AssertionError: It does not.
        """
        done = subprocess.run(
            words,
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )
        text = done.stdout + done.stderr
        assert done.returncode == status, f"{' '.join(words)}: status {done.returncode}\n{text}"
        assert says in text, f"{' '.join(words)} does not say {says!r}:\n{text}"
        sys.stdout.write(f"ok  {' '.join(words)}\n")
        return text

    @contextlib.contextmanager
    def running(self, *words: str, says: str) -> Iterator[str]:
        """Run a command until the end of the block, which begins when it has said this; gives what matched.

        Raises:
            AssertionError: It does not say it.
        """
        self._outputs += 1
        output = self.folder / f"output {self._outputs}"
        with output.open("wb") as file:
            program = subprocess.Popen(
                words,
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.PIPE,
                stdout=file,
                stderr=subprocess.STDOUT,
            )
        try:
            deadline = time.monotonic() + PATIENCE
            while not (found := re.search(says, output.read_text(encoding="utf-8"))):
                ended = program.poll() is not None or time.monotonic() > deadline
                text = output.read_text(encoding="utf-8")
                assert not ended, f"{' '.join(words)} does not say {says!r}:\n{text}"
                time.sleep(0.05)
            yield found[0]
        finally:
            program.terminate()
            # Closes its standard input, too.
            program.communicate(timeout=PATIENCE)
        sys.stdout.write(f"ok  {' '.join(words)}\n")


def board(trial: Trial) -> None:
    """Move an emulated board on a serial port."""
    port = trial.folder / "arm"
    with trial.running("hexwire", "sim", "board", "--link", str(port), says=re.escape(str(port))):
        trial.run("hexwire", "probe", "--port", str(port), says="hex7bot")
        trial.run("hexwire", "move", "J1=10", "--wait", "--port", str(port))
        trial.run("hexwire", "state", "--port", str(port), says="J1")
        trial.run("hexwire", "firmware", "info", "--port", str(port), says="in this package 2.")
        flash = ("hexwire", "firmware", "flash", "--port", str(port), "--dry-run", "--any-port")
        trial.run(*flash, says="share/firmware/mega2560-115200.hex")


def shared(trial: Trial) -> None:
    """Read an emulated arm that another program shares."""
    with trial.running("hexwire", "serve", "--robot", "sim", "--name", "tried", says="as zenoh:tried"):
        trial.run("hexwire", "state", "--port", "zenoh:tried", says="J7")


def pages(trial: Trial) -> None:
    """Fetch the page of an emulated arm, as a browser does first."""
    with trial.running("hexwire", "studio", "--demo", "--no-browser", says=r"http://127\.0\.0\.1:\S+") as address:
        direct = urllib.request.build_opener(urllib.request.ProxyHandler({}), urllib.request.HTTPCookieProcessor())
        with direct.open(address, timeout=PATIENCE) as answer:
            assert "<title>" in answer.read().decode(), address


def ros(trial: Trial) -> None:
    """Let the node of an emulated arm meet the router, and end it."""
    trial.run("hexwire-ros2", "--help", says="trajectory_msgs/JointTrajectory")
    with trial.running("hexwire", "fleet", "router", says="7447"):
        node = ("hexwire-ros2", "--ros-args", "-p", "port:=sim://so101")
        with trial.running(*node, says="is ready at"):
            pass


def talk(trial: Trial) -> None:
    """Run the talker and the listener of the README of zenoh-ros2, with its own router."""
    page = (ROOT / "packages/zenoh-ros2/README.md").read_text(encoding="utf-8")
    texts = re.findall(r"```python notest\n(.*?)```", page, re.DOTALL)
    for name, text in zip(("listener.py", "talker.py"), texts, strict=True):
        (trial.folder / name).write_text(text, encoding="utf-8")
    with (
        trial.running("python", "-m", "zenoh_ros2", says="the router is at"),
        trial.running("python", "talker.py", says=""),
        trial.running("python", "listener.py", says=r"hello \d+"),
    ):
        pass


def environment(uv: str, python: str, folder: str) -> list[str]:
    """Make an environment in a folder; returns the command that installs into it."""
    subprocess.run([uv, "venv", "--quiet", "--python", python, f"{folder}/venv"], check=True)
    return [uv, "pip", "install", "--quiet", "--python", f"{folder}/venv"]


def main(arguments: list[str] | None = None) -> int:
    """Try the wheel; returns the exit status."""
    parser = argparse.ArgumentParser(description="try the wheel in an environment of its own")
    parser.add_argument("wheel", nargs="?", type=Path)
    parser.add_argument("--uv", default="uv", help="the program uv")
    parser.add_argument("--python", default=sys.executable, help="interpreter to try it with")
    options = parser.parse_args(arguments)
    wheel = options.wheel or next(iter(sorted((ROOT / "dist").glob("hexwire-*.whl"))), None)
    wire = next(iter(sorted((ROOT / "dist" if wheel is None else wheel.parent).glob("zenoh_ros2-*.whl"))), None)
    if wheel is None or wire is None:
        sys.stderr.write("no wheel in dist; run make dist first\n")
        return 2
    with tempfile.TemporaryDirectory(prefix="zenoh-ros2-try-") as name:
        install = environment(options.uv, options.python, name)
        subprocess.run([*install, str(wire.resolve())], check=True, cwd=name)
        trial = Trial(Path(name))
        trial.run("python", "-c", "import hexwire", status=1, says="No module named 'hexwire'")
        talk(trial)
    with tempfile.TemporaryDirectory(prefix="hexwire-try-") as name:
        install = environment(options.uv, options.python, name)
        trial = Trial(Path(name))
        subprocess.run([*install, str(wheel.resolve())], check=True, cwd=name)
        where = trial.run("python", "-c", "import hexwire; print(hexwire.__file__)", says=name)
        assert str(ROOT) not in where
        trial.run("hexwire", "--version", says=wheel.name.split("-")[1])
        trial.run("hexwire-ros1", "--package-path", says=name)
        board(trial)
        trial.run("hexwire", "demo", says="cycles")
        trial.run("hexwire", "--port", "sim://so101", "state", says="gripper")
        trial.run("hexwire", "studio", "--demo", status=2, says="pip install 'hexwire[studio]'")
        trial.run("hexwire", "serve", "--robot", "sim", status=1, says="pip install 'hexwire[fleet]'")
        for words in (("state", "--port", "zenoh:lab/arm1"), ("fleet", "list")):
            trial.run("hexwire", *words, status=2, says="pip install 'hexwire[fleet]'")
        for program in ("wireshark", "sigrok", "saleae"):
            trial.run("hexwire", "analyzers", "install", program)
        trial.run("hexwire", "analyzers", "list", says="installed")
        trial.run("hexwire", "analyzers", "remove", "sigrok", says="removed")
        trial.run("man", "-w", "hexwire", says="share/man/man1/hexwire.1")
        trial.run("sh", "-c", "_HEXWIRE_COMPLETE=zsh_source hexwire", says="compdef")
        subprocess.run(
            [*install, f"hexwire[fleet,ros2,studio] @ {wheel.resolve().as_uri()}", str(wire.resolve())],
            check=True,
            cwd=name,
        )
        shared(trial)
        pages(trial)
        ros(trial)
    sys.stdout.write("the wheels alone do all of this\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
