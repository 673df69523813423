"""`python -m hexwire`."""

from __future__ import annotations

import subprocess
import sys

import pytest

import hexwire


@pytest.mark.system
def test_it_is_the_program_hexwire() -> None:
    for words, status in ((["--version"], 0), (["conf", "--nonsense"], 2)):
        done = [
            subprocess.run([sys.executable, "-m", name, *words], capture_output=True, text=True, check=False)
            for name in ("hexwire", "hexwire.cli")
        ]
        assert [run.returncode for run in done] == [status, status]
        assert (done[0].stdout, done[0].stderr) == (done[1].stdout, done[1].stderr)
        if not status:
            assert done[0].stdout == f"hexwire {hexwire.__version__}\n"
