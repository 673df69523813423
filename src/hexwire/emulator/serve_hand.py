"""The connection of a hand to an emulated arm: a socket beside the arm's line, open only to this user.

Owns the sockets, their names, and how the arm at a port is found. The socket of a pseudo-terminal is named after
the terminal, that of an arm inside a program after its address and the program. Must not know what hands do.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import re
import socket
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from hexwire.errors import DeviceError, LinkNotFoundError, UsageError
from hexwire.folders import make_private_folder, open_folder, runtime_folder
from hexwire.link.url import parse_url
from hexwire.system import user_id

from .hand import HandOrder, HandResult, Hands
from .hand_channel import HandConversation, parse_result, serialize_order

__all__ = ["HandServer", "find_arm", "inside_name", "move_by_hand", "terminal_name"]

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


def inside_name(robot: str, name: str) -> str:
    """Name for an arm inside this program; each call returns a new one."""
    return f"{_inside(robot, name)}{os.getpid()}.{next(_numbers)}"


def _inside(robot: str, name: str) -> str:
    return f"sim-{robot}-{name}{'-' if name else ''}"


def _folder() -> Path:
    return runtime_folder() / "sim"


@contextlib.contextmanager
def _short(path: Path) -> Iterator[str]:
    """An address for a socket's path, which may be longer than the system allows."""
    with open_folder(path.parent) as folder:
        yield f"/proc/self/fd/{folder.descriptor}/{path.name}"


class HandServer:
    """Lets programs of this user move the joints of an emulated arm by hand.

    Args:
        name: From `terminal_name` or `inside_name`.
        hands: The joints.
    """

    def __init__(self, name: str, hands: Hands) -> None:
        self._path, self._hands = _folder() / f"{name}{_SUFFIX}", hands
        self._door: socket.socket | None = None
        self._talks: list[tuple[socket.socket, HandConversation]] = []

    def open(self) -> None:
        """Create the socket. If that fails, log a warning: the arm then works, but cannot be moved by hand."""
        if sys.platform != "linux" or not hasattr(socket, "AF_UNIX"):
            # `move_by_hand` says so.
            return
        door = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            make_private_folder(_folder(), "set XDG_RUNTIME_DIR to a folder of yours")
            # It gets its name when it listens: until then it would be taken for the leftover of a program that was
            # killed. One such may have the name; it belongs to a terminal or program that is now ours.
            early = self._path.with_name(f"{self._path.name}-{os.getpid()}")
            with contextlib.suppress(FileNotFoundError):
                early.unlink()
            with _short(early) as address:
                door.bind(address)
            door.listen(_MOST)
            early.replace(self._path)
        except (OSError, UsageError) as error:
            door.close()
            _log.warning("the emulated arm cannot be moved by hand: %s", error)
            return
        door.setblocking(False)
        self._door = door

    def close(self) -> None:
        """Let go of all joints and remove the socket."""
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
            self._talks.append((talk, HandConversation(self._hands, now)))


def find_arm(port: str | None) -> Path:
    """The socket of the emulated arm at a port.

    Args:
        port: A pseudo-terminal or a link to one, ``sim://so101`` or ``sim://so101?name=left`` for an arm inside
            another program, or None for the only one of this user.

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
        elif url.scheme == "serial" and not os.path.lexists(url.path):
            raise LinkNotFoundError(f"there is no {url.path}; {advice}", url=port)
        else:
            raise UsageError(
                f"{port} is not an emulated arm: hands move those of 'hexwire sim board', 'hexwire sim bus' and "
                "sim://, on the machine where they run"
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
    return name.replace("pts-", "/dev/pts/")


def _is_alive(path: Path) -> bool:
    """Whether an emulator listens there; removes the socket of one that was killed."""
    try:
        _connect(path).close()
    except ConnectionRefusedError:
        with contextlib.suppress(OSError):
            path.unlink()
        return False
    except OSError:
        return False
    return True


def _connect(path: Path) -> socket.socket:
    if sys.platform != "linux" or not hasattr(socket, "AF_UNIX"):
        raise UsageError("emulated arms are moved by hand on Linux only")
    talk = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        talk.settimeout(_PATIENCE)
        with _short(path) as address:
            talk.connect(address)
        _, uid, _ = struct.unpack("3i", talk.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        if uid != user_id():
            raise PermissionError(f"{path} belongs to another user")
    except BaseException:
        talk.close()
        raise
    return talk


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
        with _connect(path) as talk:
            talk.sendall(line)
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
