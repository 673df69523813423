"""The connection of a hand to an emulated arm: a door beside the arm's line, open only to this user.

Owns the conversations, the doors and their names, and how the arm at a port is found. The door of a
pseudo-terminal is named after the terminal, that of a TCP port after its number, that of an arm inside a program
after its address and the program. On Linux it is a Unix socket at that path, and the kernel tells who serves it.
Elsewhere it is a TCP port of this machine, and the path is a file of this user with its number and a key, which
whoever comes says first.

An order is one line, its result another. Whatever arrives, the outcome is one of three: the hand moves and the line
of its result follows, or a line with an error does and nothing moves, or the conversation ends without a word
because the other side left.

    {"joint": "3", "degrees": 40.0, "seconds": 0.7, "hold": 0.0, "force": 0.6}
    {"joint": "elbow_flex", "moved": 39.98, "torque": false, "blocked": false}
    {"error": "no joint 'x'; so101 has shoulder_pan, ..."}
"""

from __future__ import annotations

import contextlib
import hmac
import itertools
import json
import logging
import os
import re
import secrets
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, fields
from pathlib import Path

from hexwire.errors import DeviceError, HexwireError, LinkNotFoundError, UsageError
from hexwire.folders import make_private_folder, open_folder, runtime_folder
from hexwire.inputs import parse_json
from hexwire.link.url import is_loopback, parse_url
from hexwire.system import user_id

from .hand import Grip, HandOrder, HandResult, Hands

__all__ = [
    "HandConversation",
    "HandServer",
    "Opened",
    "find_arm",
    "inside_name",
    "knock",
    "move_by_hand",
    "open_door",
    "parse_result",
    "port_name",
    "serialize_order",
    "terminal_name",
]

_MOST_CALLERS = 8
"""Callers that wait at a time."""
_LARGEST = 100
"""Bytes of the file that are read."""
_HERE = "127.0.0.1"

Opened = tuple[socket.socket, bytes]
"""A socket, and the key that callers say first; empty if they need none."""


def _listen_at_port(early: Path) -> Opened:
    door, key = socket.socket(socket.AF_INET, socket.SOCK_STREAM), secrets.token_hex(16).encode()
    try:
        door.bind((_HERE, 0))
        door.listen(_MOST_CALLERS)
        with open_folder(early.parent) as folder:
            file = folder.make(early.name, 0o600)
        with os.fdopen(file, "wb") as out:
            out.write(b"%d %s" % (door.getsockname()[1], key))
    except BaseException:
        door.close()
        raise
    return door, key


def _knock_at_port(path: Path, patience: float) -> Opened:
    with path.open("rb") as file:
        port, _, key = file.read(_LARGEST).partition(b" ")
    if not port.isdigit() or not key:
        # Of no program that still runs.
        raise ConnectionRefusedError(f"{path} names no port")
    return socket.create_connection((_HERE, int(port)), patience), key


_listen: Callable[[Path], Opened] = _listen_at_port
_knock: Callable[[Path, float], Opened] = _knock_at_port

