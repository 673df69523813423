"""Two modules over one channel of each kind: both ask, answer and send unasked; directions are kept."""

from __future__ import annotations

import os
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import posix_ipc
import pytest
from tests.beside import beside
from tests.link.far_ends import free_port

from hexwire.errors import ConfigError, LinkTimeoutError, LocalProtocolError
from hexwire.ipc.channel import ChannelDirection
from hexwire.ipc.conf import parse_conf
from hexwire.ipc.session import Session
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import Identity
from hexwire.wire.modules import ModuleType

pytestmark = pytest.mark.system

LONG = 30.0
ASK, TELL, BACK = 0x50, 0x51, 0x52
"""Commands of two modules' own."""
CAMERA, GRIPPER = ModuleType(12), ModuleType(13)
KINDS = ("QUEUE", "TCP", "UDP", "SERIAL")


@contextmanager
def crossed_terminals(tmp_path: Path) -> Iterator[tuple[str, str]]:
    """Two serial ports whose bytes cross, as by a null-modem cable."""
    ends = [os.openpty() for _ in range(2)]
    for _, slave in ends:
        tty.setraw(slave)

    def carry(ended: threading.Event) -> None:
        for master, _ in ends:
            os.set_blocking(master, False)
        while not ended.wait(0.001):
            for (source, _), (target, _) in (ends, ends[::-1]):
                try:
                    os.write(target, os.read(source, 4096))
                except BlockingIOError:
                    continue

    with beside(carry):
        yield os.ttyname(ends[0][1]), os.ttyname(ends[1][1])
    for end in ends:
        for fd in end:
            os.close(fd)


@contextmanager
def modules(
    tmp_path: Path, kind: str, server: str = "TRX", client: str = "TRX"
) -> Iterator[tuple[Session, Session]]:
    """Two open sessions by a file with the two ends of a channel: who is spoken to first, and who speaks."""
    file = tmp_path / "ipc_msg.conf"
    with crossed_terminals(tmp_path) as ports:
        near, far, side = f"/hexwire-{os.getpid()}", f"/hexwire-{os.getpid()}", "SERVER"
        if kind == "SERIAL":
            near, far, side = f"{ports[0]} 115200", f"{ports[1]} 115200", "CLIENT"
        elif kind != "QUEUE":
            near = far = f"127.0.0.1 {free_port()}"
        file.write_text(
            f"{int(CAMERA)} {side}_{server} {int(GRIPPER)} {kind} {near}\n"
            f"{int(GRIPPER)} CLIENT_{client} {int(CAMERA)} {kind} {far}\n"
        )
        with Session.from_conf(file, CAMERA) as one, Session.from_conf(file, GRIPPER) as other:
            yield one, other
        # A user has room for few queues.
        for end in (".rx", ".tx"):
            with pytest.raises(posix_ipc.ExistentialError):
                posix_ipc.unlink_message_queue(f"/hexwire-{os.getpid()}{end}")


def answers(session: Session, ended: threading.Event) -> None:
    """What a module does: double what it is asked, and tell and ask in turn."""
    while not ended.is_set():
        for request in session.requests(timeout=0.05):
            if request.frame.cmd == TELL:
                session.report(TELL, request.frame.body + b"!")
            session.reply(request, 2 * request.frame.body)
            if request.frame.cmd == BACK:
                back = session.request(ASK, b"and you?", window=LONG)
                session.report(BACK, back.body)


@pytest.mark.parametrize("kind", KINDS)
def test_a_server_receives_requests_replies_and_sends_unasked(tmp_path: Path, kind: str) -> None:
    with modules(tmp_path, kind) as (camera, gripper), beside(lambda ended: answers(camera, ended)):
        found = gripper.negotiate(look=False, boot_window=LONG)
        assert found.identity is not None
        assert found.identity.joints == ()
        for body in (b"x", b"", bytes(3000)):
            reply = gripper.request(ASK, body, window=LONG)
            assert (reply.status, reply.body) == (Status.OK, 2 * body), len(body)
        gripper.request(TELL, b"seen", window=LONG)
        told = next(gripper.stream(LONG))
        assert (told.cmd, told.body, told.src) == (TELL, b"seen!", CAMERA)
        # And the other way round: the server asks, the client answers.
        gripper.request(BACK, b"", window=LONG)
        asked = next(gripper.requests(LONG))
        assert (asked.frame.cmd, asked.frame.body) == (ASK, b"and you?")
        gripper.reply(asked, b"I am well")
        told = next(gripper.stream(LONG))
        assert (told.cmd, told.body) == (BACK, b"I am well")


