"""An emulated controller board: frames in, frames out, servos on a half-duplex bus behind it.

Owns the board's scheduler (one bus transaction at a time, stop first), what a stop voids, its start, reset,
watchdog and reports, and both dialects' dispatch. Time comes in as `now`; nothing here waits. Must not know links
or ptys: bytes go through `receive` and `data_to_send`.

With `dialect=1` it acts as the chapter's board: the same bytes in the same order and, when the bus is paced, with
the delays of its sketch. With `dialect=2` it acts as hexwire's firmware, which also answers dialect 1, but without
the hazards of the chapter's board.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from hexwire.session.connection import Connection, Role
from hexwire.session.conversation import Numbers
from hexwire.session.events import Request
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.modules import ModuleType
from hexwire.wire.tables import PROTO_CHAPTER

from .board_bus import BUS_TIMEOUT, BoardBus, BusBuffer, Delay, Job, Pause, Transaction
from .board_chapter import ChapterDialect, SketchReceiver
from .board_dialect1 import Dialect1
from .board_dialect2 import Dialect2
from .board_rate import LineRate
from .board_state import BoardSettings, BoardState
from .board_stop import StopQueue
from .board_trajectory import BoardTrajectory
from .bus_arms import make_hex7bot_servos
from .faults import FaultPlan
from .servo_wire import ServoWire

__all__ = ["EmulatedBoard", "make_hex7bot_board"]

_POLL_PAUSE = 0.0005
"""Seconds between two background polls of a paced bus: the time of one pass of the firmware's loop."""
_CATCH_UP = 0.2
"""Seconds of background polls that a board makes up for if nobody stepped it; a trajectory it follows in full."""
_MAX_QUEUE = 24
_BITS = 10
_TURNAROUND = 0.001
"""Seconds after which an answer counts as late: four times a servo's usual delay."""


@dataclass(slots=True)
class _Task:
    """A job and its origin: the request it answers, the frame in dialect 1, a report, or the trajectory."""

    job: Job
    request: Request | None = None
    chapter: Frame | None = None
    stop: bool = False
    report: bool = False
    start: bool = False
    path: bool = False


