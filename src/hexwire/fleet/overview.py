"""What many arms say of themselves at once, and the stop of many arms.

Owns asking many arms at the same time, so that one that hangs delays no other. Must not know terminals.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from hexwire.drivers.values import StopMode
from hexwire.errors import HexwireError
from hexwire.model.state import JointFlag

from . import messages as m
from .failures import restore
from .names import Keys
from .node import NoAnswerError, Pending
from .roster import HUNG, Roster, Seen

__all__ = ["Overview", "Stopped", "look", "stop_all"]

_WAIT = 0.002
"""Seconds between two looks for answers."""
_OPEN = 3.5
"""Seconds in which a way must be tried: connecting takes up to 3 s if somebody hangs."""
_NO_RIGHT = "this program may not stop it, or it has just vanished"
_STARTING = "it does not answer yet: it starts, or this program may not ask it"


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


@dataclass(frozen=True, slots=True)
class Stopped:
    """What became of the stop of one arm.

    Attributes:
        name: Its name, or the way on which it was not found.
        confirmed: Its server says that all that can confirm has confirmed.
        joints: Joints that confirmed.
        error: Why it is not confirmed; empty if it is.
        seconds: How long the answer took.
    """

    name: str
    confirmed: bool
    joints: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0


def look(roster: Roster, timeout: float) -> list[Overview]:
    """Ask every arm that is there how it is.

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
        if (found := _as(answer, m.Facts)) is not None:
            facts = found
        elif (newest := _as(answer, m.State)) is not None:
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
        _torque(row),
        row.stopped,
        row.error or row.held or row.reason,
        max(0.0, now - row.stamp) if row.names else None,
        False,
        seen.local,
    )


def _as(answer: m.Answer, kind: Any) -> Any:
    try:
        return msgspec.convert(answer.value, kind)
    except (msgspec.MsgspecError, ValueError):
        return None


def _torque(state: m.State) -> str:
    if len(state.flags) != len(state.names) or not state.names or state.error:
        return ""
    rows = list(zip(state.names, state.flags, strict=True))
    if any(flags & JointFlag.TORQUE_UNKNOWN for _, flags in rows):
        return ""
    on = [name for name, flags in rows if flags & JointFlag.TORQUE_ON]
    return "off" if not on else "on" if len(on) == len(rows) else " ".join(on)


def stop_all(
    roster: Roster, client: str, mode: StopMode = StopMode.HOLD, *, timeout: float = 3.0
) -> Iterator[Stopped]:
    """Stop every arm as soon as it is found; yields what became of each as soon as that is known.

    Args:
        roster: Which arms.
        client: Who stops them, for display.
        mode: How they stop.
        timeout: Seconds for the confirmation of an arm.
    """
    message = m.encode(m.StopRequest(client, int(mode)))
    asked: dict[str, tuple[float, Pending | None]] = {}
    began = time.monotonic()
    while True:
        settled = roster.settled or time.monotonic() - began > _OPEN
        for name, seen in roster.seen().items():
            if name not in asked:
                try:
                    question = seen.node.question(Keys(name).stop, message, timeout, urgent=True)
                except HexwireError as error:
                    asked[name] = time.monotonic(), None
                    yield Stopped(name, False, error=str(error))
                else:
                    asked[name] = time.monotonic(), question
        for name, (since, waiting) in list(asked.items()):
            if waiting is None:
                continue
            done = _stopped(name, waiting, time.monotonic() - since)
            if done is not None:
                asked[name] = since, None
                yield done
        if settled and all(waiting is None for _, waiting in asked.values()):
            break
        time.sleep(_WAIT)
    for name, why in roster.silent().items():
        if name not in asked:
            yield Stopped(name, False, error=why)


def _stopped(name: str, question: Pending, seconds: float) -> Stopped | None:
    try:
        payload = question.poll()
        if payload is None:
            return None
        answer = m.decode(payload, m.Answer)
        if answer.kind:
            raise restore(answer.kind, answer.text, answer.details)
        joints = tuple(map(str, answer.value)) if isinstance(answer.value, list | tuple) else ()
        missing = answer.details.get("missing")
        silent = ", ".join(map(str, missing)) if isinstance(missing, list) else ""
        error = f"not confirmed by {silent}" if silent else "" if joints else "no joint confirmed it"
        return Stopped(name, not error, joints, error, seconds)
    except NoAnswerError as none:
        return Stopped(name, False, error=_NO_RIGHT if none.absent else HUNG, seconds=seconds)
    except HexwireError as error:
        return Stopped(name, False, error=str(error), seconds=seconds)


def _ask_all(
    seen: Mapping[str, Seen], key: Callable[[Keys], str], messages: tuple[Any, ...], timeout: float
) -> Iterator[tuple[str, m.Answer | None]]:
    """Ask the arms all questions at once; yields answers as they come, None if nobody answers such questions."""
    waiting: list[tuple[str, Pending]] = []
    for message in messages:
        payload = m.encode(message)
        for name, one in seen.items():
            try:
                waiting.append((name, one.node.question(key(Keys(name)), payload, timeout)))
            except HexwireError:
                # Its connection has just ended.
                continue
    deadline = time.monotonic() + timeout + 0.5
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
