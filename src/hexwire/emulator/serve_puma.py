"""The emulated PUMA 260 behind TCP and UDP, for as many hosts as come.

Owns the loop over listener and links. Everything the robot does is `puma`'s.
"""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from dataclasses import dataclass

from hexwire.errors import LinkError
from hexwire.ipc.link import LinkKind
from hexwire.ipc.listener import Listener
from hexwire.ipc.poll_link import PollLink
from hexwire.ipc.udp import UdpListenLink

from .puma import EmulatedPuma, PumaPeer

__all__ = ["serve_puma"]

_IDLE = 0.25
_MAX_PEERS = 64


@dataclass(slots=True)
class _Caller:
    link: PollLink
    peer: PumaPeer
    heard: float


def serve_puma(
    robot: EmulatedPuma,
    *,
    listener: Listener,
    udp: UdpListenLink | None,
    stop: Callable[[], bool],
    announce: Callable[[str], None],
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Serve until told to stop. Nobody is waited for: a host that does not take its answers is hung up on.

    Args:
        robot: The robot that all hosts share.
        listener: Where TCP hosts call; opened and closed here.
        udp: Where one UDP host may speak; none if None.
        stop: Asked at least every quarter of a second.
        announce: Told the addresses when they are bound.
        clock: Monotonic seconds.
    """
    callers: dict[int, _Caller] = {}
    with listener:
        try:
            announce(listener.url)
            if udp is not None:
                udp.open()
                callers[udp.fileno()] = _Caller(udp, robot.connect(), clock())
                announce(udp.url)
            while not stop():
                _turn(robot, listener, callers, clock)
        finally:
            for caller in callers.values():
                caller.link.close()


def _turn(robot: EmulatedPuma, listener: Listener, callers: dict[int, _Caller], clock: Callable[[], float]) -> None:
    now = clock()
    due = [t for c in callers.values() if (t := c.peer.next_event_time()) is not None]
    wait = max(0.0, min([_IDLE, *(t - now for t in due)]))
    poll = select.poll()
    poll.register(listener.fileno(), select.POLLIN)
    for fd in callers:
        poll.register(fd, select.POLLIN)
    ready = {fd for fd, _ in poll.poll(wait * 1000)}
    now = clock()
    robot.step(now)
    link = listener.accept(now) if listener.fileno() in ready else None
    if link is not None:
        if len(callers) >= _MAX_PEERS:
            _make_room(callers)
        callers[link.fileno()] = _Caller(link, robot.connect(), now)
    for fd, caller in list(callers.items()):
        try:
            _serve(caller, fd in ready, clock)
        except LinkError:
            del callers[fd]
            caller.link.close()
            if isinstance(caller.link, UdpListenLink):
                # One datagram that could not go must not end UDP for good.
                caller.link.open()
                callers[caller.link.fileno()] = _Caller(caller.link, robot.connect(), now)


def _serve(caller: _Caller, readable: bool, clock: Callable[[], float]) -> None:
    now = clock()
    if readable:
        data = caller.link.read(now)
        if data:
            caller.heard = now
            caller.peer.receive(data, now, end_of_message=caller.link.kind is LinkKind.DATAGRAM)
    caller.peer.step(now)
    for frame in caller.peer.frames_to_send():
        caller.link.write(frame, now)


def _make_room(callers: dict[int, _Caller]) -> None:
    """Hang up on the host that has been silent the longest: the machine behind it may be gone."""
    silent = [(caller.heard, fd) for fd, caller in callers.items() if not isinstance(caller.link, UdpListenLink)]
    callers.pop(min(silent)[1]).link.close()
