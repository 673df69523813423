from __future__ import annotations

import pytest

from hexwire.errors import ConfigError
from hexwire.ipc.channel import COLUMNS, Cell, ChannelConf, ChannelDirection, Record, link_url, make_channels
from hexwire.link.open import known_schemes
from hexwire.wire.modules import IpcType, ModuleType

HOST, SERVER = ModuleType.PUMA260_HOST_IO_TRX, ModuleType.PUMA260_RBT_IO_SVR


def record(*words: str) -> Record:
    cells = [Cell(word, 3, 10 * number + 1) for number, word in enumerate(words)]
    return Record(dict(zip(COLUMNS, cells, strict=False)), cells[0], "x.conf")


def channel(*words: str) -> ChannelConf:
    (made,) = make_channels([record("PUMA260_HOST_IO_TRX", *words)])
    return made


@pytest.mark.parametrize(
    ("words", "expected", "url"),
    [
        (
            ("CLIENT_TRX", "PUMA260_RBT_IO_SVR", "TCP", "192.168.1.175", "15030"),
            (ChannelDirection.CLIENT_TRX, IpcType.TCP, "192.168.1.175", 15030, ""),
            "tcp://192.168.1.175:15030",
        ),
        (
            ("SERVER_RX", "PUMA260_RBT_IO_SVR", "TCP", "::1", "15030"),
            (ChannelDirection.SERVER_RX, IpcType.TCP, "::1", 15030, ""),
            "tcp-listen://[::1]:15030",
        ),
        (
            ("CLIENT_TX", "PUMA260_RBT_IO_SVR", "UDP", "arm-1.lab.local", "1"),
            (ChannelDirection.CLIENT_TX, IpcType.UDP, "arm-1.lab.local", 1, ""),
            "udp://arm-1.lab.local:1",
        ),
        (
            ("SERVER_TRX", "PUMA260_RBT_IO_SVR", "UDP", "127.0.0.1", "65535"),
            (ChannelDirection.SERVER_TRX, IpcType.UDP, "127.0.0.1", 65535, ""),
            "udp-listen://127.0.0.1:65535",
        ),
        (
            ("SERVER_TRX", "PUMA260_RBT_IO_SVR", "UDP", "10.0.0.1", "15030", "10.0.0.2"),
            (ChannelDirection.SERVER_TRX, IpcType.UDP, "10.0.0.1", 15030, "10.0.0.2"),
            "udp-listen://10.0.0.1:15030?peer=10.0.0.2",
        ),
        (
            ("SERVER_TRX", "PUMA260_RBT_IO_SVR", "UDP", "fd00::1", "15030", "fd00::2"),
            (ChannelDirection.SERVER_TRX, IpcType.UDP, "fd00::1", 15030, "fd00::2"),
            "udp-listen://[fd00::1]:15030?peer=[fd00::2]",
        ),
        (
            ("CLIENT_TRX", "ARM_7BOT_ARDUINO_TRX", "SERIAL", "/dev/serial/by-id/a#b"),
            (ChannelDirection.CLIENT_TRX, IpcType.SERIAL, "/dev/serial/by-id/a#b", 115200, ""),
            "serial:///dev/serial/by-id/a%23b?baud=115200",
        ),
        (
            ("CLIENT_TRX", "ARM_7BOT_ARDUINO_TRX", "SERIAL", "/dev/ttyUSB0", "1000000"),
            (ChannelDirection.CLIENT_TRX, IpcType.SERIAL, "/dev/ttyUSB0", 1_000_000, ""),
            "serial:///dev/ttyUSB0?baud=1000000",
        ),
        (
            ("CLIENT_TRX", "PUMA260_RBT_IO_SVR", "QUEUE", "/arm"),
            (ChannelDirection.CLIENT_TRX, IpcType.QUEUE, "/arm", None, ""),
            "mq:///arm",
        ),
        (
            ("SERVER_TRX", "PUMA260_RBT_IO_SVR", "QUEUE", "arm"),
            (ChannelDirection.SERVER_TRX, IpcType.QUEUE, "arm", None, ""),
            "mq:///arm?role=server",
        ),
    ],
)
def test_a_channel_and_its_link(words: tuple[str, ...], expected: tuple[object, ...], url: str) -> None:
    made = channel(*words)
    assert (made.direction, made.interface, made.address, made.port, made.peer) == expected
    assert (made.module, made.line) == (HOST, 3)
    assert link_url(made) == url
    assert url.partition("://")[0] in known_schemes()


