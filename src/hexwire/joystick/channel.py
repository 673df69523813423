"""The JOY_STICK module: a channel that carries axes and buttons.

Owns both ends: a sender that sends the complete state periodically, and a receiver that knows the age of the newest
state. States are not answered or repeated, since the next one follows.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self

from hexwire.errors import LinkError, LinkLostError, LinkTimeoutError, RemoteProtocolError
from hexwire.ipc.connections import module_identity, random_number
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link.base import LinkKind, Openable
from hexwire.session.connection import Connection, Role
from hexwire.session.events import Request
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.modules import ModuleType
from hexwire.wire.robot_bodies import JoystickState

__all__ = ["JoystickReceiver", "JoystickSender"]

_FORGET_ORDER = 1.0
"""Seconds of silence after which a sender may restart its count."""
_MOST_READS = 64


class JoystickSender(Openable):
    """The end with the joystick. Open it as a context manager, and send the state about 50 times per second.

    Args:
        session: A session of the JOY_STICK module.
    """

    def __init__(self, session: Session) -> None:
        self.session = session

    @classmethod
    def from_url(cls, url: str, to: ModuleType = ModuleType.ROS1_HOST) -> Self:
        """A sender over the link that `url` names."""
        return cls(Session(IpcHandle.from_url(url, ModuleType.JOY_STICK, to)))

    @classmethod
    def from_conf(cls, file: str | Path) -> Self:
        """A sender over the channel of JOY_STICK that a configuration file names."""
        return cls(Session.from_conf(file, ModuleType.JOY_STICK))

    def open(self) -> None:
        """Open the channel; raises as `Session.open`."""
        self.session.open()

    def close(self) -> None:
        """Close the channel."""
        self.session.close()

    def send(self, state: JoystickState) -> None:
        """Send a state, without confirmation. Over datagrams, states are lost until the other end answers.

        Raises:
            LinkError: The line accepts no bytes.
        """
        self.session.send(Command.JOYSTICK, state.serialize())


class JoystickReceiver(Openable):
    """The receiving end: the newest state, and its age.

    Args:
        ipc: The channel.
        clock: Monotonic seconds.

    Attributes:
        state: The newest state; None before the first.
        received: States accepted.
        ignored: Frames that are not states, or older than the newest one. Frames that a datagram link's session
            refuses are counted by the session instead.
    """

    def __init__(self, ipc: IpcHandle, clock: Callable[[], float] = time.monotonic) -> None:
        self.ipc = ipc
        self.state: JoystickState | None = None
        self.received = 0
        self.ignored = 0
        self._clock = clock
        self._heard = -math.inf
        self._sn: int | None = None
        self._conversation = 0
        self._connection = self._make_connection()

    @classmethod
    def from_url(cls, url: str, module: ModuleType = ModuleType.ROS1_HOST) -> Self:
        """A receiver over the link that `url` names, such as ``udp-listen://127.0.0.1:15040``."""
        return cls(IpcHandle.from_url(url, module, ModuleType.JOY_STICK))

    @classmethod
    def from_conf(cls, file: str | Path, module: ModuleType = ModuleType.ROS1_HOST) -> Self:
        """A receiver over the channel of `module` that a configuration file names."""
        return cls(IpcHandle(module, file))

    @property
    def age(self) -> float:
        """Seconds since the newest state arrived; infinite before the first."""
        return self._clock() - self._heard

    def open(self) -> None:
        """Open the channel. The other end need not be open.

        Raises:
            ConfigError: The channel only sends.
        """
        # The file is read by this, if there is one.
        assert self.ipc.link is not None
        self.ipc.check_receives()
        self.ipc.open()
        self._sn = None
        self._conversation = 0
        self._connection = self._make_connection()

    def close(self) -> None:
        """Close the channel. Harmless if it is closed."""
        self.ipc.close()

    def poll(self, deadline: float | None = 0.0) -> JoystickState | None:
        """Process received bytes; wait for the first frame until `deadline`.

        Later calls open a lost line again, so a sender may come back.

        Returns:
            The newest state, if a new one has arrived.
        """
        before = self.received
        link = self.ipc.link
        try:
            if not link.is_open:
                self.open()
            data = link.read(deadline)
            for _ in range(_MOST_READS):
                if not data:
                    break
                self._take(data, link.kind is LinkKind.DATAGRAM)
                data = link.read(0.0)
        except LinkLostError:
            # The next call opens the line again, perhaps for another sender.
            self._sn = None
        except LinkError:
            if link.is_open:
                raise
        now = self._clock()
        due = self._connection.next_timeout()
        if due is not None and due <= now:
            self._connection.handle_timeout(now)
        return self.state if self.received != before else None

    def _take(self, data: bytes, whole: bool) -> None:
        now = self._clock()
        self._connection.receive(data, now, end_of_message=whole)
        conversations = self._connection.conversations
        while (event := self._connection.next_event()) is not None:
            if not isinstance(event, Request):
                continue
            if conversations is None:
                self._frame(event.frame, now)
            elif event.frame.cmd == Command.IDENTIFY:
                # Only where a conversation begins with it; states themselves are never answered.
                self._connection.reply(event, Status.OK, module_identity(self._connection), now)
            else:
                if conversations.count != self._conversation:
                    self._conversation, self._sn = conversations.count, None
                if self._frame(event.frame, now):
                    self.ipc.link.confirm()
        for frame in self._connection.data_to_send():
            # An answer that cannot be sent counts as lost: the sender asks again.
            with contextlib.suppress(LinkTimeoutError):
                self.ipc.link.write(frame, 0.0)

    def _frame(self, frame: Frame, now: float) -> bool:
        """Accept a state; False if the frame is not a state, or an old one."""
        newer = self._sn is None or 0 < (frame.sn - self._sn) & 0xFFFFFFFF < 1 << 31
        known = frame.proto == tables.PROTO_HEXWIRE and frame.cmd == Command.JOYSTICK
        if not known or frame.src != self.ipc.destination or not (newer or now - self._heard > _FORGET_ORDER):
            self.ignored += 1
            return False
        try:
            self.state = JoystickState.parse(frame.body)
        except RemoteProtocolError:
            self.ignored += 1
            return False
        self._sn = frame.sn
        self._heard = now
        self.received += 1
        return True

    def _make_connection(self) -> Connection:
        ipc = self.ipc
        return Connection(
            Role.BOARD,
            local=int(ipc.module),
            remote=int(ipc.destination),
            type=int(ipc.type),
            numbers=random_number if ipc.keeps_messages else None,
        )
