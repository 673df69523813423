"""How hands reach emulated arms: by the doors of Linux, and by those of other systems."""

from __future__ import annotations

import json
import os
import select
import socket
import stat
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.waits import PATIENCE, eventually

from hexwire.bus.servo_bus import ServoBus
from hexwire.emulator import serve_hand
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.hand import HandOrder, HandResult, Hands
from hexwire.emulator.serve_hand import (
    HandConversation,
    HandServer,
    find_arm,
    inside_name,
    move_by_hand,
    parse_result,
    serialize_order,
    terminal_name,
)
from hexwire.emulator.serve_tcp import TcpServer
from hexwire.emulator.servo import EmulatedServo
from hexwire.errors import DeviceError, LinkNotFoundError, UsageError
from hexwire.wire.registers import Series

LINE = HandOrder("3", 20.0, 0.3)
LINE = serialize_order(LINE)


class Talk:
    def __init__(self) -> None:
        self.servo = EmulatedServo(Series.STS_SMS, 3, position=2048)
        self.hands = Hands([self.servo])
        self.talk = HandConversation(self.hands, 0.0)

    @property
    def error(self) -> str:
        return str(json.loads(self.talk.answer)["error"])


def test_an_order_moves_the_hand_and_its_result_follows() -> None:
    it = Talk()
    for byte in LINE:
        it.talk.receive(bytes([byte]), 0.0)
        it.talk.step(0.0)
    it.talk.step(0.2)
    assert it.talk.answer == b""
    it.talk.step(1.0)
    assert parse_result(it.talk.answer) == HandResult("servo 3", pytest.approx(20.0, abs=0.2), False, False)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (b"\n", "not JSON"),
        (b"[]\n", "table"),
        (b"{}\n", "joint"),
        (b"[" * 900 + b"\n", "nested|not JSON"),
        (b"\xff\n", "UTF-8"),
        (LINE.replace(b"20.0", b"NaN"), "finite"),
        (LINE.replace(b"20.0", b"3601"), "3600"),
        (LINE.replace(b"0.3", b"-1"), "seconds"),
        (LINE.replace(b"0.6", b"11"), "force"),
        (LINE.replace(b'"3"', b'"4"'), "no servo '4'; there are 3"),
        (LINE.replace(b'"3"', b"3"), "joint"),
        (LINE.replace(b'"hold"', b'"hodl"'), "hodl|hold"),
        (b"x" * 1001, "at most 1000 bytes"),
    ],
)
def test_anything_else_is_answered_with_one_line_and_moves_nothing(line: bytes, said: str) -> None:
    it = Talk()
    it.talk.receive(line, 0.0)
    it.talk.step(5.0)
    assert it.talk.answer.count(b"\n") == 1
    with pytest.raises(UsageError, match=said):
        parse_result(it.talk.answer)
    assert (it.servo.motion.hand, it.servo.motion.position) == (None, 2048.0)


@given(st.lists(st.binary(max_size=300), max_size=6))
def test_no_bytes_raise_or_move_a_joint(pieces: list[bytes]) -> None:
    it = Talk()
    for count, piece in enumerate(pieces):
        it.talk.receive(piece, count * 0.1)
        it.talk.step(count * 0.1)
    it.talk.step(10.0)
    assert it.error
    assert it.servo.motion.position == 2048.0


def test_a_silent_connection_is_closed() -> None:
    it = Talk()
    it.talk.receive(LINE[:-1], 0.0)
    it.talk.step(1.9)
    assert it.talk.answer == b""
    it.talk.step(2.0)
    assert it.error == "no order came"


def test_only_the_first_order_counts() -> None:
    it = Talk()
    it.talk.receive(LINE + serialize_order(HandOrder("3", -90.0, 0.3)), 0.0)
    it.talk.receive(LINE, 0.1)
    it.talk.step(3.0)
    it.talk.receive(LINE, 3.0)
    assert parse_result(it.talk.answer).moved == pytest.approx(20.0, abs=0.2)
    assert it.servo.motion.hand is None


