"""Creates the session machine that fits the link of a channel.

Owns the consequences of the kind of link: the longest frame, and over datagrams the random numbers and the IDENTIFY
requests of a conversation. Must not know the requests that follow.
"""

from __future__ import annotations

import math
import os

from hexwire.session.connection import Connection, Role
from hexwire.session.policy import RetryPolicy
from hexwire.wire import tables
from hexwire.wire.command_frame import Command
from hexwire.wire.commands import Identity
from hexwire.wire.modules import IpcType

from .handle import IpcHandle

__all__ = ["Introduction", "host_connection", "module_identity", "random_number"]

# Seconds between two IDENTIFY requests: before the answer, and after it.
_ASK_FIRST, _ASK_AGAIN = 0.1, 0.5


def random_number() -> int:
    """An unpredictable number from 0 to 2**31 - 1, for a conversation over datagrams."""
    return int.from_bytes(os.urandom(4), "little") >> 1


def module_identity(connection: Connection, boot_id: int = 0) -> bytes:
    """The answer of a module without joints to IDENTIFY."""
    capabilities = tables.CAPABILITY_FRAGMENTS
    return Identity(tables.PROTO_HEXWIRE, (0, 0, 0), boot_id, capabilities, connection.max_frame, 0, ()).serialize()


def host_connection(
    ipc: IpcHandle, src: int | None, dst: int | None, kind: int | None, *, policy: RetryPolicy, epoch: float
) -> Connection:
    """This end of a channel: that of a host, but over datagrams of who is spoken to first if the link listens.

    Args:
        ipc: The channel.
        src: Our module id; the channel's if None.
        dst: The peer's module id; the channel's if None.
        kind: Kind of channel; the channel's if None.
        policy: Deadlines and retries.
        epoch: As `Connection` takes it.
    """
    return Connection(
        Role.BOARD if ipc.keeps_messages and ipc.listens else Role.HOST,
        duplex=True,
        local=int(ipc.module if src is None else src),
        remote=int(ipc.destination if dst is None else dst),
        type=int(ipc.type if kind is None else kind),
        policy=policy,
        max_frame=tables.MAX_SERIAL_FRAME if ipc.type is IpcType.SERIAL else tables.MAX_NETWORK_FRAME,
        epoch=epoch,
        numbers=random_number if ipc.keeps_messages else None,
    )


class Introduction:
    """Sends IDENTIFY periodically, for a sender over datagrams that does not wait for answers."""

    def __init__(self) -> None:
        self._asked = -math.inf

    def ask(self, connection: Connection, now: float) -> None:
        """Send IDENTIFY if the last one is old enough, so that a restarted peer is found."""
        pause = _ASK_AGAIN if connection.in_conversation else _ASK_FIRST
        if now - self._asked >= pause:
            self._asked = now
            connection.request(Command.IDENTIFY, b"", now, window=pause, attempts=1)
