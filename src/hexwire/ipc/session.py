"""The chapter's `Session`: a link and a connection.

Owns the loop that moves bytes between the two, the order in which callers use the line, and the behaviour when the
port is lost. It adds and removes the session header through its `Connection`, which owns serial numbers, matching
and retries. Must not know joints, servos or units.

One caller at a time drives the line. A second thread waits for its turn, except for an urgent request (a stop),
which interrupts the waiting one. A request made before a stop is not sent after it unless it only reads, whatever
the origin of the stop: `epochs` decides which calls are affected.
"""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

from hexwire.arguments import DATA, SECONDS, WHOLE, Wanted, check
from hexwire.epochs import Epochs, Token
from hexwire.errors import (
    LinkClosedError,
    LinkError,
    LinkLostError,
    LinkTimeoutError,
    LocalProtocolError,
    PreemptedError,
    ReplyTimeoutError,
)
from hexwire.link.base import Openable
from hexwire.session.connection import Connection, Role
from hexwire.session.effects import Effect, effect_of
from hexwire.session.events import Answers, Event, Reply, Report, Request, TimedOut
from hexwire.session.negotiate import Negotiated, NegotiationFailed, Negotiator
from hexwire.session.policy import ReconnectPolicy, RetryPolicy
from hexwire.session.several import To
from hexwire.wire import tables
from hexwire.wire.addresses import Broadcast, Multicast, Unicast
from hexwire.wire.command_frame import Command, Frame, Status, command_name
from hexwire.wire.modules import IpcType, ModuleType

from .connections import Introduction, host_connection, module_identity, random_number
from .handle import IpcHandle
from .mistaken import find_robot, find_servos, is_servo_bus
from .raised_line import RaisedLine, raise_line
from .turn import Turn

__all__ = ["Session"]

_log = logging.getLogger(__name__)
_T = TypeVar("_T")
_LAST_COMMAND = 0xFF
_WRITE_TIMEOUT = 2.0
_KEPT = 256
_ORPHANS = 32
_IDS = Wanted("ids of servos", lambda value: isinstance(value, Collection) and all(map(WHOLE.fits, value)))
_DIALECT = Wanted("1 or 2", lambda value: value is None or (WHOLE.fits(value) and value in (1, 2)))
_GUARD = Wanted("a function", callable)
_REQUEST = Wanted("one of requests()", lambda value: isinstance(value, Request))
_STATUS = Wanted("a Status, 0 to 63", lambda value: WHOLE.fits(value) and 0 <= value <= tables.EXT_STATUS_MASK)
_NO_ANSWER = "has the board lost power, or is a plug loose?"
_NO_CONVERSATION = (
    "is the other end running? If it was restarted, or this machine was suspended, open the line again"
)
_MODULES = Wanted(
    "modules, as in (8, 9)", lambda value: isinstance(value, Collection) and all(map(WHOLE.fits, value))
)
_OBEYED = frozenset((Status.OK, Status.SERVO_SILENT, Status.SERVO_FAULT))
_HANDLE = Wanted("an IpcHandle, as in IpcHandle.from_url(...)", lambda value: isinstance(value, IpcHandle))
_LOOK = 1.0
"""Seconds after which a wait checks again: a signal handler may have cancelled its request."""
_SILENT_LONG = 1.5
"""Seconds without an answer after which whoever waits is told; a request that is under way may end before."""
_KEPT_RTTS = 8192
_VOIDED = 3
"""How often a read is repeated after a stop or the watchdog has cancelled it on the board."""
_PREEMPTED = "a stop took the line; {} was sent: it may have been done before the stop, but not after"


class _Asked(NamedTuple):
    """A request to one module, or to several, as its caller made it.

    Attributes:
        cmd: Command code.
        body: Its body.
        window: Seconds to wait for each answer; the policy's if None.
        attempts: Maximum number of transmissions; the policy's if None.
        effect: What it does to an arm.
        urgent: It goes first, and interrupts a request that waits in another thread.
        repeatable: It is sent again after a reconnection.
        guard: Called when it is its turn, before anything is sent; raises to refuse it.
        to: The modules that are asked; None for the session's peer.
    """

    cmd: int
    body: bytes
    window: float | None
    attempts: int | None
    effect: Effect
    urgent: bool
    repeatable: bool
    guard: Callable[[], None] | None = None
    to: To | None = None


