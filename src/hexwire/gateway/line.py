"""One board below a gateway: what waits for it, its messages in fragments, and what a stop voids.

Owns the order in which frames reach the board, and at which pace, so that a stop never waits behind anything, and
whether a host may leave without the board having to stop. No I/O; time comes in as `now`. Must not know the host's
link or other boards.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from dataclasses import dataclass

from hexwire.errors import LocalProtocolError, RemoteProtocolError
from hexwire.session.decoder import FrameDecoder
from hexwire.session.effects import Effect, effect_of
from hexwire.session.fragments import FragmentReceiver, FragmentSender
from hexwire.units import split_time
from hexwire.wire import tables
from hexwire.wire.board_trajectory import BeginRequest, PathFlag, PathState, PathStatus, PointsRequest
from hexwire.wire.command_frame import Command, Frame, Status, max_body, serialize_frame
from hexwire.wire.commands import FRAGMENT_HEAD_SIZE, FragmentHead, Identity
from hexwire.wire.tables import EXT_REPLY, EXT_STATUS_MASK, EXT_UNSOLICITED, PROTO_HEXWIRE

__all__ = ["GATEWAY_MODULE", "BoardLine", "LineCounters", "Use"]

_WATCHDOG_BODY = 3
_MOST_ASKED = 512
"""Requests without an answer; a host has at most 256."""


class Use:
    """The use of one board by one host.

    Attributes:
        watched: The host has armed the board's watchdog.
        mode: What that watchdog does: 0 holds, 1 switches torque off.
    """

    def __init__(self) -> None:
        self.watched = False
        self.mode = 0
        self._asked: dict[tuple[int, int], Frame] = {}
        self._outlives = self._whole = self._runs = False
        self._forgot = False

    @property
    def in_order(self) -> bool:
        """Whether the host may leave: no watchdog is armed, no path runs, and nothing that acts is unanswered."""
        acts = (effect_of(PROTO_HEXWIRE, f.cmd, f.body) is not Effect.NONE for f in self._asked.values())
        return self.finishes or not (self.watched or self._runs or self._forgot or any(acts))

    @property
    def finishes(self) -> bool:
        """Whether the host wants a path that is wholly on the board to be finished without it."""
        return self._outlives and self._whole and self._runs

    def asked(self, frame: Frame) -> None:
        """Note a request."""
        self._asked[frame.src, frame.seq] = frame
        if len(self._asked) > _MOST_ASKED:
            # No host does that. What is forgotten may have acted.
            del self._asked[next(iter(self._asked))]
            self._forgot = True

    def ended(self, frame: Frame) -> None:
        """Note that a request will not be carried out."""
        self._asked.pop((frame.src, frame.seq), None)

    def answered(self, reply: Frame) -> None:
        """Note a reply of the board."""
        request = self._asked.get((reply.dst, reply.seq))
        if request is None or request.cmd != reply.cmd:
            return
        del self._asked[reply.dst, reply.seq]
        if reply.cmd_ext == EXT_REPLY | Status.OK:
            try:
                self._done(request, reply)
            except RemoteProtocolError:
                return
        elif reply.cmd_ext & EXT_STATUS_MASK == Status.STOPPED:
            self._runs = False

    def _done(self, request: Frame, reply: Frame) -> None:
        cmd, body = request.cmd, request.body
        if cmd == Command.WATCHDOG and len(body) == _WATCHDOG_BODY:
            self.watched, self.mode = body[:2] != b"\0\0", body[2]
        elif cmd == Command.TRAJECTORY_BEGIN:
            self._outlives = bool(BeginRequest.parse(body).flags & PathFlag.OUTLIVES_HOST)
            self._whole = self._runs = False
        elif cmd == Command.TRAJECTORY_START:
            self._runs = True
        elif cmd in (Command.STOP, Command.TRAJECTORY_ABORT):
            self._runs = False
        elif cmd in (Command.TRAJECTORY_POINTS, Command.TRAJECTORY_STATUS):
            if cmd == Command.TRAJECTORY_POINTS:
                self._whole = PointsRequest.parse(body).last == 1
            if PathStatus.parse(reply.body).state in (PathState.NONE, PathState.LOADING) or self._is_over(reply):
                self._runs = False

    @staticmethod
    def _is_over(reply: Frame) -> bool:
        return PathStatus.parse(reply.body).state.over


GATEWAY_MODULE = 29
"""Source of the frames that a gateway sends itself; no board has this id."""

_MAX_QUEUE = 24
_MAX_AGE = 0.5
"""Seconds after which a request that still waits here is dropped: its host has given it up or repeats it."""
_MAX_VOIDED = 256
_BITS = 10
_STOP_AGAIN = 0.1
_STOP_TICK = tables.REPEAT_WINDOW / 128
"""Seconds after which a stop of the gateway's own has another number; they repeat after twice the window."""
_STOP_TRIES = 20
_QUIET = 0.2
"""Seconds after which a board that is asked who it is, together with others, counts as not to be reached."""
_SEEK_AGAIN = 0.05
"""Seconds before the board is asked again who it is: no burst of those who look for boards fills its line."""
_INTRODUCE_AGAIN = 0.1
"""Seconds in which a board answers the IDENTIFY that tells it of a new host; then it is asked again."""
_BODY = max_body(tables.MAX_SERIAL_FRAME)
_CHUNK = _BODY - FRAGMENT_HEAD_SIZE
_FRAGMENTS = tables.CAPABILITIES["fragments"]


