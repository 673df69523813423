"""The server of one shared arm: states out, questions and orders in.

Owns the threads that answer, so that nothing that waits for the arm delays a stop, a heartbeat or a refusal, and
the watch for other servers of its name behind a router. Decides nothing about the arm:
`hexwire.control.sharing.shared` does. Must not know the command line.
"""

from __future__ import annotations

import contextlib
import logging
import math
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from hexwire.control.loop.workers import Gathering, Worker
from hexwire.control.sharing.shared import Order
from hexwire.control.sharing.shared_goals import SharedGoals
from hexwire.drivers.values import StopMode
from hexwire.errors import (
    DeviceError,
    GoalError,
    HexwireError,
    LeaseError,
    LinkBusyError,
    RemoteProtocolError,
    UsageError,
)
from hexwire.model.state import JointState, JointTarget

from . import messages as m
from .failures import describe
from .names import ClientRole, Keys, name_of
from .network import Network
from .node import Node
from .rows import as_probe_rows, facts_of
from .set_points import SetPointReports
from .trajectories import do_goal_order, goal_row

if TYPE_CHECKING:
    from hexwire.control.sharing.shared import SharedArm
    from hexwire.epochs import Token
    from hexwire.model.state import SentTarget

    from .node import Node, Publisher, Question

__all__ = ["ArmServer", "NameGuard"]

_RETRY = 1.0
"""Seconds between two attempts to reach the router."""
_ANSWER = 1.0
"""Seconds for an answer of the router."""


class NameGuard:
    """Watches for servers of a name.

    Args:
        network: Connects to the router; it does not listen.
        key: Key or pattern of the liveliness tokens.
    """

    def __init__(self, network: Network, key: str) -> None:
        self._network, self._key = network, key
        self._node: Node | None = None
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Try once to reach the router."""
        # It is retried by `watch`, and the server's own session tells of a router that cannot be reached.
        with contextlib.suppress(HexwireError):
            self._node = self._network.open()

    def visible(self) -> list[str]:
        """Tokens of those who offer the name now; none without a connection."""
        return self._node.visible(self._key, _ANSWER) if self._node is not None else []

    def watch(self, on_token: Callable[[str, bool], object]) -> None:
        """Report in another thread which servers appear and vanish while the router can be reached."""
        self._thread = threading.Thread(target=self._watch, args=(on_token,), name="guard", daemon=True)
        self._thread.start()

    def _watch(self, on_token: Callable[[str, bool], object]) -> None:
        while self._node is None and not self._ending.is_set():
            self.open()
            if self._node is None:
                self._ending.wait(_RETRY)
        if self._node is not None:
            # From here on Zenoh connects again by itself.
            self._node.watch_visible(self._key, on_token, at_once=True)

    def close(self) -> None:
        """End it."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
        if self._node is not None:
            self._node.close()


_log = logging.getLogger(__name__)

_NUMBER_BITS = 53
_DONE = 4096
"""Most orders whose end is remembered until a later state is sampled."""
_RECENT = 0.5
"""Seconds; a joint whose value is older is silent, and no state waits for it."""
_LONGEST_NAME = 200
_STATUS = 0.2
"""Seconds between two messages while no states come."""
_ROLES = (ClientRole.OPERATOR, ClientRole.MAINTAINER)
_PROBE_AGE = 2.0
"""Seconds for which the result of a probe is reused, so that questions cannot keep the line busy."""
_SETTLE = 0.3
"""Seconds in which the tokens of two servers that start together become visible to each other."""


class _Detailed(NamedTuple):
    """The value of an answer, and what else is to be said of it."""

    value: object
    details: dict[str, Any]


