"""How a front calls the verbs of an arm for somebody who does not write Python.

Owns what a front may ask for beside the arguments of a verb, and what it is told. Must not know any front.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from hexwire.control.motion.motion_options import MotionObserver, MotionOptions

__all__ = ["Front"]


@dataclass(frozen=True, slots=True)
class Front:
    """How verbs are called; their errors name commands of `hexwire`, and not methods.

    Attributes:
        observer: Is called at the events of motions that a verb waits for; None for the log.
        options: How motions are run; the table is the arm's.
        dry_run: Check paths, and move nothing.
    """

    observer: MotionObserver | None = None
    options: MotionOptions = field(default_factory=MotionOptions)
    dry_run: bool = False
