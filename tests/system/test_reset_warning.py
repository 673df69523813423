"""Every front warns before it opens the port of a board that may drive its arm to the middle pose."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from tests.emulator.terminals import serving

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve_pty import PtyServer

ROOT = Path(__file__).resolve().parent.parent.parent
PATIENCE = 30.0
PLUG_IN = ROOT / "integrations" / "lerobot" / "src" / "lerobot_robot_hexwire" / "connection.py"
HEXWIRE = (sys.executable, "-m", "hexwire.cli")
CONNECT = "import hexwire, sys\nhexwire.connect(sys.argv[1]).detach()\n"
ROS2 = "from hexwire.cli.__main__ import ros2\nros2()\n"
SERVOS = "from hexwire.studio.source import Source\nimport sys\nSource().open_bus(sys.argv[1])\n"
# Its package imports LeRobot; the connection itself does not.
LEROBOT = """
import pathlib, sys, types
folder = pathlib.Path(sys.argv[2]).parent
package = types.ModuleType("plug_in")
package.__path__ = [str(folder)]
sys.modules["plug_in"] = package
from importlib import import_module
connection = import_module("plug_in.connection")
connection.Connection(sys.argv[1], "hex7bot", degrees=True, patience=0.5).open()
"""

# Thirteen programs; tests/drivers/test_board_reset.py proves of every link that it is warned of.
pytestmark = [pytest.mark.system, pytest.mark.slow]


def fronts(port: str, image: Path) -> dict[str, tuple[str, ...]]:
    return {
        "cli": (*HEXWIRE, "state", "--port", port),
        "probe --all": (*HEXWIRE, "probe", "--all", "--port", port),
        "bus scan": (*HEXWIRE, "bus", "scan", "--port", port),
        "so101": (*HEXWIRE, "--robot", "so101", "state", "--port", port),
        "loopback": (*HEXWIRE, "loopback", "--port", port),
        "connect": (sys.executable, "-c", CONNECT, port),
        "lerobot": (sys.executable, "-c", LEROBOT, port, str(PLUG_IN)),
        "serve": (*HEXWIRE, "serve", "--name", "arm", "--port", port),
        "studio": (*HEXWIRE, "studio", "--port", port),
        "studio, page Servos": (sys.executable, "-c", SERVOS, port),
        "firmware flash": (*HEXWIRE, "firmware", "flash", "--any-port", "--hex", str(image), "--port", port),
        "gateway": (*HEXWIRE, "gateway", "--listen", "tcp://127.0.0.1:0", "--board", port),
        "ros2": (sys.executable, "-c", ROS2, "--ros-args", "-p", f"port:={port}"),
    }


def test_every_front_warns_before_it_opens_the_port(tmp_path: Path) -> None:
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path), "PYTHONUNBUFFERED": "1"}
    image = tmp_path / "some.hex"
    image.write_text(":00000001FF\n")
    board = make_hex7bot_board(dialect=1, faults=("sketch",), start=time.monotonic())
    with serving(PtyServer(board, reset_on_open=True)) as port:
        for name, words in fronts(port, image).items():
            program = subprocess.Popen(
                words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, cwd=ROOT
            )
            late = threading.Timer(PATIENCE, program.kill)
            late.start()
            try:
                assert program.stdout is not None
                said = []
                for line in program.stdout:
                    said.append(line)
                    if "opening it may reset the board" in line:
                        break
                else:
                    pytest.fail(f"{name} opened it without a warning: {''.join(said)}")
                assert "10 uF from RESET to GND prevents the reset" in said[-1], name
            finally:
                late.cancel()
                program.kill()
                program.communicate()
                late.join()
