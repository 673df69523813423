"""What many arms say of themselves at once, and the stop of many arms.

Owns asking many arms at the same time, so that one that hangs delays no other. Must not know terminals.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from hexwire.control.loop.power import Stopped, Torques
from hexwire.drivers.values import StopMode
from hexwire.errors import HexwireError, RemoteProtocolError
from hexwire.model.state import JointFlag

from . import messages as m
from .address import role_of
from .failures import restore
from .names import ClientRole, Keys
from .node import NoAnswerError, OpenQuestion
from .questions import KEEPS_TORQUE
from .roster import HUNG, SLOW, Roster, Seen
from .rows import joint_state

__all__ = ["Overview", "Stopped", "look", "stop_all"]

_WAIT = 0.002
"""Seconds between two checks for answers."""
_LATE = 0.05
"""Time-out for the end of a question that has timed out, seconds."""
_NO_RIGHT = "no answer: its program is halted or has just ended, or this program may not stop it"
_DENIED = (
    "this program may not switch its torque off; if its certificate allows it, write the router's access file "
    "again with 'hexwire fleet config'"
)
_STARTING = "no answer: its server is starting or ending, or this program may not ask it"

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Overview:
    """One arm at one time.

    Attributes:
        name: Its name.
        robot: Its model; empty if unknown.
        host: The computer of its server.
        holder: Who holds its lease; empty if nobody does.
        torque: ``on``, ``off``, names of the joints that have torque, or empty if unknown.
        stopped: It is stopped.
        why: Why it is stopped, why it holds, or what is wrong; empty if nothing is.
        age: Age of its newest state, seconds; None if there is none.
        silent: It does not answer.
        local: It is served by this user on this machine.
        faults: What its servos report, as in ``J3: overload``; empty if nothing.
    """

    name: str
    robot: str = ""
    host: str = ""
    holder: str = ""
    torque: str = ""
    stopped: bool = False
    why: str = ""
    age: float | None = None
    silent: bool = False
    local: bool = False
    faults: str = ""

    @property
    def condition(self) -> str:
        """Its condition in words: ``ok``, ``no answer`` or ``stopped`` and why, or what is wrong."""
        if self.silent:
            return f"no answer: {self.why}"
        if self.stopped:
            return f"stopped: {self.why}" if self.why else "stopped"
        return self.why or "ok"


def look(roster: Roster, timeout: float) -> list[Overview]:
    """Ask every arm for its condition.

    Args:
        roster: Which arms; those that it knows at present.
        timeout: Seconds for the answers.
    """
    seen = roster.seen()
    answers: dict[str, list[m.Answer]] = {}
    absent = set()
    for name, answer in _ask_all(seen, lambda keys: keys.ask, (m.Ask("facts"), m.Ask("state")), timeout):
        if answer is None:
            absent.add(name)
        elif not answer.kind:
            answers.setdefault(name, []).append(answer)
    rows = {
        name: _overview(one, answers.get(name, []), _STARTING if name in absent else HUNG)
        for name, one in seen.items()
    }
    for name, why in roster.silent().items():
        rows.setdefault(name, Overview(name, why=why, silent=True))
    return [rows[name] for name in sorted(rows)]


def _overview(seen: Seen, answers: list[m.Answer], why: str) -> Overview:
    facts: m.Facts | None = None
    state: tuple[m.State, float] | None = None
    for answer in answers:
        if (found := _as(answer.value, m.Facts)) is not None:
            facts = found
        elif (newest := _as(answer.value, m.State)) is not None:
            state = newest, answer.clock
    robot, host = (facts.robot, facts.host) if facts is not None else ("", "")
    if state is None:
        return Overview(seen.name, robot, host, why=why, silent=True, local=seen.local)
    row, now = state
    return Overview(
        seen.name,
        robot,
        host,
        row.holder,
        _torque(row, now),
        row.stopped,
        row.error or row.held or row.reason,
        max(0.0, now - row.stamp) if row.names else None,
        False,
        seen.local,
        _faults(row),
    )


def _faults(state: m.State) -> str:
    if len(state.flags) != len(state.names) or state.error:
        return ""
    found = ((name, JointFlag(flags).faults) for name, flags in zip(state.names, state.flags, strict=True))
    return "; ".join(f"{name}: {faults}" for name, faults in found if faults)


def _as_torques(details: dict[str, Any]) -> Torques | None:
    """As its server says; a server of before this says nothing."""
    found = _as(details, Torques)
    return found if found is not None and any((found.holding, found.limp, found.unknown)) else None


def _as(value: object, kind: type[_T]) -> _T | None:
    try:
        return m.convert(value, kind)
    except RemoteProtocolError:
        return None


def _torque(state: m.State, now: float) -> str:
    if not state.names or state.error:
        return ""
    try:
        return Torques.of(state.names, joint_state(state, state.stamp), now).short
    except HexwireError:
        return ""


def stop_all(
    roster: Roster,
    client: str,
    mode: StopMode = StopMode.HOLD,
    *,
    timeout: float = 3.0,
    only: Collection[str] | None = None,
) -> Iterator[Stopped]:
    """Stop every arm as soon as it is found; yields each result as soon as it is known.

    Args:
        roster: Which arms.
        client: Who stops them, for display.
        mode: How they stop. Torque off is for operators and maintainers; an arm where it is denied is stopped all
            the same, and holds.
        timeout: Seconds for the confirmation of an arm.
        only: Names of the arms, of those in the roster; None for all.
    """
    stops: dict[str, _ArmStop | None] = {}
    request = m.StopRequest(client, int(mode))
    # Of each certificate, read once: many arms are behind one router.
    roles: dict[str, ClientRole] = {}
    began = time.monotonic()
    while True:
        settled = roster.settled or time.monotonic() - began > SLOW
        for name, seen in roster.seen().items():
            if name not in stops and (only is None or name in only):
                try:
                    stops[name] = _ArmStop(seen, request, roles, timeout)
                except HexwireError as error:
                    stops[name] = None
                    yield Stopped(name, False, error=str(error))
        for name, stop in list(stops.items()):
            if stop is not None and (done := stop.poll()) is not None:
                stops[name] = None
                yield done
        known = settled or (only is not None and stops.keys() >= set(only))
        if known and not any(stops.values()):
            break
        time.sleep(_WAIT)
    for name, why in roster.silent().items():
        if name not in stops and (only is None or name in only):
            yield Stopped(name, False, error=why)


class _ArmStop:
    """The stop of one arm while it waits for an answer."""

    def __init__(self, seen: Seen, request: m.StopRequest, roles: dict[str, ClientRole], timeout: float) -> None:
        self._seen, self._payload, self._timeout = seen, m.encode(request), timeout
        self._began = time.monotonic()
        self._kept = ""
        keys = Keys(seen.name)
        self._plain = key = keys.stop
        if request.mode == StopMode.TORQUE_OFF:
            role = _role(seen.node.cert, roles)
            self._kept = KEEPS_TORQUE if role is ClientRole.OBSERVER else ""
            key = keys.stop if self._kept else keys.off(role)
        self._ask(key)

    def _ask(self, key: str) -> None:
        self._key = key
        self._question = self._seen.node.question(key, self._payload, self._timeout, urgent=True)

    def poll(self) -> Stopped | None:
        """The result; None while it is not known."""
        name, seconds = self._seen.name, time.monotonic() - self._began
        try:
            payload = self._question.poll()
            if payload is None:
                return None
            answer = m.decode(payload, m.Answer)
            if answer.kind:
                raise restore(answer.kind, answer.text, answer.details)
        except NoAnswerError as none:
            if none.absent and self._key != self._plain:
                return self._hold()
            return Stopped(name, False, error=_NO_RIGHT if none.absent else HUNG, seconds=seconds)
        except HexwireError as error:
            return Stopped(name, False, error=str(error), seconds=seconds)
        joints = tuple(map(str, answer.value)) if isinstance(answer.value, list | tuple) else ()
        missing = answer.details.get("missing")
        silent = ", ".join(map(str, missing)) if isinstance(missing, list) else ""
        why = f"not confirmed by {silent}" if silent else "" if joints else "no joint confirmed it"
        torques = _as_torques(answer.details) or Torques(unknown=joints)
        return Stopped(name, not why, joints, why, seconds, self._kept, torques)

    def _hold(self) -> Stopped | None:
        """Torque off was denied: stop it nevertheless."""
        self._kept = _DENIED
        try:
            self._ask(self._plain)
        except HexwireError as error:
            return Stopped(self._seen.name, False, error=str(error))
        return None


def _role(cert: str, roles: dict[str, ClientRole]) -> ClientRole:
    """Role in a certificate; the lowest role if the certificate can no longer be read."""
    if cert not in roles:
        try:
            roles[cert] = role_of(cert)
        except HexwireError:
            roles[cert] = ClientRole.OBSERVER
    return roles[cert]


def _ask_all(
    seen: Mapping[str, Seen], key: Callable[[Keys], str], messages: tuple[Any, ...], timeout: float
) -> Iterator[tuple[str, m.Answer | None]]:
    """Ask all arms at once; yields the answers as they arrive, None for a question that no program answers."""
    waiting: list[tuple[str, OpenQuestion]] = []
    for message in messages:
        payload = m.encode(message)
        for name, one in seen.items():
            try:
                waiting.append((name, one.node.question(key(Keys(name)), payload, timeout)))
            except HexwireError:
                # Its connection has just ended.
                continue
    deadline = time.monotonic() + timeout + _LATE
    while waiting and time.monotonic() < deadline:
        left = []
        for name, question in waiting:
            try:
                payload_or_none = question.poll()
                if payload_or_none is None:
                    left.append((name, question))
                else:
                    yield name, m.decode(payload_or_none, m.Answer)
            except NoAnswerError as none:
                if none.absent:
                    yield name, None
            except HexwireError:
                continue
        waiting = left
        if waiting:
            time.sleep(_WAIT)
