"""A goal that begins: its way out of the running motion is planned and checked while nobody is kept waiting.

Owns that this is done without the lock of the controllers, and when it is done again. Must not know how a way is
planned, nor who asks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from hexwire.motion.set_point_generator import Mode

if TYPE_CHECKING:
    from hexwire.motion.trajectory import Trajectory

    from ..motion.goals import Tolerances
    from .controller import TrajectoryController
    from .outcomes import GoalListener
    from .owner import RobotOwner
    from .plan import Plan

__all__ = ["begin"]

_TRIES = 3
"""How often a way is planned without the lock while the motion that it leads out of goes on; then with it."""
_LONGEST = 0.2
"""Seconds by which a goal may begin later, so that it is planned before that."""


def begin(
    owner: RobotOwner,
    controller: TrajectoryController,
    plan: Plan,
    end: tuple[GoalListener | None, Tolerances | None],
    *,
    meanwhile: Callable[[float], Sequence[Trajectory]],
    refuse: Callable[[], object],
    accepting: Callable[[], object],
) -> None:
    """Have a controller accept a goal whose path was checked.

    Args:
        owner: Of the robot.
        controller: Of the joints.
        plan: Of the goal.
        end: Listener and tolerances, as in `TrajectoryController.accept`.
        meanwhile: Returns what other controllers do from a time on; called with the lock held.
        refuse: Raises the error with which the goal is refused by now; likewise.
        accepting: Called right before it is accepted; likewise.

    Raises:
        HexwireError: It is refused; the previous motion goes on.
    """
    listener, tolerances = end
    generator, streamed = controller.generator, listener is None
    for i in range(_TRIES + 1):
        with owner.locked():
            refuse()
            state, now = owner.newest(), owner.now()
            soonest = generator.next_start(now)
            waits = plan.goal.delay > 0.0 and plan.due > soonest
            # What gives way needs no way, and must begin at once.
            if i == _TRIES or waits or plan.goal.gives_way:
                accepting()
                controller.accept(
                    plan, state, now, listener=listener, tolerances=tolerances, meanwhile=meanwhile(soonest)
                )
                return
            # What follows set-points is where they will be, which nobody knows.
            later = min(_LONGEST, 2.0 * controller.planning) if generator.mode is not Mode.STREAM else 0.0
            begins = soonest + (later if not generator.done or streamed else 0.0)
            outline = controller.outline(plan, state, now, begins, meanwhile(begins), streamed=streamed)
        ready = controller.prepare(outline)
        with owner.locked():
            refuse()
            state, done = owner.newest(), owner.now()
            controller.planning = done - now
            if controller.is_current(ready, done):
                accepting()
                controller.accept(plan, state, done, listener=listener, tolerances=tolerances, ready=ready)
                return
