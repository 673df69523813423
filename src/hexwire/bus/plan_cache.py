"""Cache of the plans of a bus, so that each request is built once.

Owns the caches, and the time that a plan's answers take on the wire. No I/O, no clock; `plan` defines the plans.
"""

from __future__ import annotations

from hexwire.errors import UsageError
from hexwire.wire.registers import Register, Series

from .plan import ReadPlan, SyncReadPlan, SyncWritePlan
from .servos import KnownServos
from .timing import LineTiming

__all__ = ["LEGACY_READ", "PlanCache", "writable"]

LEGACY_READ = 2
"""Bytes in a legacy servo's answer to any read."""
_MOST_PLANS = 512


def writable(series: Series, servo_id: int, name: str) -> Register:
    """Return a register that may be written.

    Raises:
        UsageError: The series has no such register, or it is read-only.
    """
    register = series.register(name)
    if register.access != "rw":
        raise UsageError(f"register {name} of servo {servo_id} is read-only")
    return register


class PlanCache:
    """Plans of one bus, for the present line rate and return delays.

    Args:
        servos: Known facts of the servos.
        timing: Transmission times; replaced by `clear` when the rate changes.

    Attributes:
        reads: Plan and register of a single read, by servo and register name.
        syncs: Plan of a sync read, by register name and ids; None if single reads are needed.
        sync_writes: Plan of a sync write, by register name and ids.
        newest_sync: Newest plan of a sync read, by register name: a control loop repeats one.
        newest_write: The same of a sync write.
    """

    def __init__(self, servos: KnownServos, timing: LineTiming) -> None:
        self.reads: dict[tuple[int, str], tuple[ReadPlan, Register]] = {}
        self.syncs: dict[tuple[str, tuple[int, ...]], SyncReadPlan | None] = {}
        self.sync_writes: dict[tuple[str, tuple[int, ...]], SyncWritePlan] = {}
        self.newest_sync: dict[str, SyncReadPlan] = {}
        self.newest_write: dict[str, SyncWritePlan] = {}
        self._blocks: dict[tuple[int, int, tuple[int, ...]], SyncReadPlan] = {}
        self._servos = servos
        self._timing = timing

    def clear(self, timing: LineTiming) -> None:
        """Drop all plans: the rate, a series or a return delay has changed."""
        self._timing = timing
        self.reads.clear()
        self.syncs.clear()
        self.sync_writes.clear()
        self.newest_sync.clear()
        self.newest_write.clear()
        self._blocks.clear()

    def read(self, servo_id: int, name: str) -> tuple[ReadPlan, Register]:
        """Make the plan of a single read.

        Raises:
            UsageError: The servo's series has no such register.
        """
        series = self._servos.series_of(servo_id)
        register = series.register(name)
        count = LEGACY_READ if series is Series.SEVEN_BOT else register.size
        plan = ReadPlan(servo_id, series, register.address, count, register)
        plan.base = self._base(plan.total, (servo_id,))
        entry = self.reads[servo_id, name] = (plan, register)
        return entry

    def sync(self, name: str, ids: tuple[int, ...]) -> SyncReadPlan | None:
        """Return the plan of a sync read of servos of one series; None if they need single reads.

        Raises:
            UsageError: No servo is named, or a series has no such register.
        """
        if not ids:
            raise UsageError("a sync read needs at least one servo id")
        key = (name, ids)
        if key in self.syncs:
            return self.syncs[key]
        kinds = {self._servos.series_of(servo_id) for servo_id in ids}
        registers = [self._servos.series_of(servo_id).register(name) for servo_id in ids]
        plan = None
        if len(kinds) == 1 and all(kind.sync_read for kind in kinds):
            plan = SyncReadPlan(kinds.pop(), ids, registers[0].address, registers[0].size, registers[0])
            plan.base = self._base(plan.total, ids)
        self.syncs[key] = plan
        return plan

    def block(self, address: int, count: int, ids: tuple[int, ...]) -> SyncReadPlan:
        """Return the plan of a sync read of neighbouring registers. All of the servos support sync read."""
        key = (address, count, ids)
        plan = self._blocks.get(key)
        if plan is None:
            plan = SyncReadPlan(self._servos.series_of(ids[0]), ids, address, count)
            plan.base = self._base(plan.total, ids)
            if len(self._blocks) >= _MOST_PLANS:
                self._blocks.clear()
            self._blocks[key] = plan
        return plan

    def part(self, plan: SyncReadPlan, ids: tuple[int, ...], address: int, count: int) -> SyncReadPlan:
        """Return a plan that repeats the read for some of a plan's servos, in a block around the registers."""
        if plan.register is not None and (address, count) == (plan.address, plan.count):
            again = self.sync(plan.register.name, ids)
            if again is not None:
                return again
        return self.block(address, count, ids)

    def sync_write(self, name: str, ids: tuple[int, ...]) -> SyncWritePlan | None:
        """Make the plan of a sync write of a two-byte register that is the same for all; None if it is not.

        Raises:
            UsageError: No servo is named, or a servo has no such writable register.
        """
        if not ids:
            raise UsageError("a sync write needs at least one servo id")
        registers = [writable(self._servos.series_of(servo_id), servo_id, name) for servo_id in ids]
        if registers[0].size != 2 or any(register != registers[0] for register in registers):
            return None
        plan = self.sync_writes[name, ids] = SyncWritePlan(registers[0], ids)
        return plan

    def _base(self, total: int, ids: tuple[int, ...]) -> float:
        return self._timing.line_time(total) + self._servos.return_delays(ids)