if sys.platform == "linux":

    @contextlib.contextmanager
    def _short(path: Path) -> Iterator[str]:
        """An address for a socket's path, which may be longer than the system allows."""
        with open_folder(path.parent) as folder:
            yield f"/proc/self/fd/{folder.descriptor}/{path.name}"

    def _listen_at_path(early: Path) -> Opened:
        door = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            with _short(early) as address:
                door.bind(address)
            door.listen(_MOST_CALLERS)
        except BaseException:
            door.close()
            raise
        return door, b""

    def _knock_at_path(path: Path, patience: float) -> Opened:
        talk = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            talk.settimeout(patience)
            with _short(path) as address:
                talk.connect(address)
            _, uid, _ = struct.unpack("3i", talk.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
            if uid != user_id():
                raise PermissionError(f"{path} belongs to another user")
        except BaseException:
            talk.close()
            raise
        return talk, b""

    _listen, _knock = _listen_at_path, _knock_at_path


def open_door(path: Path) -> Opened:
    """A listening socket that others find by a path.

    Raises:
        OSError: It cannot be made.
        UsageError: The folder cannot be opened.
    """
    # It gets its name when it listens: until then it would be taken for the leftover of a program that was killed.
    # One such may have the name; it belongs to a terminal, port or program that is now ours.
    early = path.with_name(f"{path.name}-{os.getpid()}")
    with contextlib.suppress(FileNotFoundError):
        early.unlink()
    door, key = _listen(early)
    try:
        early.replace(path)
        door.setblocking(False)
    except BaseException:
        door.close()
        raise
    return door, key


def knock(path: Path, patience: float) -> Opened:
    """A connection to the program whose door has a path, and what to say to it first.

    Args:
        path: Of the door.
        patience: Time-out of the connection, seconds.

    Raises:
        ConnectionRefusedError: Whoever made it does not listen any more.
        OSError: There is no such door, or it belongs to another user.
    """
    return _knock(path, patience)


_LONGEST = 1000
"""Most bytes of a line."""
_SILENCE = 2.0
"""Seconds within which an order must be complete."""
_MOST_DEGREES = 3600.0
_MOST_SECONDS = 600.0
_MOST_FORCE = 10.0


class HandConversation:
    """One conversation, seen from the emulator: an order, then its result.

    Args:
        hands: The joints.
        now: When it began.
        key: What the other side says first; empty if its socket has proved who it is.

    Attributes:
        answer: The line for the other side; empty as long as there is none. After it the conversation is over.
    """

    def __init__(self, hands: Hands, now: float, key: bytes = b"") -> None:
        self.answer = b""
        self._hands, self._until, self._key = hands, now + _SILENCE, key
        self._heard = b""
        self._grip: Grip | None = None

    @property
    def is_moving(self) -> bool:
        """Whether its hand is at a joint."""
        return self._grip is not None and not self.answer

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes; what follows the order is ignored."""
        if self._grip is not None or self.answer:
            return
        self._heard += data
        line, end, _ = self._heard.partition(b"\n")
        if len(line) > _LONGEST:
            self._answer({"error": f"an order has at most {_LONGEST} bytes"})
        elif end and not hmac.compare_digest(line[: len(self._key)], self._key):
            self._answer({"error": "this emulated arm belongs to another program or user"})
        elif end:
            line = line[len(self._key) :]
            try:
                self._grip = self._hands.take(_parse_order(line), now)
            except HexwireError as error:
                self._answer({"error": str(error)})

    def step(self, now: float) -> None:
        """Let time pass."""
        if self._grip is None:
            if now >= self._until and not self.answer:
                self._answer({"error": "no order came"})
        elif not self.answer and (result := self._grip.step(now)) is not None:
            self._answer(asdict(result))

    def end(self) -> None:
        """The other side has left: the hand lets go."""
        if self._grip is not None:
            self._grip.let_go()

    def _answer(self, row: dict[str, object]) -> None:
        self.answer = json.dumps(row).encode() + b"\n"


def serialize_order(order: HandOrder) -> bytes:
    """The line of an order.

    Raises:
        UsageError: A number of it is out of range, or the joint's name too long.
    """
    line = json.dumps(asdict(order)).encode()
    _parse_order(line)
    return line + b"\n"


def _parse_order(line: bytes) -> HandOrder:
    row = parse_json(line).table([field.name for field in fields(HandOrder)], ())
    return HandOrder(
        joint=row["joint"].text(100),
        degrees=row["degrees"].number(-_MOST_DEGREES, _MOST_DEGREES),
        seconds=row["seconds"].number(0.0, _MOST_SECONDS),
        hold=row["hold"].number(0.0, _MOST_SECONDS),
        force=row["force"].number(0.0, _MOST_FORCE),
    )


def parse_result(line: bytes) -> HandResult:
    """The result of an order from the line of the emulator.

    Raises:
        UsageError: The emulator refused the order; the text is its own. Or it is no such line.
    """
    item = parse_json(line[:_LONGEST])
    row = item.table()
    if "error" in row:
        raise UsageError(row["error"].text(_LONGEST))
    row = item.table([field.name for field in fields(HandResult)], ())
    return HandResult(row["joint"].text(100), row["moved"].number(), row["torque"].flag(), row["blocked"].flag())


_log = logging.getLogger(__name__)

_SUFFIX = ".hand"
_MOST = 8
"""Conversations at a time."""
_READ = 2000
_PATIENCE = 5.0
"""Time-out for the result after the end of the motion, seconds."""
_TERMINAL = re.compile(r"/dev/pts/([0-9]{1,9})")
_numbers = itertools.count(1)


def terminal_name(path: str) -> str:
    """Name for the arm behind a pseudo-terminal; empty if the path leads to none."""
    found = _TERMINAL.fullmatch(os.path.realpath(path))
    return f"pts-{found[1]}" if found else ""


def port_name(number: int) -> str:
    """Name for the arm at a TCP port of this machine."""
    return f"tcp-{number}"


def inside_name(robot: str, name: str) -> str:
    """Name for an arm inside this program; each call returns a new one."""
    return f"{_inside(robot, name)}{os.getpid()}.{next(_numbers)}"


def _inside(robot: str, name: str) -> str:
    return f"sim-{robot}-{name}{'-' if name else ''}"


def _folder() -> Path:
    return runtime_folder() / "sim"


class HandServer:
    """Lets programs of this user move the joints of an emulated arm by hand.

    Args:
        name: From `terminal_name`, `port_name` or `inside_name`.
        hands: The joints.
    """

    def __init__(self, name: str, hands: Hands) -> None:
        self._path, self._hands = _folder() / f"{name}{_SUFFIX}", hands
        self._door: socket.socket | None = None
        self._key = b""
        self._talks: list[tuple[socket.socket, HandConversation]] = []

    def open(self) -> None:
        """Open the door. If that fails, log a warning: the arm then works, but cannot be moved by hand."""
        try:
            make_private_folder(_folder(), "set XDG_RUNTIME_DIR to a folder of yours")
            self._door, self._key = open_door(self._path)
        except (OSError, UsageError) as error:
            _log.warning("the emulated arm cannot be moved by hand: %s", error)

    def close(self) -> None:
        """Let go of all joints and remove the door."""
        for talk, conversation in self._talks:
            conversation.end()
            talk.close()
        self._talks = []
        if self._door is not None:
            self._door.close()
            self._door = None
            with contextlib.suppress(OSError):
                self._path.unlink()

    def descriptors(self) -> list[int]:
        """Descriptors that become readable when `step` has something to do."""
        door = [] if self._door is None else [self._door]
        return [one.fileno() for one in (*door, *(talk for talk, _ in self._talks))]

    @property
    def is_busy(self) -> bool:
        """Whether `step` has something to do as time passes."""
        return bool(self._talks)

    def step(self, now: float) -> None:
        """Handle orders, and move joints up to `now`. Never waits."""
        if self._door is not None:
            self._accept(self._door, now)
        for row in list(self._talks):
            talk, conversation = row
            try:
                data = talk.recv(_READ)
            except BlockingIOError:
                data = None
            except OSError:
                data = b""
            if data:
                conversation.receive(data, now)
            elif data is not None:
                conversation.end()
            conversation.step(now)
            if conversation.answer or data == b"":
                self._talks.remove(row)
                with talk, contextlib.suppress(OSError):
                    talk.send(conversation.answer)

    def _accept(self, door: socket.socket, now: float) -> None:
        while True:
            try:
                talk, _ = door.accept()
            except OSError:
                return
            if len(self._talks) >= _MOST:
                talk.close()
                continue
            talk.setblocking(False)
            self._talks.append((talk, HandConversation(self._hands, now, self._key)))


def find_arm(port: str | None) -> Path:
    """The door of the emulated arm at a port.

    Args:
        port: A pseudo-terminal or a link to one, ``tcp://127.0.0.1:7001`` for one of this machine, ``sim://so101``
            or ``sim://so101?name=left`` for an arm inside another program, or None for the only one of this user.

    Raises:
        UsageError: Nothing is emulated at such a port, or several arms fit.
        LinkNotFoundError: No arm is emulated there now.
    """
    folder, advice = _folder(), "start 'hexwire sim bus', or a program that opens sim://so101"
    if port is None:
        fitting = sorted(folder.glob(f"*{_SUFFIX}"))
    else:
        url = parse_url(port)
        if url.scheme == "sim":
            advice = "start a program that opens it and goes on reading it, such as 'hexwire serve'"
            inside = re.escape(_inside(url.netloc, url.query.get("name", "")))
            pattern = inside + ("[0-9.]+" if "name" in url.query else r"(.+-)?[0-9.]+") + re.escape(_SUFFIX)
            fitting = sorted(path for path in folder.glob(f"*{_SUFFIX}") if re.fullmatch(pattern, path.name))
        elif url.scheme == "serial" and (name := terminal_name(url.path)):
            fitting = [folder / f"{name}{_SUFFIX}"]
        elif url.scheme == "tcp" and is_loopback((address := url.host_port())[0]):
            fitting = [folder / f"{port_name(address[1])}{_SUFFIX}"]
        elif url.scheme == "serial" and not os.path.lexists(url.path):
            raise LinkNotFoundError(f"there is no {url.path}; {advice}", url=port)
        else:
            raise UsageError(
                f"{port} is not an emulated arm: hands move those of 'hexwire sim board', 'hexwire sim bus' and "
                "sim://, on the machine where they run; one at a TCP port is tcp://127.0.0.1:PORT there"
            )
    alive = [path for path in fitting if _is_alive(path)]
    if not alive:
        at = f" at {port}" if port is not None else ""
        raise LinkNotFoundError(f"no emulated arm of this user is running{at}; {advice}", url=port or "")
    if len(alive) > 1:
        names = ", ".join(_shown(path) for path in alive)
        raise UsageError(
            f"several emulated arms are running: {names}; name one with --port, as in sim://so101?name=left"
        )
    return alive[0]


def _shown(path: Path) -> str:
    name = path.name.removesuffix(_SUFFIX)
    if found := re.fullmatch(r"sim-([^-]*)-(?:(.*)-)?([0-9]+)\.[0-9]+", name):
        return f"sim://{found[1]}{f'?name={found[2]}' if found[2] else ''} (pid {found[3]})"
    return name.replace("pts-", "/dev/pts/").replace("tcp-", "tcp://127.0.0.1:")


def _is_alive(path: Path) -> bool:
    """Whether an emulator listens there; removes the door of one that was killed."""
    if not os.path.lexists(path):
        return False
    try:
        knock(path, _PATIENCE)[0].close()
    except ConnectionRefusedError:
        with contextlib.suppress(OSError):
            path.unlink()
        return False
    except OSError:
        return False
    return True


def move_by_hand(port: str | None, order: HandOrder) -> HandResult:
    """Move a joint of a running emulated arm by hand, and wait for the end of it.

    If this program ends meanwhile, the hand lets go.

    Args:
        port: As for `find_arm`.
        order: What to do.

    Raises:
        UsageError: As `find_arm`; or the arm has no such joint, or a number is out of range.
        LinkNotFoundError: As `find_arm`.
        DeviceError: The emulator ended, or does not run on because nobody reads the arm.
    """
    line = serialize_order(order)
    path = find_arm(port)
    deadline = time.monotonic() + order.seconds + order.hold + _PATIENCE
    heard = b""
    try:
        talk, key = knock(path, _PATIENCE)
        with talk:
            talk.sendall(key + line)
            while not heard.endswith(b"\n"):
                talk.settimeout(max(0.001, deadline - time.monotonic()))
                data = talk.recv(_READ)
                if not data:
                    raise DeviceError("the emulated arm ended, or is moved by too many hands")
                heard += data
    except TimeoutError:
        raise DeviceError("the emulated arm does not run: the program that has it open does not read it") from None
    except OSError as error:
        raise DeviceError(f"the emulated arm cannot be reached: {error.strerror or error}") from None
    return parse_result(heard)
