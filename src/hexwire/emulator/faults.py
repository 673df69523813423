"""Scripted faults of an emulated board, its host line and its servo bus.

A fault is written ``[PLACE.]KIND[:ARGUMENT...]``. P is a probability in 0..1, T and D seconds, V volts, ID a servo
id.

| fault            | places (first = without prefix) | what happens |
|------------------|------|---------------------------------------------------------------------------------|
| `silent:ID[:P]`  | bus  | the servo hears and obeys, but does not answer |
| `late:ID:D[:P]`  | bus  | its answers come D seconds late |
| `babble:ID[:P]`  | bus  | it sends 1..8 random bytes after any request, whether to it or not |
| `overload:ID`    | bus  | it reports overload, and gives only its holding torque |
| `hot:ID`         | bus  | it is 15 degrees above its temperature limit, or at 85 without one |
| `supply:ID:V`    | bus  | its supply is V volts |
| `flip:P`         | host, bus | a message has one bit flipped |
| `drop:P`         | host, bus | a message loses one byte |
| `dup:P`          | host, bus | a message has one byte doubled |
| `junk:P`         | host, bus | 1..16 random bytes come before a message |
| `cut:P`          | host, bus | a message loses its end, one byte or more |
| `echo`           | bus, host | the sender hears itself |
| `reset:T`        | board | the board restarts T seconds after the start |
| `brownout:T:D`   | board | board and servos have no supply from T to T + D, then restart |
| `boot:D`         | board | the board is deaf for D seconds after every start |
| `sketch`         | board | as the chapter's: frames end at the first 0D 0A, a reset drives the joints home |

P is 1 unless given, 0.2 for `babble`. A message is a servo packet or an answer on the bus, or one write or read on
the host line. Faults of a line apply in both directions. Every fault has a random generator of its own, seeded by
the plan's seed and its place in the list, so that adding one does not change the others.

Owns the specifications and their random numbers. Knows nothing of frames; board and wire ask it at the places
named above.
"""

from __future__ import annotations

import random
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.wire.registers import Series
from hexwire.wire.tables import STATUS_BITS

if TYPE_CHECKING:
    from .servo import EmulatedServo

__all__ = ["Fault", "FaultPlan", "parse_fault"]


@dataclass(frozen=True, slots=True)
class Fault:
    """One parsed specification. Fields that a kind does not use keep their defaults."""

    kind: str
    place: str
    servo_id: int = -1
    probability: float = 1.0
    at: float = 0.0
    duration: float = 0.0
    volts: float = 0.0


# kind -> places, names of the arguments ("?" marks one that may be left out)
_KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "silent": (("bus",), ("servo_id", "probability?")),
    "late": (("bus",), ("servo_id", "duration", "probability?")),
    "babble": (("bus",), ("servo_id", "probability?")),
    "overload": (("bus",), ("servo_id",)),
    "hot": (("bus",), ("servo_id",)),
    "supply": (("bus",), ("servo_id", "volts")),
    "flip": (("host", "bus"), ("probability",)),
    "drop": (("host", "bus"), ("probability",)),
    "dup": (("host", "bus"), ("probability",)),
    "junk": (("host", "bus"), ("probability",)),
    "cut": (("host", "bus"), ("probability",)),
    "echo": (("bus", "host"), ()),
    "reset": (("board",), ("at",)),
    "brownout": (("board",), ("at", "duration")),
    "boot": (("board",), ("duration",)),
    "sketch": (("board",), ()),
}
_LETTERS = {"servo_id": "ID", "probability": "P", "at": "T", "duration": "D", "volts": "V"}
_BABBLE = 0.2
_LINE_KINDS = ("flip", "drop", "dup", "junk", "cut")


def _form(kind: str) -> str:
    text = kind
    for name in _KINDS[kind][1]:
        letter = _LETTERS[name.rstrip("?")]
        text += f"[:{letter}]" if name.endswith("?") else f":{letter}"
    return text


