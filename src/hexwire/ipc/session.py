"""The chapter's `Session`: a link joined to a connection.

Owns the loop that moves bytes between the two, who may use the line when, and what happens when the port goes
away. It adds and removes the session header through its `Connection`, which owns serial numbers, matching and
retries. Must not know joints, servos or units.

One caller at a time drives the line. A second thread waits its turn, but for an urgent request (a stop), which
interrupts the one that is waiting.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Self, TypeVar

from hexwire.errors import (
    LinkClosedError,
    LinkError,
    LinkLostError,
    PreemptedError,
    ReplyTimeoutError,
)
from hexwire.session.connection import Connection
from hexwire.session.events import Event, Reply, Report, TimedOut
from hexwire.session.negotiate import Negotiated, NegotiationFailed, Negotiator
from hexwire.session.policy import ReconnectPolicy, RetryPolicy
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, command_name
from hexwire.wire.modules import IpcType, ModuleType

from .connections import Introduction, host_connection
from .handle import IpcHandle
from .mistaken import find_servos, is_servo_bus
from .turn import Turn

if TYPE_CHECKING:
    from types import TracebackType

__all__ = ["Session"]

_log = logging.getLogger(__name__)

_T = TypeVar("_T")

_WRITE_TIMEOUT = 2.0
_KEPT = 256
_KEPT_RTTS = 8192


class Session:
    """An active conversation with a board over one channel.

    Args:
        ipc: The channel.
        src: Our module id; the channel's if None.
        dst: The peer's module id; the channel's if None.
        type: Kind of channel, as in the chapter's constructor; the channel's if None.
        policy: Deadlines and retries.
        reconnect: What to do when the port goes away.
        clock: Monotonic seconds; must be the clock of the link's deadlines.
        wall: Seconds since 1970 for the header's time stamps.

    Attributes:
        connection: The state machine, with its counters.
        negotiated: The outcome of the last negotiation, or None.
        generation: Grows with every reconnection; a driver compares it to see that the board may be another.
        board_restarts: Resets of the board that showed in its frame counter, the port being open.
        rtts: Round-trip times of the last answers, seconds.
    """

    def __init__(
        self,
        ipc: IpcHandle,
        src: ModuleType | None = None,
        dst: ModuleType | None = None,
        type: IpcType | None = None,
        *,
        policy: RetryPolicy | None = None,
        reconnect: ReconnectPolicy | None = None,
        clock: Callable[[], float] | None = None,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self.ipc = ipc
        self.policy = policy or RetryPolicy()
        self.reconnect = reconnect or ReconnectPolicy()
        self.negotiated: Negotiated | None = None
        self.generation = 0
        self.reconnects = 0
        self.board_restarts = 0
        self._board_sn = 0
        self.rtts: deque[float] = deque(maxlen=_KEPT_RTTS)
        self._src = src
        self._dst = dst
        self._type = type
        self._clock = clock
        self._wall = wall
        self._now = clock or time.monotonic
        self._sn = 0
        self._datagrams = False
        self._introduction = Introduction()
        self.connection = self._make_connection(time.monotonic)
        self._sleep: Callable[[float], None] = time.sleep
        self._closed = False
        self._turn = Turn()
        self._awaited: set[int] = set()
        self._stash: dict[int, Event] = {}
        self._reports: deque[tuple[Frame, float]] = deque(maxlen=_KEPT)
        self._frames: deque[Frame] = deque(maxlen=_KEPT)
        self._negotiation: tuple[float, Sequence[int], int | None] | None = None

    @classmethod
    def from_url(cls, url: str) -> Session:
        """A session over the link that `url` names; not open yet."""
        return cls(IpcHandle.from_url(url))

    @classmethod
    def from_conf(cls, file: str | Path, module: ModuleType) -> Session:
        """A session over the channel that a configuration file names for `module`; not open yet."""
        return cls(IpcHandle(module, file))

    # -- opening and closing ------------------------------------------------------------------------

    def open(self) -> None:
        """Open the channel. The board is not spoken to; see `negotiate`.

        Raises:
            LinkError: As `Link.open`.
        """
        self._closed = False
        self._open()

    def _open(self) -> None:
        self.ipc.open()
        clock = self._clock or getattr(self.ipc.link, "clock", None) or time.monotonic
        self._now = clock
        # A link in simulated time brings a clock that can sleep.
        self._sleep = getattr(clock, "sleep", time.sleep)
        self._sn = self.connection.sn
        self._datagrams = self.ipc.keeps_messages
        self.connection = self._make_connection(clock)
        self._introduction = Introduction()
        self._reports.clear()
        self._frames.clear()
        self._stash.clear()
        self._board_sn = 0

    def close(self) -> None:
        """Close the channel; a request that waits in another thread ends with LinkClosedError."""
        self._closed = True
        self.ipc.close()

    @property
    def is_open(self) -> bool:
        """Whether the channel is open."""
        return self.ipc.link.is_open

    @property
    def dialect(self) -> int:
        """Dialect that requests are sent in."""
        return self.connection.dialect

    def now(self) -> float:
        """This session's clock, seconds."""
        return self._now()

    def negotiate(
        self,
        *,
        boot_window: float = tables.BOOT_WINDOW,
        ping_ids: Sequence[int] = (0,),
        dialect: int | None = None,
        look: bool = True,
    ) -> Negotiated:
        """Find out which dialect the board speaks; waits for a board that is booting.

        Args:
            boot_window: Seconds to go on asking.
            ping_ids: Servos to ping in dialect 1.
            dialect: Ask only in this dialect.
            look: When the first questions find no ear, look whether this is a servo bus. That takes a tenth of a
                second, once; a board that was here before is not kept waiting by it.

        Raises:
            WrongDeviceError: This is a servo bus.
            ReplyTimeoutError: Nobody answers; the text says what that may mean.
        """
        with self._turn.taken():
            self._negotiation = (boot_window, ping_ids, dialect)
            look = look and self.negotiated is None
            negotiator = Negotiator(
                self.connection, self.now(), boot_window=boot_window, ping_ids=ping_ids, dialect=dialect, look=look
            )
            while negotiator.outcome is None:
                if negotiator.paused:
                    self._look_for_servos()
                    negotiator.go_on(self.now())
                    continue
                self._step(None)
                while (event := self.connection.next_event()) is not None:
                    negotiator.handle(event, self.now())
            if isinstance(negotiator.outcome, NegotiationFailed):
                if negotiator.outcome.servo_id is not None:
                    raise is_servo_bus(self.ipc.link.url, [negotiator.outcome.servo_id])
                if look and negotiator.outcome.frames == negotiator.outcome.echoes:
                    # Its supply may have come on since, or the machine stalled when we looked first.
                    self._look_for_servos()
                raise negotiator.outcome.as_error(self.ipc.link.url)
            self.negotiated = negotiator.outcome
            if self.negotiated.identity is not None:
                self.connection.limit_frame(self.negotiated.identity.max_frame)
            _log.info("%s speaks dialect %d", self.ipc.link.url, self.negotiated.dialect)
            return self.negotiated

    def _look_for_servos(self) -> None:
        servo_ids = find_servos(self.ipc.link)
        if servo_ids:
            raise is_servo_bus(self.ipc.link.url, servo_ids)

    # -- asking -------------------------------------------------------------------------------------

    def request(
        self,
        cmd: int,
        body: bytes = b"",
        *,
        window: float | None = None,
        attempts: int | None = None,
        urgent: bool = False,
        repeatable: bool = False,
        guard: Callable[[], None] | None = None,
    ) -> Reply:
        """Ask and wait for the answer. The status is the caller's to look at.

        Over datagrams, if nobody has said who is there yet, that is asked first.

        Args:
            cmd: Command code.
            body: Its body; in dialect 1 a servo packet.
            window: Seconds to wait for each answer; the policy's if None.
            attempts: How often to send; the policy's if None.
            urgent: Go first, and interrupt a request that waits in another thread.
            repeatable: Send it again after a reconnection. Never for what moves an arm.
            guard: Called when it is this request's turn, before anything is sent; refuses it by raising.

        Raises:
            ReplyTimeoutError: No answer.
            LinkLostError: The port went away; if it came back, the text says that this was not repeated.
            PreemptedError: A stop took the line; whether this was done is unknown.
            LocalProtocolError: It cannot be sent in this dialect or over this link.
        """
        self._turn.begin(self.ipc.link.wake if urgent else None)
        try:
            while True:
                if guard is not None:
                    guard()
                try:
                    if self._datagrams and cmd != Command.IDENTIFY and not self.connection.in_conversation:
                        self._await(self.connection.request(Command.IDENTIFY, b"", self.now()), urgent)
                    ticket = self.connection.request(
                        cmd, body, self.now(), window=window, attempts=attempts, urgent=urgent
                    )
                    return self._await(ticket, urgent)
                except LinkLostError as lost:
                    self._reopen(lost)
                    if not repeatable:
                        raise LinkLostError(
                            f"{self.ipc.link.url} was lost and is open again; {command_name(cmd)} was not repeated",
                            url=self.ipc.link.url,
                        ) from lost
        finally:
            self._turn.end()

    def send(self, cmd: int, body: bytes = b"") -> None:
        """Send a frame and do not wait for an answer; one that comes is thrown away.

        Over datagrams it is sent only if the other end has said who it is. It is asked again and again by the way,
        so that one that was started anew is found; until it answers, what is sent is lost.

        Raises:
            LinkError: The line takes nothing.
        """
        with self._turn.taken():
            if self._datagrams:
                self._step(self.now())
                self._sort_events()
                self._introduction.ask(self.connection, self.now())
                self._write()
            if self.connection.in_conversation:
                ticket = self.connection.request(cmd, body, self.now(), attempts=1)
                self._write()
                self.connection.abandon(ticket)

    def receive(self, timeout: float | None = None) -> Frame | None:
        """Wait for the next frame that answers nothing we asked; None if none came within `timeout` seconds."""
        return self._receive(self._frames, timeout)

    def stream(self, timeout: float | None = None) -> Iterator[Frame]:
        """Yield unsolicited frames as they come; ends when none came for `timeout` seconds."""
        for frame, _ in self.reports(timeout):
            yield frame

    def reports(self, timeout: float | None = None) -> Iterator[tuple[Frame, float]]:
        """As `stream`, each frame with the time of its arrival: it may have waited while something was asked."""
        while (row := self._receive(self._reports, timeout)) is not None:
            yield row

    def poll_reports(self) -> Frame | None:
        """Take what has arrived without waiting; the newest unsolicited frame, or None."""
        with self._turn.taken():
            self._step(self.now())
            self._sort_events()
            newest = self._reports[-1][0] if self._reports else None
            self._reports.clear()
            return newest

    # -- the loop -----------------------------------------------------------------------------------

    def _await(self, ticket: int, urgent: bool) -> Reply:
        connection = self.connection
        self._awaited.add(ticket)
        try:
            if connection.dialect != tables.PROTO_CHAPTER and not self._turn.urgent_waiting:
                # Nothing can have happened yet: the usual case is one step, and the answer is there.
                self._step(None)
            while True:
                while (event := connection.next_event()) is not None:
                    if event.__class__ is Reply and event.ticket == ticket:
                        # What is never answered counts as done when it is sent; and a confirmation may be due.
                        self._write()
                        self.rtts.append(event.rtt)
                        self._note_number(event)
                        return event
                    if isinstance(event, TimedOut) and event.ticket == ticket:
                        raise self._timed_out(event)
                    self._sort(event)
                stashed = self._stash.pop(ticket, None)
                if isinstance(stashed, Reply):
                    return stashed
                if isinstance(stashed, TimedOut):
                    raise self._timed_out(stashed)
                if self._turn.urgent_waiting and not urgent:
                    raise PreemptedError("a stop took the line; whether the request was done is unknown")
                if self.connection is not connection:
                    raise LinkLostError(f"{self.ipc.link.url} was lost and opened anew", url=self.ipc.link.url)
                self._step(None)
        except BaseException:
            connection.abandon(ticket)
            raise
        finally:
            self._awaited.discard(ticket)

    def _note_number(self, reply: Reply) -> None:
        frame = reply.frame
        if frame is not None and reply.attempts == 1 and not self._datagrams:
            # A frame counter that starts again is a board that did.
            self.board_restarts += frame.sn < self._board_sn
            self._board_sn = frame.sn

    def _step(self, deadline: float | None) -> None:
        """Write what is due, read once, until `deadline` or the connection's own next one."""
        connection = self.connection
        out = connection.data_to_send()
        due = connection.next_timeout()
        if due is None or (deadline is not None and deadline < due):
            due = deadline
        link = self.ipc.link
        if len(out) == 1 and due is not None:
            # The hot path, one request and its answer: the link does both in one go.
            data = link.exchange(out[0], max(0.0, due - self._now()))
        else:
            for frame in out:
                link.write(frame, self._now() + _WRITE_TIMEOUT)
            data = link.read(due)
        now = self._now()
        if data:
            connection.receive(data, now, end_of_message=self._datagrams)
            if connection.conversations is not None and connection.conversations.has_news():
                link.confirm()
        if due is not None and now >= due:
            connection.handle_timeout(now)

    def _write(self) -> None:
        for data in self.connection.data_to_send():
            self.ipc.link.write(data, self.now() + _WRITE_TIMEOUT)

    def _receive(self, queue: deque[_T], timeout: float | None) -> _T | None:
        deadline = None if timeout is None else self.now() + timeout
        looked = False
        while True:
            with self._turn.taken():
                # A stop goes first; nothing is lost by listening again after it.
                while not self._turn.urgent_waiting:
                    self._sort_events()
                    if queue:
                        return queue.popleft()
                    if looked and deadline is not None and self.now() >= deadline:
                        return None
                    looked = True
                    try:
                        self._step(deadline)
                    except LinkLostError as lost:
                        self._reopen(lost)

    def _sort_events(self) -> None:
        while (event := self.connection.next_event()) is not None:
            self._sort(event)

    def _sort(self, event: Event) -> None:
        if isinstance(event, Report):
            self._reports.append((event.frame, self.now()))
        elif isinstance(event, Reply | TimedOut):
            if event.ticket in self._awaited:
                self._stash[event.ticket] = event
        else:
            frame = getattr(event, "frame", None)
            if frame is not None:
                self._frames.append(frame)
            _log.debug("%s: %s", self.ipc.link.url, event)

    # -- when it does not work ----------------------------------------------------------------------

    def _reopen(self, lost: LinkLostError) -> None:
        policy = self.reconnect
        link = self.ipc.link
        if not policy.enabled or self._negotiation is None:
            raise lost
        _log.warning("%s; waiting up to %g s for it to come back", lost, policy.give_up_after)
        link.close()
        started = self.now()
        before = self.negotiated.identity if self.negotiated else None
        boot_window, ping_ids, dialect = self._negotiation
        while True:
            if self._closed:
                raise LinkClosedError(f"{link.url} is closed", url=link.url)
            try:
                self._open()
                self.negotiate(boot_window=boot_window, ping_ids=ping_ids, dialect=dialect)
            except LinkClosedError:
                raise
            except LinkError as error:
                # Whatever the reason: udev sets the permissions of a port a moment after it is there, and a
                # plug in motion comes and goes.
                link.close()
                if self.now() - started >= policy.give_up_after:
                    raise LinkLostError(
                        f"{link.url} was lost and did not come back within {policy.give_up_after:g} s: {error}",
                        url=link.url,
                    ) from lost
                self._sleep(policy.interval)
            except BaseException:
                # Nobody knows who is there now: nothing may be sent until someone opens this anew.
                link.close()
                raise
            else:
                break
        self.generation += 1
        self.reconnects += 1
        after = self.negotiated.identity if self.negotiated else None
        reset = before is not None and after is not None and before.boot_id != after.boot_id
        _log.warning(
            "%s is back after %.1f s%s",
            link.url,
            self.now() - started,
            "; the board was reset" if reset else "",
        )

    def _timed_out(self, event: TimedOut) -> ReplyTimeoutError:
        if self.connection.dialect == tables.PROTO_CHAPTER:
            # What is still on its way belongs to the request that was given up.
            try:
                self.ipc.link.flush_input()
            except (LinkLostError, LinkClosedError):
                _log.debug("%s: nothing to flush, the link is gone", self.ipc.link.url)
        return ReplyTimeoutError(
            command_name(event.cmd),
            attempts=event.attempts,
            instead=event.instead,
            advice="" if event.instead else "has the board lost its power, is a plug loose?",
        )

    def _make_connection(self, clock: Callable[[], float]) -> Connection:
        epoch = self._wall() - clock()
        connection = host_connection(self.ipc, self._src, self._dst, self._type, policy=self.policy, epoch=epoch)
        connection.sn = self._sn
        return connection

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