@pytest.mark.parametrize("kind", KINDS)
def test_both_ends_ask_and_answer_at_the_same_time(tmp_path: Path, kind: str) -> None:
    """Each waits for its answer in one thread, and answers in another: neither waits for the other's end."""
    with modules(tmp_path, kind) as (camera, gripper):
        with beside(lambda ended: answers(camera, ended)), beside(lambda ended: answers(gripper, ended)):
            assert gripper.request(ASK, b"x", window=LONG).body == b"xx"
            at_once = threading.Barrier(2)
            heard: dict[str, list[bytes]] = {"camera": [], "gripper": []}

            def ask(name: str, session: Session) -> None:
                for number in range(20):
                    at_once.wait(LONG)
                    heard[name].append(session.request(TELL, b"%d" % number, window=LONG).body)

            askers = [threading.Thread(target=ask, args=end) for end in (("camera", camera), ("gripper", gripper))]
            for asker in askers:
                asker.start()
            for asker in askers:
                asker.join(2 * LONG)
        expected = [2 * (b"%d" % number) for number in range(20)]
        assert heard == {"camera": expected, "gripper": expected}
        for session in (camera, gripper):
            told = [next(session.stream(LONG)).body for _ in range(20)]
            assert told == [b"%d!" % number for number in range(20)]


@pytest.mark.parametrize("kind", ["TCP", "UDP", "QUEUE"])
def test_a_server_is_there_for_the_next_module(tmp_path: Path, kind: str) -> None:
    with modules(tmp_path, kind) as (camera, gripper), beside(lambda ended: answers(camera, ended)):
        for _ in range(3):
            gripper.negotiate(look=False, boot_window=LONG)
            assert gripper.request(ASK, b"x", window=LONG).body == b"xx"
            gripper.close()
            gripper.open()


@pytest.mark.parametrize("kind", ["UDP", "QUEUE"])
def test_over_datagrams_the_client_speaks_first(tmp_path: Path, kind: str) -> None:
    with modules(tmp_path, kind) as (camera, _):
        for send in (camera.request, camera.send, camera.report):
            with pytest.raises(LinkTimeoutError, match="nobody has spoken yet"):
                send(TELL)
        with pytest.raises(LocalProtocolError, match="is spoken to first"):
            camera.negotiate()


@pytest.mark.parametrize("kind", KINDS)
def test_the_direction_of_a_record_is_kept(tmp_path: Path, kind: str) -> None:
    with modules(tmp_path, kind, server="RX", client="TX") as (camera, gripper):
        sends = {
            "request": lambda: camera.request(ASK),
            "send": lambda: camera.send(ASK),
            "report": lambda: camera.report(ASK),
            "stop": lambda: camera.request(Command.STOP, b"\0"),
            "several": lambda: camera.request_all(Command.STOP, b"\0"),
            "negotiate": lambda: camera.negotiate(),
        }
        for name, send in sends.items():
            with pytest.raises(
                ConfigError, match=r"12 is \w+_RX, which only receives.* write \w+_TRX or \w+_TX"
            ) as e:
                send()
            assert (e.value.line, e.value.file) == (1, str(tmp_path / "ipc_msg.conf")), name
        receives = {
            "receive": lambda: gripper.receive(0.0),
            "stream": lambda: next(gripper.stream(0.0)),
            "requests": lambda: next(gripper.requests(0.0)),
        }
        for name, receive in receives.items():
            with pytest.raises(ConfigError, match=r"13 is CLIENT_TX, which only sends") as e:
                receive()
            assert e.value.line == 2, name


@pytest.mark.parametrize("kind", KINDS)
def test_what_only_sends_reaches_what_only_receives(tmp_path: Path, kind: str) -> None:
    with modules(tmp_path, kind, server="RX", client="TX") as (camera, gripper):
        heard: list[bytes] = []

        def listen(ended: threading.Event) -> None:
            while not ended.is_set() and not heard:
                heard.extend(request.frame.body for request in camera.requests(timeout=0.05))

        with beside(listen):
            for _ in range(int(LONG / 0.05)):
                if heard:
                    break
                gripper.send(TELL, b"seen")
                threading.Event().wait(0.05)
        assert heard[0] == b"seen"


@pytest.mark.parametrize("way", [way for way in ChannelDirection if way.is_server])
def test_a_server_on_a_serial_port_is_refused(way: ChannelDirection) -> None:
    line = f"12 {way.value} 13 IPC_SERIAL_PORT /dev/ttyUSB0 115200\n"
    client = way.value.replace("SERVER", "CLIENT")
    with pytest.raises(ConfigError, match=f"a serial port has no server: write {client} at both ends") as error:
        parse_conf(line)
    assert (error.value.line, error.value.column) == (1, 4)


def test_the_identity_of_a_module_is_its_own(tmp_path: Path) -> None:
    seen = set()
    for _ in range(2):
        with modules(tmp_path, "TCP") as (camera, gripper), beside(lambda ended, c=camera: answers(c, ended)):  # type: ignore[misc]  # bound
            reply = gripper.request(Command.IDENTIFY, window=LONG)
            seen.add(Identity.parse(reply.body).boot_id)
    assert len(seen) == 2
