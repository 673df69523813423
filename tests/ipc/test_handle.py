from __future__ import annotations

from pathlib import Path

import pytest

from hexwire.errors import ConfigError, LinkNotFoundError, UsageError
from hexwire.ipc.handle import IpcHandle
from hexwire.link.base import LinkKind
from hexwire.link.memory import memory_pair
from hexwire.wire.modules import IpcType, ModuleType

CONF = """
# module direction destination interface address port
ROS1_HOST CLIENT_TRX TEMPLATE_ROBOT TCP 127.0.0.1 9001
ARM_7BOT_SERIAL_TRX CLIENT_TRX ARM_7BOT_ARDUINO_TRX SERIAL /dev/ttyUSB7
    57600
"""


def test_a_configured_handle_takes_everything_from_the_file(tmp_path: Path) -> None:
    file = tmp_path / "ipc_msg.conf"
    file.write_text(CONF.replace("TEMPLATE_ROBOT", "ARM_7BOT_SERIAL_TRX"))
    handle = IpcHandle(ModuleType.ARM_7BOT_SERIAL_TRX, file)
    assert handle.destination == ModuleType.INVALID_MODULE
    assert not handle.keeps_messages
    assert handle.link.url == "serial:///dev/ttyUSB7?baud=57600"
    assert handle.destination == ModuleType.ARM_7BOT_ARDUINO_TRX
    assert handle.type == IpcType.SERIAL
    host = IpcHandle(ModuleType.ROS1_HOST, file)
    assert host.link.url == "tcp://127.0.0.1:9001"
    assert (host.destination, host.type) == (ModuleType.ARM_7BOT_SERIAL_TRX, IpcType.TCP)


def test_a_module_that_the_file_does_not_name(tmp_path: Path) -> None:
    file = tmp_path / "ipc_msg.conf"
    file.write_text(CONF.replace("TEMPLATE_ROBOT", "ARM_7BOT_SERIAL_TRX"))
    with pytest.raises(ConfigError, match=r"no channel for ARM_7BOT_ARDUINO_TRX; the file has .*ROS1_HOST"):
        IpcHandle(ModuleType.ARM_7BOT_ARDUINO_TRX, file).open()


def test_a_missing_file_is_reported_when_it_is_needed(tmp_path: Path) -> None:
    handle = IpcHandle(ModuleType.ROS1_HOST, tmp_path / "nothing.conf")
    handle.close()  # harmless
    with pytest.raises((ConfigError, LinkNotFoundError), match=r"nothing\.conf"):
        handle.open()


@pytest.mark.parametrize(
    ("url", "kind"),
    [
        ("/dev/ttyACM3", IpcType.SERIAL),
        ("serial:///dev/ttyACM3?baud=9600", IpcType.SERIAL),
        ("tcp://localhost:5", IpcType.TCP),
        ("udp://localhost:5", IpcType.UDP),
        ("mq:///name", IpcType.QUEUE),
    ],
)
def test_from_url_knows_the_kind_and_opens_nothing(url: str, kind: IpcType) -> None:
    handle = IpcHandle.from_url(url)
    assert handle.type == kind
    assert not handle.link.is_open
    assert (handle.module, handle.destination) == (7, 8)


def test_a_bad_url_is_refused_at_once() -> None:
    with pytest.raises(UsageError):
        IpcHandle.from_url("gopher://x")


def test_over_a_link_that_exists() -> None:
    near, far = memory_pair(LinkKind.DATAGRAM)
    with far, IpcHandle.from_link(near, ModuleType.ROS1_HOST, ModuleType.ARM_7BOT_ARDUINO_TRX) as handle:
        assert near.is_open
        assert handle.keeps_messages
        assert handle.module == ModuleType.ROS1_HOST
    assert not near.is_open
    handle.close()


def test_an_address_may_name_the_destination() -> None:
    handle = IpcHandle.from_url("tcp://127.0.0.1:15040?to=9")
    assert (handle.destination, handle.link.url) == (9, "tcp://127.0.0.1:15040")
    assert IpcHandle.from_url("/dev/ttyUSB0?to=JOY_STICK&baud=9600").destination is ModuleType.JOY_STICK
    assert IpcHandle.from_url("tcp://127.0.0.1:15040").destination is ModuleType.ARM_7BOT_ARDUINO_TRX
    for wrong in ("NOBODY", "-1", str(2**30)):
        with pytest.raises(UsageError, match="module"):
            IpcHandle.from_url(f"tcp://127.0.0.1:15040?to={wrong}")