def parse_fault(spec: str) -> Fault:
    """Parse one specification, as in the table above.

    Raises:
        UsageError: Unknown kind (names the known ones), wrong place, or an invalid argument.
    """
    head, *arguments = spec.strip().split(":")
    prefix, _, kind = head.rpartition(".")
    if kind not in _KINDS:
        known = ", ".join(_form(name) for name in _KINDS)
        raise UsageError(f"unknown fault {spec!r}; known: {known}")
    places, names = _KINDS[kind]
    if prefix and prefix not in places:
        raise UsageError(f"fault {spec!r}: {kind} happens on the {' or '.join(places)}, not on {prefix!r}")
    needed = sum(not name.endswith("?") for name in names)
    if not needed <= len(arguments) <= len(names):
        raise UsageError(f"fault {spec!r} is written {_form(kind)}")
    given = {name.rstrip("?"): text for name, text in zip(names, arguments, strict=False)}
    numbers = {name: _number(spec, name, text) for name, text in given.items()}
    return Fault(
        kind,
        prefix or places[0],
        servo_id=int(numbers.get("servo_id", -1)),
        probability=numbers.get("probability", _BABBLE if kind == "babble" else 1.0),
        at=numbers.get("at", 0.0),
        duration=numbers.get("duration", 0.0),
        volts=numbers.get("volts", 0.0),
    )


def _on_bus(spec: str) -> Fault:
    fault = parse_fault(spec)
    if "." not in spec.partition(":")[0] and "bus" in _KINDS[fault.kind][0]:
        return replace(fault, place="bus")
    if fault.place != "bus" and fault.kind != "brownout":
        raise UsageError(f"fault {spec!r} happens on a board, and there is none on a servo bus")
    return fault


def _number(spec: str, name: str, text: str) -> float:
    try:
        value = int(text) if name == "servo_id" else float(text)
    except ValueError:
        raise UsageError(f"fault {spec!r}: {text!r} is not a number") from None
    low, high = {"servo_id": (0, 253), "probability": (0, 1), "volts": (0, 25)}.get(name, (0, 1e9))
    if not low <= value <= high:
        raise UsageError(f"fault {spec!r}: {text} is outside {low}..{high:g}")
    return value


