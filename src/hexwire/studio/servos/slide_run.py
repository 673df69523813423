"""Moves one servo of a bus for a tab: by its slider or buttons while somebody there holds them, or by a step.

Owns what a page may ask for. The motion belongs to `setup.servo_slide`, and the rule that it ends with the hold to
`control.motion.hold_to_run`.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.control.motion.jog import JogRequest
from hexwire.errors import HexwireError, UsageError
from hexwire.inputs import Item
from hexwire.setup.servo_slide import SlideServo, sliding_servo
from hexwire.studio.access import Right
from hexwire.studio.calls import Asked, CallHost, OfServo, call

if TYPE_CHECKING:
    from hexwire.control.motion.hold_to_run import HeldMotion
    from hexwire.epochs import Token
    from hexwire.studio.bus_source import BusSource
    from hexwire.studio.tabs import Tab

__all__ = ["add_slide", "read_slide"]

_log = logging.getLogger(__name__)

_MOST = 1000.0
"""Greatest angle in radians; a greater one is in a wrong unit."""


@call("slide.range", OfServo, right=Right.OPERATE)
def _range(asked: Asked, args: OfServo) -> dict[str, float]:
    """Where a servo may be, radians from count 0, as its live values are."""
    (servo_id,) = asked.known(args.servo)
    with asked.bus.bench.working(f"a look at servo {servo_id}"):
        joint = sliding_servo(asked.bus.bus, servo_id).model.joints[0]
    return {"min": joint.minimum, "max": joint.maximum}


@dataclass(frozen=True, slots=True)
class SlideRequest:
    """What a page asks for.

    Attributes:
        servo_id: The servo.
        speed: Share of the greatest speed.
        turn: Direction of a jog, -1..1; None for none.
        goal: Goal of a drag, radians; None for none.
        by: Length of a step, radians; None for none.
    """

    servo_id: int
    speed: float
    turn: float | None
    goal: float | None
    by: float | None

    @property
    def request(self) -> JogRequest:
        """The jog or drag."""
        name = f"servo {self.servo_id}"
        if self.goal is not None:
            return JogRequest(goals={name: self.goal}, speed=self.speed)
        return JogRequest(directions={name: self.turn or 0.0}, speed=self.speed)


def read_slide(args: Mapping[str, object]) -> SlideRequest:
    """Check what a page asks for.

    Raises:
        UsageError: A value is missing or out of bounds.
    """
    item = Item(args)
    row = item.table(("servo",), ("speed", "turn", "goal", "by"))
    if sum(key in row for key in ("turn", "goal", "by")) != 1:
        raise item.fault("has a turn, a goal, or a step")
    speed = row["speed"].number(0.01, 1.0) if "speed" in row else 0.3
    turn = row["turn"].number(-1.0, 1.0) if "turn" in row else None
    goal, by = (row[key].number(-_MOST, _MOST, "rad") if key in row else None for key in ("goal", "by"))
    return SlideRequest(row["servo"].integer(0, 253), speed, turn, goal, by)


def add_slide(studio: CallHost) -> None:
    """Let pages hold one servo."""
    runs: dict[str, _Run] = {}

    def begin(tab: Tab, entry: HeldMotion, args: Mapping[str, object], arrived: Token) -> None:
        bus, wanted = studio.source.need_bus(), read_slide(args)
        if wanted.servo_id not in bus.bench.servo_ids:
            raise UsageError(f"servo {wanted.servo_id} was not found on this bus; search first")
        runs[tab.key] = run = _Run(bus, entry, arrived, wanted)
        thread = threading.Thread(target=run.work, name="studio slide", daemon=True)
        # Its end is seen in each cycle: there is nothing more to be done for it.
        bus.hold_to_run.begun(entry, lambda why: None)
        thread.start()

    def change(tab: Tab, args: Mapping[str, object]) -> None:
        if (run := runs.get(tab.key)) is not None:
            run.change(read_slide(args))

    studio.holds.add("servo", begin, change)


class _Run:
    def __init__(self, bus: BusSource, entry: HeldMotion, arrived: Token, wanted: SlideRequest) -> None:
        self._bus, self._entry, self._arrived, self._wanted = bus, entry, arrived, wanted
        self._slide: SlideServo | None = None

    def change(self, wanted: SlideRequest) -> None:
        if wanted.servo_id != self._wanted.servo_id or (wanted.goal is None) != (self._wanted.goal is None):
            raise UsageError("release first, to hold something else")
        self._wanted = wanted
        if self._slide is not None and wanted.by is None:
            self._slide.wanted = wanted.request

    def work(self) -> None:
        entry, why = self._entry, ""
        try:
            with self._bus.bus.epochs.using(self._arrived):
                self._run()
        except HexwireError as error:
            why = str(error)
        except Exception:  # noqa: BLE001  # logged and told
            _log.exception("the motion of a servo failed")
            why = "the studio failed at this; see its log"
        self._bus.hold_to_run.end(entry.who, why or entry.ended or "arrived", entry.number)
        self._bus.on_change()

    def _run(self) -> None:
        bus, wanted = self._bus, self._wanted
        bench, servo_id = bus.bench, wanted.servo_id
        with (
            bench.working(f"servo {servo_id} is moved", acts=True) as job,
            sliding_servo(bus.bus, servo_id) as arm,
        ):
            slide = SlideServo(
                arm,
                wanted.request,
                lambda: self._entry.age(time.monotonic()),
                bench.silence,
                clock=time.monotonic,
                sleep=time.sleep,
            )
            if wanted.by is not None:
                slide.by(wanted.by, bus.slid.get(servo_id, math.nan), wanted.speed)
            else:
                if wanted.goal is not None:
                    arm.model.joints[0].check(wanted.goal)
                self._slide = slide
                # What has changed meanwhile.
                slide.wanted = self._wanted.request
            slide.run(job.go_on, once=wanted.by is not None)
            bus.slid[servo_id] = slide.sent
