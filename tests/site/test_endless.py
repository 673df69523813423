"""Commands of the pages that end when somebody ends them: each is started as a program, says that it is at work,
and ends as with Ctrl-C. `test_blocks.py` runs those that end by themselves.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.emulator.terminals import serving
from tests.link.far_ends import free_port
from tests.site.shell import ELSEWHERE, ENDLESS, commands, matches, parse_mentioned, split
from tests.site.test_blocks import ALL, MADE_UP, OWN, OWN_ARM, PAGES, inline_commands
from tests.waits import PATIENCE

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.serve_pty import PtyServer

ROOT = Path(__file__).resolve().parents[2]
NOT_HERE = {
    # Two calibrated arms.
    r"^hexwire follow leader\.toml@": "tests/test_so101_page.py",
    # A screen.
    r"--view\b": "tests/cli/test_sim_view.py",
    # It ends by itself, on an arm in a program of its own.
    r"^hexwire sim hand\b": "tests/cli/test_sim_hand.py",
    # A camera.
    r"^hexwire (studio|serve) .*--camera\b": "tests/studio/test_camera_views.py",
    # The certificates of another page.
    r"^hexwire studio .*--cert\b": "tests/studio/test_listening.py",
}
"""Those that cannot be started here -> the test that has what they need."""
WARNING = re.compile(rb"^warning: .*(\n|$)", re.MULTILINE)
BUS = r"^hexwire bus\b|--robot so10[01]\b"


def printed() -> dict[str, str]:
    """Every such command of a page's blocks and tables -> where it is."""
    found: dict[str, str] = {}
    for page in PAGES:
        if page in OWN_ARM:
            continue
        blocks = () if page in OWN else ALL[page]
        lines = [
            (line, block.line)
            for block in blocks
            if block.language == "console"
            for line, _ in commands(block.text)
        ]
        lines += [(row.command, row.line) for row in inline_commands(page) if row.table]
        for line, number in lines:
            for words in split(line):
                command = " ".join(words).removeprefix(".venv/bin/")
                endless = command.startswith("hexwire ") and matches(ENDLESS, command)
                if endless and not MADE_UP.search(command) and parse_mentioned(command.split()):
                    found.setdefault(command, f"{page}:{number}")
    return {command: at for command, at in found.items() if not matches(ELSEWHERE, command)}


PRINTED = printed()
HERE = {command: at for command, at in PRINTED.items() if not matches(NOT_HERE, command)}


def test_what_is_not_started_here_is_in_the_test_that_is_named() -> None:
    for pattern, test in NOT_HERE.items():
        assert any(re.search(pattern, command) for command in PRINTED), f"no page has {pattern} any more"
        assert (ROOT / test).is_file(), test


@pytest.fixture
def ports(tmp_path: Path) -> Iterator[dict[str, str]]:
    """A port of its own for each name of a serial port, with a board or with servos."""
    start = time.monotonic()
    with ExitStack() as stack:
        yield {
            name: stack.enter_context(serving(PtyServer(device)))
            for name, device in (
                ("/dev/ttyACM0", make_hex7bot_board(start=start)),
                ("/dev/ttyACM1", make_hex7bot_board(start=start)),
                ("/dev/ttyUSB0", make_hex7bot_board(start=start)),
                ("servos", BusDevice(make_bus_arm("so101", start=start).servos)),
            )
        }


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.parametrize("command", HERE)
def test_it_is_at_work_until_it_is_ended(command: str, ports: dict[str, str], tmp_path: Path) -> None:
    at = f"{HERE[command]}: {command}"
    servos = re.search(BUS, command) is not None

    def stands_for(match: re.Match[str]) -> str:
        return ports["servos"] if servos else ports[match[0]]

    line = re.sub(r"/dev/tty\w+", stands_for, command)
    made = "--link" in command
    line = line.replace(
        "/tmp/arm", str(tmp_path / "arm") if made else ports["servos" if servos else "/dev/ttyUSB0"]
    )
    line = line.replace(":15040", f":{free_port()}").replace("mq:///arms", f"mq:///hexwire-pages-{os.getpid()}")
    words = split(line)[0][1:]
    own = {name: str(tmp_path) for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "XDG_CONFIG_HOME", "HOME")}
    port = ports["servos" if servos else "/dev/ttyUSB0"]
    with subprocess.Popen(
        [sys.executable, "-m", "hexwire.cli", *words],
        cwd=tmp_path,
        env=os.environ | own | {"HEXWIRE_PORT": port, "PYTHONUNBUFFERED": "1", "BROWSER": "true"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as program:
        try:
            assert program.stdin is not None
            assert program.stdout is not None
            program.stdin.write(b"y\n")  # teach asks
            program.stdin.flush()
            said = b""
            while not (told := WARNING.sub(b"", said).strip()):
                more = os.read(program.stdout.fileno(), 65536)
                assert more, f"{at}: it ended: {said!r}"
                said += more
            assert not told.startswith(b"error: "), f"{at}: {said!r}"
            program.send_signal(signal.SIGINT)
            said += program.communicate(timeout=PATIENCE)[0]
        finally:
            program.kill()
    assert program.returncode in (0, 130), f"{at}: {program.returncode}, {said!r}"
    assert b"Traceback" not in said, f"{at}: {said!r}"
