"""Work at a bare servo bus: who has control, one job at a time, and a stop that reaches every servo.

Owns the bus while servos are searched, set up and tested by hand, without an arm. Whatever moves is held: it lasts
while somebody holds it. Must not know pages or terminals.

A stop ends the job, voids what was not sent yet, and makes every servo with torque hold where it is; it is kept for
the next program like the stop of an arm. Nobody needs control for it.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from hexwire.control.motion.hold_to_run import SILENCE, HoldToRun
from hexwire.control.sharing.lease import Grant, Lease
from hexwire.drivers.arm_file import BusArmFile
from hexwire.drivers.bus_arm import BusArm
from hexwire.drivers.stop_memory import StopMemory
from hexwire.drivers.values import StopMode
from hexwire.errors import DeviceError, LeaseError, StoppedError, UsageError
from hexwire.model.arm import ArmModel, JointModel

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus

__all__ = ["Job", "ServoBench"]

_LEASE = 5.0
"""Seconds without a renewal after which control is lost."""
_RANK = 1
"""All who take control have one rank: none takes it from another without asking for it."""
_ANYWHERE = 100.0
"""Radians: more turns than a servo counts."""
_PATIENCE = 0.3
"""Seconds for which a stop waits until a search is back at the bus's own rate."""


class Job:
    """Something that takes a while. Any thread may cancel it.

    Attributes:
        what: In words.
        told: Its present step, in words, for display.
        share: How much of it is done, 0.0 to 1.0; NaN if it does not know.
        ended: Why it is to end; empty while it may go on.
    """

    def __init__(self, what: str) -> None:
        self.what, self.told, self.share, self.ended = what, "", math.nan, ""

    def go_on(self) -> bool:
        """Whether it may go on; asked again and again by the job itself."""
        return not self.ended

    def cancel(self, why: str) -> None:
        """Let it end soon."""
        self.ended = self.ended or why

    def tell(self, words: str, share: float = math.nan) -> None:
        """Set what is displayed.

        Raises:
            DeviceError: The job was cancelled.
        """
        self.told, self.share = words, share
        if self.ended:
            raise DeviceError(f"{self.what} has ended: {self.ended}")


