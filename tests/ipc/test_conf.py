from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import ConfigError
from hexwire.ipc.conf import (
    ChannelConf,
    ChannelDirection,
    link_url,
    load_conf,
    parse_conf,
    parse_toml,
    to_conf,
    to_toml,
)
from hexwire.wire.modules import IpcType, ModuleType

# As printed in the chapter, section 9.2, the comment that goes on in an indented line included.
CHAPTER = Path(__file__).with_name("ipc_msg.conf").read_text()
IO = ChannelConf(
    ModuleType.PUMA260_HOST_IO_TRX,
    ChannelDirection.CLIENT_TRX,
    ModuleType.PUMA260_RBT_IO_SVR,
    IpcType.TCP,
    "192.168.1.175",
    15030,
)
COMMANDS = ChannelConf(
    ModuleType.PUMA260_HOST_JNT_CMD_TX,
    ChannelDirection.CLIENT_TRX,
    ModuleType.PUMA260_RBT_IO_SVR,
    IpcType.TCP,
    "192.168.2.35",
    15030,
)


def test_the_chapters_own_file() -> None:
    channels = parse_conf(CHAPTER, "ipc_msg.conf")
    assert channels == [IO, COMMANDS]
    assert [channel.line for channel in channels] == [4, 6]
    assert [link_url(channel) for channel in channels] == ["tcp://192.168.1.175:15030", "tcp://192.168.2.35:15030"]


def test_every_way_to_write_one_record() -> None:
    one_line = "PUMA260_HOST_IO_TRX CLIENT_TRX PUMA260_RBT_IO_SVR TCP 192.168.1.175 15030"
    for text in (
        one_line,
        one_line + "  # the arm in the lab",
        "\n\n# note\n" + one_line + "\n\n",
        one_line.replace(" ", "\t"),
        one_line.replace(" ", "\n\t"),
        one_line.replace(" ", "   # a note\n   "),
        one_line.replace(" TCP", "\n# a note inside\n  TCP"),
        one_line.replace(" TCP", "\n    # an indented note\n  TCP"),
    ):
        assert parse_conf(text) == [IO], text


def test_an_empty_file_has_no_channels() -> None:
    for text in ("", "\n", "# nothing\n   here\n", "   \n\t\n"):
        assert parse_conf(text) == []


def test_a_file_of_comments_only_has_no_channels(tmp_path: Path) -> None:
    path = tmp_path / "ipc_msg.conf"
    path.write_text("# nothing here\n\n")
    assert load_conf(path) == []


def test_what_is_written_names_its_columns() -> None:
    header, row, *_ = to_conf([IO]).splitlines()
    assert header.split() == [
        "#",
        "module_name",
        "direction",
        "destination_module",
        "interface",
        "address",
        "[port]",
    ]
    assert len(header.split()) - 1 == len(row.split())


@pytest.mark.parametrize("kind", ["TCP", "IPC_TCP_SOCKET"])
@pytest.mark.parametrize("module", ["PUMA260_HOST_IO_TRX", "2", "02"])
@pytest.mark.parametrize("destination", ["PUMA260_RBT_IO_SVR", "3"])
def test_ids_and_the_chapters_names_of_interfaces(module: str, destination: str, kind: str) -> None:
    assert parse_conf(f"{module} CLIENT_TRX {destination} {kind} 192.168.1.175 15030") == [IO]


