"""What an emulated board remembers: joints as last seen, settings, stop, watchdog, reports, counters.

Owns plain state and its small rules. Knows neither frames nor the bus.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from hexwire.wire import tables
from hexwire.wire.commands import AGE_NEVER, JointReport, LimitRow, OffsetRow
from hexwire.wire.registers import Series

from .gate import JointFacts

__all__ = ["SERVO_BITS", "BoardSettings", "BoardState", "JointSlot"]

SERVO_BITS = sum(tables.STATUS_BITS.values())
"""The bits of a servo's error byte that have a meaning; the board uses the others for its own flags."""
_ARRIVED = 4


@dataclass(slots=True)
class JointSlot:
    """One joint as the board knows it. Counts and the units of JOINT_STATE.

    Attributes:
        ceiling: Current ceiling of an HLS servo; 0 is unknown.
        mode: Operating mode as last read; 0 is position.
        unsure: Its torque switch or mode may have changed; both are read before a target is written to it.
        target: The last target written to it; None if there is none.
        following: It follows a trajectory, which alone may give it targets.
    """

    servo_id: int
    series: Series
    present: bool = False
    position: int = 0
    speed: int = 0
    load: int = 0
    voltage: int = 0
    temperature: int = 0
    current: int = 0
    error: int = 0
    ceiling: int = 0
    torque_on: bool = False
    mode: int = 0
    unsure: bool = True
    target: int | None = None
    clamped: bool = False
    following: bool = False
    sampled_at: float | None = None

    @property
    def flags(self) -> int:
        """The status byte of this joint in JOINT_STATE."""
        flags = self.error & SERVO_BITS
        flags |= tables.SERVO_FLAGS_CLAMPED if self.clamped else 0
        flags |= tables.SERVO_FLAGS_TORQUE_ON if self.torque_on else 0
        return flags | (0 if self.present else tables.SERVO_FLAGS_SILENT)

    @property
    def may_move(self) -> bool:
        """Whether it may have moved since it was sampled."""
        away = self.target is not None and abs(self.target - self.position) > _ARRIVED
        return self.torque_on and (away or self.speed != 0)

    def age(self, now: float) -> int:
        """Milliseconds since the last sample."""
        if self.sampled_at is None:
            return AGE_NEVER
        return min(int((now - self.sampled_at) * 1000), AGE_NEVER - 1)


@dataclass(slots=True)
class BoardSettings:
    """Settings that the board's EEPROM keeps through a reset; None where nothing is stored."""

    limits: list[LimitRow] | None = None
    offsets: list[OffsetRow] | None = None