def _check_timeout(timeout: float | None) -> None:
    """Refuse a time-out of a call that receives, if it is none."""
    if timeout is not None:
        check("receive", "timeout", SECONDS, timeout)


class Session(Openable):
    """An active conversation with a board, or with another module, over one channel.

    It is a duplex channel: `request` asks, `requests` and `reply` answer, `report` sends unasked and `stream`
    receives that. A board is asked; between two modules of your own both ends may do all of it.

    Args:
        ipc: The channel.
        src: Our module id; the channel's if None.
        dst: The peer's module id; the channel's if None.
        type: Kind of channel; the channel's if None.
        policy: Deadlines and retries.
        reconnect: What to do when the port is lost.
        clock: Monotonic seconds; must be the clock of the link's deadlines.
        wall: Seconds since 1970 for the header's time stamps.

    Attributes:
        connection: The state machine, with its counters.
        negotiated: The outcome of the last negotiation, or None.
        generation: Grows with every reconnection; a driver compares it, since the board may be a different one.
        reconnects: Number of reconnections.
        board_restarts: Number of board resets seen in its frame counter while the port was open.
        epochs: The stops, and the calls that they cancel.
        modules: The modules that have answered an IDENTIFY to several, or that a gateway has named in their place.
        rtts: Round-trip times of the last answers, seconds.
        sleep: Waits for a number of seconds of the link's clock.
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
        check("Session", "ipc", _HANDLE, ipc)
        self.ipc = ipc
        self.policy = policy or RetryPolicy()
        self.reconnect = reconnect or ReconnectPolicy()
        self.negotiated: Negotiated | None = None
        self.generation = 0
        self.reconnects = 0
        self.board_restarts = 0
        self.epochs = Epochs()
        self.epochs.on_stop(self._look_up)
        self.modules: frozenset[int] = frozenset()
        self.rtts: deque[float] = deque(maxlen=_KEPT_RTTS)
        self._src = src
        self._dst = dst
        self._type = type
        self._clock = clock
        self._wall = wall
        self._sn = 0
        self._introduction = Introduction()
        self._boot_id = random_number()
        self._now: Callable[[], float] = clock or time.monotonic
        self._turn = Turn()
        self._datagrams = False
        self._raised: RaisedLine | None = None
        self._stash: dict[int, Event] = {}
        self._reports: deque[tuple[Frame, float]] = deque(maxlen=_KEPT)
        self._requests: deque[Request] = deque(maxlen=_KEPT)
        self._frames: deque[Frame] = deque(maxlen=_KEPT)
        self._board_sn = self._noted = 0
        self.connection = self._make_connection(time.monotonic)
        self.sleep: Callable[[float], None] = time.sleep
        self._closed = False
        self._stop = (int(Command.STOP), b"\0")
        self._negotiation: tuple[float, Sequence[int], int | None] | None = None

    @classmethod
    def from_url(cls, url: str) -> Session:
        """A session over the link that `url` names; not open yet."""
        return cls(IpcHandle.from_url(url))

    @classmethod
    def from_conf(cls, file: str | Path, module: ModuleType) -> Session:
        """A session over the channel that a configuration file names for `module`; not open yet."""
        return cls(IpcHandle(module, file))

    def now(self) -> float:
        """This session's clock, seconds."""
        return self._now()

    @property
    def is_open(self) -> bool:
        """Whether the channel is open."""
        return self.ipc.link.is_open

    @property
    def dialect(self) -> int:
        """Dialect of the requests."""
        return self.connection.dialect

    def share_stops(self, other: Session) -> None:
        """Share the stops of two sessions of one arm: a stop on one cancels what waits on the other."""
        self.epochs = other.epochs
        self.epochs.on_stop(self._look_up)

    def _look_up(self) -> None:
        if self._turn.owner:
            self.ipc.link.wake()

    # -- opening and closing ------------------------------------------------------------------------

    def open(self) -> None:
        """Open the channel. Nothing is sent to the board; see `negotiate`.

        The opening of a serial port may reset a board, whose firmware, if it is the chapter's, then drives the arm
        to its middle pose. Drivers warn of that; for a session, `hexwire.drivers.board_reset.warn_of_reset` does.

        Raises:
            LinkError: As `Link.open`.
        """
        self._closed = False
        self.epochs.forget()
        self._open()

    def _open(self) -> None:
        self._forget_rate()
        self.ipc.open()
        clock = self._clock or getattr(self.ipc.link, "clock", None) or time.monotonic
        self._now = clock
        # A link in simulated time has a clock that can sleep.
        self.sleep = getattr(clock, "sleep", time.sleep)
        self._sn = self.connection.sn
        self._datagrams = self.ipc.keeps_messages
        self.connection = self._make_connection(clock)
        self._introduction = Introduction()
        self._reports.clear()
        self._frames.clear()
        self._requests.clear()
        self._stash.clear()
        self._board_sn = self._noted = 0

    def close(self) -> None:
        """Close the channel; a request that waits in another thread ends with LinkClosedError.

        A raised rate is put back first, unless another thread has the line.
        """
        self._closed = True
        if self._raised is not None and self.is_open and not self._turn.owner:
            self._raised.lower()
        self._forget_rate()
        self.ipc.close()

    def negotiate(
        self,
        *,
        boot_window: float = tables.BOOT_WINDOW,
        ping_ids: Sequence[int] = (0,),
        dialect: int | None = None,
        look: bool = True,
    ) -> Negotiated:
        """Find out the dialect of the board; waits for a board that is booting.

        If the link's address asks for it, the rate of the line is then raised.

        Args:
            boot_window: Seconds to keep asking.
            ping_ids: Servos to ping in dialect 1.
            dialect: Ask only in this dialect.
            look: If the first requests get no answer, test for a servo bus and for other robots. That takes half
                a second, once; it is skipped if a board has answered before.

        Raises:
            WrongDeviceError: This is a servo bus, or another robot.
            ReplyTimeoutError: There is no answer; the text gives possible reasons.
        """
        check("negotiate", "boot_window", SECONDS, boot_window)
        check("negotiate", "ping_ids", _IDS, ping_ids)
        check("negotiate", "dialect", _DIALECT, dialect)
        self.ipc.check_sends("IDENTIFY")
        if self.connection.role is Role.BOARD:
            raise LocalProtocolError(f"{self.ipc.link.url} is spoken to first: only the other end can negotiate")
        with self._turn.taken():
            self._negotiation = (boot_window, ping_ids, dialect)
            look = look and self.negotiated is None
            negotiator = Negotiator(
                self.connection, self.now(), boot_window=boot_window, ping_ids=ping_ids, dialect=dialect, look=look
            )
            silent_long = self.now() + _SILENT_LONG if look else math.inf
            while negotiator.outcome is None:
                if self.now() >= silent_long:
                    silent_long = math.inf
                    if hint := negotiator.hint(self.ipc.link.url, self.now()):
                        _log.warning(hint)
                if negotiator.paused:
                    self._look_for_servos()
                    wrong = find_robot(self.ipc.link, self.connection.remote, pings=dialect == tables.PROTO_HEXWIRE)
                    if wrong is not None:
                        raise wrong
                    negotiator.go_on(self.now())
                    continue
                self._step(None)
                while (event := self.connection.next_event()) is not None:
                    negotiator.handle(event, self.now())
            if isinstance(negotiator.outcome, NegotiationFailed):
                if negotiator.outcome.servo_id is not None:
                    raise is_servo_bus(self.ipc.link.url, [negotiator.outcome.servo_id])
                if look and negotiator.outcome.frames == negotiator.outcome.echoes:
                    # The servos may have been switched on since, or the machine stalled during the first test.
                    self._look_for_servos()
                raise negotiator.outcome.as_error(self.ipc.link.url)
            self.negotiated = negotiator.outcome
            if self.negotiated.identity is not None:
                self.connection.limit_frame(self.negotiated.identity.max_frame)
            _log.info("%s speaks dialect %d", self.ipc.link.url, self.negotiated.dialect)
            self._raised = raise_line(self.ipc.link, self.negotiated.identity, self.request, self.now)
            return self.negotiated

    def _look_for_servos(self) -> None:
        servo_ids = find_servos(self.ipc.link)
        if servo_ids:
            raise is_servo_bus(self.ipc.link.url, servo_ids)

    # -- requests -----------------------------------------------------------------------------------

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
        """Send a request and wait for the answer. The caller must check the status.

        A command that stops the arm is always urgent and cancels earlier calls. A call that acts and was made
        before a stop is not sent after it.

        Over datagrams, IDENTIFY is sent first if no conversation exists yet.

        Args:
            cmd: Command code, 0 to 255.
            body: Its body; in dialect 1 a servo packet.
            window: Seconds to wait for each answer; the policy's if None.
            attempts: Maximum number of transmissions; the policy's if None.
            urgent: Go first, and interrupt a request that waits in another thread.
            repeatable: Send it again after a reconnection. Never for a request that moves an arm.
            guard: Called when it is this request's turn, before anything is sent; raises to refuse it.

        Raises:
            ReplyTimeoutError: No answer.
            LinkLostError: The port was lost; if it came back, the text says that the request was not repeated.
            StoppedError: A stop came first, or is in progress; the request was not sent.
            PreemptedError: A stop took the line; the request was sent and may have been executed before the stop.
            LocalProtocolError: It cannot be sent in this dialect or over this link.
        """
        self._check_request("request", cmd, body, window, attempts, guard)
        effect = effect_of(self.connection.dialect, cmd, body)
        stops = effect is Effect.STOP
        asked = _Asked(cmd, body, window, attempts, effect, urgent or stops, repeatable, guard)
        if stops:
            self._stop = (cmd, body)
            with self.epochs.stopping():
                reply = self._single(asked, None)
                if reply.status not in _OBEYED:
                    self.epochs.unconfirmed()
                return reply
        token = self.epochs.of_this_call
        if effect is not Effect.NONE and token is None:
            token = self.epochs.token(command_name(cmd), freeing=effect is not Effect.ACT)
        try:
            reply = self._single(asked, token)
        except PreemptedError:
            if effect is Effect.RESUME and self.epochs.stopped_by_this_thread:
                # A signal handler may stop the arm at the moment when the bytes can no longer be held back. They
                # then arrive after the stop and end it, so stop again.
                self.request(*self._stop, repeatable=True)
            raise
        for _ in range(_VOIDED):
            if effect is not Effect.NONE or reply.status != Status.STOPPED:
                break
            reply = self._single(asked, token)
        if effect is Effect.RESUME and reply.status == Status.OK and token is not None:
            self.epochs.resumed(token)
        return reply

    def request_all(
        self,
        cmd: int,
        body: bytes = b"",
        to: Unicast | Multicast | Broadcast | Iterable[int] = Broadcast(),  # noqa: B008  # it is frozen
        *,
        window: float | None = None,
        attempts: int | None = None,
        repeatable: bool = False,
    ) -> Answers:
        """Send one request to several modules and collect their answers; the caller must check each status.

        The call returns when everybody has answered who is named by `to`, or for a broadcast everybody in
        `modules`; otherwise when the time is up. A broadcast of IDENTIFY always takes its time, and finds
        the `modules`; a gateway names those that it cannot reach, which count as silent. Repeats go only to those
        who have not answered. Stops, and what acts, are treated as by `request`.

        Args:
            cmd: Command code; PROTOCOL.md says which may go to several modules.
            body: Its body; it must fit one frame.
            to: The modules.
            window: Seconds to wait for the answers to each attempt; the policy's if None.
            attempts: Maximum number of transmissions; the policy's if None.
            repeatable: Send it again after a reconnection. Never for a request that moves an arm.

        Returns:
            The reply of each module, and the modules that were named or known and have not answered.

        Raises:
            LinkLostError: As `request`.
            StoppedError: As `request`.
            PreemptedError: As `request`.
            LocalProtocolError: It cannot be sent to several modules in this dialect or over this link.
        """
        self._check_request("request_all", cmd, body, window, attempts)
        if isinstance(to, Unicast):
            to = Multicast((to.module,))
        elif not isinstance(to, Multicast | Broadcast):
            check("request_all", "to", _MODULES, to)
            to = Multicast(to)
        finding = cmd == Command.IDENTIFY and isinstance(to, Broadcast)
        effect = effect_of(self.connection.dialect, cmd, body)
        stops = effect is Effect.STOP
        known = To(to, () if finding else self.modules)
        asked = _Asked(cmd, body, window, attempts, effect, stops, repeatable, to=known)
        if stops:
            with self.epochs.stopping():
                answers = self._collect(asked, None)
                if answers.silent or not all(r.status in _OBEYED for r in answers.replies.values()):
                    self.epochs.unconfirmed()
                return answers
        token = self.epochs.of_this_call
        if effect is not Effect.NONE and token is None:
            token = self.epochs.token(command_name(cmd), freeing=effect is not Effect.ACT)
        answers = self._collect(asked, token)
        if cmd == Command.IDENTIFY:
            self.modules |= {module for module, r in answers.replies.items() if r.status == Status.OK}
            if finding:
                self.modules |= answers.silent
                answers = replace(answers, silent=self.modules - answers.replies.keys())
        done = bool(answers.replies) and all(r.status == Status.OK for r in answers.replies.values())
        if effect is Effect.RESUME and token is not None and done and not answers.silent:
            self.epochs.resumed(token)
        return answers

    def _check_request(
        self,
        method: str,
        cmd: int,
        body: bytes,
        window: float | None = None,
        attempts: int | None = None,
        guard: Callable[[], None] | None = None,
    ) -> None:
        """Refuse what cannot be sent, before anything is done."""
        # The types first, since every request comes here.
        if type(cmd) is not int and type(cmd) is not Command:
            check(method, "cmd", WHOLE, cmd)
        if not 0 <= cmd <= _LAST_COMMAND:
            raise LocalProtocolError(f"there is no command {cmd}; commands are 0 to {_LAST_COMMAND}")
        if type(body) is not bytes:
            check(method, "body", DATA, body)
        if window is not None:
            check(method, "window", SECONDS, window)
        if attempts is not None:
            check(method, "attempts", WHOLE, attempts)
        if guard is not None:
            check(method, "guard", _GUARD, guard)
        self.ipc.check_sends(command_name(cmd))

    def _single(self, asked: _Asked, token: Token | None) -> Reply:
        reply = self._request(asked, token)
        assert reply.__class__ is Reply
        return reply

    def _collect(self, asked: _Asked, token: Token | None) -> Answers:
        answers = self._request(asked, token)
        assert answers.__class__ is Answers
        return answers

    def _request(self, asked: _Asked, token: Token | None) -> Reply | Answers:
        """Send a request and wait for what ends it: a `Reply`, or `Answers` if several modules were asked."""
        cmd, body, window, attempts, effect, urgent, repeatable, guard, to = asked
        self._turn.begin(self.ipc.link.wake if urgent else None)
        try:
            if urgent:
                # Requests that wait for an answer, or have not been sent yet, must not be sent after a stop.
                self.connection.void()
            while True:
                if token is not None:
                    self.epochs.check(token, command_name(cmd))
                if guard is not None:
                    guard()
                try:
                    self._check_spoken()
                    if self._datagrams and cmd != Command.IDENTIFY and not self.connection.in_conversation:
                        first = self.connection.request(Command.IDENTIFY, b"", self.now(), urgent=urgent)
                        self._await(first, Command.IDENTIFY, Effect.NONE, urgent, token)
                    if self.connection.dialect == tables.PROTO_CHAPTER:
                        # Bytes received before cannot be its answer.
                        self.connection.receive(self.ipc.link.read(self._now()), self._now())
                    if token is not None and effect is Effect.ACT:
                        self.epochs.check_leaving(token, command_name(cmd))
                    connection, now = self.connection, self._now()
                    if to is None:
                        ticket = connection.request(cmd, body, now, window=window, attempts=attempts, urgent=urgent)
                    else:
                        ticket = connection.several.request(
                            to, cmd, body, now, window=window, attempts=attempts, urgent=urgent
                        )
                    return self._await(ticket, cmd, effect, urgent, token)
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
        """Send a frame without waiting for an answer; an answer is discarded.

        Over datagrams it is sent only in a conversation. IDENTIFY is also sent periodically, so that a restarted
        peer is found; until it answers, frames are lost.

        Raises:
            LinkError: The line accepts no bytes.
            StoppedError: As `request`. A stop sent like this is not confirmed: all is refused until a resume.
        """
        self._check_request("send", cmd, body)
        effect = effect_of(self.connection.dialect, cmd, body)
        if effect is Effect.STOP:
            with self.epochs.stopping():
                self._send(cmd, body, None, urgent=True)
                self.epochs.unconfirmed()
            return
        token = None
        if effect is not Effect.NONE:
            token = self.epochs.token(command_name(cmd), freeing=effect is not Effect.ACT)
        self._send(cmd, body, token)
        if effect is Effect.RESUME and token is not None:
            self.epochs.resumed(token)

    def _send(self, cmd: int, body: bytes, token: Token | None, *, urgent: bool = False) -> None:
        self._turn.begin(self.ipc.link.wake if urgent else None)
        try:
            if urgent:
                self.connection.void()
            if self._datagrams:
                self._step(self.now())
                self._sort_events()
                self._check_spoken()
                if not self.ipc.listens:
                    self._introduction.ask(self.connection, self.now())
                self._write()
            if token is not None:
                self.epochs.check_leaving(token, command_name(cmd))
            if self.connection.in_conversation:
                ticket = self.connection.request(cmd, body, self.now(), attempts=1, urgent=urgent)
                try:
                    self._write()
                finally:
                    self.connection.abandon(ticket)
        finally:
            self._turn.end()

    # -- answering ------------------------------------------------------------------------------------

    def requests(self, timeout: float | None = None) -> Iterator[Request]:
        """Yield the requests of the module at the other end; ends when none arrives for `timeout` seconds.

        Answer each by `reply`. Repeats are answered from store, and IDENTIFY is answered here, as long as this or
        another call drives the line.

        Raises:
            ConfigError: The channel only sends.
        """
        _check_timeout(timeout)
        while (request := self._receive(self._requests, timeout)) is not None:
            yield request

    def reply(self, request: Request, body: bytes = b"", status: int = Status.OK) -> None:
        """Answer a request.

        Args:
            request: One of `requests`.
            body: Body of the answer; in dialect 1 a servo packet.
            status: Status code.

        Raises:
            LinkError: The line accepts no bytes.
            ConfigError: The channel only receives.
        """
        check("reply", "request", _REQUEST, request)
        check("reply", "body", DATA, body)
        check("reply", "status", _STATUS, status)
        self.ipc.check_sends("a reply")

        def answer() -> None:
            if request.frame.proto == tables.PROTO_CHAPTER:
                self.connection.reply_dialect1(body, self.now(), dst=request.frame.src)
            else:
                self.connection.reply(request, status, body, self.now())
            self._write()

        self._turn.run(answer, self.ipc.link.wake)

    def report(self, cmd: int, body: bytes = b"") -> None:
        """Send a frame unasked; `stream` of the other end yields it.

        Raises:
            LinkError: The line accepts no bytes, or over datagrams nobody has spoken yet.
            LocalProtocolError: The body does not fit one frame.
            ConfigError: The channel only receives.
        """
        self._check_request("report", cmd, body)

        def tell() -> None:
            self._check_spoken()
            self.connection.report(cmd, body, self.now())
            self._write()

        self._turn.run(tell, self.ipc.link.wake)

    def _check_spoken(self) -> None:
        """Over datagrams a server knows its peer only when that one has spoken."""
        if self.ipc.listens and not self.connection.in_conversation:
            raise LinkTimeoutError(f"{self.ipc.link.url}: nobody has spoken yet, so there is nobody to send to")

    # -- unsolicited frames ---------------------------------------------------------------------------

    def receive(self, timeout: float | None = None) -> Frame | None:
        """Wait for the next frame that is not an answer; None if none arrives within `timeout` seconds."""
        _check_timeout(timeout)
        return self._receive(self._frames, timeout)

    def stream(self, timeout: float | None = None) -> Iterator[Frame]:
        """Yield unsolicited frames as they arrive; ends when none arrives for `timeout` seconds."""
        for frame, _ in self.reports(timeout):
            yield frame

    def reports(self, timeout: float | None = None) -> Iterator[tuple[Frame, float]]:
        """Like `stream`, each frame with its time of arrival: it may have waited during a request."""
        # Not for each frame, of which a board may report a hundred a second.
        _check_timeout(timeout)
        while (row := self._receive(self._reports, timeout)) is not None:
            yield row

    def poll_reports(self) -> Frame | None:
        """Process received bytes without waiting; returns the newest unsolicited frame, or None."""
        with self._turn.taken():
            self._step(self.now())
            self._sort_events()
            newest = self._reports[-1][0] if self._reports else None
            self._reports.clear()
            return newest

    def _receive(self, queue: deque[_T], timeout: float | None) -> _T | None:
        self.ipc.check_receives()
        deadline = None if timeout is None else self.now() + timeout
        looked = False
        while True:
            alone = self._turn.begin_listening(self.ipc.link.wake, queue.__len__)
            if alone is None:
                with suppress(IndexError):
                    return queue.popleft()
                continue
            try:
                # A stop or a request goes first; reading can continue after it without loss.
                while not (self._turn.urgent_waiting or (alone and self._turn.waiting)):
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
            finally:
                self._turn.end()

    # -- waiting -------------------------------------------------------------------------------------

    def _await(self, ticket: int, cmd: int, effect: Effect, urgent: bool, token: Token | None) -> Reply | Answers:
        connection, epochs = self.connection, self.epochs
        try:
            if connection.dialect != tables.PROTO_CHAPTER and not self._turn.urgent_waiting:
                # Nothing can have happened yet. Usually the answer arrives in this one step.
                self._step(self._now() + _LOOK, token)
            while True:
                while (event := connection.next_event()) is not None:
                    if event.__class__ is Reply and event.ticket == ticket:
                        if token is not None and event.frame is None:
                            # It is never answered: it counts as done, but is only sent now.
                            epochs.check(token, command_name(cmd))
                        # A request that is never answered counts as done once sent; a confirmation may be due too.
                        self._write()
                        if token is not None and event.frame is None and not epochs.holds(token):
                            raise PreemptedError(_PREEMPTED.format(command_name(cmd)))
                        self.rtts.append(event.rtt)
                        self._note_number(event)
                        return event
                    if isinstance(event, TimedOut) and event.ticket == ticket:
                        raise self._timed_out(event)
                    if event.__class__ is Answers and event.ticket == ticket:
                        return event
                    self._sort(event)
                stashed = self._stash.pop(ticket, None)
                if isinstance(stashed, Reply | Answers):
                    return stashed
                if isinstance(stashed, TimedOut):
                    raise self._timed_out(stashed)
                if not urgent and (
                    self._turn.urgent_waiting
                    or not connection.holds(ticket)
                    or (token is not None and not epochs.holds(token))
                ):
                    raise PreemptedError(_PREEMPTED.format(command_name(cmd)))
                if self.connection is not connection:
                    raise LinkLostError(f"{self.ipc.link.url} was lost and opened again", url=self.ipc.link.url)
                self._turn.run_jobs()
                self._step(self._now() + _LOOK, token)
        except BaseException as error:
            left = connection.abandon(ticket)
            if isinstance(error, PreemptedError) and token is not None and (effect is Effect.NONE or not left):
                # It was not executed, and the operation that it belongs to is over.
                epochs.check(token, command_name(cmd))
            raise

    # -- the loop -----------------------------------------------------------------------------------

    def _step(self, deadline: float | None, token: Token | None = None) -> None:
        """Write pending bytes and read once, until `deadline` or the connection's own next deadline.

        Args:
            deadline: Latest time to return.
            token: The call that waits here: after a stop, nothing of it is written.
        """
        connection = self.connection
        if self._raised is not None:
            self._raised.watch(connection)
        out = connection.data_to_send()
        due = connection.next_timeout()
        if due is None or (deadline is not None and deadline < due):
            due = deadline
        link = self.ipc.link
        if token is not None and not self.epochs.holds(token):
            return
        if len(out) == 1 and due is not None:
            # The fast path, one request and its answer: the link does both in one call.
            data = link.exchange(out[0], max(0.0, due - self._now()))
        else:
            for frame in out:
                if token is not None and not self.epochs.holds(token):
                    break
                link.write(frame, self._now() + _WRITE_TIMEOUT)
            data = link.read(due)
        now = self._now()
        if data:
            connection.receive(data, now, end_of_message=self._datagrams)
            if connection.conversations is not None and connection.conversations.has_news():
                link.confirm()
        if due is not None and now >= due:
            connection.handle_timeout(now)

    def _forget_rate(self) -> None:
        """A port opens at its own rate."""
        if self._raised is not None:
            self._raised.forget()
            self._raised = None

    def _write(self) -> None:
        for data in self.connection.data_to_send():
            self.ipc.link.write(data, self.now() + _WRITE_TIMEOUT)

    def _sort_events(self) -> None:
        while (event := self.connection.next_event()) is not None:
            self._sort(event)

    def _sort(self, event: Event) -> None:
        if isinstance(event, Report):
            self._reports.append((event.frame, self.now()))
        elif isinstance(event, Request):
            if event.frame.proto != tables.PROTO_CHAPTER and event.frame.cmd == Command.IDENTIFY:
                identity = module_identity(self.connection, self._boot_id)
                self.connection.reply(event, Status.OK, identity, self.now())
            else:
                self._requests.append(event)
        elif isinstance(event, Reply | TimedOut | Answers):
            if len(self._stash) >= _ORPHANS:
                del self._stash[next(iter(self._stash))]
            self._stash[event.ticket] = event
        else:
            frame = getattr(event, "frame", None)
            if frame is not None:
                self._frames.append(frame)
            _log.debug("%s: %s", self.ipc.link.url, event)

    def _note_number(self, reply: Reply) -> None:
        frame = reply.frame
        if frame is not None and reply.attempts == 1 and reply.ticket > self._noted and not self._datagrams:
            self._noted = reply.ticket
            # A restarted frame counter means a restarted board.
            self.board_restarts += frame.sn < self._board_sn
            self._board_sn = frame.sn

    def _timed_out(self, event: TimedOut) -> ReplyTimeoutError:
        if self.connection.dialect == tables.PROTO_CHAPTER:
            # Bytes that are still to come belong to the abandoned request.
            try:
                self.ipc.link.flush_input()
            except (LinkLostError, LinkClosedError):
                _log.debug("%s: nothing to flush, the link is gone", self.ipc.link.url)
        return ReplyTimeoutError(
            command_name(event.cmd),
            attempts=event.attempts,
            instead=event.instead,
            advice="" if event.instead else _NO_CONVERSATION if self._datagrams else _NO_ANSWER,
        )

    # -- reconnection -------------------------------------------------------------------------------

    def _reopen(self, lost: LinkLostError) -> None:
        policy = self.reconnect
        link = self.ipc.link
        if self.ipc.listens and self._negotiation is None and not self._closed:
            # Another module may connect.
            self._open()
            return
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
                # For any reason: udev sets the permissions of a port shortly after it appears, and a plug that is
                # being inserted may lose contact.
                link.close()
                if self.now() - started >= policy.give_up_after:
                    raise LinkLostError(
                        f"{link.url} was lost and did not come back within {policy.give_up_after:g} s: {error}",
                        url=link.url,
                    ) from lost
                self.sleep(policy.interval)
            except BaseException:
                # The device is unknown now: nothing may be sent until the session is opened again.
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

    def _make_connection(self, clock: Callable[[], float]) -> Connection:
        epoch = self._wall() - clock()
        connection = host_connection(self.ipc, self._src, self._dst, self._type, policy=self.policy, epoch=epoch)
        connection.sn = self._sn
        return connection