class FaultPlan:
    """All faults of one emulation, with their random numbers.

    Args:
        faults: Parsed or written specifications.
        seed: Seed of the random numbers.
        start: The time from which T counts.

    Raises:
        UsageError: As `parse_fault`.
    """

    def __init__(self, faults: Iterable[Fault | str] = (), *, seed: int = 0, start: float = 0.0) -> None:
        self.faults = tuple(parse_fault(fault) if isinstance(fault, str) else fault for fault in faults)
        self._dice = [random.Random(f"{seed}/{index}/{fault.kind}") for index, fault in enumerate(self.faults)]
        # (when, cause) of the board's restarts; the supply comes back to the servos at the same moment.
        causes = {"reset": 0.0, "brownout": 1.0}
        self._restarts = sorted(
            (start + fault.at + fault.duration * causes[fault.kind], fault.kind)
            for fault in self.faults
            if fault.kind in causes
        )
        self._outages = [(start + fault.at, start + fault.at + fault.duration) for fault in self._of("brownout")]
        self._board_at = 0
        self._servos_back = sorted(end for _, end in self._outages)

    @classmethod
    def for_bus(cls, specs: Iterable[str], *, seed: int = 0, start: float = 0.0) -> FaultPlan:
        """Make the plan of a servo bus without a board: a fault without a place happens on the bus.

        Raises:
            UsageError: As `parse_fault`; or a fault that only a board can have.
        """
        return cls([_on_bus(spec) for spec in specs], seed=seed, start=start)

    def _of(self, *kinds: str, place: str = "") -> list[Fault]:
        return [f for f in self.faults if f.kind in kinds and (not place or f.place == place)]

    def _dead(self, now: float) -> bool:
        return bool(self._outages) and any(begin <= now < end for begin, end in self._outages)

    # --- the board ---------------------------------------------------------------------------------------------

    @property
    def boot_time(self) -> float:
        """Seconds the board is deaf after a start."""
        return max((fault.duration for fault in self._of("boot")), default=0.0)

    @property
    def sketch(self) -> bool:
        """Whether the board has that sketch, hazards and all."""
        return bool(self._of("sketch"))

    def reset_due(self, now: float) -> str | None:
        """Cause of a restart that became due since the last call: "reset", "brownout", or None."""
        cause = None
        while self._board_at < len(self._restarts) and self._restarts[self._board_at][0] <= now:
            cause = self._restarts[self._board_at][1]
            self._board_at += 1
        return cause

    def next_time(self, now: float) -> float | None:
        """When the next restart is due, None if never; `now` or before it if one is overdue."""
        if self._board_at == len(self._restarts):
            return None
        return self._restarts[self._board_at][0]

    # --- the host line -----------------------------------------------------------------------------------------

    @property
    def host_echo(self) -> bool:
        """Whether the host hears itself."""
        return bool(self._of("echo", place="host"))

    def host_in(self, data: bytes, now: float) -> bytes:
        """What the board gets of a message from the host."""
        return b"" if self._dead(now) else self._spoil(data, "host")

    def host_out(self, data: bytes, now: float) -> bytes:
        """What the host gets of a message from the board."""
        return b"" if self._dead(now) else self._spoil(data, "host")

    # --- the servo bus -----------------------------------------------------------------------------------------

    @property
    def bus_echo(self) -> bool:
        """Whether the board hears itself on the servo bus."""
        return bool(self._of("echo", place="bus"))

    def bus_dead(self, now: float) -> bool:
        """Whether the servos have no supply."""
        return self._dead(now)

    def power_returned(self, now: float) -> float | None:
        """When the supply came back to the servos, if it did since the last call."""
        back = None
        while self._servos_back and self._servos_back[0] <= now:
            back = self._servos_back.pop(0)
        return back

    def afflict(self, servo: EmulatedServo) -> None:
        """Overload or heat a servo, or change its supply, if the plan says so."""
        for fault in self._of("overload", "hot", "supply"):
            if fault.servo_id != servo.servo_id:
                continue
            if fault.kind == "supply":
                if servo.supply != fault.volts:
                    servo.supply = fault.volts
                continue
            if fault.kind == "overload":
                servo.protection.forced |= STATUS_BITS["overload"]
            elif servo.protection.ambient < 80:
                limit = servo.protection.limits.temperature
                hot = 85.0 if servo.series is Series.SEVEN_BOT else limit + 15.0
                servo.protection.ambient = servo.protection.temperature = hot

    def bus_request(self, data: bytes) -> bytes:
        """What the servos get of a request."""
        return self._spoil(data, "bus")

    def bus_answer(self, servo_id: int, answer: bytes | None) -> tuple[bytes, float]:
        """What a servo says after a request (whether to it or not), and how many seconds late."""
        said, late = answer or b"", 0.0
        for fault, dice in zip(self.faults, self._dice, strict=True):
            if fault.servo_id != servo_id or fault.place != "bus" or fault.kind in ("overload", "hot", "supply"):
                continue
            if dice.random() >= fault.probability:
                continue
            if fault.kind == "silent":
                said = b""
            elif fault.kind == "late":
                late += fault.duration
            elif fault.kind == "babble":
                said = dice.randbytes(dice.randint(1, 8)) + said
        return said, late

    def bus_heard(self, data: bytes) -> bytes:
        """What the board gets of the answers."""
        return self._spoil(data, "bus")

    # --- both lines --------------------------------------------------------------------------------------------

    def _spoil(self, data: bytes, place: str) -> bytes:
        if not data or not self.faults:
            return data
        spoilt = bytearray(data)
        for fault, dice in zip(self.faults, self._dice, strict=True):
            if fault.kind not in _LINE_KINDS or fault.place != place or dice.random() >= fault.probability:
                continue
            if fault.kind == "junk":
                spoilt[:0] = dice.randbytes(dice.randint(1, 16))
            elif spoilt:
                at = dice.randrange(len(spoilt))
                if fault.kind == "flip":
                    spoilt[at] ^= 1 << dice.randrange(8)
                elif fault.kind == "drop":
                    del spoilt[at]
                elif fault.kind == "dup":
                    spoilt.insert(at, spoilt[at])
                else:
                    del spoilt[at:]
        return bytes(spoilt)
