"""`Session.from_conf` over each interface, with the chapter's own file; only addresses are put in its place."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.link.far_ends import PtyEnd, free_port
from tests.system.mirror import Mirror

from hexwire.errors import ConfigError, LinkNotFoundError
from hexwire.ipc.conf import link_url, load_conf, parse_conf, to_toml
from hexwire.ipc.session import Session
from hexwire.link.base import Link
from hexwire.link.open import make_link
from hexwire.wire.modules import IpcType, ModuleType

pytestmark = pytest.mark.system

CHAPTER = (Path(__file__).parents[1] / "ipc" / "ipc_msg.conf").read_text()
HOST, ROBOT = ModuleType.PUMA260_HOST_IO_TRX, ModuleType.PUMA260_RBT_IO_SVR


def served(folder: Path, interface: str, address: str) -> Link:
    """The robot's side, from a file of its own."""
    file = folder / "robot.conf"
    file.write_text(f"PUMA260_RBT_IO_SVR SERVER_TRX PUMA260_HOST_IO_TRX {interface} {address}\n")
    return make_link(link_url(load_conf(file)[0]))


def tcp(folder: Path) -> tuple[str, Link]:
    words = f"127.0.0.1 {free_port()}"
    return f"TCP {words}", served(folder, "TCP", words)


def udp(folder: Path) -> tuple[str, Link]:
    words = f"127.0.0.1 {free_port(socket.SOCK_DGRAM)}"
    return f"UDP {words}", served(folder, "UDP", words)


def queue(folder: Path) -> tuple[str, Link]:
    name = f"/hexwire-conf-{time.monotonic_ns()}"
    return f"QUEUE {name}", make_link(f"mq://{name}?role=server&unlink=1")


def serial(folder: Path) -> tuple[str, Link]:
    return f"SERIAL {folder}/tty 115200", PtyEnd(folder / "tty")


@contextmanager
def mirrored(link: Link, max_frame: int) -> Iterator[Mirror]:
    mirror = Mirror(link, max_frame, ROBOT)
    with link:
        thread = threading.Thread(target=mirror.run)
        thread.start()
        try:
            yield mirror
        finally:
            mirror.stop()
            thread.join(30)


@pytest.mark.parametrize("form", ["conf", "toml"])
@pytest.mark.parametrize("make", [tcp, udp, queue, serial])
def test_a_session_over_each_interface(make: Callable[[Path], tuple[str, Link]], form: str, tmp_path: Path) -> None:
    words, far = make(tmp_path)
    text = CHAPTER.replace("TCP 192.168.1.175 15030", words)
    assert text != CHAPTER
    file = tmp_path / f"ipc_msg.{form}"
    file.write_text(to_toml(parse_conf(text)) if form == "toml" else text)
    interface = IpcType[words.split()[0]]
    session = Session.from_conf(file, HOST)
    with mirrored(far, 253 if interface is IpcType.SERIAL else 8192) as mirror, session:
        assert (session.ipc.module, session.ipc.destination, session.ipc.type) == (HOST, ROBOT, interface)
        assert session.request(0x7A, b"hello").body == b"hello"
        frame = session.request(0x7A, b"again").frame
        assert frame is not None
        assert (frame.src, frame.dst) == (ROBOT, HOST)
        assert mirror.got == [b"hello", b"again"]


def test_what_the_file_does_not_name(tmp_path: Path) -> None:
    file = tmp_path / "ipc_msg.conf"
    file.write_text(CHAPTER)
    named = "the file has PUMA260_HOST_IO_TRX, PUMA260_HOST_JNT_CMD_TX"
    with pytest.raises(ConfigError, match=f"there is no channel for JOY_STICK; {named}"):
        Session.from_conf(file, ModuleType.JOY_STICK).open()
    file.write_text(CHAPTER.replace("TCP 192.168.1.175 15030", f"TCP 127.0.0.1 {free_port()}"))
    with pytest.raises(LinkNotFoundError, match="no server listens there"):
        Session.from_conf(file, HOST).open()
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        Session.from_conf(tmp_path / "none.conf", HOST).open()