def test_ids_without_a_name() -> None:
    (channel,) = parse_conf("40 CLIENT_TRX 1073741823 IPC_QUEUE arm trust=anna")
    assert (channel.module, channel.destination, channel.interface) == (40, 2**30 - 1, IpcType.QUEUE)
    assert parse_conf(to_conf([channel])) == [channel]
    assert parse_toml(to_toml([channel])) == [channel]
    same = "[[channel]]\nmodule = 40\ndirection = 'CLIENT_TRX'\ndestination = 1073741823\ninterface = 'IPC_QUEUE'\n"
    assert parse_toml(same + "address = 'arm'\ntrust = 'anna'\n") == [channel]
    with pytest.raises(ConfigError, match="40 has a channel already"):
        parse_conf("40 CLIENT_TX 1 QUEUE arm\n40 CLIENT_RX 1 QUEUE legs")


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("JOY_STICK CLIENT_TRX 1073741824 TCP h 1", "1:22", "unknown destination_module '1073741824'"),
        ("-1 CLIENT_TRX ROS1_HOST TCP h 1", "1:1", "and ids from 0 to 1073741823"),
        ("JOY_STICK CLIENT_TRX INVALID_MODULE TCP h 1", "1:22", "unknown destination_module 'INVALID_MODULE'"),
        ("JOY_STICK CLIENT_TRX ROS1_HOST IPC_SERIAL h 1", "1:32", "unknown interface 'IPC_SERIAL'"),
        ("PUMA CLIENT_TRX JOY_STICK TCP h 1", "1:1", "unknown module_name 'PUMA'"),
        ("# x\nJOY_STICK CLIENT_TRX\n  ROS1_HOST  TCPP h 1", "3:14", "unknown interface 'TCPP'"),
        ("JOY_STICK CLIENT_TRX ROS1_HOST TCP h 1 2 3", "1:42", "unexpected word '3'"),
        ("JOY_STICK CLIENT_TRX ROS1_HOST TCP h 1 2", "1:40", "unexpected word '2': only a UDP server"),
        ("JOY_STICK CLIENT_TRX ROS1_HOST\n\n  TCP h 1", "3:3", "an indented line continues a record"),
        (
            "JOY_STICK CLIENT_TRX ROS1_HOST\nROS1_HOST CLIENT_TX JOY_STICK TCP h 1",
            "1:1",
            "ends before its interface",
        ),
        ("  JOY_STICK CLIENT_TRX ROS1_HOST TCP h 1", "1:3", "start the line in the first column"),
        ("# note\n  JOY_STICK CLIENT_TRX ROS1_HOST TCP h 1", "2:3", "start the line in the first column"),
        ("JOY_STICK CLIENT_TX ROS1_HOST TCP h 1\nJOY_STICK CLIENT_TX ROS1_HOST TCP h 1", "2:1", "in line 1"),
    ],
)
def test_errors_have_file_line_and_column(text: str, place: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_conf(text, "lab/ipc_msg.conf")
    assert str(caught.value).startswith(f"lab/ipc_msg.conf:{place}: ")
    assert words in str(caught.value)


TOML = '[[channel]]\nmodule = "JOY_STICK"\n'


@pytest.mark.parametrize("name", ["ipc.toml", "ipc_msg.conf"])
@pytest.mark.parametrize("before", ["", "# a note\n\n", "\n   \n"])
def test_toml_is_told_by_its_name_or_its_first_line(tmp_path: Path, name: str, before: str) -> None:
    path = tmp_path / name
    path.write_text(before + TOML)
    with pytest.raises(ConfigError, match="the record ends before its direction"):
        load_conf(path)
    path.write_text(
        before + TOML + 'direction = "CLIENT_TX"\ndestination = "ROS1_HOST"\ninterface = "QUEUE"\naddress = "/q"\n'
    )
    assert [channel.address for channel in load_conf(str(path))] == ["/q"]


def test_files_of_other_systems(tmp_path: Path) -> None:
    path = tmp_path / "ipc_msg.conf"
    path.write_bytes(b"\xef\xbb\xbf" + CHAPTER.replace("\n", "\r\n").encode())
    assert load_conf(path) == [IO, COMMANDS]


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.conf: cannot be read: No such file"):
        load_conf(tmp_path / "none.conf")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        load_conf(tmp_path)
    path = tmp_path / "latin1.conf"
    path.write_bytes(b"# note\n# gr\xfc\xdfe\n")
    with pytest.raises(ConfigError, match=r"latin1\.conf:2:5: not UTF-8 text"):
        load_conf(path)


def test_a_queue_may_name_a_user_whose_queue_it_may_be() -> None:
    text = "JOY_STICK SERVER_RX ROS1_HOST QUEUE /arm trust=robot\n"
    (channel,) = parse_conf(text)
    assert (channel.port, channel.peer) == (None, "robot")
    assert link_url(channel) == "mq:///arm?role=server&trust=robot"
    assert parse_conf(to_conf([channel])) == [channel]
    assert parse_toml(to_toml([channel])) == [channel]
    assert 'trust = "robot"' in to_toml([channel])
    for wrong, column, words in (("trust=", 48, "bad user ''"), ("trust=a,b", 48, "bad user 'a,b'")):
        with pytest.raises(ConfigError) as caught:
            parse_conf(text.replace("trust=robot", wrong))
        assert (caught.value.column, words in str(caught.value)) == (column, True)
    with pytest.raises(ConfigError, match="peer belongs to UDP, trust to QUEUE"):
        parse_toml(to_toml([channel]).replace("trust", "peer"))


HOSTS = st.from_regex(r"[a-z][a-z0-9-]{0,10}(\.[a-z]{2,5})?", fullmatch=True) | st.ip_addresses().map(str)
MODULES = st.sampled_from([module for module in ModuleType if module >= 0])


@st.composite
def channels(draw: st.DrawFn) -> list[ChannelConf]:
    made = []
    for number, module in enumerate(draw(st.lists(MODULES, unique=True, max_size=9))):
        interface = draw(st.sampled_from(IpcType))
        ways = [way for way in ChannelDirection if not (way.is_server and interface is IpcType.SERIAL)]
        direction = draw(st.sampled_from(ways))
        peer = ""
        port: int | None = 1000 + number
        if interface is IpcType.SERIAL:
            address, port = f"/dev/tty{draw(st.sampled_from('SAé#%'))}{number}", draw(st.integers(50, 12_000_000))
        elif interface is IpcType.QUEUE:
            address, port = f"/queue{number}", None
            peer = draw(st.sampled_from(["", "root", "robot-1"]))
        else:
            address = draw(HOSTS)
            if interface is IpcType.UDP and direction.is_server:
                peer = draw(HOSTS)
        made.append(ChannelConf(module, direction, draw(MODULES), interface, address, port, peer))
    return made


@given(channels())
def test_what_is_written_reads_back(made: list[ChannelConf]) -> None:
    assert parse_conf(to_conf(made)) == made


WORDS = st.sampled_from(
    ["JOY_STICK", "ROS1_HOST", "CLIENT_TX", "SERVER_TRX", "TCP", "UDP", "SERIAL", "QUEUE", "::1", "/dev/ttyS0"]
)


@given(
    st.lists(WORDS | st.sampled_from([" ", "\n", "\n  ", "#", "\t", "15030"]) | st.text(max_size=3), max_size=40)
)
def test_any_text_is_channels_or_a_placed_error(pieces: list[str]) -> None:
    text = " ".join(pieces)
    fault = None
    try:
        made = parse_conf(text, "f")
    except ConfigError as error:
        fault = error
    if fault is None:
        assert parse_conf(to_conf(made)) == made
    else:
        assert 1 <= fault.line <= text.count("\n") + 1
        assert fault.column >= 1
