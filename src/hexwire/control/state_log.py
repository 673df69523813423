"""The joint positions in the log of a node, as the chapter's node prints them.

Owns when a state is logged: once a second. Must not know where the log goes.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from hexwire.trace.chapter_log import format_positions

from .rate import Periodic

if TYPE_CHECKING:
    from hexwire.model.state import JointState

    from .known_state import KnownState

__all__ = ["logging_states"]

_log = logging.getLogger(__name__)

_PERIOD = 1.0


def logging_states(
    on_state: Callable[[JointState, KnownState], object], name: str
) -> Callable[[JointState, KnownState], object]:
    """The receiver of states of a `RobotOwner`, which logs them too.

    Args:
        on_state: Receives every state, before it is logged.
        name: The robot's, for the log.
    """
    due = Periodic()

    def both(state: JointState, published: KnownState) -> None:
        on_state(state, published)
        if due.due(state.stamp, _PERIOD):
            degrees = [math.degrees(angle) for angle in state.position]
            _log.info("%s", "\n".join(format_positions(state.names, degrees, name=name)))

    return both