@dataclass(slots=True)
class LineCounters:
    """What happened to frames on their way to one board and back.

    Attributes:
        down: Frames of the host that left for the board.
        up: Frames of the board that left for the host.
        split: Requests that were sent in fragments.
        joined: Replies that came in fragments.
        voided: Requests that a stop overtook.
        lost: Requests while the board was not connected.
        old: Requests that waited too long.
        refused: Requests that were answered with `busy` or `not_supported`.
        strange: Frames of the board that mean nothing here.
    """

    down: int = 0
    up: int = 0
    split: int = 0
    joined: int = 0
    voided: int = 0
    lost: int = 0
    old: int = 0
    refused: int = 0
    strange: int = 0


@dataclass(slots=True)
class _Waiting:
    frame: Frame
    since: float
    chunk: bool = False


@dataclass(slots=True)
class _FragmentedRequest:
    """A request of the host that goes down in fragments."""

    request: Frame
    message_id: int
    until: float


class BoardLine:
    """The way to one board. It has one host at a time; others may only stop it.

    Args:
        module: The board's id in frames of the host.
        local: Its id on its own line.
        baud: Rate of that line, if it is a serial one: at most one frame is given away ahead. 0 is without pace.

    Attributes:
        up: The board is connected.
        use: What the host does with the board.
        counters: What happened to frames.
        identity: The board's last answer to IDENTIFY, as hosts get it; empty if there is none.
        said: Answers to others than the host, each with who asked.
    """

    def __init__(self, module: int, *, local: int, baud: int = 0) -> None:
        self.module = module
        self.local = local
        self.up = True
        self.use = Use()
        self.counters = LineCounters()
        self.identity = b""
        self.said: list[tuple[object, Frame]] = []
        self._askers: dict[tuple[object, int], Frame] = {}
        self._per_byte = _BITS / baud if baud else 0.0
        self._free_at = 0.0
        self._queue: deque[_Waiting] = deque()
        self._stops: deque[Frame] = deque()
        self._voided: OrderedDict[tuple[int, int, int, bytes], float] = OrderedDict()
        # Refused, since the queue was full.
        self._refused: deque[tuple[tuple[int, int, int, bytes], float]] = deque(maxlen=_MAX_VOIDED)
        self._stop_number, self._newest = 0, -1
        self._restarted = False
        self._own_stop: tuple[Frame, int, float] | None = None
        self._owed: int | None = None
        # IDENTIFY to several that the board has not answered, and until when it may.
        self._sought: tuple[Frame, float] | None = None
        # The same of those who look for boards while this one has no host.
        self._seekers: dict[tuple[object, int], tuple[Frame, float]] = {}
        self._seek_number, self._seek_again = 0, -math.inf
        # IDENTIFY in the name of a new host, which the board has not answered, and when it is sent.
        self._introduction: Frame | None = None
        self._introduction_number, self._introduce_at = 0, 0.0
        self._begin()

    def _begin(self) -> None:
        self.decoder = FrameDecoder(tables.MAX_SERIAL_FRAME)
        self._sender = FragmentSender(_CHUNK, first=1)
        self._receiver = FragmentReceiver()
        self._message: _FragmentedRequest | None = None
        self._message_count = 0
        self._last: Frame | None = None
        self._takes_fragments = False

    # -- from the host --------------------------------------------------------------------------------

    def introduce(self, src: int, now: float) -> None:
        """Tell the board of a new host before it gets a frame of it.

        By IDENTIFY in the host's name, since the numbers of two hosts with one id are the same to the board. It
        would take a request for a repeat of one by the host before: a RESUME would be answered and not carried out.
        """
        self._introduction_number += 1
        number = self._introduction_number & 0xFF
        self._introduction = self._own_frame(Command.IDENTIFY, number, b"", now)._replace(src=src)
        self._introduce_at = now

    def request(self, frame: Frame, now: float) -> list[Frame]:
        """Take a frame of the host for this board; returns frames for the host, in place of the board's answer.

        Args:
            frame: With the board's own id as destination.
            now: Seconds, monotonic.
        """
        if effect_of(PROTO_HEXWIRE, frame.cmd, frame.body) is Effect.STOP:
            return self._take_stop(frame, now)
        sought = frame.cmd == Command.IDENTIFY and frame.dst != self.local
        if not self.up:
            self.counters.lost += 1
            return [self._answer(frame, Status.UNREACHABLE)] if sought else []
        if sought and (self._sought is None or not _same(self._sought[0], frame)):
            self._sought = (frame, now + _QUIET)
        if self._is_void(frame, now):
            return [self._answer(frame, Status.STOPPED)]
        if any(_same(waiting.frame, frame) for waiting in self._queue):
            return []
        if frame.cmd == Command.HOST_BAUD:
            # The board would change the rate of a line whose other end is here.
            return [self._refuse(frame, Status.NOT_SUPPORTED)]
        if frame.cmd == Command.IDENTIFY:
            # A restarted host: nothing of the one before it continues.
            self._receiver.forget()
            self._drop_message()
            self._voided = OrderedDict((k, v) for k, v in self._voided.items() if k[0] != frame.src)
            self._refused = deque((entry for entry in self._refused if entry[0][0] != frame.src), _MAX_VOIDED)
        if len(frame.body) > _BODY:
            return self._split(frame, now)
        if sum(not waiting.chunk for waiting in self._queue) >= _MAX_QUEUE:
            self._refused.append((_key(frame), now))
            return [self._refuse(frame, Status.BUSY)]
        self.use.asked(frame)
        self._queue.append(_Waiting(frame, now))
        return []

    def _take_stop(self, frame: Frame, now: float) -> list[Frame]:
        if not self.up:
            self.counters.lost += 1
            self._owed = frame.body[0] if frame.cmd == Command.STOP and frame.body else 0
            return []
        void = self._void(now)
        self.use.asked(frame)
        self._stops.append(frame)
        return void

    def stop(self, mode: int, now: float) -> None:
        """Stop the board from here, since nobody else will; repeated until it answers."""
        self._void(now)
        if not self.up:
            self._owed = mode
            return
        # By the time: a stop with the number of one shortly before, also of a gateway that was restarted meanwhile,
        # is a repeat to the board, which answers it and does not stop.
        self._stop_number = max(self._stop_number + 1, int(now / _STOP_TICK))
        frame = self._own_frame(Command.STOP, self._stop_number & 0xFF, bytes((mode,)), now)
        self._own_stop = (frame, 0, now)
        self.handle_timeout(now)

    def stop_for(self, who: object, frame: Frame, now: float) -> list[Frame]:
        """Stop the board for one who is not its host, or whose last stop still waits; returns frames for the host.

        The stop is the gateway's own, since the numbers of two hosts are the same to the board: it would take one's
        stop for a repeat of the other's. The answer is passed on in `said`.
        """
        mode = frame.body[0] if frame.cmd == Command.STOP and frame.body else 0
        if not self.up:
            self.counters.lost += 1
            self._owed = max(mode, self._owed or 0)
            return []
        self._askers[who, frame.seq] = frame
        void = self._void(now)
        waits = self._own_stop is not None and self._own_stop[0] in self._stops
        # One that has not left yet stops for this one, too.
        if not waits or self._own_stop is None or self._own_stop[0].body[0] < mode:
            self.stop(mode, now)
        return void

    def seek_for(self, who: object, frame: Frame, now: float) -> None:
        """Ask a board without a host who it is, in the gateway's own name; the answer is passed on in `said`.

        Who only looks for boards does not become their host, and keeps nobody out.
        """
        if not self.up:
            self.said.append((who, self._answer(frame, Status.UNREACHABLE)))
            return
        self._seekers.setdefault((who, frame.seq), (frame, now + _QUIET))
        if now >= self._seek_again:
            self._seek_again = now + _SEEK_AGAIN
            self._seek_number += 1
            ask = self._own_frame(Command.IDENTIFY, self._seek_number & 0xFF, b"", now)
            self._queue.append(_Waiting(ask, now))

    def _own_frame(self, cmd: int, seq: int, body: bytes, now: float) -> Frame:
        sec, nsec = split_time(now)
        # The kind of channel is that of a host on a serial line.
        return Frame(sec, nsec, 0, GATEWAY_MODULE, self.local, 3, PROTO_HEXWIRE, seq, cmd, body)

    def refuse_stranger(self, frame: Frame, host: str, *, several: bool) -> Frame:
        """Answer one who is not the host: the board is busy, and with whom. Who looks for boards finds it."""
        if several and frame.cmd == Command.IDENTIFY and not self.up:
            return self._answer(frame, Status.UNREACHABLE)
        if several and frame.cmd == Command.IDENTIFY and self.identity:
            return self._answer(frame, Status.OK, self.identity)
        text = f"module {self.module} has another host, {host}; `hexwire stop --all` stops it all the same"
        self.counters.refused += 1
        return self._answer(frame, Status.BUSY, text.encode())

    @property
    def stops_itself(self) -> bool:
        """Whether a stop of the host, too, has to be the gateway's own.

        One that has not left yet stops for the host as well. A board that has not been told of the host would take
        its stop for a repeat of one by the host before.
        """
        return bool(self._stops) or self._introduction is not None

    @property
    def stopping(self) -> bool:
        """Whether a stop of the gateway's own still waits for its answer."""
        return self._own_stop is not None

    def _void(self, now: float) -> list[Frame]:
        """Void what has not left yet; returns the answers for it."""
        void = [waiting.frame for waiting in self._queue if not (waiting.chunk or _is_own(waiting))]
        self._queue = deque(filter(_is_own, self._queue))
        self._sought = None
        if self._message is not None:
            void.append(self._message.request)
            self._drop_message()
        self._receiver.forget()
        self.counters.voided += len(void)
        for frame in void:
            self.use.ended(frame)
            if frame.cmd != Command.IDENTIFY:
                self._voided[_key(frame)] = now
        # Who repeats one of these after the stop had asked for it before.
        self._voided.update(self._refused)
        self._refused.clear()
        while len(self._voided) > _MAX_VOIDED:
            self._voided.popitem(last=False)
        return [self._answer(frame, Status.STOPPED) for frame in void]

    def _is_void(self, frame: Frame, now: float) -> bool:
        since = self._voided.get(_key(frame))
        return since is not None and now - since < tables.REPEAT_WINDOW

    def _split(self, frame: Frame, now: float) -> list[Frame]:
        """Begin a message in fragments, or remind the board of the one that it is receiving."""
        message = self._message
        if message is not None and now >= message.until:
            self._drop_message()
            message = None
        if message is not None and _same(message.request, frame):
            bodies = self._sender.remind(message.message_id, frame.cmd, 0, frame.body, now)
            self._queue_chunks(frame, list(bodies), now)
            return []
        if not self._takes_fragments:
            return [self._refuse(frame, Status.NOT_SUPPORTED)]
        if message is not None:
            return [self._refuse(frame, Status.BUSY)]
        self._message_count = (self._message_count + 1) & 0xFF
        message_id = self._message_count << 8 | frame.seq
        try:
            bodies = self._sender.send(message_id, frame.cmd, 0, frame.body, now)
            self._queue_chunks(frame, list(bodies), now)
        except LocalProtocolError:
            return [self._refuse(frame, Status.BUSY)]
        self.counters.split += 1
        self.use.asked(frame)
        self._message = _FragmentedRequest(frame, message_id, now + tables.FRAGMENT_LIFETIME)
        return []

    def _queue_chunks(self, request: Frame, bodies: list[bytes], now: float) -> None:
        waiting = {entry.frame.body for entry in self._queue if entry.chunk}
        for body in bodies:
            if body not in waiting:
                frame = request._replace(cmd=Command.FRAGMENT, body=body)
                self._queue.append(_Waiting(frame, now, chunk=True))

    def _drop_message(self) -> None:
        if self._message is not None:
            self._sender.forget(self._message.message_id)
            self.use.ended(self._message.request)
            self._message = None
        self._queue = deque(waiting for waiting in self._queue if not waiting.chunk)

    def _refuse(self, frame: Frame, status: Status) -> Frame:
        self.counters.refused += 1
        return self._answer(frame, status)

    def _answer(self, frame: Frame, status: Status, body: bytes = b"") -> Frame:
        # Number and time are those of the board's last frame: by them the host follows its clock and its restarts.
        last = self._last
        sec, nsec, sn = (0, 0, 0) if last is None else (last.time_sec, last.time_nsec, last.sn)
        ext = EXT_REPLY | status & EXT_STATUS_MASK
        kind = self.local if last is None else last.type
        return Frame(sec, nsec, sn, self.module, frame.src, kind, PROTO_HEXWIRE, frame.seq, frame.cmd, body, ext)

    # -- to the board ---------------------------------------------------------------------------------

    def next_frame(self, now: float) -> bytes:
        """Take the frame to write now; empty if there is none, or the line is still busy."""
        while self.up and now >= self._free_at and (self._stops or self._queue):
            if self._stops:
                frame = self._stops.popleft()
            elif now - (waiting := self._queue[0]).since > _MAX_AGE and not waiting.chunk:
                self._queue.popleft()
                self.counters.old += 1
                self.use.ended(waiting.frame)
                continue
            elif self._introduction is None:
                frame = self._queue.popleft().frame
            elif now >= self._introduce_at:
                frame = self._introduction
                self._introduce_at = now + _INTRODUCE_AGAIN
            else:
                return b""
            data = serialize_frame(frame, tables.MAX_SERIAL_FRAME)
            self._free_at = now + len(data) * self._per_byte
            self.counters.down += 1
            return data
        return b""

    def next_timeout(self) -> float | None:
        """Time at which there is something to write or to repeat, or None."""
        waits = self.up and (self._stops or self._queue)
        held = self._introduction is not None and not self._stops
        times = (
            (max(self._free_at, self._introduce_at) if held else self._free_at) if waits else None,
            None if self._own_stop is None else self._own_stop[2],
            None if self._sought is None else self._sought[1],
            min((until for _, until in self._seekers.values()), default=None),
            self.decoder.next_timeout(),
            self._receiver.next_timeout(),
        )
        return min((when for when in times if when is not None), default=None)

    def handle_timeout(self, now: float) -> list[Frame]:
        """Repeat and give up what is due; returns frames for the host."""
        found: list[Frame] = []
        while self.decoder.handle_timeout(now) is not None:
            found += self._drain(now)
        for body in self._receiver.handle_timeout(now):
            self._ask(body, now)
        if self._own_stop is not None and self._own_stop[2] <= now:
            frame, sent, _ = self._own_stop
            self._own_stop = (frame, sent + 1, now + _STOP_AGAIN) if sent < _STOP_TRIES else None
            if self._own_stop is None:
                self._askers.clear()
            if self._own_stop is not None and frame not in self._stops:
                self._stops.append(frame)
        if self._sought is not None and self._sought[1] <= now:
            found.append(self._answer(self._sought[0], Status.UNREACHABLE))
            self._sought = None
        for key, (frame, until) in list(self._seekers.items()):
            if until <= now:
                del self._seekers[key]
                self.said.append((key[0], self._answer(frame, Status.UNREACHABLE)))
        return found

    def _ask(self, body: bytes, now: float) -> None:
        """Ask the board for chunks of its message."""
        last = self._last
        if last is not None:
            sec, nsec = split_time(now)
            frame = last._replace(
                time_sec=sec, time_nsec=nsec, src=last.dst, dst=self.local, cmd=Command.FRAGMENT_MISSING, cmd_ext=0
            )
            self._queue.append(_Waiting(frame._replace(body=body), now, chunk=True))

    # -- from the board -------------------------------------------------------------------------------

    def receive(self, data: bytes, now: float) -> list[Frame]:
        """Process bytes of the board; returns the frames for the host."""
        self.decoder.receive(data, now)
        return self._drain(now)

    def _drain(self, now: float) -> list[Frame]:
        found = []
        while (event := self.decoder.next_event()) is not None:
            if isinstance(event, Frame):
                frame = self._take(event, now)
                if frame is not None:
                    self.counters.up += 1
                    found.append(frame)
        return found

    def _take(self, frame: Frame, now: float) -> Frame | None:
        if frame.proto != PROTO_HEXWIRE or frame.src != self.local:
            self.counters.strange += 1
            return None
        # A board counts its frames from the beginning when it restarts.
        self._restarted |= frame.sn <= self._newest
        self._newest = frame.sn
        if frame.dst == GATEWAY_MODULE:
            if frame.cmd == Command.IDENTIFY and frame.cmd_ext & EXT_REPLY:
                known = self._as_host_sees(frame)
                for (who, _), (asked, _) in self._seekers.items():
                    self.said.append((who, known._replace(dst=asked.src, seq=asked.seq)))
                self._seekers.clear()
            elif self._own_stop is not None and (frame.cmd, frame.seq) == (Command.STOP, self._own_stop[0].seq):
                self._own_stop = None
                for (who, _), asked in self._askers.items():
                    answer = frame._replace(src=self.module, dst=asked.src, seq=asked.seq, cmd=asked.cmd)
                    self.said.append((who, answer))
                self._askers.clear()
            return None
        self._last = frame
        if self._answers_introduction(frame, now):
            return None
        if frame.cmd in (Command.FRAGMENT, Command.FRAGMENT_MISSING):
            return self._take_fragment(frame, now)
        if not frame.cmd_ext & (EXT_REPLY | EXT_UNSOLICITED):
            self.counters.strange += 1
            return None
        return self._lift(frame)

    def _answers_introduction(self, frame: Frame, now: float) -> bool:
        asked = self._introduction
        if asked is None or (frame.dst, frame.seq, frame.cmd) != (asked.src, asked.seq, asked.cmd):
            return False
        if frame.cmd_ext == EXT_REPLY | Status.STOPPED:
            # A stop overtook it.
            self._introduce_at = now
        else:
            self._introduction = None
            self._as_host_sees(frame)
        return True

    def _take_fragment(self, frame: Frame, now: float) -> Frame | None:
        try:
            if frame.cmd == Command.FRAGMENT_MISSING:
                self._take_missing(frame, now)
                return None
            message, asks = self._receiver.receive(frame.body, now)
            seq = FragmentHead.parse(frame.body).message_id & 0xFF
        except RemoteProtocolError:
            self.counters.strange += 1
            return None
        for body in asks:
            self._ask(body, now)
        if message is None:
            return None
        self.counters.joined += 1
        return self._lift(frame._replace(cmd=message.cmd, cmd_ext=message.cmd_ext, body=message.body, seq=seq))

    def _take_missing(self, frame: Frame, now: float) -> None:
        bodies = list(self._sender.receive_missing(frame.body, now))
        if self._message is not None:
            self._message.until = now + tables.FRAGMENT_LIFETIME
            self._queue_chunks(self._message.request, bodies, now)

    def _lift(self, frame: Frame) -> Frame:
        """A reply or a report as the host sees it."""
        if frame.cmd_ext & EXT_REPLY:
            message = self._message
            if message is not None and (message.request.seq, message.request.cmd) == (frame.seq, frame.cmd):
                self._drop_message()
            self.use.answered(frame)
            if frame.cmd == Command.IDENTIFY:
                self._sought = None
        return self._as_host_sees(frame)

    def _as_host_sees(self, frame: Frame) -> Frame:
        if frame.cmd == Command.IDENTIFY and frame.cmd_ext == EXT_REPLY | Status.OK:
            try:
                identity = Identity.parse(frame.body)
            except RemoteProtocolError:
                return frame._replace(src=self.module)
            self._takes_fragments = bool(identity.capabilities & _FRAGMENTS)
            if self._takes_fragments:
                # Longer frames are split here.
                identity = identity._replace(max_frame=tables.MAX_NETWORK_FRAME)
            identity = identity._replace(capabilities=identity.capabilities & ~tables.CAPABILITY_HOST_BAUD)
            self.identity = identity.serialize()
            frame = frame._replace(body=self.identity)
        return frame._replace(src=self.module)

    def take_restart(self) -> bool:
        """Whether the board has restarted since the last call, by the numbers of its frames."""
        restarted, self._restarted = self._restarted, False
        return restarted

    # -- loss -----------------------------------------------------------------------------------------

    def forget_host(self, now: float) -> None:
        """The host is gone: nothing of it is sent any more."""
        self._void(now)
        self._voided.clear()
        self._stops.clear()
        self._sought = self._introduction = None
        self.use = Use()

    def lost(self) -> None:
        """The board is gone. What waits is dropped, and a stop is kept until the board is back."""
        pending = [*self._stops, *([] if self._own_stop is None else [self._own_stop[0]])]
        if pending:
            self._owed = max(frame.body[0] if frame.body else 0 for frame in pending)
        self.up = False
        self.counters.lost += sum(not waiting.chunk for waiting in self._queue)
        self._queue.clear()
        self._stops.clear()
        self._own_stop = None
        self._askers.clear()
        self.use = Use()
        self._begin()

    def back(self, now: float) -> None:
        """The board is connected again; a stop that could not reach it goes first."""
        self.up = True
        self._free_at = now
        if self._owed is not None:
            mode, self._owed = self._owed, None
            self.stop(mode, now)


def _key(frame: Frame) -> tuple[int, int, int, bytes]:
    return frame.src, frame.seq, frame.cmd, frame.body


def _is_own(waiting: _Waiting) -> bool:
    """Whether a frame is the gateway's own question, which ends with no host and no stop."""
    return waiting.frame.src == GATEWAY_MODULE


def _same(one: Frame, other: Frame) -> bool:
    return _key(one) == _key(other)
