"""The life cycle of a node, as managed nodes show it: its state, its transitions, and requests to change it.

Owns the states and transitions of `rcl_lifecycle`, the services and the topic. Must not know what a state means for
an arm: whoever owns the node mirrors the state here, and carries requests out or refuses them.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple

from .node import Deferred
from .qos import DEFAULT

if TYPE_CHECKING:
    from .node import Node
    from .types import Types

__all__ = ["TRANSITIONS", "Change", "Lifecycle", "State", "Transition"]

_log = logging.getLogger(__name__)


class State(IntEnum):
    """States of a managed node, with the numbers of lifecycle_msgs/msg/State."""

    UNKNOWN = 0
    UNCONFIGURED = 1
    INACTIVE = 2
    ACTIVE = 3
    FINALIZED = 4
    CONFIGURING = 10
    CLEANINGUP = 11
    SHUTTINGDOWN = 12
    ACTIVATING = 13
    DEACTIVATING = 14
    ERRORPROCESSING = 15

    @property
    def label(self) -> str:
        """Its name in messages."""
        return self.name.lower()


class Change(IntEnum):
    """What a client may ask for, with the numbers of lifecycle_msgs/msg/Transition."""

    CONFIGURE = 1
    CLEANUP = 2
    ACTIVATE = 3
    DEACTIVATE = 4
    UNCONFIGURED_SHUTDOWN = 5
    INACTIVE_SHUTDOWN = 6
    ACTIVE_SHUTDOWN = 7

    @property
    def label(self) -> str:
        """Its name in messages."""
        return "shutdown" if self.name.endswith("SHUTDOWN") else self.name.lower()


class Transition(NamedTuple):
    """One transition."""

    id: int
    label: str
    start: State
    goal: State


def _make_transitions() -> tuple[Transition, ...]:
    rows = []
    for change, during, before, after in (
        (Change.CONFIGURE, State.CONFIGURING, State.UNCONFIGURED, State.INACTIVE),
        (Change.CLEANUP, State.CLEANINGUP, State.INACTIVE, State.UNCONFIGURED),
        (Change.ACTIVATE, State.ACTIVATING, State.INACTIVE, State.ACTIVE),
        (Change.DEACTIVATE, State.DEACTIVATING, State.ACTIVE, State.INACTIVE),
    ):
        # The ends of transition 1 are 10 to 12, those of transition 2 are 20 to 22.
        rows += [
            Transition(change, change.label, before, during),
            Transition(10 * change, "transition_success", during, after),
            Transition(10 * change + 1, "transition_failure", during, before),
            Transition(10 * change + 2, "transition_error", during, State.ERRORPROCESSING),
        ]
    for change, before in (
        (Change.UNCONFIGURED_SHUTDOWN, State.UNCONFIGURED),
        (Change.INACTIVE_SHUTDOWN, State.INACTIVE),
        (Change.ACTIVE_SHUTDOWN, State.ACTIVE),
    ):
        rows.append(Transition(change, change.label, before, State.SHUTTINGDOWN))
    rows += [
        Transition(50, "transition_success", State.SHUTTINGDOWN, State.FINALIZED),
        Transition(51, "transition_failure", State.SHUTTINGDOWN, State.FINALIZED),
        Transition(52, "transition_error", State.SHUTTINGDOWN, State.ERRORPROCESSING),
        Transition(60, "transition_success", State.ERRORPROCESSING, State.UNCONFIGURED),
        Transition(61, "transition_failure", State.ERRORPROCESSING, State.FINALIZED),
        Transition(62, "transition_error", State.ERRORPROCESSING, State.FINALIZED),
    ]
    return tuple(rows)


TRANSITIONS = _make_transitions()
"""Every transition, in the order of `rcl_lifecycle`."""

_SHUTDOWNS = frozenset({Change.UNCONFIGURED_SHUTDOWN, Change.INACTIVE_SHUTDOWN, Change.ACTIVE_SHUTDOWN})
_SUCCESS, _FAILURE, _ERROR = "transition_success", "transition_failure", "transition_error"
_WAYS: dict[tuple[State, State], tuple[str, ...]] = {
    (State.UNCONFIGURED, State.INACTIVE): ("configure", _SUCCESS),
    (State.UNCONFIGURED, State.ACTIVE): ("configure", _SUCCESS, "activate", _SUCCESS),
    (State.INACTIVE, State.ACTIVE): ("activate", _SUCCESS),
    (State.INACTIVE, State.UNCONFIGURED): ("cleanup", _SUCCESS),
    (State.ACTIVE, State.INACTIVE): ("deactivate", _SUCCESS),
    # Only a failure leads from active to unconfigured, such as a lost connection.
    (State.ACTIVE, State.UNCONFIGURED): ("deactivate", _ERROR, _SUCCESS),
    **{
        (state, State.FINALIZED): ("shutdown", _SUCCESS)
        for state in (State.UNCONFIGURED, State.INACTIVE, State.ACTIVE)
    },
}
"""Labels of the transitions from one primary state to another."""


class Lifecycle:
    """The life cycle of a node, which begins unconfigured.

    Args:
        node: The node; must be open.
        types: Its types.
        on_change: Carries out what a client asks for, in a thread of its own; may wait. It refuses with an error
            whose text is the reason; then the state stays. Otherwise the node is in the state that was asked for,
            until `mirror` says something else.
        present: Returns the present state, as for `mirror`: whoever has just asked for something else sees what
            it did. None for that of the last `mirror`.
        refused_by: The errors of `on_change` that refuse; any other is a fault of the program, and logged as one.
    """

    def __init__(
        self,
        node: Node,
        types: Types,
        on_change: Callable[[Change], object],
        present: Callable[[], State] | None = None,
        refused_by: type[Exception] = ValueError,
    ) -> None:
        self._on_change, self._present, self._refused_by = on_change, present, refused_by
        message = types.message
        self._state_message = message("lifecycle_msgs/msg/State")
        self._transition_message = message("lifecycle_msgs/msg/Transition")
        self._description = message("lifecycle_msgs/msg/TransitionDescription")
        self._event = message("lifecycle_msgs/msg/TransitionEvent")
        self._time = message("builtin_interfaces/msg/Time")
        self._changed = types.service("lifecycle_msgs/srv/ChangeState").response
        self._got_state = types.service("lifecycle_msgs/srv/GetState").response
        self._got_states = types.service("lifecycle_msgs/srv/GetAvailableStates").response
        self._got_transitions = types.service("lifecycle_msgs/srv/GetAvailableTransitions").response
        self._name = node.full_name
        self._lock = threading.RLock()
        self._state = State.UNCONFIGURED
        # The node has ended while a request was carried out.
        self._over = False
        self._events = node.publisher("~/transition_event", "lifecycle_msgs/msg/TransitionEvent", DEFAULT)
        for name, kind, callback in (
            ("change_state", "ChangeState", self._change_state),
            ("get_state", "GetState", self._get_state),
            ("get_available_states", "GetAvailableStates", self._get_available_states),
            ("get_available_transitions", "GetAvailableTransitions", self._get_available_transitions),
            ("get_transition_graph", "GetAvailableTransitions", self._get_transition_graph),
        ):
            node.service(f"~/{name}", f"lifecycle_msgs/srv/{kind}", callback)

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    def mirror(self, state: State) -> None:
        """Take a state, through the transitions that lead there; nothing happens if it is the present one.

        While a request is carried out, only the end of the node counts, and is shown after it.

        Args:
            state: UNCONFIGURED, INACTIVE, ACTIVE or FINALIZED, after which none follows.
        """
        with self._lock:
            if self._state not in (State.UNCONFIGURED, State.INACTIVE, State.ACTIVE):
                self._over = self._over or state is State.FINALIZED
                return
            for label in _WAYS.get((self._state, state), ()):
                self._move(label)

    def _move(self, label: str) -> None:
        row = next(row for row in TRANSITIONS if row.start is self._state and row.label == label)
        self._state = row.goal
        fields = {"start_state": self._message(row.start), "goal_state": self._message(row.goal)}
        if "stamp" in self._event.fields:
            # Up to Kilted, ROS leaves the transition and its time empty.
            seconds, rest = divmod(time.time_ns(), 1_000_000_000)
            fields["stamp"] = self._time(sec=seconds, nanosec=rest)
            fields["transition"] = self._transition_message(id=row.id, label=row.label)
        self._events.publish(self._event(**fields))

    # -- services -------------------------------------------------------------------------------------------------

    def _change_state(self, request: Any) -> Any:
        asked = request.transition
        self._look()
        with self._lock:
            change = self._asked_change(int(asked.id), str(asked.label))
            if change is None:
                what = repr(asked.label)[:80] if asked.label else f"transition {asked.id}"
                _log.warning("%s: no %s from the state %s", self._name, what, self._state.label)
                return self._changed(success=False)
            if change not in _SHUTDOWNS:
                self._move(change.label)
        answer = Deferred()
        threading.Thread(target=self._carry_out, args=(change, answer), name="lifecycle", daemon=True).start()
        return answer

    def _asked_change(self, number: int, label: str) -> Change | None:
        """What is asked for; the label counts if there is one, as in `rclcpp`."""
        for row in TRANSITIONS:
            if row.start is self._state and (row.label == label if label else row.id == number):
                return Change(row.id) if row.id in set(Change) else None
        return None

    def _carry_out(self, change: Change, answer: Deferred) -> None:
        success = False
        try:
            self._on_change(change)
            success = True
        except self._refused_by as error:
            _log.warning("%s: %s was not done: %s", self._name, change.label, error)
        except Exception:  # noqa: BLE001
            # The client must get an answer.
            _log.exception("%s: %s failed", self._name, change.label)
        with self._lock:
            if change in _SHUTDOWNS:
                # A failed shutdown is the end too for ROS, so a refused one does not begin.
                if success:
                    self.mirror(State.FINALIZED)
            else:
                self._move(_SUCCESS if success else _FAILURE)
                if self._over:
                    self.mirror(State.FINALIZED)
        answer.answer(self._changed(success=success))

    def _look(self) -> State:
        if self._present is not None:
            self.mirror(self._present())
        return self._state

    def _get_state(self, _request: Any) -> Any:
        return self._got_state(current_state=self._message(self._look()))

    def _get_available_states(self, _request: Any) -> Any:
        return self._got_states(available_states=[self._message(state) for state in State])

    def _get_available_transitions(self, _request: Any) -> Any:
        state = self._look()
        rows = [self._describe(row) for row in TRANSITIONS if row.start is state]
        return self._got_transitions(available_transitions=rows)

    def _get_transition_graph(self, _request: Any) -> Any:
        return self._got_transitions(available_transitions=[self._describe(row) for row in TRANSITIONS])

    # -- messages -------------------------------------------------------------------------------------------------

    def _message(self, state: State) -> Any:
        return self._state_message(id=int(state), label=state.label)

    def _describe(self, row: Transition) -> Any:
        return self._description(
            transition=self._transition_message(id=int(row.id), label=row.label),
            start_state=self._message(row.start),
            goal_state=self._message(row.goal),
        )
