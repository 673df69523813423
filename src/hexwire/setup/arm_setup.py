"""The set-up of a new arm, one servo at a time: which one to connect next, and what to do with it.

Owns the next step, found from what answers on the bus and not from a file, so that a set-up can be resumed at any
point; the picture of the arm; and what a servo should be. Pure. Must not know a bus, terminals or pages:
`setting_up` asks the bus.

New servos all have id 1, so at most one of them may be connected at a time. Servos that are set up already may stay
connected, and are recognized by their id. Id 1 itself belongs to the last joint that is set up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

from hexwire.bus.survey import Remark
from hexwire.model.arms import assembly_of

if TYPE_CHECKING:
    from hexwire.bus.setup import ServoInfo
    from hexwire.model.arm import ArmModel, JointModel

__all__ = ["ArmSetup", "SeenServo", "SetupStep", "StepKind", "label", "picture"]

FACTORY_ID = 1
_NOTES = 7
"""Lines that the notes beside a picture need."""


class SeenServo(NamedTuple):
    """A servo that answers now.

    Attributes:
        servo_id: Its id.
        baud: Rate at which it answers.
        shared: Several servos seem to have this id.
        info: Its identity; None if it answers pings only.
        remarks: What is known of it: voltage class, firmware, supply.
        supply: Its supply, volts; NaN if unknown.
        kind: Voltage class, as in ``7.4 V``; empty if unknown.
        blocked: Why nothing may be stored in it now, such as a wrong supply; empty if nothing.
    """

    servo_id: int
    baud: int
    shared: bool
    info: ServoInfo | None
    remarks: tuple[Remark, ...] = ()
    supply: float = float("nan")
    kind: str = ""
    blocked: str = ""

    def __str__(self) -> str:
        what = f"servo {self.servo_id} at {self.baud} baud"
        if self.info is None:
            return what
        words = [self.info.model_name or "unknown model"]
        words += [f"firmware {self.info.firmware}"] if self.info.firmware else []
        words += [f"made for {self.kind}"] if self.kind else []
        words += [f"supply {self.supply:.1f} V"] if self.supply == self.supply else []  # not NaN
        return f"{what}: {', '.join(words)}"


class StepKind(Enum):
    """What is to be done next."""

    CONNECT = "connect"
    """Connect the servo of a joint."""
    SEPARATE = "separate"
    """Unplug a servo: two that are not set up, or two with one id, are connected."""
    ASSIGN = "assign"
    """Give the servo that was found the id and rate of a joint."""
    CHECK = "check"
    """All are set up: connect all of them, and check that they answer."""
    DONE = "done"
    """All answer together."""


@dataclass(frozen=True, slots=True)
class SetupStep:
    """The next step.

    Attributes:
        kind: What is to be done.
        joint: Whose servo it is about, or None.
        text: In words.
        servo: The servo that was found, of ASSIGN.
        blocked: Why it must not be changed now; empty if it may.
        warning: What to think about before; empty if nothing.
    """

    kind: StepKind
    joint: JointModel | None
    text: str
    servo: SeenServo | None = None
    blocked: str = ""
    warning: str = ""


class ArmSetup:
    """The set-up of one arm.

    Args:
        model: The arm: joints and ids.
        baud: Rate that every servo gets.
        leader: A leader arm, whose servos have other gears; None if that is not known.
        only: Set up the servo of this joint alone, whatever its id is now; None for the whole arm.

    Attributes:
        order: The joints, in the order of their set-up.
        done: Identity of every servo that has its id and rate, by joint name.
    """

    def __init__(self, model: ArmModel, baud: int, *, leader: bool | None = None, only: str | None = None) -> None:
        self.model, self.baud, self.leader = model, baud, leader
        self._assembly = assembly_of(model)
        self.order: tuple[JointModel, ...] = tuple(
            sorted(model.joints, key=lambda joint: (joint.servo_id == FACTORY_ID, -joint.servo_id))
        )
        self.only = None if only is None else model.joint(only)
        if self.only is not None:
            self.order = (self.only,)
        self.done: dict[str, ServoInfo] = {}
        self._seen: tuple[SeenServo, ...] = ()
        self._checked = False

    @property
    def seen(self) -> tuple[SeenServo, ...]:
        """The servos that answered at the last look."""
        return self._seen

    @property
    def target(self) -> JointModel | None:
        """The joint whose servo is next; None if all are set up."""
        return next((joint for joint in self.order if joint.name not in self.done), None)

    def receive(self, seen: Sequence[SeenServo]) -> None:
        """Take what answers on the bus now."""
        self._seen = tuple(seen)
        if self.only is not None:
            return
        for servo in sorted(self._seen, key=lambda servo: servo.servo_id == FACTORY_ID):
            joint = self._joint_of(servo)
            if joint is not None and servo.info is not None:
                self.done[joint.name] = servo.info
        self._checked = self.target is None and not self._problem()

    def assigned(self, joint: JointModel, info: ServoInfo) -> None:
        """Note that a servo has the id and rate of a joint, and was read back."""
        self.done[joint.name] = info

    @property
    def step(self) -> SetupStep:
        """The next step."""
        shared = [servo for servo in self._seen if servo.shared]
        if shared:
            ids = ", ".join(str(servo.servo_id) for servo in shared)
            text = f"several servos have id {ids}: unplug all but one of them"
            return SetupStep(StepKind.SEPARATE, self.target, text)
        target = self.target
        if target is None:
            return self._last_step()
        new = self._new()
        if len(new) > 1:
            names = " and ".join(f"{servo.servo_id} at {servo.baud} baud" for servo in new)
            text = f"{len(new)} servos that are not set up are connected ({names}): unplug all but one"
            return SetupStep(StepKind.SEPARATE, target, text)
        if not new:
            return SetupStep(StepKind.CONNECT, target, self._connect(target))
        return self._assign(new[0], target)

    # -- judging what answers -----------------------------------------------------------------------------

    def _joint_of(self, servo: SeenServo) -> JointModel | None:
        """The joint that a servo is set up for, or None."""
        if servo.shared or servo.baud != self.baud or servo.info is None:
            return None
        joint = self.model.by_servo(servo.servo_id)
        if joint is not None and servo.servo_id == FACTORY_ID:
            # Every new servo has this id: it counts only once all others are set up.
            others = {other.name for other in self.order if other.servo_id != FACTORY_ID}
            return joint if others <= set(self.done) else None
        return joint

    def _new(self) -> list[SeenServo]:
        """The servos that answer and are not set up."""
        if self.only is not None:
            return list(self._seen)
        return [servo for servo in self._seen if self._joint_of(servo) is None]

    def _assign(self, servo: SeenServo, target: JointModel) -> SetupStep:
        own = self.model.by_servo(servo.servo_id)
        if self.only is None and own is not None and own.name not in self.done and servo.servo_id != FACTORY_ID:
            # It has the id of a joint already, and only lacks the rate: a set-up was cut off here.
            target = own
        blocked = servo.blocked
        warnings = [remark.text for remark in servo.remarks if remark.text != blocked]
        model = servo.info.model_name if servo.info is not None else ""
        usual = self._assembly.servo_models
        if usual and model and model not in usual:
            warnings.insert(0, f"this arm has {usual[0]} servos, and this is a {model}")
        if self.leader and servo.kind == "12 V":
            warnings.insert(0, "a leader arm has servos for 7.4 V, and this one is made for 12 V")
        others = {row.servo_id: row for row in self._seen if row is not servo}
        if target.servo_id in others:
            blocked = f"servo {target.servo_id} is connected too: unplug it"
        text = f"{target.name} becomes servo {target.servo_id} at {self.baud} baud"
        return SetupStep(StepKind.ASSIGN, target, text, servo, blocked, "; ".join(warnings))

    def _last_step(self) -> SetupStep:
        if self.only is not None or self._checked:
            return SetupStep(StepKind.DONE, None, "all servos are set up")
        return SetupStep(StepKind.CHECK, None, self._problem() or "look again")

    def _problem(self) -> str:
        """What is wrong with the whole arm as it answers now; empty if nothing."""
        here = {servo.servo_id for servo in self._seen if self._joint_of(servo) is not None}
        missing = [f"{joint.name} ({joint.servo_id})" for joint in self.model.joints if joint.servo_id not in here]
        if missing:
            return f"connect all servos in a chain; not there: {', '.join(missing)}"
        strangers = [str(servo.servo_id) for servo in self._seen if self._joint_of(servo) is None]
        return f"unplug what does not belong to the arm: servo {', '.join(strangers)}" if strangers else ""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is to be known of the servos that answer, each with its joint, once."""
        found: dict[str, list[str]] = {}
        for servo in self._seen:
            joint = self.model.by_servo(servo.servo_id)
            for remark in servo.remarks:
                found.setdefault(remark.text, []).append(joint.name if joint else f"servo {servo.servo_id}")
        kinds = {servo.kind for servo in self._seen if servo.kind}
        rows = [f"{', '.join(names)}: {text}" for text, names in found.items()]
        if len(kinds) > 1:
            rows.append(f"servos for {' and for '.join(sorted(kinds))} are mixed: no supply fits both")
        return tuple(rows)

    def _connect(self, joint: JointModel) -> str:
        how = "alone" if self.only is not None else "alone, or with those that are set up"
        return f"connect the servo of {joint.name}: {how}"