@pytest.mark.parametrize(
    ("words", "column", "text"),
    [
        (("CLIENT",), 1, "the record ends before its destination_module; columns: module_name direction"),
        (("BOTH", "PUMA260_RBT_IO_SVR", "TCP", "h", "1"), 11, "unknown direction 'BOTH'; known: CLIENT_TX,"),
        (("CLIENT_TX", "PUMA", "TCP", "h", "1"), 21, "unknown destination_module 'PUMA'; known: ROS1_HOST"),
        (("CLIENT_TX", "INVALID_MODULE", "TCP", "h", "1"), 21, "unknown destination_module"),
        (
            ("CLIENT_TX", "JOY_STICK", "CAN", "h", "1"),
            31,
            "unknown interface 'CAN'; known: QUEUE, TCP, UDP, SERIAL",
        ),
        (("CLIENT_TX", "JOY_STICK", "TCP", "192.168.1.300", "1"), 41, "bad address '192.168.1.300'"),
        (("CLIENT_TX", "JOY_STICK", "TCP", "-host", "1"), 41, "neither an IP address nor a host name"),
        (("CLIENT_TX", "JOY_STICK", "UDP", "a..b", "1"), 41, "bad address 'a..b'"),
        (("CLIENT_TX", "JOY_STICK", "TCP", "h"), 1, "the record ends before its port; TCP needs one"),
        (("CLIENT_TX", "JOY_STICK", "TCP", "h", "0"), 51, "bad port '0': a number from 1 to 65535 is needed"),
        (("CLIENT_TX", "JOY_STICK", "TCP", "h", "65536"), 51, "bad port '65536'"),
        (("CLIENT_TX", "JOY_STICK", "TCP", "h", "http"), 51, "bad port 'http'"),
        (("CLIENT_TX", "JOY_STICK", "SERIAL", "ttyUSB0"), 41, "a device path such as /dev/ttyUSB0 is needed"),
        (("CLIENT_TX", "JOY_STICK", "SERIAL", "/dev/tty\0"), 41, "bad address"),
        (("CLIENT_TX", "JOY_STICK", "SERIAL", "/dev/ttyS0", "12"), 51, "bad baud rate '12'"),
        (("CLIENT_TX", "JOY_STICK", "QUEUE", "/a/b"), 41, "a queue is named by letters"),
        (("CLIENT_TX", "JOY_STICK", "QUEUE", "/a", "5"), 51, "a queue has no port; unexpected word '5'"),
        (("SERVER_TX", "JOY_STICK", "UDP", "10.0.0.1", "5"), 41, "must name the host it accepts"),
        (("SERVER_TX", "JOY_STICK", "UDP", "10.0.0.1", "5", "1.2"), 61, "bad peer '1.2'"),
        (
            ("CLIENT_TX", "JOY_STICK", "UDP", "10.0.0.1", "5", "h"),
            61,
            "unexpected word 'h': only a UDP server",
        ),
    ],
)
def test_what_is_wrong_is_named_with_its_place(words: tuple[str, ...], column: int, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        channel(*words)
    assert str(caught.value).startswith(f"x.conf:3:{column}: ")
    assert text in str(caught.value)
    assert (caught.value.file, caught.value.line, caught.value.column) == ("x.conf", 3, column)


def pair(first: str, second: str) -> list[Record]:
    return [record(*first.split()), record(*second.split())]


@pytest.mark.parametrize(
    ("first", "second", "text"),
    [
        (
            "JOY_STICK CLIENT_TX ROS1_HOST TCP a 1",
            "JOY_STICK CLIENT_RX ROS1_HOST TCP b 2",
            "JOY_STICK has a channel already, in line 3",
        ),
        (
            "JOY_STICK CLIENT_TX ROS1_HOST SERIAL /dev/ttyS0",
            "ROS1_HOST CLIENT_RX JOY_STICK SERIAL /dev/ttyS0 9600",
            "/dev/ttyS0 is in use already",
        ),
        (
            "JOY_STICK SERVER_TX ROS1_HOST TCP 127.0.0.1 15030",
            "ROS1_HOST SERVER_RX JOY_STICK TCP 127.0.0.1 15030",
            "127.0.0.1 port 15030 has a server already",
        ),
        (
            "JOY_STICK SERVER_TX ROS1_HOST QUEUE /q",
            "ROS1_HOST SERVER_RX JOY_STICK QUEUE /q",
            "/q has a server already",
        ),
    ],
)
def test_channels_that_exclude_each_other(first: str, second: str, text: str) -> None:
    with pytest.raises(ConfigError, match="duplicate") as caught:
        make_channels(pair(first, second))
    assert text in str(caught.value)


def test_channels_that_get_on_with_each_other() -> None:
    # Both ends of one line in one file; two clients of one server; TCP and UDP on one port number.
    make_channels(
        pair(
            "JOY_STICK CLIENT_TRX ROS1_HOST TCP 127.0.0.1 15030",
            "ROS1_HOST SERVER_TRX JOY_STICK TCP 127.0.0.1 15030",
        )
    )
    make_channels(pair("JOY_STICK CLIENT_TX ROS1_HOST TCP h 1", "ROS1_HOST CLIENT_RX JOY_STICK TCP h 1"))
    make_channels(
        pair("JOY_STICK SERVER_TX ROS1_HOST TCP 127.0.0.1 1", "ROS1_HOST SERVER_RX JOY_STICK UDP 127.0.0.1 1")
    )


def test_directions() -> None:
    assert [d for d in ChannelDirection if d.is_server] == [
        ChannelDirection.SERVER_TX,
        ChannelDirection.SERVER_RX,
        ChannelDirection.SERVER_TRX,
    ]
    assert ChannelDirection.CLIENT_TX.sends
    assert not ChannelDirection.CLIENT_TX.receives
    assert ChannelDirection.SERVER_RX.receives
    assert not ChannelDirection.SERVER_RX.sends
    assert ChannelDirection.CLIENT_TRX.sends
    assert ChannelDirection.CLIENT_TRX.receives
