"""The memory of an emulated servo: live bytes, and those that survive power-off.

Owns defaults, access rights, ranges and the EEPROM lock. Knows nothing of motion or packets.

Rules where public documents are silent:

- A write to EEPROM registers while the lock is 1 changes the live value and is lost at the next power-up; with
  lock 0 it persists. Servos without a lock register (legacy) always persist.
- A write to a read-only register, or to an address without a register, has no effect; the latter reads 0.
- A value outside a register's range is clamped if it has a unit, and ignored if it is a bare number (id, baud
  code, mode ...).
"""

from __future__ import annotations

from hexwire.wire.registers import Register, Series
from hexwire.wire.tables import MODEL_WORDS

__all__ = ["RegisterFile"]

FIRMWARE = {Series.SCS: (0, 20), Series.STS_SMS: (3, 10), Series.HLS: (3, 43)}
_MODEL = {Series.SCS: "scs009", Series.STS_SMS: "sts3215", Series.HLS: "hls3606"}

# Values for rows without a default. The currents and speeds are assumed; a phase of 8 means that goal_speed 0 is
# the maximum and one unit is 50 counts/s, as the register rows say.
_ASSUMED: dict[Series, dict[str, int]] = {
    Series.SEVEN_BOT: {},
    Series.SCS: {"min_position_limit": 0, "goal_speed": 0},
    Series.STS_SMS: {"phase": 8, "max_voltage": 80, "goal_speed": 0, "max_speed": 68},
    Series.HLS: {"phase": 0, "protection_current": 500, "goal_speed": 60, "max_speed": 151},
}

# RAM registers loaded from EEPROM at power-up.
_COPIES: dict[Series, dict[str, str]] = {
    Series.SEVEN_BOT: {},
    Series.SCS: {},
    Series.STS_SMS: {"torque_limit": "max_torque"},
    Series.HLS: {
        "torque_limit": "max_torque",
        "goal_torque": "protection_current",
        "kp": "position_p",
        "kd": "position_d",
        "ki": "position_i",
    },
}


