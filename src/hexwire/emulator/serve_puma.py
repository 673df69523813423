"""The emulated PUMA 260 behind TCP and UDP, for any number of hosts, and behind a POSIX queue for one.

Owns the loop over listener, links, UDP peers and queue, and which hosts may stay when there are more than the
server accepts: the commanding host never loses its slot. What the robot does, and what makes a request valid,
belongs to `puma`.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from hexwire.errors import LinkError, LinkTimeoutError
from hexwire.ipc.connections import random_number
from hexwire.link.listener import Listener
from hexwire.link.poll_link import PollLink
from hexwire.link.udp import Peer, UdpServer
from hexwire.system import READABLE, make_poll

from .puma import EmulatedPuma, PumaPeer
from .serve import Arrivals

__all__ = ["ClientSlots", "serve_puma"]

K = TypeVar("K", bound=Hashable)

_TOGETHER = 2.0
"""Most seconds between the first messages of the channels that one program opens."""


@dataclass(slots=True)
class _SlotHolder:
    host: str
    came: float
    heard: float | None = None
    commanded: float | None = None


class ClientSlots(Generic[K]):
    """The slots of a server.

    When no slot is left, in total or for one host, one is taken from, in this order:

    1. a client that has never sent a valid request, the oldest first, whatever bytes it has sent;
    2. a client that has sent none for `idle` seconds, the longest silent first, unless it or another client on its
       host commanded last: quiet channels of a robot belong to the host that moves it;
    3. where the new client's host has all its slots: one of its clients that has sent none for `own_idle` seconds,
       the longest silent first, but neither the one that commanded last nor those that came together with it. Over
       datagrams nobody is seen to leave, so a host would fill its slots with programs that have ended.

    If there is no such client, the new one is refused.

    Args:
        most: Total number of slots.
        per_host: Places for one host; a host beyond that loses one of its own.
        idle: Seconds without a valid request after which a client may lose its slot.
        own_idle: The same, for a new client of the same host.
    """

    def __init__(self, most: int = 64, *, per_host: int = 32, idle: float = 60.0, own_idle: float = 1.0) -> None:
        self.most = most
        self.per_host = per_host
        self.idle = idle
        self.own_idle = own_idle
        self.turned_away = 0
        self._guests: dict[K, _SlotHolder] = {}

    def __len__(self) -> int:
        return len(self._guests)

    def admit(self, key: K, host: str, now: float) -> tuple[bool, K | None]:
        """Give a new client a slot.

        Returns:
            Whether it has one, and the client that loses its slot for it.
        """
        out = None
        mine = [k for k, guest in self._guests.items() if guest.host == host]
        host_full = len(mine) >= self.per_host
        if host_full or len(self._guests) >= self.most:
            out = self._weakest(mine if host_full else list(self._guests), now)
            if out is None and host_full:
                out = self._oldest_own(mine, now)
            if out is None:
                self.turned_away += 1
                return False, None
            self.leave(out)
        self._guests[key] = _SlotHolder(host, now)
        return True, out

    def heard(self, key: K, now: float, *, commanded: bool = False) -> None:
        """Record a valid request, and whether it was a command."""
        guest = self._guests.get(key)
        if guest is not None:
            guest.heard = now
            if commanded:
                guest.commanded = now

    def leave(self, key: K) -> None:
        """A client has left. Harmless if it has no slot."""
        self._guests.pop(key, None)

    def _weakest(self, keys: list[K], now: float) -> K | None:
        strangers = [k for k in keys if self._guests[k].heard is None]
        if strangers:
            return min(strangers, key=lambda k: self._guests[k].came)
        commander = self._commander()
        host = commander.host if commander is not None else None
        return self._longest_silent([k for k in keys if self._guests[k].host != host], now, self.idle)

    def _oldest_own(self, keys: list[K], now: float) -> K | None:
        commander = self._commander()
        if commander is not None and commander.host == self._guests[keys[0]].host:
            keys = [k for k in keys if abs(self._guests[k].came - commander.came) > _TOGETHER]
        return self._longest_silent(keys, now, self.own_idle)

    def _longest_silent(self, keys: list[K], now: float, idle: float) -> K | None:
        silent = {k: heard for k in keys if (heard := self._guests[k].heard) is not None and now - heard > idle}
        return min(silent, key=silent.__getitem__, default=None)

    def _commander(self) -> _SlotHolder | None:
        """The client that commanded last, among the connected ones."""
        commanded = {k: guest.commanded for k, guest in self._guests.items() if guest.commanded is not None}
        return self._guests[max(reversed(commanded), key=commanded.__getitem__)] if commanded else None


_IDLE = 0.25
_MOST_AT_ONCE = 64
"""Most callers or datagrams accepted before connected hosts are served again."""
_MOST_LOOKS = 4
"""Looks for more bytes in a turn; they may come all the time."""


@dataclass(slots=True)
class _Caller:
    link: PollLink
    peer: PumaPeer


@dataclass(slots=True)
class _Hosts:
    """Connected hosts, their slots (TCP and UDP hosts cannot displace each other), and when what they sent came."""

    callers: dict[int, _Caller] = field(default_factory=dict)
    peers: dict[Peer, PumaPeer] = field(default_factory=dict)
    queue: _Caller | None = None
    tcp_slots: ClientSlots[int] = field(default_factory=ClientSlots)
    udp_slots: ClientSlots[Peer] = field(default_factory=ClientSlots)
    arrivals: Arrivals = field(default_factory=Arrivals)

    def next_event_time(self) -> float | None:
        """When the next host has something to do."""
        ends = [*(caller.peer for caller in self.callers.values()), *self.peers.values()]
        ends += [] if self.queue is None else [self.queue.peer]
        return min((t for end in ends if (t := end.next_event_time()) is not None), default=None)


def serve_puma(
    robot: EmulatedPuma,
    *,
    listener: Listener,
    udp: UdpServer | None,
    queue: PollLink | None = None,
    stop: Callable[[], bool],
    announce: Callable[[str], None],
) -> None:
    """Serve until told to stop. A host that does not take its answers is disconnected, so that no other waits.

    Args:
        robot: The robot that all hosts share.
        listener: Accepts TCP hosts; opened and closed here.
        udp: Receives from UDP hosts; opened and closed here. None to serve TCP only.
        queue: The server's end of a queue; opened and closed here. None for none.
        stop: Called at least every quarter of a second; True ends it.
        announce: Called with each address once it is bound.
    """
    hosts = _Hosts()
    with listener:
        try:
            announce(listener.url)
            if udp is not None:
                udp.open()
                announce(udp.url)
            if queue is not None:
                queue.open()
                hosts.queue = _Caller(queue, robot.connect(numbers=random_number))
                announce(queue.url)
            while not stop():
                _turn(robot, listener, udp, hosts)
        finally:
            for caller in hosts.callers.values():
                caller.link.close()
            if udp is not None:
                udp.close()
            if queue is not None:
                queue.close()


def _turn(robot: EmulatedPuma, listener: Listener, udp: UdpServer | None, hosts: _Hosts) -> None:
    due = hosts.next_event_time()
    wait = _IDLE if due is None else max(0.0, min(_IDLE, due - time.monotonic()))
    poll = make_poll()
    for fd in (listener.fileno(), *([] if udp is None else [udp.fileno()]), *hosts.callers, *_queue_of(hosts)):
        poll.register(fd, READABLE)
    begun = time.monotonic()
    ready = {fd for fd, _ in poll.poll(wait * 1000)}
    # A velocity ends when nobody repeats it: what has arrived is read before that is judged, of all hosts.
    robot.step(hosts.arrivals.since(begun, wait, time.monotonic()))
    # Connected hosts go before new ones.
    _hear(robot, udp, hosts, ready)
    # Silence is judged up to when a look began that found nothing: this process may stall anywhere.
    now = time.monotonic()
    for _ in range(_MOST_LOOKS):
        more = {fd for fd, _ in poll.poll(0)} - {listener.fileno()}
        if not more:
            break
        _hear(robot, udp, hosts, more)
        now = time.monotonic()
    _answer_callers(hosts, now)
    if udp is not None:
        _answer_peers(udp, hosts, now)
    if hosts.queue is not None:
        _answer_queue(hosts.queue, now)
    if listener.fileno() in ready:
        _let_in(robot, listener, hosts)


def _hear(robot: EmulatedPuma, udp: UdpServer | None, hosts: _Hosts, ready: set[int]) -> None:
    _hear_callers(hosts, ready)
    if udp is not None and udp.fileno() in ready:
        _hear_peers(robot, udp, hosts)
    if hosts.queue is not None and hosts.queue.link.fileno() in ready:
        _hear_queue(hosts.queue)


def _hear_callers(hosts: _Hosts, ready: set[int]) -> None:
    for fd, caller in list(hosts.callers.items()):
        now = time.monotonic()
        try:
            if fd in ready and (data := caller.link.read(now)):
                caller.peer.receive(data, now)
                _note(hosts.tcp_slots, fd, caller.peer, now)
        except LinkError:
            _hang_up(hosts, fd)


def _answer_callers(hosts: _Hosts, now: float) -> None:
    for fd, caller in list(hosts.callers.items()):
        try:
            caller.peer.step(now)
            for frame in caller.peer.frames_to_send():
                caller.link.write(frame, now)
        except LinkError:
            _hang_up(hosts, fd)


def _queue_of(hosts: _Hosts) -> list[int]:
    return [] if hosts.queue is None else [hosts.queue.link.fileno()]


def _hear_queue(host: _Caller) -> None:
    now = time.monotonic()
    if data := host.link.read(now):
        host.peer.receive(data, now, end_of_message=True)


def _answer_queue(host: _Caller, now: float) -> None:
    host.peer.step(now)
    for frame in host.peer.frames_to_send():
        # What nobody takes is lost.
        with contextlib.suppress(LinkTimeoutError):
            host.link.write(frame, now)


def _let_in(robot: EmulatedPuma, listener: Listener, hosts: _Hosts) -> None:
    for _ in range(_MOST_AT_ONCE):
        now = time.monotonic()
        link = listener.accept(now)
        if link is None:
            return
        fd = link.fileno()
        admitted, out = hosts.tcp_slots.admit(fd, link.peer.rpartition(":")[0], now)
        if out is not None:
            _hang_up(hosts, out)
        if admitted:
            hosts.callers[fd] = _Caller(link, robot.connect())
        else:
            link.close()


def _hang_up(hosts: _Hosts, fd: int) -> None:
    hosts.tcp_slots.leave(fd)
    hosts.callers.pop(fd).link.close()


def _hear_peers(robot: EmulatedPuma, udp: UdpServer, hosts: _Hosts) -> None:
    for _ in range(_MOST_AT_ONCE):
        came = udp.receive()
        now = time.monotonic()
        if came is None:
            break
        sender, data = came
        peer = hosts.peers.get(sender) or _seat(robot, hosts, sender, now)
        if peer is not None:
            peer.receive(data, now, end_of_message=True)
            _note(hosts.udp_slots, sender, peer, now)


def _answer_peers(udp: UdpServer, hosts: _Hosts, now: float) -> None:
    for sender, peer in hosts.peers.items():
        peer.step(now)
        for frame in peer.frames_to_send():
            udp.send(sender, frame)


def _seat(robot: EmulatedPuma, hosts: _Hosts, sender: Peer, now: float) -> PumaPeer | None:
    admitted, out = hosts.udp_slots.admit(sender, str(sender[0]), now)
    if out is not None:
        del hosts.peers[out]
    if not admitted:
        return None
    peer = hosts.peers[sender] = robot.connect(numbers=random_number)
    return peer


def _note(slots: ClientSlots[int] | ClientSlots[Peer], key: int | Peer, peer: PumaPeer, now: float) -> None:
    if peer.heard == now:
        slots.heard(key, now, commanded=peer.commanded == now)  # type: ignore[arg-type]  # each key is of its slots