class ServoBench:
    """One open servo bus, and the work at it. Any thread may call the methods; those that use the bus wait for it.

    Args:
        bus: An open bus. Whoever opened it closes it.
        clock: Monotonic seconds.
        silence: Seconds without a sign of life after which what somebody holds ends.

    Attributes:
        bus: The open bus.
        hold_to_run: What somebody holds.
        silence: Seconds without a sign of life after which what somebody holds ends.
        servo_ids: The servos that are known, at the bus's rate: a stop reaches these.
        why_stopped: Why it is stopped, in words; empty if it is not.
    """

    def __init__(
        self, bus: ServoBus, *, clock: Callable[[], float] = time.monotonic, silence: float = SILENCE
    ) -> None:
        self.bus = bus
        self.hold_to_run = HoldToRun(clock=clock, silence=silence)
        self.silence = silence
        self.servo_ids: tuple[int, ...] = ()
        self.why_stopped = ""
        self._clock = clock
        self._memory = StopMemory(bus.link.url)
        self._lease, self._lock = Lease(timeout=_LEASE), threading.Lock()
        self._job: Job | None = None
        self._alone = False
        self._at_home = threading.Event()
        self._at_home.set()
        if self._memory.stopped:
            bus.epochs.assume_stopped()
            self.why_stopped = "stopped by another program of this user"

    # -- control ------------------------------------------------------------------------------------------

    @property
    def holder(self) -> Grant | None:
        """Who has control, or None."""
        with self._lock:
            self._lease.expire(self._clock())
            return self._lease.holder

    def take(self, client: str, *, key: int = 0, force: bool = False) -> Grant:
        """Give somebody control; a job of somebody else ends.

        Raises:
            LeaseError: Another one has it.
        """
        with self._lock:
            now = self._clock()
            self._lease.expire(now)
            kept = self._lease.keep(key, now) if key else None
            if kept is not None:
                return kept
            taken = self._lease.take(client, _RANK, now, force=force)
        self._cancel(f"{client} took control")
        return taken

    def beat(self, key: int) -> None:
        """Renew the control of somebody; raises `LeaseError` if it is lost."""
        with self._lock:
            self._lease.beat(key, self._clock())

    def leave(self, key: int) -> None:
        """Give control back; a job ends."""
        with self._lock:
            holder = self._lease.holder
            if holder is None or holder.key != key:
                return
            self._lease.leave(key, self._clock())
        self._cancel("control was given back")

    def need_control(self, key: int) -> None:
        """Check that somebody has control.

        Raises:
            LeaseError: Somebody else has it, or nobody.
        """
        with self._lock:
            if not key:
                raise LeaseError("nobody has taken control here; take it first")
            self._lease.check(key, self._clock())

    # -- jobs ---------------------------------------------------------------------------------------------

    @property
    def job(self) -> Job | None:
        """The present job, or None."""
        return self._job

    @property
    def stopped(self) -> bool:
        """Whether nothing may move or be written until `resume`."""
        return self.bus.epochs.stopped

    @contextmanager
    def working(
        self, what: str, *, acts: bool = False, alone: bool = False, changes_rate: bool = False
    ) -> Iterator[Job]:
        """Do a job for a `with` block. The bus is for this job; only reads of live values may come between.

        Args:
            what: In words.
            acts: It writes or moves: refused while stopped.
            alone: Not even live values may be read meanwhile.
            changes_rate: The bus is at other rates meanwhile: it is alone, and a stop waits a moment for it.

        Raises:
            StoppedError: It acts, and the servos are stopped.
            UsageError: Another job is under way.
        """
        if acts:
            self.refuse_if_stopped(what)
        mine = Job(what)
        with self._lock:
            if self._job is not None:
                raise UsageError(f"{self._job.what} is under way; wait for its end or cancel it")
            self._job, self._alone = mine, alone or changes_rate
            if changes_rate:
                self._at_home.clear()
        try:
            yield mine
        finally:
            with self._lock:
                self._job, self._alone = None, False
                self._at_home.set()

    @property
    def readable(self) -> bool:
        """Whether live values may be read now, between the steps of a job."""
        return not self._alone

    def cancel(self) -> None:
        """Let the present job end."""
        self._cancel("cancelled")

    def refuse_if_stopped(self, what: str) -> None:
        """Raise `StoppedError` while the servos are stopped."""
        if self.stopped:
            raise StoppedError.unsent(what, StoppedError.STATUS, "the servos are stopped; resume first")

    def describe(self, servo_ids: Sequence[int], reach: float) -> BusArmFile:
        """Describe an arm of servos of which nothing else is known.

        Args:
            servo_ids: Its servos.
            reach: How far a joint may be from the middle of its servo, radians.
        """
        joints = []
        for servo_id in servo_ids:
            series = self.bus.series_of(servo_id)
            scale = math.radians(series.range_deg) / series.counts_per_rev
            joint = JointModel(
                f"servo {servo_id}", servo_id, series.value, series.neutral, 1, 0.0, scale, -reach, reach, math.inf
            )
            joints.append(joint)
        return BusArmFile(ArmModel("servos", tuple(joints)), self.bus.timing.baud)

    def arm_of(self, servo_ids: Sequence[int]) -> BusArm:
        """Make an arm of servos, for torque and stops; its joints may be anywhere. Attach it before use."""
        return BusArm(self.bus.link, arm=self.describe(servo_ids, _ANYWHERE), bus=self.bus)

    def torque(self, on: bool, servo_ids: Sequence[int]) -> tuple[int, ...]:
        """Switch torque; a servo that gets it holds where it is.

        Returns:
            Ids of the servos that confirm it.

        Raises:
            StoppedError: Torque on, while stopped.
            HexwireError: No servo answers.
        """
        if on:
            self.refuse_if_stopped("torque on")
        with self.arm_of(servo_ids) as arm:
            done = arm.torque(on)
            return tuple(joint.servo_id for joint in arm.model.joints if joint.name in done)

    # -- stop ---------------------------------------------------------------------------------------------

    def stop(self, why: str, mode: StopMode = StopMode.HOLD) -> tuple[int, ...]:
        """Stop: end the job and what is held, and let every known servo hold, or lose its torque.

        Args:
            why: In words, for display.
            mode: What the servos do.

        Returns:
            Ids of servos that do not confirm it.

        Raises:
            HexwireError: The line has a fault.
        """
        self.why_stopped = why
        self._cancel(why)
        self.hold_to_run.end_all(why)
        with self.bus.epochs.stopping():
            # A search leaves the servos' rate for a while; at another rate they would not hear.
            self._at_home.wait(_PATIENCE)
            ids = self.servo_ids
            if not ids:
                self._memory.remember()
                return ()
            with self.arm_of(ids) as arm:
                done = arm.stop(mode)
            return tuple(joint.servo_id for joint in arm.model.joints if joint.name not in done)

    def resume(self) -> None:
        """End the stop. Nothing moves.

        Raises:
            StoppedError: A stop is under way.
        """
        epochs = self.bus.epochs
        token = epochs.token("resume", freeing=True)
        epochs.check(token, "resume")
        epochs.resumed(token)
        self._memory.forget()
        self.why_stopped = ""

    def shutdown(self) -> None:
        """End the job and what is held; waits a moment for the job. The servos keep their torque."""
        self._cancel("the bus is closed")
        self.hold_to_run.end_all("the bus is closed")
        until = self._clock() + 2.0
        while self._job is not None and self._clock() < until:
            time.sleep(0.005)

    def _cancel(self, why: str) -> None:
        job = self._job
        if job is not None:
            job.cancel(why)
