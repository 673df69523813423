"""A whole arm set up servo by servo, with a picture of what to connect next.

Owns which set-up belongs to which tab, and what its page is told. The next step is `setup.arm_setup`'s, which
asks the bus and can be resumed at any point; `setup.setting_up` carries it out.
"""

from __future__ import annotations

import math
from typing import Any

from hexwire.drivers.registry import load_bus_arm
from hexwire.errors import UsageError
from hexwire.model.arms import assembled_arms
from hexwire.setup.arm_setup import ArmSetup, SetupStep, StepKind
from hexwire.setup.setting_up import assign, look
from hexwire.studio.calls import Arguments, Asked, call

__all__ = ["assign_one", "look_for", "plan_of"]

_ROLES = {"": "not known", "follower": "follower", "leader": "leader"}


class _Look(Arguments, frozen=True):
    arm: str
    role: str
    again: bool
    everywhere: bool


def _arms() -> dict[str, str]:
    """What may be set up: words by name."""
    return assembled_arms() | {"chain": "six servos in a chain"}


@call("set_up.choices", Arguments)
def _choices(asked: Asked, args: Arguments) -> dict[str, Any]:
    return {"arms": [*_arms().items()], "roles": [*_ROLES.items()]}


@call("set_up.look", _Look, control=True)
def _look(asked: Asked, args: _Look) -> dict[str, Any]:
    """Look what is connected: for a set-up that begins, or again for that of before."""
    setup = _setup_of(asked) if args.again else None
    if setup is None:
        setup = plan_of(args.arm, args.role)
        asked.tab.begun["set-up"] = asked.bus, setup
    look_for(asked, setup, everywhere=args.everywhere)
    return _told(setup)


@call("set_up.assign", Arguments, control=True)
def _assign(asked: Asked, args: Arguments) -> str:
    """Carry out the step that was told last; what was done."""
    setup = _setup_of(asked)
    if setup is None or setup.step.kind is not StepKind.ASSIGN or setup.step.blocked:
        raise UsageError("look what is connected first")
    step = setup.step
    assign_one(asked, setup, step)
    return f"{step.joint.name if step.joint else 'the servo'} is set up"


def _setup_of(asked: Asked) -> ArmSetup | None:
    bus, setup = asked.tab.begun.get("set-up", (None, None))
    return setup if isinstance(setup, ArmSetup) and bus is asked.bus else None


def _told(setup: ArmSetup) -> dict[str, Any]:
    step = setup.step
    sentence = _sentence(step.text)
    return {
        "joint": "" if step.joint is None else step.joint.name,
        "text": sentence,
        "found": "" if step.servo is None else f"Found: {step.servo}.",
        "blocked": _sentence(step.blocked),
        "warning": _sentence(step.warning),
        "question": ""
        if step.kind is not StepKind.ASSIGN or step.blocked
        else "\n".join(part for part in (f"{sentence} Both are stored.", step.warning) if part),
        "joints": [(joint.name, _state(setup, joint.name)) for joint in setup.order],
        "remarks": [f"{remark}." for remark in setup.remarks],
    }


def plan_of(arm: str, role: str) -> ArmSetup:
    """Begin the set-up of an arm.

    Raises:
        UsageError: There is no such arm or role.
    """
    if arm not in _arms() or role not in _ROLES:
        raise UsageError("choose one of the arms in the list")
    described = load_bus_arm(arm).described()
    return ArmSetup(described.model, described.baud, leader=role == "leader" if role else None)


def look_for(asked: Asked, setup: ArmSetup, *, everywhere: bool) -> None:
    """Look what is connected, and tell the set-up; those that are set up are in the list of servos then.

    Raises:
        DeviceError: It was cancelled or stopped.
        HexwireError: The line has a fault.
    """
    with asked.bus.bench.working("the search for servos", changes_rate=True) as job:
        look(
            asked.bus.bus,
            setup,
            everywhere=everywhere,
            progress=lambda baud, servo_id, found: job.tell(f"{baud} baud, id {servo_id}", math.nan),
        )
        for servo in setup.seen:
            if servo.baud == setup.baud and servo.info is not None and not servo.shared:
                asked.bus.look_again(servo.servo_id)


def assign_one(asked: Asked, setup: ArmSetup, step: SetupStep) -> None:
    """Carry out a step that changes a servo; raises as `setup.setting_up.assign`."""
    with asked.bus.bench.working("the set-up of a servo", acts=True, changes_rate=True) as job:

        def tell(words: str) -> None:
            # A change that has begun is completed: half of it would be worse.
            job.told = words

        assign(asked.bus.bus, setup, step, tell=tell)
        assert step.servo is not None
        assert step.joint is not None
        asked.bus.look_again(step.joint.servo_id, former=step.servo.servo_id)


def _state(setup: ArmSetup, name: str) -> str:
    servo_id = setup.model.joint(name).servo_id
    info = setup.done.get(name)
    return f"servo {servo_id}: {'to do' if info is None else f'set up, {info.model_name} {info.firmware}'}"


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}." if text else ""
