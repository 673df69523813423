"""`hexwire studio`: what it prints, and what it refuses."""

from __future__ import annotations

import re
import signal
import subprocess
import sys

import pytest
from click.testing import CliRunner

from hexwire.cli.main import cli


@pytest.mark.system
def test_demo_prints_both_addresses_and_ends_at_ctrl_c() -> None:
    command = [sys.executable, "-m", "hexwire.cli", "studio", "--demo"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(2)]
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert re.fullmatch(r"operate: http://127\.0\.0\.1:\d+/\?token=[\w-]{43}\n", lines[0])
    assert re.fullmatch(r"watch:   http://127\.0\.0\.1:\d+/\?token=[\w-]{43}\n", lines[1])
    assert lines[0].split()[1] != lines[1].split()[1]
    assert process.returncode == 0
    assert errors == "the studio has ended\n"


def test_demo_and_port_contradict_each_other() -> None:
    result = CliRunner().invoke(cli, ["studio", "--demo", "--port", "/dev/null"])
    assert result.exit_code == 2