class ArmServer:
    """Offers a shared arm under a name.

    Args:
        shared: The arm; started by the caller.
        name: Its name in the fleet, checked.
        node: The session; closed by the caller.
        server: This host, process and version, in words.
        guard: Sees other servers of this name behind a router; opened and closed by the caller.
        started: When it was started, wall clock; the later of two servers of a name ends.

    Attributes:
        conflict: Another server offers this name: which; empty if none does.
        served: Number of answered orders and questions.
        refused: Number of messages that could not be understood or for which there was no room.
    """

    def __init__(
        self,
        shared: SharedArm,
        name: str,
        node: Node,
        *,
        guard: NameGuard | None = None,
        server: str = "",
        started: float = 0.0,
    ) -> None:
        self.conflict = ""
        self.served = self.refused = 0
        self._shared, self._node, self._keys, self._server = shared, node, Keys(name), server
        self._guard = guard
        self._owner, self._robot = shared.arm.owner, shared.arm.owner.robot
        # Sorts like the time of its start: 16 hexadecimal digits, then what distinguishes two of the same time.
        self._instance = f"{int(1e6 * started):016x}-{secrets.token_hex(8)}"
        # Tells a client that this is another server than before, whatever its clock says.
        self._number = secrets.randbits(_NUMBER_BITS)
        self._sequence = 0
        self._set_points = SetPointReports()
        # Orders done; when each was, how many then, and which set-point; the same before the last state's values.
        self._done = 0
        self._before = 0, (0, 0)
        self._ends: deque[tuple[float, int, tuple[int, int]]] = deque(maxlen=_DONE)
        self._counting = threading.Lock()
        self._published = -1.0
        self._publish: Publisher
        self._publishing = threading.Lock()
        self._ending = threading.Event()
        self._probe: tuple[float, Any] | None = None
        self._workers: dict[str, Worker] = {}
        self._stops: dict[StopMode, Gathering[tuple[Question, str]]] = {}
        self._questions: Gathering[tuple[Question, m.Ask]] = Gathering("questions", self._answer_questions)
        self._goals = SharedGoals(shared)

    def start(self) -> None:
        """Offer the arm.

        Raises:
            LinkBusyError: Another server offers this name.
        """
        node, keys = self._node, self._keys
        if self._others(self._visible()):
            raise self._taken()
        node.announce(keys.token(self._instance))
        # Two servers that start at the same time see each other's tokens now; one of them ends.
        self._ending.wait(_SETTLE)
        if any(other < self._instance for other in self._others(self._visible())):
            raise self._taken()
        # Separate: a slow order does not delay a lease, and nothing delays a stop, not even another kind of stop.
        self._workers = {name: Worker(name) for name in ("orders", "leases")}
        self._stops = {mode: Gathering("stops", partial(self._stop, mode), lasting=True) for mode in StopMode}
        self._publish = node.publisher(keys.state)
        node.watch_visible(keys.alive, self._on_token, at_once=True)
        if self._guard is not None:
            self._guard.watch(self._on_token)
        self._take_stops(keys.stop, StopMode.HOLD)
        node.answer(keys.ask, self._guarded(self._on_question), lane="questions")
        for role in _ROLES:
            node.answer(keys.lease(role), self._guarded(partial(self._on_lease, role)), lane="leases")
            accept, refuse = partial(self._accept_order, role), self._guarded(self._refuse_order)
            node.answer(keys.order(role), refuse, lane="questions", at_once=accept)
            node.take_at_once(keys.order(role), self._accept_set_point)
            self._take_stops(keys.off(role), StopMode.TORQUE_OFF)
        self._owner.observe(self._send)
        self._owner.needed = lambda: self._publish.is_wanted or self._shared.holder is not None
        self._shared.looks.append(self._tell)

    def close(self) -> None:
        """End the answers; what was accepted is answered first."""
        self._ending.set()
        with contextlib.suppress(ValueError):
            self._shared.looks.remove(self._tell)
            self._owner.observe(self._send, on=False)
            self._goals.close()
        for worker in self._workers.values():
            worker.close(1.0)
        for stops in self._stops.values():
            stops.close(1.0)
        self._questions.close(1.0)

    # -- unique names -----------------------------------------------------------------------------------

    def _visible(self) -> list[str]:
        """Tokens of all servers of this name."""
        by_router = self._guard.visible() if self._guard is not None else []
        return [*self._node.visible(self._keys.alive, 1.0), *by_router]

    def _taken(self) -> LinkBusyError:
        return LinkBusyError(
            f"the name {self._keys.name} is already served by another program; choose another --name"
        )

    def _others(self, tokens: list[str]) -> list[str]:
        found = []
        for token in tokens:
            with contextlib.suppress(UsageError):
                name, instance = name_of(token)
                if name == self._keys.name and instance != self._instance:
                    found.append(instance)
        return found

    def _on_token(self, key: str, visible: bool) -> None:
        # Two parts of a network have been reconnected. The server that was started later ends.
        if visible and any(other < self._instance for other in self._others([key])):
            self.conflict = self.conflict or f"another server offers {self._keys.name}, and was started earlier"

    # -- states -----------------------------------------------------------------------------------------

    def _tell(self) -> float:
        """Send a message if no states come; returns the seconds until the next one may be due."""
        left = self._published + _STATUS - self._shared.now()
        if left > 0.0:
            return left
        # No states: the robot is lost, or a long request occupies its line.
        self._send(None)
        return _STATUS

    def _send(self, state: JointState | None) -> None:
        with self._publishing:
            self._sequence += 1
            self._published = now = self._shared.now()
            # Without readers, of which an arm at rest may have none, its states cost nothing more.
            if self._publish.is_wanted:
                self._publish(m.encode(self._message(state, now)))

    def _message(self, state: JointState | None, now: float) -> m.State:
        shared, owner = self._shared, self._owner
        reason, holder = owner.group.reason, shared.holder
        done, dealt = self._before_sample(state)
        shown = JointState.of({}, stamp=now, board_time=0.0) if state is None else state
        return m.State(
            self._number,
            self._sequence,
            shown.stamp,
            now,
            time.time(),
            shown.names,
            shown.position,
            self._velocity(shown),
            shown.load,
            shown.current,
            shown.voltage,
            shown.temperature,
            shown.flags,
            shown.age,
            shown.board_time,
            shown.stopped or reason is not None,
            shown.watchdog_tripped or shared.tripped,
            shown.maintenance,
            holder.client if holder else "",
            shared.held,
            str(reason or ""),
            "" if owner.connected else owner.error,
            done,
            round(1000.0 * shown.stalled),
            self._set_points.report(holder.key if holder else 0, dealt),
        )

    def _velocity(self, state: JointState) -> tuple[float, ...]:
        """Velocities; short reports leave them out, so that those out of the positions take their place."""
        measured = state.velocity
        if not any(map(math.isnan, measured)):
            return measured
        computed = self._owner.speeds(state.names)
        return tuple([a if a == a else b for a, b in zip(measured, computed, strict=True)])  # NaN

    def _before_sample(self, state: JointState | None) -> tuple[int, tuple[int, int]]:
        """Number of orders done before the values of a state were sampled, and `SetPointReports.dealt` then."""
        if state is not None and not self._ends:
            # An order that ends now ends after the sample.
            return self._before
        if state is None:
            # It has no values, and may report that the robot is lost.
            return self._done, self._set_points.dealt
        if (oldest := max(state.age, default=0.0)) >= _RECENT:
            oldest = max([age for age in state.age if age < _RECENT], default=0.0)
        sampled = state.stamp - oldest
        with self._counting:
            while self._ends and self._ends[0][0] <= sampled:
                self._before = self._ends.popleft()[1:]
        return self._before

    def _count(self, done: int = 1) -> None:
        """An order was done, or a set-point refused."""
        with self._counting:
            self._done += done
            self._ends.append((self._shared.now(), self._done, self._set_points.dealt))

    # -- what arrives -----------------------------------------------------------------------------------
    # Called in threads that must not wait for the arm.

    def _guarded(self, on_query: Callable[[Question], object]) -> Callable[[Question], None]:
        """So that a mistake in this program is answered and logged; Zenoh would only print it."""

        def guarded(query: Question) -> None:
            try:
                on_query(query)
            except Exception as error:  # noqa: BLE001  # logged and answered
                _log.exception("a message failed")
                self._refuse(query, DeviceError(f"the arm's server failed at this: {error}"))

        return guarded

    def _take_stops(self, key: str, most: StopMode) -> None:
        accept, refuse = partial(self._accept_stop, most), self._guarded(partial(self._refuse_stop, most))
        self._node.answer(key, refuse, lane="stops", at_once=accept)

    def _accept_stop(self, most: StopMode, query: Question) -> bool:
        """Pass a stop to its thread; False if that needs an answer first."""
        try:
            request = m.decode(query.payload, m.StopRequest)
        except RemoteProtocolError:
            return False
        rules = self._shared.rules
        if request.own and rules.taken_from(request.key):
            return False
        if request.key:
            rules.void(request.key, request.sequence)
        # Without the right to switch torque off, the stop still takes place, and the arm holds.
        mode = _mode(request.mode) if most is StopMode.TORQUE_OFF else StopMode.HOLD
        return self._stops[mode].put((query, _shown(request.client)))

    def _refuse_stop(self, most: StopMode, query: Question) -> None:
        # What kept it from being accepted may be over.
        if self._accept_stop(most, query):
            return
        request = self._parse(query, m.StopRequest)
        if request is None:
            return
        if request.own and (taken := self._shared.rules.taken_from(request.key)):
            self._refuse(query, LeaseError(taken))
            return
        self.refused += 1
        self._refuse(query, DeviceError("so many stop the arm that this is not answered; it is being stopped"))

    def _stop(self, mode: StopMode, requests: list[tuple[Question, str]]) -> None:
        """Stop the arm once for all who have asked since the last stop began."""
        clients = dict.fromkeys(client for _, client in requests)
        self._answer([query for query, _ in requests], partial(self._stop_for, ", ".join(clients), mode))

    def _stop_for(self, clients: str, mode: StopMode) -> object:
        confirmed = self._shared.stop(f"{clients[:_LONGEST_NAME]} stopped it", mode)
        self._count()
        missing = [name for name in self._robot.model.names if name not in confirmed]
        torques = self._shared.arm.torques().after_stop(confirmed, mode)
        return _Detailed(confirmed, {"missing": missing} | asdict(torques))

    def _on_question(self, query: Question) -> None:
        ask = self._parse(query, m.Ask)
        if ask is None:
            return
        if ask.what == "clock":
            self._reply(query, None)
        elif ask.what == "facts":
            self._reply(query, facts_of(self._shared, self._server))
        elif ask.what == "goal":
            report = self._goals.report(ask.number)
            if report is None:
                self._refuse(query, GoalError(f"there is no goal {ask.number}; another program may have begun one"))
            else:
                self._reply(query, goal_row(report))
        elif ask.what == "state":
            self._reply(query, self._message(self._owner.state, self._shared.now()))
        elif not self._questions.put((query, ask)):
            self._refuse_busy(query)

    def _on_lease(self, role: ClientRole, query: Question) -> None:
        request = self._parse(query, m.LeaseRequest)
        if request is None:
            return
        shared = self._shared
        if isinstance(request, m.Beat):
            try:
                shared.beat(request.key, request.idle)
            except LeaseError as error:
                self._refuse(query, error)
            else:
                self._reply(query, None)
        elif isinstance(request, m.Take):
            self._queue("leases", query, lambda: self._take(request, role))
        else:
            self._queue("leases", query, lambda: self._leave(request))

    def _accept_order(self, role: ClientRole, query: Question) -> bool:
        """Queue an order of the holder. Others do not fill its queue; undecoded, what is long costs as little."""
        payload = query.payload
        if not self._is_holder(payload):
            return False
        arrived = self._robot.epochs.mark()
        return self._workers["orders"].put(
            lambda: self._answer([query], lambda: self._do_order(role, payload, arrived))
        )

    def _accept_set_point(self, payload: bytes) -> None:
        """Queue a set-point that is published, as `_accept_order` does; states tell what becomes of it."""
        try:
            key = m.lease_key(payload)
        except RemoteProtocolError:
            key = 0
        if not key or len(payload) > m.SHORT:
            # Nobody is told: no client sends that.
            self.refused += 1
            return
        holder = self._shared.holder
        if holder is None or holder.key != key:
            self._shared.refusal(key)
            return
        arrived = self._robot.epochs.mark()
        if not self._workers["orders"].put(partial(self._do_set_point, key, payload, arrived)):
            self.refused += 1
            with contextlib.suppress(RemoteProtocolError):
                sequence = m.decode(payload, m.Envelope).sequence
                self._set_points.refuse(key, sequence, DeviceError("the arm's server is busy; nothing was done"))

    def _is_holder(self, payload: bytes) -> bool:
        try:
            key, holder = m.lease_key(payload), self._shared.holder
        except RemoteProtocolError:
            return False
        return holder is not None and holder.key == key

    def _refuse_order(self, query: Question) -> None:
        payload = query.payload
        if self._is_holder(payload):
            # More of its orders wait than there is room for; or it has just got the lease.
            self._refuse_busy(query)
            return
        try:
            error: HexwireError = self._shared.refusal(m.lease_key(payload))
        except RemoteProtocolError as wrong:
            self.refused += 1
            error = wrong
        self._refuse(query, error)

    def _parse(self, query: Question, kind: Any) -> Any:
        """The message of a query; None if it is not one, which was answered then."""
        try:
            return m.decode(query.payload, kind)
        except RemoteProtocolError as error:
            self.refused += 1
            self._refuse(query, error)
            return None

    def _queue(self, worker: str, query: Question, call: Callable[[], object]) -> None:
        if not self._workers[worker].put(lambda: self._answer([query], call)):
            self._refuse_busy(query)

    def _refuse_busy(self, query: Question) -> None:
        self.refused += 1
        self._refuse(query, DeviceError("the arm's server is busy; nothing was done"))

    def _answer(self, queries: Sequence[Question], call: Callable[[], object]) -> None:
        """Make a call, and pass its result to all callers that wait for it."""
        try:
            value = call()
        except HexwireError as error:
            for query in queries:
                self._refuse(query, error)
        except Exception as error:  # noqa: BLE001  # a mistake in this program: the client must get an answer
            _log.exception("an order or question failed")
            for query in queries:
                self._refuse(query, DeviceError(f"the arm's server failed at this: {error}"))
        else:
            for query in queries:
                self._reply(query, value)

    def _reply(self, query: Question, value: object) -> None:
        self.served += 1
        value, details = value if isinstance(value, _Detailed) else (value, {})
        self._send_answer(query, m.Answer("", "", details, value, self._shared.now(), self._done))

    def _refuse(self, query: Question, error: HexwireError) -> None:
        kind, text, details = describe(error)
        self._send_answer(query, m.Answer(kind, text, details, None, self._shared.now(), self._done))

    def _send_answer(self, query: Question, answer: m.Answer) -> None:
        query.reply(m.encode(answer))

    # -- in the threads of the workers --------------------------------------------------------------------

    def _take(self, request: m.Take, role: ClientRole) -> object:
        grant = self._shared.take(
            f"{_shown(request.client)}, {role.word}",
            role,
            key=request.key,
            force=request.force,
            watchdog=request.watchdog,
            watchdog_mode=_mode(request.mode),
        )
        return _Detailed(grant.key, {"lease": self._set_points.number(grant.key)})

    def _leave(self, request: m.Leave) -> None:
        self._shared.leave(request.key, finish=request.finish)

    def _do_order(self, role: ClientRole, payload: bytes, arrived: Token) -> object:
        try:
            envelope = m.decode(payload, m.Envelope)
        except RemoteProtocolError:
            self.refused += 1
            raise
        order, shared, what = Order(envelope.key, envelope.sequence, arrived), self._shared, envelope.order
        value: object = None
        if isinstance(what, m.Write):
            sent = self._write(envelope, what, arrived)
            value = [
                [name for name, _ in sent.positions],
                [angle for _, angle in sent.positions],
                sent.duration,
                sent.clamped,
                sent.silent,
            ]
        elif isinstance(what, m.Torque):
            value = shared.torque(order, what.on, what.names)
        elif isinstance(what, m.Resume):
            shared.resume(order)
        elif isinstance(what, m.Watchdog):
            shared.watchdog(order, what.timeout, _mode(what.mode))
        elif isinstance(what, m.Follow | m.Confirm | m.Cancel):
            value = do_goal_order(self._goals, order, what)
        elif role < ClientRole.MAINTAINER:
            raise LeaseError("servo settings and firmware need the role maintainer", lost=False)
        else:
            value = shared.ioctl(order, what.sub_cmd, what.data)
        self._count()
        return value

    def _write(self, envelope: m.Envelope, what: m.Write, arrived: Token) -> SentTarget:
        order = Order(envelope.key, envelope.sequence, arrived, envelope.made, envelope.doubt)
        if len(what.names) != len(what.position):
            raise UsageError("a target needs one position for each joint")
        positions = tuple(zip(what.names, what.position, strict=True))
        return self._shared.write(order, JointTarget(positions, what.duration, guided=what.guided))

    def _do_set_point(self, key: int, payload: bytes, arrived: Token) -> None:
        sequence = 0
        try:
            envelope = m.decode(payload, m.Envelope)
            sequence, what = envelope.sequence, envelope.order
            if not isinstance(what, m.Write):
                raise UsageError("an order that is no set-point needs an answer; nothing was done")
            sent = self._write(envelope, what, arrived)
        except Exception as error:  # noqa: BLE001  # a mistake in this program is logged; the client must hear of it
            if not isinstance(error, HexwireError):
                _log.exception("a set-point failed")
                error = DeviceError(f"the arm's server failed at this: {error}")
            self._set_points.refuse(key, sequence, error)
            self._count(0)
        else:
            self._set_points.done(key, sequence, sent)
            self._count()

    def _answer_questions(self, asked: list[tuple[Question, m.Ask]]) -> None:
        """Ask the arm once for all who have asked the same since the last answers began."""
        together: dict[tuple[str, int], list[Question]] = {}
        for query, ask in asked:
            together.setdefault((ask.what, ask.number), []).append(query)
        for (what, number), queries in together.items():
            self._answer(queries, partial(self._answer_question, m.Ask(what, number)))

    def _answer_question(self, ask: m.Ask) -> object:
        shared = self._shared
        if ask.what == "probe":
            now = shared.now()
            if self._probe is None or now - self._probe[0] > _PROBE_AGE:
                self._probe = (now, as_probe_rows(shared.probe()))
            return self._probe[1]
        if ask.what == "ping":
            return shared.ping(ask.number)
        if ask.what == "counters":
            return {**shared.board_counters(), **shared.refusals()}
        raise UsageError(f"there is no question {ask.what!r}")


def _shown(text: str) -> str:
    """A client's name for display: shortened, and without characters that move a terminal's cursor."""
    return "".join(letter if letter.isprintable() else "?" for letter in text[:_LONGEST_NAME])


def _mode(number: int) -> StopMode:
    """The stop mode of a message; to hold, if it is none."""
    return StopMode.TORQUE_OFF if number == StopMode.TORQUE_OFF else StopMode.HOLD
