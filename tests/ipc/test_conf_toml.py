from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import ConfigError
from hexwire.ipc.conf import parse_conf, parse_toml, to_conf, to_toml

BOTH = """\
ARM_7BOT_SERIAL_TRX CLIENT_TRX ARM_7BOT_ARDUINO_TRX SERIAL /dev/serial/by-id/usb"é"\\x 1000000
PUMA260_RBT_IO_SVR SERVER_TRX PUMA260_HOST_IO_TRX UDP 10.0.0.1 15030 10.0.0.2
PUMA260_HOST_IO_TRX CLIENT_TRX PUMA260_RBT_IO_SVR TCP 192.168.1.175 15030
JOY_STICK CLIENT_TX ROS1_HOST QUEUE /joy
"""
SAME = """\
[[channel]]
module = "ARM_7BOT_SERIAL_TRX"
direction = "CLIENT_TRX"
destination = "ARM_7BOT_ARDUINO_TRX"
interface = "SERIAL"
address = "/dev/serial/by-id/usb\\"é\\"\\\\x"
baud = 1000000

[[channel]]
module = "PUMA260_RBT_IO_SVR"
direction = "SERVER_TRX"
destination = "PUMA260_HOST_IO_TRX"
interface = "UDP"
address = "10.0.0.1"
port = 15030
peer = "10.0.0.2"

[[channel]]
module = "PUMA260_HOST_IO_TRX"
direction = "CLIENT_TRX"
destination = "PUMA260_RBT_IO_SVR"
interface = "TCP"
address = "192.168.1.175"
port = 15030

[[channel]]
module = "JOY_STICK"
direction = "CLIENT_TX"
destination = "ROS1_HOST"
interface = "QUEUE"
address = "/joy"
"""


def test_both_forms_mean_the_same() -> None:
    channels = parse_conf(BOTH)
    assert parse_toml(SAME) == channels
    assert to_toml(channels) == SAME
    assert parse_conf(to_conf(parse_toml(SAME))) == channels
    assert [channel.line for channel in parse_toml(SAME)] == [1, 9, 18, 26]


def test_nothing_and_inline_tables() -> None:
    assert parse_toml("") == []
    assert parse_toml("channel = []") == []
    inline = (
        'channel = [{module="JOY_STICK", direction="CLIENT_TX", destination="ROS1_HOST", '
        'interface="QUEUE", address="/joy"}]'
    )
    assert parse_toml(inline) == parse_toml(SAME)[3:]
    with pytest.raises(ConfigError, match=r"^f:1:11: unknown module_name 'X'"):
        parse_toml(inline.replace("JOY_STICK", "X"), "f")


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ('module = "JOY_STICK"', 'module = "JOY"', "27:10", "unknown module_name 'JOY'"),
        ('address = "/joy"', 'adress = "/joy"', "31:10", "adress is an unknown key, did you mean address?"),
        ('address = "/joy"', "", "26:1", "the record ends before its address"),
        ("port = 15030\npeer", 'port = "15030"\npeer', "15:8", "port must be a whole number, not the text '15030'"),
        ("port = 15030\npeer", "port = true\npeer", "15:8", "port must be a whole number, not true"),
        ("port = 15030\npeer", "port = 99999\npeer", "15:8", "bad port '99999'"),
        ('address = "/joy"', "address = 5", "31:11", "address must be text, not 5"),
        ('address = "/joy"', 'address = "/my joy"', "31:11", "address must be one word"),
        ('address = "/joy"', 'address = ""', "31:11", "address must be one word"),
        ("baud = 1000000", "port = 1000000", "7:8", "baud belongs to SERIAL, port to TCP and UDP"),
        ("port = 15030\npeer", "baud = 15030\npeer", "15:8", "baud belongs to SERIAL"),
        ("baud = 1000000", "baud = 1000000\nport = 1000000", "8:8", "port and baud are the same thing"),
        ('l]]\nmodule = "JOY', '1]]\nmodule = "JOY', "26:1", "channe1 is an unknown key, did you mean channel?"),
        ('module = "JOY_STICK"', "module = ", "27:10", "not TOML: Invalid value"),
        ('destination = "ROS1_HOST"', 'destination = "ROS1"', "29:15", "unknown destination_module 'ROS1'"),
    ],
)  # fmt: skip
def test_errors_have_file_line_and_column(old: str, new: str, place: str, words: str) -> None:
    assert SAME.count(old) == 1
    with pytest.raises(ConfigError) as caught:
        parse_toml(SAME.replace(old, new), "ipc.toml")
    assert str(caught.value).startswith(f"ipc.toml:{place}: ")
    assert words in str(caught.value)


@pytest.mark.parametrize("text", ["channel = 5", 'channel = ["x"]', '[channel]\nmodule = "JOY_STICK"'])
def test_channels_must_be_tables(text: str) -> None:
    with pytest.raises(ConfigError, match=r"f:1:1?1: channel must be tables \[\[channel\]\]"):
        parse_toml(text, "f")


def test_brackets_without_end() -> None:
    with pytest.raises(ConfigError):
        parse_toml("x = " + "[" * 100_000, "f")


VALUES = st.sampled_from(['"JOY_STICK"', "15030", "true", "[]", "{}", '"/dev/ttyS0"', '"SERIAL"', "1979-05-27"])
KEYS = st.sampled_from(["module", "direction", "interface", "address", "port", "baud", "peer", "x", "'a b'"])


@given(st.lists(st.builds("{} = {}\n".format, KEYS, VALUES) | st.just("[[channel]]\n") | st.text(max_size=5)))
def test_any_text_is_channels_or_a_config_error(pieces: list[str]) -> None:
    with contextlib.suppress(ConfigError):
        parse_toml("".join(pieces), "f")