def test_the_hand_lets_go_if_the_other_side_leaves() -> None:
    it = Talk()
    it.talk.receive(LINE, 0.0)
    it.talk.step(0.1)
    it.talk.end()
    assert it.servo.motion.hand is None
    HandConversation(it.hands, 0.0).end()


def test_orders_and_results_are_checked_on_this_side_too() -> None:
    for wrong in (HandOrder("3", 1e9, 1.0), HandOrder("3", float("nan"), 1.0), HandOrder("x" * 200, 1.0, 1.0)):
        with pytest.raises(UsageError):
            serialize_order(wrong)
    for line in (b"", b"{}", b"[1]", b'{"joint": 3, "moved": 1, "torque": false, "blocked": false}'):
        with pytest.raises(UsageError):
            parse_result(line)


ORDER = HandOrder("3", 5.0, 0.2)


@pytest.fixture(autouse=True, params=["path", "port"])
def kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The kind of door; a TCP port is that of other systems than Linux."""
    kind: str = request.param
    for what in ("listen", "knock"):
        monkeypatch.setattr(serve_hand, f"_{what}", getattr(serve_hand, f"_{what}_at_{kind}"))
    return kind


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    # Longer than the system allows for the address of a socket.
    runtime = tmp_path / ("x" * 100)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    return runtime / "hexwire" / "sim"


def servo() -> EmulatedServo:
    return EmulatedServo(Series.STS_SMS, 3, position=2048, start=time.monotonic())


@contextmanager
def serving(name: str, one: EmulatedServo | None = None, *, runs: bool = True) -> Iterator[HandServer]:
    server = HandServer(name, Hands([one or servo()]))
    server.open()
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(0.01):
            server.step(time.monotonic())

    thread = threading.Thread(target=run)
    if runs:
        thread.start()
    try:
        yield server
    finally:
        ended.set()
        if runs:
            thread.join(PATIENCE)
        server.close()


@contextmanager
def talking(path: Path) -> Iterator[socket.socket]:
    talk, key = serve_hand.knock(path, PATIENCE)
    with talk:
        talk.sendall(key)
        yield talk


def until(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_a_joint_is_moved_and_the_socket_is_private_and_goes(folder: Path) -> None:
    with serving(inside_name("so101", "left")):
        (path,) = folder.iterdir()
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        assert stat.S_ISSOCK(path.stat().st_mode) or stat.S_IMODE(path.stat().st_mode) == 0o600
        for port in ("sim://so101?name=left", "sim://so101", None):
            assert find_arm(port) == path
        assert move_by_hand(None, ORDER) == HandResult("servo 3", pytest.approx(5.0, abs=0.3), False, False)
        with pytest.raises(UsageError, match="no servo '9'; there are 3"):
            move_by_hand(None, HandOrder("9", 5.0, 0.2))
    assert list(folder.iterdir()) == []


def test_arms_are_distinguished_by_kind_and_name(folder: Path) -> None:
    names = [inside_name("so101", "left"), inside_name("so101", ""), inside_name("so100", "left")]
    with serving(names[0], runs=False), serving(names[1], runs=False), serving(names[2], runs=False):
        assert find_arm("sim://so101?name=left&seed=3").name == f"{names[0]}.hand"
        assert find_arm("sim://so100").name == f"{names[2]}.hand"
        pid = os.getpid()
        both = rf"sim://so101 \(pid {pid}\), sim://so101\?name=left \(pid {pid}\); name one"
        with pytest.raises(UsageError, match=both):
            find_arm("sim://so101")
        with pytest.raises(UsageError, match="several"):
            find_arm(None)
        for port in ("sim://hex7bot", "sim://so101?name=right", "sim://so10"):
            with pytest.raises(LinkNotFoundError, match="goes on reading"):
                find_arm(port)


def test_a_terminal_is_found_by_any_name(tmp_path: Path) -> None:
    master, slave = os.openpty()
    try:
        path = os.ttyname(slave)
        link = tmp_path / "arm"
        link.symlink_to(path)
        assert terminal_name(str(link)) == terminal_name(path) == path.replace("/dev/pts/", "pts-")
        with serving(terminal_name(path), runs=False):
            assert find_arm(str(link)) == find_arm(f"serial://{link}?baud=9600") == find_arm(path)
    finally:
        os.close(master)
        os.close(slave)


@pytest.mark.parametrize("port", ["/dev/null", "tcp://192.0.2.1:1", "udp://127.0.0.1:1", "/"])
def test_what_is_no_emulated_arm_is_refused(port: str) -> None:
    with pytest.raises(UsageError, match="is not an emulated arm"):
        find_arm(port)


@pytest.mark.parametrize("port", ["/dev/pts/9999", "tcp://127.0.0.1:1"])
def test_a_port_where_no_arm_was_ever_emulated_is_told(port: str) -> None:
    with pytest.raises(LinkNotFoundError, match=f"no emulated arm of this user is running at {port}; start"):
        find_arm(port)


def test_an_arm_at_a_tcp_port_is_found_by_its_number() -> None:
    servos = [servo()]
    server = TcpServer(BusDevice(servos), "127.0.0.1", 0, hands=Hands(servos))
    url = server.open()
    ended = threading.Event()

    def run() -> None:
        while not ended.is_set():
            server.run_once(0.05)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        # While a host has the line.
        with ServoBus.from_url(url) as bus:
            for port in (url, url.replace("127.0.0.1", "localhost"), None):
                before = eventually(lambda: bus.read(3, "present_position").raw)
                assert move_by_hand(port, ORDER) == HandResult("servo 3", pytest.approx(5.0, abs=0.3), False, False)
                after = eventually(lambda: bus.read(3, "present_position").raw)
                assert after - before == pytest.approx(57, abs=4)
        with serving("pts-7", runs=False), pytest.raises(UsageError, match=f"/dev/pts/7, {url}; name one"):
            find_arm(None)
    finally:
        ended.set()
        thread.join(PATIENCE)
        server.close()
    with pytest.raises(LinkNotFoundError, match=f"is running at {url}"):
        find_arm(url)


def test_no_running_emulator_is_an_error_that_says_so(tmp_path: Path) -> None:
    assert terminal_name("/dev/null") == ""
    with pytest.raises(LinkNotFoundError, match=r"no emulated arm of this user is running; start"):
        find_arm(None)
    with pytest.raises(LinkNotFoundError, match=r"there is no .*/x; start"):
        find_arm(str(tmp_path / "x"))


def test_an_arm_that_is_starting_is_not_taken_for_what_a_killed_one_left(monkeypatch: pytest.MonkeyPatch) -> None:
    class Looked(socket.socket):
        """Somebody looks for arms right before it listens."""

        def listen(self, backlog: int = 0, /) -> None:
            with pytest.raises(LinkNotFoundError):
                find_arm(None)
            super().listen(backlog)

    monkeypatch.setattr(socket, "socket", Looked)
    with serving("pts-7", runs=False):
        assert find_arm(None).name == "pts-7.hand"


def test_what_a_killed_emulator_left_is_removed_and_its_name_can_be_taken(folder: Path) -> None:
    with serving("pts-7", runs=False):
        left = folder / "left"
        os.link(folder / "pts-7.hand", left)
    left.rename(folder / "pts-7.hand")
    with pytest.raises(LinkNotFoundError):
        find_arm(None)
    assert list(folder.iterdir()) == []
    (folder / "pts-7.hand").touch()
    with serving("pts-7", runs=False):
        find_arm(None)


def test_what_a_killed_emulator_left_may_be_removed_by_two_programs_at_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving("pts-7", runs=False):
        left = folder / "left"
        os.link(folder / "pts-7.hand", left)
    left.rename(folder / "pts-7.hand")
    unlink = Path.unlink

    def second(path: Path, missing_ok: bool = False) -> None:
        unlink(path)
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", second)
    with pytest.raises(LinkNotFoundError, match="no emulated arm of this user is running"):
        find_arm(None)
    assert list(folder.iterdir()) == []


def test_without_a_folder_the_arm_works_but_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "file"))
    with serving("pts-7", runs=False) as server:
        server.step(0.0)
        assert server.descriptors() == []
    assert "cannot be moved by hand" in caplog.text


def test_a_closed_connection_releases_the_joint(folder: Path) -> None:
    one = servo()
    with serving("pts-7", one), talking(folder / "pts-7.hand") as talk:
        talk.sendall(serialize_order(HandOrder("3", 20.0, 0.5, hold=60.0)))
        until(lambda: one.motion.hand is not None)
        talk.close()
        until(lambda: one.motion.hand is None)


def test_the_end_of_the_emulator_ends_the_hand(folder: Path) -> None:
    one = servo()
    with serving("pts-7", one), talking(folder / "pts-7.hand") as talk:
        talk.sendall(serialize_order(HandOrder("3", 20.0, 0.5, hold=60.0)))
        until(lambda: one.motion.hand is not None)
    assert one.motion.hand is None


def test_conversations_are_few_and_silent_ones_end(folder: Path) -> None:
    with serving("pts-7", runs=False) as server:
        stack = ExitStack()
        talks = [stack.enter_context(talking(folder / "pts-7.hand")) for _ in range(9)]
        server.step(1000.0)
        assert server.is_busy
        assert len(server.descriptors()) == 9
        with suppress(ConnectionResetError):
            assert talks[8].recv(10) == b""
        talks[0].sendall(b"nonsense\n")
        server.step(1000.1)
        assert b"error" in talks[0].recv(200)
        server.step(1002.0)
        assert b"no order came" in talks[7].recv(200)
        assert not server.is_busy
        stack.close()


def test_an_emulator_that_stands_still_or_ends_is_an_error(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setattr(serve_hand, "_PATIENCE", 0.1)
    with serving("pts-7", runs=False) as server:
        with pytest.raises(DeviceError, match="does not run"):
            move_by_hand(None, ORDER)
        monkeypatch.setattr(serve_hand, "_PATIENCE", PATIENCE)
        here = find_arm(None)
        monkeypatch.setattr(serve_hand, "find_arm", lambda port: here)
        # Done with who called until now.
        server.step(0.0)
        server.step(PATIENCE)

        def close_when_asked() -> None:
            # Earlier there would be nobody to be asked.
            select.select(server.descriptors(), [], [], PATIENCE)
            server.close()

        thread = threading.Thread(target=close_when_asked)
        thread.start()
        with pytest.raises(DeviceError, match=r"ended|cannot be reached"):
            move_by_hand(None, ORDER)
        thread.join()


@pytest.mark.parametrize("kind", ["path"], indirect=True)
def test_a_socket_of_another_user_is_not_trusted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with serving("pts-7", runs=False):
        monkeypatch.setattr(os, "geteuid", lambda: 12345)
        with pytest.raises(LinkNotFoundError):
            find_arm(None)


@pytest.mark.parametrize("kind", ["port"], indirect=True)
def test_an_order_without_the_key_of_the_arm_moves_nothing(folder: Path) -> None:
    one = servo()
    with serving("pts-7", one):
        port, key = (folder / "pts-7.hand").read_bytes().split()
        for wrong in (b"", key[:-1] + b"-", b"x" * len(key)):
            with socket.create_connection(("127.0.0.1", int(port)), PATIENCE) as talk:
                talk.sendall(wrong + serialize_order(ORDER))
                assert b"belongs to another program or user" in talk.recv(200)
        assert one.motion.hand is None
        assert move_by_hand(None, ORDER).moved == pytest.approx(5.0, abs=0.3)