def label(model: ArmModel, joint: str, *, leader: bool | None) -> str:
    """The gears of a joint's servo and the part number with them, as on its label; empty if not known."""
    return "" if leader is None else assembly_of(model).label(joint, leader=leader)


def picture(setup: ArmSetup) -> tuple[str, ...]:
    """The arm from its side, as lines of text: (6) is the servo to connect, [5] is set up; none for other arms."""
    model = setup.model
    assembly = assembly_of(model)
    if not assembly.picture:
        return ()
    target = setup.target
    marks = {}
    for joint in model.joints:
        form = "({})" if target is joint else "[{}]" if joint.name in setup.done else " {} "
        marks[str(joint.servo_id)] = form.format(joint.servo_id)
    text = [*assembly.picture, *[""] * (_NOTES - len(assembly.picture))]
    for i, line in enumerate(text):
        for number, mark in marks.items():
            line = line.replace(f"{{{number}}}", mark)
        text[i] = line.rstrip()
    if target is not None:
        text[2] = f"{text[2]:32}({target.servo_id}) {target.name}"
        text[3] = f"{text[3]:32}{assembly.joint(target.name).where}"
        gears = label(model, target.name, leader=setup.leader)
        text[4] = f"{text[4]:32}{f'gears {gears}' if gears else ''}"
    text[-1] = f"{text[-1]:32}[ ] is set up"
    return tuple(line.rstrip() for line in text)
