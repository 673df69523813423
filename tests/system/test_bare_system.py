"""hexwire without termios, poll, epoll, file flags and numbered users, as far as this machine can be such a one."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from threading import Event, Thread

import pytest

from hexwire.emulator.bus_device import BusDevice, make_servos
from hexwire.emulator.serve_pty import serve_bus
from hexwire.emulator.serve_tcp import TcpServer
from hexwire.wire.registers import Series

PROGRAM = Path(__file__).with_name("bare_system.py")
# For one system only, and said so. Nobody needs them elsewhere: `make_link` chooses another link, `sim` offers TCP.
LINUX_ONLY = {
    "hexwire.emulator.serve_pty",
    "hexwire.link.mqueue",
    "hexwire.link.serial",
}


@pytest.fixture
def urls(tmp_path: Path) -> object:
    """A bus on a terminal, and one behind TCP."""
    ended, link = Event(), tmp_path / "ttyUSB0"
    ready = Event()
    terminal = Thread(
        target=lambda: serve_bus(
            make_servos([Series.STS_SMS], [1, 2], start=time.monotonic()),
            baud=1_000_000,
            stop=ended.is_set,
            announce=lambda path: ready.set(),
            link=link,
        )
    )
    server = TcpServer(BusDevice(make_servos([Series.STS_SMS], [1, 3], start=time.monotonic())), "127.0.0.1", 0)
    url = server.open()

    def serve() -> None:
        while not ended.is_set():
            server.run_once(0.05)

    tcp = Thread(target=serve)
    for thread in (terminal, tcp):
        thread.start()
    try:
        assert ready.wait(30.0)
        yield [f"serial://{link}?baud=1000000&backend=pyserial", url]
    finally:
        ended.set()
        for thread in (terminal, tcp):
            thread.join()
        server.close()


@pytest.mark.slow
def test_every_module_is_there_and_a_bus_is_driven(urls: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, PROGRAM, *urls], check=False, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert set(found["refused"]) == LINUX_ONLY, found["refused"]
    assert found["answers"] == {urls[0]: [1, 2, 7], urls[1]: [1, 3, 7]}
    assert found["queue"].startswith("UsageError: mq:///arm: this system has no such link")
    assert "\n" not in found["queue"]


@pytest.mark.parametrize("system", ["darwin", "win32"])
@pytest.mark.parametrize("module", sorted(LINUX_ONLY))
def test_what_is_for_linux_says_so_in_one_line(module: str, system: str) -> None:
    code = (
        f"import sys; sys.platform = {system!r}\ntry:\n    import {module}\nexcept ImportError as e:\n    print(e)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60)
    assert done.stdout.count("\n") == 1, done.stdout + done.stderr
    assert "Linux" in done.stdout