@dataclass(slots=True)
class BoardState:
    """Everything a reset clears."""

    boot_id: int
    now: float
    settings: BoardSettings
    joints: list[JointSlot] = field(default_factory=list)
    limits: list[LimitRow] = field(default_factory=list)
    offsets: list[OffsetRow] = field(default_factory=list)
    stopped: bool = False
    torque_off_stop: bool = False
    maintenance: bool = False
    under_voltage_reset: bool = False
    watchdog_tripped: bool = False
    watchdog_timeout: float = 0.0
    watchdog_mode: int = 0
    watchdog_due: float | None = None
    watchdog_trips: int = 0
    report_period: float = 0.0
    report_fields: int = 0
    report_due: float | None = None
    io: int = 0
    bus_transactions: int = 0
    bus_retries: int = 0
    bus_timeouts: int = 0
    bus_bad: int = 0
    queue_high_water: int = 0
    stores_left: int = tables.SETTINGS_STORES
    stores_gained: float = 0.0
    _index: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        by_name = {series.value: series for series in Series}
        self.joints = [
            JointSlot(servo_id, by_name[name])
            for servo_id, name in zip(tables.BOARD_JOINT_IDS, tables.BOARD_JOINT_SERIES, strict=True)
        ]
        self._index = {joint.servo_id: index for index, joint in enumerate(self.joints)}
        limit = LimitRow(tables.DEFAULT_MINIMUM, tables.DEFAULT_MAXIMUM, tables.DEFAULT_SPEED)
        self.limits = self.settings.limits or [limit] * len(self.joints)
        offset = OffsetRow(tables.DEFAULT_NEUTRAL, tables.DEFAULT_SIGN)
        self.offsets = self.settings.offsets or [offset] * len(self.joints)

    def joint(self, servo_id: int) -> JointSlot | None:
        """The joint of a servo id, or None."""
        return next((j for j in self.joints if j.servo_id == servo_id), None)

    def may_store(self, now: float) -> bool:
        """Whether settings that differ may be written to the EEPROM; counts it if so."""
        while self.stores_left < tables.SETTINGS_STORES and now - self.stores_gained >= tables.SETTINGS_STORE_EVERY:
            self.stores_left += 1
            self.stores_gained += tables.SETTINGS_STORE_EVERY
        if self.stores_left == tables.SETTINGS_STORES:
            self.stores_gained = now
        if not self.stores_left:
            return False
        self.stores_left -= 1
        return True

    @property
    def board_flags(self) -> int:
        """The board flags of IDENTIFY and JOINT_STATE."""
        flags = tables.BOARD_FLAGS_STOPPED if self.stopped else 0
        flags |= tables.BOARD_FLAGS_WATCHDOG_TRIPPED if self.watchdog_tripped else 0
        stored = self.settings.limits is not None and self.settings.offsets is not None
        flags |= 0 if stored else tables.BOARD_FLAGS_SETTINGS_DEFAULT
        flags |= tables.BOARD_FLAGS_MAINTENANCE if self.maintenance else 0
        flags |= tables.BOARD_FLAGS_UNDER_VOLTAGE_RESET if self.under_voltage_reset else 0
        return flags | (tables.BOARD_FLAGS_TORQUE_OFF_STOP if self.torque_off_stop else 0)

    def facts(self, now: float) -> dict[int, JointFacts]:
        """What the gate needs to know of the joints, by servo id."""
        return {joint.servo_id: self.facts_of(joint, now) for joint in self.joints}

    def facts_of(self, joint: JointSlot, now: float) -> JointFacts:
        """The same of one joint."""
        limit = self.limits[self._index[joint.servo_id]]
        return JointFacts(
            legacy=joint.series is Series.SEVEN_BOT,
            torque_on=joint.torque_on,
            positioning=joint.mode == 0,
            position=joint.position if joint.present and joint.sampled_at is not None else None,
            late_ms=joint.age(now) + 1 if joint.may_move else 0,
            ceiling=joint.ceiling,
            minimum=limit.minimum,
            maximum=limit.maximum,
            speed=limit.speed,
            following=joint.following,
        )

    def latch(self, *, torque_off: bool) -> None:
        """Latch a stop until RESUME: STOP arrived, or the watchdog tripped."""
        self.stopped = True
        self.torque_off_stop |= torque_off
        self.maintenance = False
        self.watchdog_due = None

    def feed_watchdog(self, now: float) -> None:
        """Restart the watchdog's time-out, as a valid frame arrived."""
        if self.watchdog_timeout and not self.watchdog_tripped:
            self.watchdog_due = now + self.watchdog_timeout

    def clock_us(self, now: float) -> int:
        """The board's microsecond clock."""
        return int((now - self.now) * 1e6) & 0xFFFFFFFF

    def report(self, fields: int, now: float) -> JointReport:
        """JOINT_STATE with these fields."""
        joints = self.joints
        newest = max((j.sampled_at for j in joints if j.sampled_at is not None), default=now)
        columns: dict[str, tuple[int, ...]] = {
            name: tuple(getattr(j, name) for j in joints)
            for name in ("speed", "load", "voltage", "temperature", "current")
            if fields & tables.STATE_FIELDS[name]
        }
        if fields & tables.STATE_FIELD_AGE:
            columns["age"] = tuple(j.age(now) for j in joints)
        return JointReport(
            self.clock_us(newest),
            self.board_flags,
            tuple(j.position for j in joints),
            tuple(j.flags for j in joints),
            **columns,
        )