class RegisterFile:
    """The 256 bytes of one servo.

    Args:
        series: Its family.
        servo_id: Stored id.
        firmware: Major and minor version; None for the usual one of the series.
        settings: Stored values of further EEPROM registers by name.
    """

    def __init__(
        self,
        series: Series,
        servo_id: int,
        *,
        firmware: tuple[int, int] | None = None,
        settings: dict[str, int] | None = None,
    ) -> None:
        self.series = series
        self.rows = series.registers
        self.firmware = firmware or FIRMWARE.get(series, (0, 0))
        self.live = bytearray(256)
        """Its bytes now: to be read; `put` and `write` change them."""
        self._stored = bytearray(256)
        self._has_lock = "lock" in self.rows
        self.version = 0
        """Incremented whenever a live value may have changed."""
        # Registers are read and written very often. Addresses of those of one byte without a sign, which most are:
        self._plain = {r.name: r.address for r in self.rows.values() if r.size == 1 and r.sign_bit is None}
        # Addresses of the low and the high byte of those of two, and the sign's place in the value, or 0.
        self._words = {r.name: _word(r) for r in self.rows.values() if r.size == 2}
        # Owner of each address, so that a write finds its registers without a search.
        self._owner: list[Register | None] = [None] * 256
        for row in self.rows.values():
            self._owner[row.address : row.address + row.size] = [row] * row.size
        self.restore(servo_id, settings or {})

    def restore(self, servo_id: int, settings: dict[str, int] | None = None) -> None:
        """Restore the factory settings with this id, stored and live; RAM is as after power-up."""
        values = {row.name: row.default or 0 for row in self.rows.values()}
        values.update(_ASSUMED[self.series], id=servo_id)
        if "model_major" in values:
            word = MODEL_WORDS[_MODEL[self.series]]
            values.update(model_major=word & 0xFF, model_minor=word >> 8)
            values.update(firmware_major=self.firmware[0], firmware_minor=self.firmware[1])
        for name, value in values.items():
            self.put(name, value)
        for name, value in (settings or {}).items():
            self.put(name, value)
        self._stored[:] = self.live
        self.power_up()

    def power_up(self) -> None:
        """Load EEPROM registers from their store, set RAM registers to their defaults, and make the copies."""
        self.version += 1
        assumed = _ASSUMED[self.series]
        for row in self.rows.values():
            if row.area == "ram":
                self.put(row.name, assumed.get(row.name, row.default or 0))
            else:
                span = slice(row.address, row.address + row.size)
                self.live[span] = self._stored[span]
        for name, source in _COPIES[self.series].items():
            self.put(name, self.get(source))

    def backup(self) -> None:
        """Store every EEPROM register as it is now."""
        for row in self.rows.values():
            if row.area == "eeprom":
                self._store(row)

    def get(self, name: str) -> int:
        """Live value, signed."""
        at = self._plain.get(name)
        if at is not None:
            return self.live[at]
        word = self._words.get(name)
        if word is not None:
            low, high, sign = word
            value = self.live[low] | self.live[high] << 8
            if not sign:
                return value
            magnitude = value & (sign - 1)
            return -magnitude if value & sign else magnitude
        row = self.rows[name]
        return row.decode(bytes(self.live[row.address : row.address + row.size]))

    def stored(self, name: str) -> int:
        """Value that the next power-up restores, signed."""
        row = self.rows[name]
        return row.decode(bytes(self._stored[row.address : row.address + row.size]))

    def put(self, name: str, value: int) -> None:
        """Set a live value from inside the servo, clipped to the range of its coding."""
        self.version += 1
        at = self._plain.get(name)
        if at is not None:
            self.live[at] = 0 if value < 0 else 255 if value > 255 else value
            return
        word = self._words.get(name)
        if word is not None:
            low, high, sign = word
            most = sign - 1 if sign else 0xFFFF
            if value < 0:
                value = min(-value, most) | sign if sign else 0
            elif value > most:
                value = most
            self.live[low], self.live[high] = value & 0xFF, value >> 8
            return
        row = self.rows[name]
        fits = row.fits
        clipped = max(fits[0], min(fits[-1], value))
        self.live[row.address : row.address + row.size] = row.encode(clipped)

    def put_stored(self, name: str, value: int) -> None:
        """Set a value from inside the servo and store it, whatever the lock says."""
        self.put(name, value)
        self._store(self.rows[name])

    def read(self, address: int, count: int) -> bytes:
        """Live bytes; fewer than asked for if they run past address 255."""
        return bytes(self.live[address : address + count])

    def write(self, address: int, data: bytes) -> set[str]:
        """Write from the bus; returns the names of the registers it touched, changed or not."""
        self.version += 1
        locked = self._has_lock and bool(self.get("lock"))
        before = bytes(self.live)
        touched: dict[str, Register] = {}
        for at, byte in enumerate(data, address):
            row = self._owner[at] if at < 256 else None
            if row is not None and row.access == "rw":
                self.live[at] = byte
                touched[row.name] = row
        for row in list(touched.values()):
            value = self.get(row.name)
            low = row.fits[0] if row.minimum is None else row.minimum
            high = row.fits[-1] if row.maximum is None else row.maximum
            if not low <= value <= high:
                if row.unit is None:
                    span = slice(row.address, row.address + row.size)
                    self.live[span] = before[span]
                    del touched[row.name]
                else:
                    self.put(row.name, max(low, min(high, value)))
        # The lock that counts is the one before the write: unlocking and setting in one packet does not store.
        if not locked:
            for row in touched.values():
                if row.area == "eeprom":
                    self._store(row)
        return set(touched)

    def _store(self, row: Register) -> None:
        span = slice(row.address, row.address + row.size)
        self._stored[span] = self.live[span]


def _word(row: Register) -> tuple[int, int, int]:
    first, second = row.address, row.address + 1
    low, high = (second, first) if row.byte_order == "big" else (first, second)
    return low, high, 0 if row.sign_bit is None else 1 << row.sign_bit
