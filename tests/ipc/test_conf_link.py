"""The address of a channel in a configuration file."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.emulator.test_serve_tcp import serving

from hexwire.cli.main import cli
from hexwire.drivers.firmware import device_of
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.puma260 import Puma260Driver
from hexwire.drivers.registry import connect, make_driver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.errors import ConfigError, LinkNotFoundError, UsageError
from hexwire.ipc.conf import device_url
from hexwire.ipc.handle import IpcHandle
from hexwire.link.open import make_link
from hexwire.link.tcp import TcpLink
from hexwire.wire.modules import IpcType, ModuleType

RECORDS = """\
ARM_7BOT_SERIAL_TRX  CLIENT_TRX  9                     IPC_SERIAL_PORT  /dev/none  500000
12                   CLIENT_TRX  ROS1_HOST             IPC_UDP_SOCKET   127.0.0.1  15040
PUMA260_HOST_IO_TRX  CLIENT_TRX  PUMA260_RBT_IO_SVR    IPC_TCP_SOCKET   127.0.0.1  15030
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "ipc_msg.conf"
    path.write_text(RECORDS)
    return path


@pytest.mark.parametrize("form", ["{}", "conf://{}"])
def test_the_file_names_link_and_modules(file: Path, form: str) -> None:
    handle = IpcHandle.from_url(form.format(file))
    assert handle.link.url == "serial:///dev/none?baud=500000"
    assert (handle.module, handle.destination, handle.type) == (7, 9, IpcType.SERIAL)


@pytest.mark.parametrize("module", ["12", "12&", "PUMA260_HOST_IO_TRX"])
def test_another_module_of_the_file(file: Path, module: str) -> None:
    url = f"{file}?module={module}"
    if module.endswith("&"):
        with pytest.raises(UsageError, match="option"):
            IpcHandle.from_url(url)
        return
    handle = IpcHandle.from_url(url)
    assert handle.module == (12 if module == "12" else ModuleType.PUMA260_HOST_IO_TRX)
    assert make_link(url).url == handle.link.url


def test_a_relative_path(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(file.parent)
    for url in ("ipc_msg.conf", "conf://ipc_msg.conf", "./ipc_msg.conf"):
        assert make_link(url).url == "serial:///dev/none?baud=500000"


def test_a_driver_speaks_with_the_modules_of_the_file(file: Path) -> None:
    driver = make_driver(str(file))
    assert isinstance(driver, Hex7BotDriver)
    assert driver.url == "serial:///dev/none?baud=500000"
    with pytest.raises(LinkNotFoundError):
        driver.attach()
    with pytest.raises(LinkNotFoundError, match="/dev/none"):
        connect(f"conf://{file}")


def test_the_chapters_channels_of_a_puma(file: Path) -> None:
    driver = make_driver(str(file), "puma260", boot_window=0.5)
    assert isinstance(driver, Puma260Driver)
    assert driver.session.ipc.module is ModuleType.PUMA260_HOST_IO_TRX
    assert driver.states is driver.session


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("conf://?module=ROS1_HOST", "the file is missing"),
        ("conf:ipc_msg.conf", "write '//'"),
        ("{}?module=NOBODY", "unknown module 'NOBODY'"),
        ("{}?modul=ROS1_HOST", "unknown option 'modul'"),
    ],
)
def test_a_wrong_address(file: Path, url: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        make_link(url.format(file))


def test_a_module_that_the_file_does_not_name(file: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"no channel for JOY_STICK; the file has ARM_7BOT_SERIAL_TRX, .*module 12"
    ):
        IpcHandle.from_url(f"{file}?module=JOY_STICK")
    with pytest.raises(ConfigError, match="missing"):
        make_driver(str(file.with_name("missing.conf")))


@pytest.mark.parametrize("way", ["CLIENT_TX", "CLIENT_RX"])
@pytest.mark.parametrize(
    "words",
    [
        "state --robot so101 --port",
        "stop --robot so101 --port",
        "bus scan --port",
        "gateway --listen tcp://127.0.0.1:0 --board",
    ],
)
def test_what_is_asked_and_answers_needs_both_directions(file: Path, way: str, words: str) -> None:
    """A servo bus and a board behind a gateway; its port is not even opened."""
    file.write_text(f"\nARM_7BOT_SERIAL_TRX {way} 8 IPC_SERIAL_PORT /dev/none\n")
    result = CliRunner().invoke(cli, [*words.split(), str(file)])
    assert result.exit_code == 2
    assert f"{file}:2:1: ARM_7BOT_SERIAL_TRX is {way}" in result.stderr
    assert "write CLIENT_TRX" in result.stderr


def test_commands_about_a_device_find_it_in_the_file(file: Path) -> None:
    for port in (str(file), "/dev/none?baud=500000", "serial:///dev/none?baud=500000"):
        assert (device_url(port).scheme, device_url(port).path) == ("serial", "/dev/none")
        assert device_of(port) == "/dev/none"
    result = CliRunner().invoke(cli, ["doctor", "--port", str(file)])
    assert (result.exit_code, "/dev/none" in result.stderr + result.stdout) == (1, True)


def test_a_board_is_driven_over_the_channel_of_a_file(file: Path) -> None:
    with serving(make_hex7bot_board(start=time.monotonic())) as url:
        host, _, port = url.removeprefix("tcp://").partition(":")
        file.write_text(f"12 CLIENT_TRX 8 IPC_TCP_SOCKET {host} {port}\n")
        with connect(f"{file}?module=12") as robot:
            assert isinstance(robot, Hex7BotDriver)
            assert len(robot.read().names) == 7
            assert (robot.session.connection.local, robot.session.connection.remote) == (12, 8)


@pytest.mark.parametrize("robot", ["hex7bot", "puma260"])
def test_a_channel_that_only_receives_is_refused_before_it_is_opened(
    file: Path, robot: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Opening the port of a board may reset it."""
    module = "PUMA260_HOST_IO_TRX" if robot == "puma260" else "ARM_7BOT_SERIAL_TRX"
    file.write_text(f"{module} CLIENT_RX 8 TCP 127.0.0.1 15030\n")
    opened: list[str] = []
    monkeypatch.setattr(TcpLink, "open", lambda link: opened.append(link.url))
    with pytest.raises(ConfigError, match="CLIENT_RX, which only receives, so IDENTIFY is not sent"):
        connect(str(file), robot)
    assert (opened, caplog.messages) == ([], [])
