"""A judge for stops: what takes effect at servos, when, and which call it belongs to.

Every move has a target of its own (counts nobody else asks for), so that what stands in a servo tells which call
put it there. A `Judge` keeps the calls and stops of a run and the effects at the servos, in one order, and names
every effect that came after a stop which had been confirmed, of a call that was made before it.

It needs eyes on the servos (`watch` for emulated ones); what is between the caller and the servos is not its
business.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from hexwire.emulator import servo_control
from hexwire.emulator.servo import EmulatedServo
from hexwire.emulator.servo_wire import ServoWire

FIRST = 1200
"""Counts of the first target; the arm stands near 2047."""
NEVER = 1 << 60


@dataclass
class Call:
    """Something that was asked for."""

    what: str
    began: int
    ended: int = NEVER
    count: int = -1
    outcome: str = "under way"

    def may_cause(self, order: int) -> bool:
        """Whether it was under way then, or had left and was no longer waited for."""
        return self.began < order and (order < self.ended or "was sent" in self.outcome)


@dataclass
class Stop:
    """A stop: what was called before it began must not take effect once it is confirmed."""

    began: int
    confirmed: int = NEVER


@dataclass
class Effect:
    """Something that happened at a servo, or the end of a stop at the board."""

    what: str
    order: int
    count: int = -1


@dataclass
class Judge:
    """Who asked for what, what happened, and what should not have."""

    calls: list[Call] = field(default_factory=list)
    stops: list[Stop] = field(default_factory=list)
    effects: list[Effect] = field(default_factory=list)
    _order: Iterator[int] = field(default_factory=itertools.count)
    _targets: Iterator[int] = field(default_factory=lambda: itertools.count(FIRST))

    def order(self) -> int:
        """The next place in the one order of everything. Any thread."""
        return next(self._order)

    @contextmanager
    def call(self, what: str, count: int = -1) -> Iterator[Call]:
        """Around a call; what it raises goes on."""
        call = Call(what, self.order(), count=count)
        self.calls.append(call)
        try:
            yield call
            call.outcome = "done"
        except BaseException as error:
            call.outcome = f"{type(error).__name__}: {error}"
            raise
        finally:
            call.ended = self.order()

    @contextmanager
    def stop(self) -> Iterator[None]:
        """Around a stop; one that raises was not confirmed."""
        stop = Stop(self.order())
        self.stops.append(stop)
        yield
        stop.confirmed = self.order()

    def target(self) -> int:
        """Counts that no other move asks for."""
        return next(self._targets)

    def seen(self, what: str, count: int = -1) -> None:
        """Something happened at a servo."""
        self.effects.append(Effect(what, self.order(), count))

    def wrong(self) -> list[str]:
        """Effects of calls that a confirmed stop had made void, and effects while it held."""
        found = []
        by_count = {call.count: call for call in self.calls if call.count >= 0}
        for effect in self.effects:
            before = [stop.began for stop in self.stops if stop.confirmed < effect.order]
            if not before:
                continue
            if effect.what == "limp target":
                continue  # counted as a target
            # Whoever may have caused it: one must have been called after the last of these stops.
            if effect.what == "target":
                causes = [by_count[effect.count]] if effect.count in by_count else []
                if not causes:
                    continue  # a hold: where the joint is
            else:
                causes = [c for c in self.calls if c.what == effect.what and c.may_cause(effect.order)]
            if not any(call.began > max(before) for call in causes):
                found.append(f"{effect} after {before}, of {causes}")
            elif effect.what != "resume" and not self._resumed(max(before), effect.order):
                found.append(f"{effect} after {before}, and nobody resumed")
        return found

    def _resumed(self, stop: int, order: int) -> bool:
        """Whether somebody asked to end a stop before something happened."""
        return any(call.what == "resume" and stop < call.began < order for call in self.calls)

    def without_torque(self) -> list[str]:
        """Targets that servos without torque took, and torque that nobody asked for."""
        asked = {call.count for call in self.calls}
        found = [f"{e} without torque" for e in self.effects if e.what == "limp target" and e.count in asked]
        calls = [call for call in self.calls if call.what == "torque"]
        return found + [
            f"{effect} that nobody asked for"
            for effect in self.effects
            if effect.what == "torque" and not any(c.may_cause(effect.order) for c in calls)
        ]

    def moved(self) -> int:
        """How many moves took effect at all: a run in which nothing ever moves proves nothing."""
        asked = {call.count for call in self.calls}
        return sum(effect.what == "target" and effect.count in asked for effect in self.effects)


def watch(judge: Judge, wire: ServoWire, servo: EmulatedServo) -> None:
    """Have a judge see the goal and torque of one emulated servo."""
    goal = servo_control.goal_name(servo.series)
    plain, last = wire.transact, [servo.registers.get(goal), servo.torque_on]

    def transact(packet: bytes, now: float) -> tuple[bytes, float]:
        heard = plain(packet, now)
        here, power = servo.registers.get(goal), servo.torque_on
        if here != last[0]:
            judge.seen("target", here)
            if not last[1]:
                judge.seen("limp target", here)
        if power and not last[1]:
            judge.seen("torque")
        last[:] = [here, power]
        return heard

    wire.transact = transact  # type: ignore[method-assign]  # eyes on the wire