class EmulatedBoard:
    """One emulated board.

    Args:
        wire: The servo bus with its servos.
        dialect: 1 for the chapter's board, 2 for hexwire's.
        faults: Scripted faults; none if None.
        max_frame: Longest frame it accepts, in bytes.
        module: Its module id.
        host_rate: Own rate of its host line, bits per second; 0 if that has none.
        start: The time at which it starts.
        numbers: Its host line carries messages: a source of random numbers, as `Connection` takes it.
    """

    def __init__(
        self,
        wire: ServoWire,
        *,
        dialect: int = 2,
        faults: FaultPlan | None = None,
        max_frame: int = tables.MAX_SERIAL_FRAME,
        module: int = ModuleType.ARM_7BOT_ARDUINO_TRX,
        host_rate: int = 0,
        start: float = 0.0,
        numbers: Numbers | None = None,
    ) -> None:
        self.wire = wire
        self._numbers = numbers
        self.module = module
        self.dialect = dialect
        self.faults = faults or FaultPlan()
        self.paced = wire.baud > 0
        self.max_frame = max_frame
        self._own_rate = host_rate
        self.resets = 0
        self.settings = BoardSettings()
        self.time = start
        self._now = start
        self._out: list[bytes] = []
        self._reading = False
        self.reset(start)

    @property
    def host_rate(self) -> int:
        """Present rate of the host line, bits per second; 0 if it has none."""
        return self.line_rate.now

    # -- bytes and time -----------------------------------------------------------------------------

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host line. They end a silence; only `step` judges it, see `serve.deliver`."""
        self._reading = True
        self.step(now)
        self._reading = False
        if self.faults.host_echo:
            self._out.append(data)
        if now < self._deaf_until:
            return
        data = self.faults.host_in(data, now)
        if self._sketch is not None:
            self._sketch.put(data, busy=self._busy)
        else:
            self.connection.receive(data, now)
            self._take_requests(now)
        self.step(now)

    def step(self, now: float) -> None:
        """Do everything that is due by `now`."""
        cause = self.faults.reset_due(now)
        if cause is not None:
            self.reset(now)
            self.state.under_voltage_reset = cause == "brownout"
        self._now = max(self._now, now)
        if not self._reading and self.line_rate.step(now):
            self.connection.decoder.reset()
        if not self._busy and self.trajectory.due_at is None:
            self.time = max(self.time, now - _CATCH_UP)
        while True:
            if self._busy:
                self._timers(min(self._busy_until, now))
                if self._busy_until > now:
                    return
                self.time = max(self.time, self._busy_until)
                self._finish_wait()
                continue
            self._timers(self.time)
            if not (self._start_next() or self._sketch_loop()):
                if self.time >= now:
                    return
                # Whoever steps it may come late, but all happens in its order and at its time.
                self.time = self._next_moment(now)

    def data_to_send(self) -> bytes:
        """Bytes for the host line since the last call."""
        if self.line_rate.leaves:
            return b""
        frames = [*self._out, *self.connection.data_to_send()]
        self._out = []
        self._report_unsent = False
        data = self.faults.host_out(b"".join(frames), self._now)
        self.line_rate.sent(len(data), self._now)
        return data

    def next_event_time(self) -> float | None:
        """When `step` must be called next if no bytes arrive; None if never."""
        watchdog = None if self.trajectory.outlives_host else self.state.watchdog_due
        times = [t for t in (self.state.report_due, watchdog, self.line_rate.due) if t is not None]
        if self._busy:
            times.append(self._busy_until)
        elif self.stops or (self._tasks and not self.line_rate.changing):
            times.append(self.time)
        elif self.paced and self.dialect == 2:
            times.append(self._next_poll)
        if not self._busy and (step := self.trajectory.due_at) is not None:
            times.append(step)
        decoder = self.connection.next_timeout()
        if decoder is not None:
            times.append(decoder)
        others = (self.faults.next_time(self.time), self.dialect2.messages.next_timeout())
        times += [due for due in others if due is not None]
        return min(times, default=None)

    def _next_moment(self, now: float) -> float:
        """When an idle board has something to do, at the latest now."""
        messages = self.dialect2.messages.next_timeout()
        due = (self.state.watchdog_due, self.state.report_due, self.trajectory.due_at, messages)
        moments = [t for t in due if t is not None and t > self.time]
        if self.paced and self.dialect == 2:
            moments.append(self._next_poll)
        return min(now, *moments) if moments else now

    def _clock(self) -> float:
        return self.time

    def reset(self, now: float) -> None:
        """Restart, as after power-up or the reset button. No servo moves, but by the chapter's sketch."""
        self.resets += 1
        self.time = now
        # Differs after every reset and every start of the emulator: the time differs, or the number of resets.
        boot_id = (int(now * 1000) + self.resets) & 0xFFFFFFFF or 1
        self.state = BoardState(boot_id, now, self.settings)
        self.connection = Connection(
            Role.BOARD,
            local=self.module,
            remote=ModuleType.ARM_7BOT_SERIAL_TRX,
            type=ModuleType.ARM_7BOT_ARDUINO_TRX,
            max_frame=self.max_frame,
            epoch=-now,
            assembles=False,
            numbers=self._numbers,
        )
        state, connection, clock = self.state, self.connection, self._clock
        self.line_rate = LineRate(self._own_rate)
        self.stops = StopQueue()
        self._buffer = BusBuffer()
        self.bus = BoardBus(state, clock, paced=self.paced)
        self.chapter = ChapterDialect(state, self._buffer, clock, connection)
        self.dialect1 = Dialect1(state, self.bus, clock, connection)
        self.trajectory = BoardTrajectory(state, self.bus, clock)
        self.dialect2 = Dialect2(state, self.bus, clock, connection, self.stops, self.trajectory, self.line_rate)
        self._sketch = SketchReceiver() if self.dialect == 1 and self.faults.sketch else None
        self._deaf_until = now + self.faults.boot_time
        self._out = []
        self._tasks: deque[_Task] = deque()
        self._task: _Task | None = None
        self._waiting: tuple[_Task, bytes] | None = None
        self._busy: bool = False
        self._used_bus = False
        self._listening = False
        self._busy_until: float = now
        self._cut_at: float = now
        self._answer = b""
        self._next_poll = now
        self._answered = 0
        self._report_queued = self._report_unsent = False
        self._sketch_reply = b""
        if self.dialect == 2:
            self._tasks.append(_Task(self.bus.discover(), start=True))
        elif self._sketch is not None and self.resets > 1:
            # An emulation begins with an arm that has come to rest long ago.
            self._tasks.append(_Task(self.chapter.setup()))

    # -- jobs ---------------------------------------------------------------------------------------

    def _take_requests(self, now: float) -> None:
        counters = self.connection.counters
        answered = counters.repeats + counters.not_for_several
        if answered != self._answered:
            # A repeat that was answered from store also shows that the host is alive, and so does a refusal.
            self._answered = answered
            self.state.feed_watchdog(now)
        while (event := self.connection.next_event()) is not None:
            if isinstance(event, Request):
                self.line_rate.heard(now)
                if event.frame.proto == PROTO_CHAPTER or event.frame.cmd != Command.HOST_BAUD:
                    self.state.feed_watchdog(now)
                self._queue(event)

    def _queue(self, event: Request) -> None:
        frame = event.frame
        chapter = frame.proto == PROTO_CHAPTER or self.dialect == 1
        mode = None if chapter else self.dialect2.stop_mode(frame)
        if mode is not None:
            self._stop(mode, event)
        elif len(self._tasks) >= _MAX_QUEUE:
            if not chapter:
                self.dialect2.refuse(event, Status.BUSY)
        elif chapter:
            dialect = self.chapter if self.dialect == 1 else self.dialect1
            self._tasks.append(_Task(dialect.job(frame), chapter=frame))
        else:
            self._tasks.append(_Task(self.dialect2.job(event), request=event))
        self.state.queue_high_water = max(self.state.queue_high_water, len(self._tasks))

    # -- stops --------------------------------------------------------------------------------------

    def _stop(self, mode: int, request: Request | None) -> None:
        """A STOP arrived, or the watchdog tripped: every earlier request is void."""
        self.state.latch(torque_off=mode == 1)
        self.trajectory.stop()
        self.connection.take_stop(self.time)
        void, self._tasks = list(self._tasks), deque()
        if self._waiting is not None:
            void.insert(0, self._waiting[0])
            self._waiting = None
        if self._task is not None and not self._task.stop:
            void.insert(0, self._cut())
        for task in void:
            task.job.close()
            self._report_queued &= not task.report
            if task.request is not None:
                self.dialect2.refuse(task.request, Status.STOPPED, voided=True)
            elif task.chapter is not None:
                self.dialect1.void(task.chapter)
            elif task.start:
                self._tasks.append(_Task(self.bus.discover(), start=True))
        self.dialect2.messages.stop()
        if not self.stops.add(mode, request) and request is not None:
            self.dialect2.refuse(request, Status.BUSY)
        if self.stops.interrupts:
            self._cut().job.close()
            self.stops.put_back()

    def _cut(self) -> _Task:
        """End the current job: its packet on the bus is completed, but the answer is not awaited."""
        task, self._task = self._task, None
        assert task is not None
        if self._busy:
            self._busy_until = min(self._busy_until, self._cut_at)
            self.wire.free_at = min(self.wire.free_at, max(self._busy_until, self.time))
        return task

    def _start_next(self) -> bool:
        held = self.line_rate.changing
        if self.stops:
            self._task = _Task(self.dialect2.stop_job(self.stops.start()), stop=True)
        elif self.trajectory.due(self.time):
            self._task = _Task(self.trajectory.step(), path=True)
        elif self._tasks and not held:
            self._task = self._tasks.popleft()
        elif self.paced and self.dialect == 2 and self._next_poll <= self.time:
            self._task = _Task(self.bus.poll_next())
        else:
            return False
        self._run(None)
        return True

    def _finish_wait(self) -> None:
        """Resume the current job after its wait."""
        self._busy = False
        self._answer = self._buffer.read(self.time) if self._listening else b""
        task, trajectory = self._task, self.trajectory
        interruptible = task is not None and not (task.stop or task.start or task.path)
        # Targets do not wait until a long request is done. A start does: it must not come between two packets of a
        # request that moves the same joints.
        if task is not None and interruptible and trajectory.active and trajectory.due(self.time):
            self._waiting = (task, self._answer)
            self._task = _Task(trajectory.step(), path=True)
            self._run(None)
        else:
            self._run(self._answer)

    def _run(self, answer: bytes | None) -> None:
        """Run the current job to its next wait."""
        task = self._task
        if task is None:
            return
        try:
            wait = task.job.send(answer)
        except StopIteration:
            if task.report:
                self._report_queued = False
                # Nothing was sent if the host switched the reports off meanwhile.
                self._report_unsent |= self.state.report_due is not None
            if self._sketch is not None:
                # The sketch has one buffer for replies: a reply that is not sent yet is lost.
                self._sketch_reply = b"".join(self.connection.data_to_send()) or self._sketch_reply
            self._task = None
            if self._waiting is not None:
                (self._task, self._answer), self._waiting = self._waiting, None
                self._run(self._answer)
                return
            # A host that asks without a pause must not keep the board from its servos.
            if self._used_bus or (task.request is None and task.chapter is None):
                self._next_poll = self.time + _POLL_PAUSE
            self._used_bus = False
            return
        self._busy = True
        self._listening = isinstance(wait, Transaction)
        if isinstance(wait, Delay | Pause):
            self._cut_at = self.time
            self._busy_until = self.time + (wait.seconds if self.paced or isinstance(wait, Pause) else 0.0)
            return
        if isinstance(wait, Transaction):
            self._buffer.read(self.time)
        self._used_bus = True
        self.state.bus_transactions += 1
        heard, finish = self.wire.transact(wait.packet, self.time)
        byte = _BITS / self.wire.baud if self.paced else 0.0
        sent = self.time + len(wait.packet) * byte
        if heard:
            self._buffer.put(heard, finish)
        self._busy_until = self._cut_at = sent
        if isinstance(wait, Transaction) and wait.reply_length:
            self._cut_at = sent + wait.reply_length * byte + BUS_TIMEOUT
            deadline = sent + wait.reply_length * byte + wait.timeout
            whole = len(heard) - len(wait.packet) * self.wire.echo >= wait.reply_length
            self._busy_until = deadline if finish > deadline or (self.paced and not whole) else finish
        # Until a late answer arrives, others may use the line.
        self.wire.free_at = min(finish, max(self._busy_until, sent + len(heard) * byte + _TURNAROUND))

    def _sketch_loop(self) -> bool:
        """The sketch's idle loop: read; with nothing to read, send the last reply. True if a command arrived."""
        sketch = self._sketch
        if sketch is None:
            return False
        frame = sketch.next_frame()
        if frame is None:
            if self._sketch_reply and not sketch.waiting:
                self._out.append(self._sketch_reply)
                self._sketch_reply = b""
            return False
        if not frame.hangs:
            self._tasks.append(_Task(self.chapter.job(frame)))
            return True
        sketch.hung = True
        return False

    def _judge_silence(self, now: float) -> None:
        timeout = self.connection.next_timeout()
        if timeout is not None and timeout <= now:
            self.connection.handle_timeout(now)
            self._take_requests(now)
        self.dialect2.messages.handle_timeout(now)
        state = self.state
        overdue = state.watchdog_due is not None and state.watchdog_due <= now
        if overdue and not self.trajectory.outlives_host:
            state.watchdog_tripped = True
            state.watchdog_trips += 1
            self._stop(state.watchdog_mode, None)

    def _timers(self, now: float) -> None:
        if not self._reading:
            self._judge_silence(now)
        state = self.state
        if state.report_due is not None and state.report_due <= now:
            state.report_due += state.report_period
            if state.report_due <= now:
                # No burst of reports after a pause: the line may be slower than the period.
                state.report_due = now + state.report_period
            if not (self._report_queued or self._report_unsent):
                self._report_queued = True
                self._tasks.append(_Task(self.dialect2.report_job(), report=True))


def make_hex7bot_board(
    *,
    dialect: int = 2,
    baud: int = 0,
    faults: Sequence[str] = (),
    module: int = ModuleType.ARM_7BOT_ARDUINO_TRX,
    seed: int = 0,
    start: float = 0.0,
    host_rate: int = 0,
    numbers: Numbers | None = None,
) -> EmulatedBoard:
    """The board of a Hex7Bot with its seven servos.

    Args:
        dialect: 1 for the chapter's board, 2 for hexwire's.
        baud: Rate of the servo bus; with 0, bytes take no time.
        faults: Fault specifications, see `faults`.
        module: Its module id.
        seed: Seed of all random numbers.
        start: The time at which it starts.
        host_rate: Own rate of the host line; 0 if it has none.
        numbers: As of `EmulatedBoard`.
    """
    plan = FaultPlan(faults, seed=seed, start=start)
    wire = ServoWire(make_hex7bot_servos(seed=seed, start=start), baud=baud, faults=plan)
    return EmulatedBoard(
        wire, dialect=dialect, faults=plan, module=module, start=start, host_rate=host_rate, numbers=numbers
    )
