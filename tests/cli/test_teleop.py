"""The commands around sticks."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.link.far_ends import free_port

from hexwire.cli.main import cli
from hexwire.joystick.channel import JoystickReceiver
from hexwire.wire.robot_bodies import JoystickState

# -- the commands -----------------------------------------------------------------------------------


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, list(words))


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (("joystick", "send"), 2, "name the destination with --to URL or --conf FILE"),
        (("joystick", "send", "--to", "udp://127.0.0.1:1", "--conf", "x"), 2, "name the destination"),
        (("joystick", "send", "/none/js0", "--to", "udp://127.0.0.1:1"), 1, "there is no such device"),
        (("joystick", "show", "/none/event3"), 1, "there is no such device"),
        (("teleop", "--device", "a", "--from", "b"), 2, "give only one of --device, --from and --conf"),
        (("teleop", "--speed", "2", "--port", "/dev/x"), 2, "--speed 2 exceeds the joints' speed limits"),
        (("teleop", "--device", "/none/js0", "--port", "/dev/x"), 1, "there is no such device"),
        (("teleop", "--conf", "/none/x.conf", "--port", "/dev/x"), 2, "cannot be read"),
    ],
)
def test_mistakes(words: tuple[str, ...], status: int, text: str) -> None:
    result = run(*words)
    assert (result.exit_code, text in result.stderr) == (status, True), result.stderr
    assert result.stderr.count("\n") == 1


def test_no_joystick_is_no_error() -> None:
    result = run("joystick", "list")
    assert result.exit_code == 0


@pytest.mark.system
def test_a_joystick_is_sent_over_a_channel(tmp_path: Path) -> None:
    device, port = tmp_path / "js0", free_port()
    os.mkfifo(device)
    command = [
        sys.executable,
        "-m",
        "hexwire.cli",
        "joystick",
        "send",
        str(device),
        "--to",
        f"udp://127.0.0.1:{port}",
    ]
    with JoystickReceiver.from_url(f"udp-listen://127.0.0.1:{port}") as receiver:
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:
            with device.open("wb", buffering=0) as stick:
                stick.write(struct.pack("<IhBB", 0, 32767, 0x02, 1) + struct.pack("<IhBB", 0, 1, 0x01, 4))
                end = time.monotonic() + 30
                while receiver.received < 5 and time.monotonic() < end:
                    receiver.poll(time.monotonic() + 0.1)
            assert receiver.state == JoystickState((0.0, 1.0), 1 << 4)
            # Nobody holds the stick any more: that ends it, and the channel falls silent.
            assert process.wait(30) == 1
        finally:
            process.kill()
            process.wait()
            assert process.stderr is not None
            said = process.stderr.read()
            process.stderr.close()
    assert "js0 was unplugged" in said
