"""A whole arm set up servo by servo, with a picture of what to connect next.

Owns what is asked and shown. The next step is `control.arm_setup`'s, which asks the bus and can be resumed at any
point; `control.setting_up` carries it out.
"""

from __future__ import annotations

import math
from html import escape

from hexwire.control.arm_setup import ArmSetup, SetupStep, StepKind, picture
from hexwire.control.setting_up import assign, look
from hexwire.drivers.arm_file import load_profile
from hexwire.errors import UsageError
from hexwire.studio.app import FAILED

from .view import View, button, facts, html, question, section

__all__ = ["ARMS", "assign_one", "look_for", "plan_of"]

ARMS = {"so101": "SO-101", "so100": "SO-100", "chain": "six servos in a chain"}
_ROLES = {"": "not known", "follower": "follower", "leader": "leader"}


def build(view: View) -> None:
    """Build the part."""
    from nicegui import ui

    bus = view.bus
    html("Set up an arm", "h2", "sv-h2")
    section(
        "Servo by servo",
        "New servos all have id 1: connect them one at a time. Each gets its id and rate, and is read back. The "
        "servos themselves are asked what is done, so a set-up can be resumed at any time. Nothing moves.",
    )
    plan: list[ArmSetup] = []
    with ui.element("div").classes("sv-form"):
        arm = ui.select(ARMS, value="so101", label="Arm").props("dense outlined options-dense")
        role = ui.select(_ROLES, value="", label="Leader or follower").props("dense outlined options-dense")
        begin = button("Look what is connected", lambda: search(False), level="main")
        everywhere = button("Look at every id and rate", lambda: search(True))
    told = html("", "p", "sv-hint")
    told.props('role="status"')
    place = ui.element("div")

    def progress() -> None:
        job = bus.bench.job
        if job is not None:
            told.set_content(escape(job.told or job.what))

    watch = ui.timer(0.2, progress, active=False)

    def choose() -> None:
        # What is shown was about another arm.
        plan.clear()
        place.clear()

    arm.on_value_change(choose)
    role.on_value_change(choose)

    async def search(all_of_it: bool) -> None:
        for made in (begin, everywhere):
            made.set_visibility(False)
        watch.activate()
        try:
            if not plan:
                made_plan = await view.act(lambda: plan_of(str(arm.value), str(role.value or "")))
                if made_plan is FAILED:
                    return
                plan[:] = [made_plan]
            setup = plan[0]
            found = await view.act(lambda: look_for(view, setup, everywhere=all_of_it))
        finally:
            watch.deactivate()
            told.set_content("")
            for made in (begin, everywhere):
                made.set_visibility(True)
        # Another arm may have been chosen meanwhile.
        if found is not FAILED and plan == [setup]:
            draw(setup)

    def draw(setup: ArmSetup) -> None:
        step = setup.step
        place.clear()
        with place:
            drawn = picture(setup)
            if drawn and step.kind is not StepKind.DONE:
                alt = f"The arm: {step.text}"
                ui.html(escape("\n".join(drawn)), sanitize=False, tag="pre").classes("sv-picture").props(
                    f'role="img" aria-label="{escape(alt)}" tabindex="0"'
                )
            html(_sentence(step.text), "p").props('role="status"')
            if step.servo is not None:
                html(f"Found: {step.servo}.", "p", "sv-hint")
            for words, level in ((step.blocked, "error"), (step.warning, "warn")):
                if words:
                    html(_sentence(words), "p").props(f'data-level="{level}"')
            if step.kind is StepKind.ASSIGN and not step.blocked:
                button("Give it this id and rate", lambda: give(setup, step), level="danger")
            facts([(joint.name, _state(setup, joint.name)) for joint in setup.order])
            for remark in setup.remarks:
                html(f"{remark}.", "p").props('data-level="warn"')

    async def give(setup: ArmSetup, step: SetupStep) -> None:
        text = "\n".join(part for part in (f"{_sentence(step.text)} Both are stored.", step.warning) if part)
        if not await question("Set this servo up", text, "Set it up"):
            return
        done = await view.act(lambda: assign_one(view, setup, step))
        if done is not FAILED:
            ui.notify(f"{step.joint.name if step.joint else 'the servo'} is set up", type="positive")
        await search(False)


def plan_of(arm: str, role: str) -> ArmSetup:
    """Begin the set-up of an arm.

    Raises:
        UsageError: There is no such arm or role.
    """
    if arm not in ARMS or role not in _ROLES:
        raise UsageError("choose one of the arms in the list")
    described = load_profile(arm)
    return ArmSetup(described.model, described.baud, leader=role == "leader" if role else None)


def look_for(view: View, setup: ArmSetup, *, everywhere: bool) -> None:
    """Look what is connected, and tell the set-up; those that are set up are in the list of servos then.

    Raises:
        DeviceError: It was cancelled or stopped.
        HexwireError: The line has a fault.
    """
    with view.bus.bench.working("the search for servos", changes_rate=True) as job:
        look(
            view.bus.bus,
            setup,
            everywhere=everywhere,
            progress=lambda baud, servo_id, found: job.tell(f"{baud} baud, id {servo_id}", math.nan),
        )
        for servo in setup.seen:
            if servo.baud == setup.baud and servo.info is not None and not servo.shared:
                view.bus.look_again(servo.servo_id)


def assign_one(view: View, setup: ArmSetup, step: SetupStep) -> None:
    """Carry out a step that changes a servo; raises as `control.setting_up.assign`."""
    with view.bus.bench.working("the set-up of a servo", acts=True, changes_rate=True) as job:

        def tell(words: str) -> None:
            # A change that has begun is completed: half of it would be worse.
            job.told = words

        assign(view.bus.bus, setup, step, tell=tell)
        assert step.servo is not None
        assert step.joint is not None
        view.bus.look_again(step.joint.servo_id, former=step.servo.servo_id)


def _state(setup: ArmSetup, name: str) -> str:
    servo_id = setup.model.joint(name).servo_id
    info = setup.done.get(name)
    return f"servo {servo_id}: {'to do' if info is None else f'set up, {info.model_name} {info.firmware}'}"


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."
