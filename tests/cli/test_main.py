from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from hexwire.cli.main import COMMANDS, GROUPS, cli

SRC = Path(__file__).parents[2] / "src"


def run(*args: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(cli, list(args), prog_name="hexwire")
    return result.exit_code, result.stdout, result.stderr


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_row_of_the_table_leads_to_a_command_that_explains_itself(name: str) -> None:
    target, line = COMMANDS[name]
    module, _, attribute = target.partition(":")
    command = getattr(importlib.import_module(module), attribute)
    assert isinstance(command, click.Command)
    assert line.endswith(".")
    assert len(line) <= 70
    status, out, err = run(name, "--help")
    assert (status, err) == (0, "")
    assert out.startswith(f"Usage: hexwire {name}")
    assert "\n  " + (command.help or "").splitlines()[0][:40] in out


def test_help_fits_a_screen_and_names_every_command_once_in_its_group(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = run("--help")
    assert status == 0
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(COMMANDS)
    lines = out.splitlines()
    words = [line.split() for line in lines]
    for title, names in GROUPS.items():
        assert [*title.split(), *names] in words
    # 24 lines are a screen, and the shell needs one.
    assert len(lines) <= 23
    assert max(map(len, lines)) < 80


def test_help_in_detail_has_a_line_for_every_command() -> None:
    status, out, _ = run("-v", "--help")
    assert status == 0
    assert "'hexwire sim board'" in out
    for name, (_, line) in COMMANDS.items():
        assert f"  {name} " in out
        assert line in out


def test_help_imports_no_command_and_nothing_heavy() -> None:
    code = (
        "import sys\nfrom hexwire.cli.main import cli\n"
        "try:\n    cli.main(['--help'], prog_name='hexwire')\n"
        "except SystemExit as end:\n    assert end.code == 0\n"
        "print(*sorted(sys.modules), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    loaded = set(done.stderr.split())
    modules = {target.partition(":")[0] for target, _ in COMMANDS.values()}
    assert "hexwire.cli.main" in loaded
    assert not loaded & modules
    assert not loaded & {"rich", "serial", "numpy", "hexwire.wire", "hexwire.ipc", "hexwire.emulator"}


def test_without_a_command_it_shows_help_as_a_usage_error() -> None:
    status, out, err = run()
    assert (status, out) == (2, "")
    assert "Usage: hexwire" in err


def test_version() -> None:
    status, out, _ = run("--version")
    assert status == 0
    assert out.startswith("hexwire ")
    assert out.split()[1][0].isdigit()


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (["stat"], "error: no command 'stat'; did you mean 'state'? (see 'hexwire --help')\n"),
        (["home"], "error: no command 'home'; did you mean 'goto home'? (see 'hexwire --help')\n"),
        (["qqqqq"], "error: no command 'qqqqq' (see 'hexwire --help')\n"),
        (["--qqqqqq"], "error: No such option '--qqqqqq'"),
        (["ping", "--dialect", "3"], "error: Invalid value for '--dialect': 3 is not in the range 1<=x<=2"),
        (["torque"], "error: Missing argument 'on|off'"),
        (["sim", "bord"], "error: No such command 'bord'"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_2(args: list[str], text: str) -> None:
    status, out, err = run(*args)
    assert (status, out) == (2, "")
    assert err.startswith(text)
    assert err.count("\n") == 1
    assert " --help')" in err


def test_the_module_runs_as_the_program() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hexwire.cli", "--version"], capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("hexwire ")


@pytest.mark.parametrize("program", ["main", "ros1", "ros2"])
def test_ctrl_c_while_the_program_loads_ends_it_without_a_traceback(tmp_path: Path, program: str) -> None:
    (tmp_path / "click.py").write_text("import signal\nsignal.raise_signal(signal.SIGINT)\n")
    done = subprocess.run(
        [sys.executable, "-c", f"from hexwire.cli.__main__ import {program}; {program}()", "--version"],
        capture_output=True,
        check=False,
        timeout=60,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, b"", b"")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_can_be_set_up(shell: str) -> None:
    env = {"_HEXWIRE_COMPLETE": f"{shell}_source", "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        [sys.executable, "-c", "from hexwire.cli.main import main; main()"],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env=env,
    )
    assert done.returncode == 0
    assert "_hexwire_completion" in done.stdout
