"""Every command that reads a file refuses a pipe at once: reading one waits for a writer that may never come."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import click
import pytest
from click.testing import CliRunner

from hexwire.cli.main import cli
from hexwire.cli.options import InputFile
from hexwire.inputs import open_file

_PATIENCE = 30
_WRITES = ["--plot", "--csv", "--save", "--output", "--link", "--record", "--record-ros2"]
"""Options that name what is written; `tests/test_new_file.py` has these."""
_ELSEWHERE = {
    # A joystick is a device, and opened as one (`tests/joystick/test_device.py`).
    "teleop --device",
    # What is written, or a folder.
    "bus backup file", "bus calibrate file", "teach file", "studio --recordings", "cert issue folder",
    "cert new folder", "fleet config folder", "model ros2-package folder", "record ros2 folder",
    "analyzers install --folder", "analyzers remove --folder", "studio --urdf",
}  # fmt: skip
_ROUTER = "--router tls/127.0.0.1:1"
_READS = {
    "bus calibrate --from": "bus calibrate so101 OUT --from PIPE --port sim://so101",
    "bus diff file": "bus diff PIPE --port sim://so101",
    "bus restore file": "bus restore PIPE --port sim://so101 --yes",
    "conf check file": "conf check PIPE",
    "firmware build --source": "firmware build --source PIPE",
    "firmware flash --hex": "firmware flash --hex PIPE --port /dev/null --any-port",
    "firmware flash --source": "firmware flash --source PIPE --port /dev/null --any-port",
    "firmware info --source": "firmware info --source PIPE --port sim://hex7bot",
    "fleet config certificates": "fleet config DIR PIPE",
    "fleet play file": "fleet play PIPE --on a",
    "fleet router --access": "fleet router --access PIPE --listen tls/127.0.0.1:1",
    "fleet router --zenoh-config": "fleet router --zenoh-config PIPE",
    "joystick send --conf": "joystick send PIPE --conf PIPE",
    "teleop --conf": "teleop --conf PIPE --port sim://hex7bot",
    "model ik place": "model ik PIPE",
    "goto --links": "goto 0 220 200 --links PIPE --port sim://hex7bot",
    "line --links": "line 0 220 200 --links PIPE --port sim://hex7bot",
    "model check --links": "model check 0 0 0 0 0 --links PIPE",
    "model fk --links": "model fk 0 0 0 0 0 0 --links PIPE",
    "model ik --links": "model ik 0 220 200 --links PIPE",
    "model ros2-package --links": "model ros2-package DIR --links PIPE",
    "model urdf --links": "model urdf --links PIPE",
    "move --links": "move J1=1 --links PIPE --port sim://hex7bot",
    "play --links": "play GOOD.json --links PIPE --port sim://hex7bot",
    "serve --links": "serve --links PIPE --port sim://hex7bot",
    "studio --links": "studio --links PIPE --port sim://hex7bot",
    "teleop --links": "teleop --links PIPE --port sim://hex7bot",
    "tip --links": "tip --links PIPE --port sim://hex7bot",
    "play file": "play PIPE --port sim://hex7bot",
    "record export file": "record export PIPE OUT.csv",
    "record info file": "record info PIPE",
    "record plot file": "record plot PIPE OUT.png",
    "record recover file": "record recover PIPE OUT.mcap",
    "record replay file": "record replay PIPE",
    "record ros2 file": "record ros2 PIPE DIR",
    "serve --config": "serve --config PIPE",
    "serve --access": "serve --access PIPE --port sim://hex7bot --listen tls/127.0.0.1:1",
    "studio --password-file": "studio --password-file PIPE --no-browser",
    "trace decode file": "trace decode PIPE",
    **{
        f"{command} {option}": f"{command} {rest} --ca PIPE --cert PIPE --key PIPE"
        for command, rest in (
            ("fleet list", _ROUTER), ("fleet play", f"GOOD.json --on a {_ROUTER}"), ("fleet watch", _ROUTER),
            ("fleet router", _ROUTER), ("fleet stop", f"a {_ROUTER}"), ("fleet record", f"OUT.mcap {_ROUTER}"),
            ("serve", f"--port sim://hex7bot {_ROUTER}"), ("sim puma260", "--tcp 127.0.0.1:0"),
            ("studio", "--no-browser"),
        )
        for option in ("--ca", "--cert", "--key")
    },
}  # fmt: skip
"""A command line that reads it, for each parameter that names a file."""


def _named(command: click.Command, path: tuple[str, ...] = ()) -> Iterator[str]:
    """Every parameter of every command that names a file, as ``record info file``."""
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from _named(below, (*path, name))
    for one in command.params:
        shown = (getattr(one, "metavar", None) or one.name or "").upper()
        words = ("FILE", "FOLDER", "PATH", "CERT", "DIR", "SOURCE")
        if one.type.name in ("file", "filename", "path", "directory") or any(word in shown for word in words):
            if getattr(one, "is_flag", False) or not path or set(one.opts) & set(_WRITES):
                continue
            yield " ".join((*path, one.opts[0]))


def test_every_parameter_that_names_a_file_is_known_here() -> None:
    assert set(_named(cli)) == {*_READS, *_ELSEWHERE}


@pytest.fixture
def own_signals() -> Iterator[None]:
    """Some commands listen to signals; the test's own alarm ends one that waits."""
    numbers = (signal.SIGALRM, signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [(number, signal.getsignal(number)) for number in numbers]
    try:
        yield
    finally:
        signal.alarm(0)
        for number, handler in before:
            signal.signal(number, handler)


class _Alarm:
    """Ends a command that waits, not one that computes: a busy machine takes long to import what it needs."""

    def __init__(self) -> None:
        self._used = time.thread_time()
        signal.signal(signal.SIGALRM, self._ring)
        signal.alarm(_PATIENCE)

    def _ring(self, number: int, frame: object) -> None:
        before, self._used = self._used, time.thread_time()
        if self._used - before < 0.1:
            raise TimeoutError("it waits for the pipe")
        signal.alarm(_PATIENCE)


@pytest.mark.usefixtures("own_signals")
def test_no_command_waits_for_a_pipe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("PIPE")
    points = [{"time_from_start": at, "positions": [0.1 * at]} for at in (0, 1)]
    Path("GOOD.json").write_text(json.dumps({"joint_names": ["J1"], "points": points}))
    for line in dict.fromkeys(_READS.values()):
        _Alarm()
        ended = CliRunner().invoke(cli, line.replace("PIPE", "./PIPE").split())
        signal.alarm(0)
        # A stop through a router that cannot be asked is not confirmed, which is a fault of the device.
        expected = 1 if line.startswith("fleet stop") else 2
        assert ended.exit_code == expected, f"hexwire {line}: {ended.output}{ended.exception!r}"
        assert "PIPE" in ended.output, f"hexwire {line}: {ended.output}"


def test_a_file_is_opened_once_before_anything_else_and_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = list[IO[bytes]]()

    def counted(path: str) -> IO[bytes]:
        opened.append(open_file(path))
        return opened[-1]

    monkeypatch.setattr("hexwire.inputs.open_file", counted)
    (tmp_path / "frames").write_text("FF FF 01 02 01 FB\n")
    assert CliRunner().invoke(cli, ["trace", "decode", str(tmp_path / "frames")]).exit_code == 0
    assert [file.closed for file in opened] == [True]
    ended = CliRunner().invoke(cli, ["record", "export", str(tmp_path / "none"), str(tmp_path / "out.csv")])
    assert (ended.exit_code, ended.stderr) == (
        2,
        f"error: {tmp_path / 'none'}: cannot be read: No such file or directory\n",
    )
    assert not (tmp_path / "out.csv").exists()


def test_a_shell_offers_files() -> None:
    context = click.Context(cli)
    assert [item.type for item in InputFile().shell_complete(context, cli.params[0], "x")] == ["file"]
