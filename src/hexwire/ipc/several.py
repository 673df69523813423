"""Requests of a session to several modules of its channel.

Owns the modules that the session knows, and what a stop or a resume of several means for the calls of this program.
Must not know how a request is sent: `Session` does.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from typing import Any

from hexwire.arguments import WHOLE, Wanted, check
from hexwire.epochs import Token
from hexwire.session.effects import Effect, effect_of
from hexwire.session.events import Answers, Reply
from hexwire.session.several import To
from hexwire.wire.addresses import Broadcast, Multicast, Unicast
from hexwire.wire.command_frame import Command, Status, command_name

from .session_line import SessionLine

__all__ = ["SeveralModules"]

_MODULES = Wanted(
    "modules, as in (8, 9)", lambda value: isinstance(value, Collection) and all(map(WHOLE.fits, value))
)
_OBEYED = frozenset((Status.OK, Status.SERVO_SILENT, Status.SERVO_FAULT))


class SeveralModules(SessionLine):
    """The part of `Session` that asks several modules at once; see there.

    Attributes:
        modules: The modules that have answered an IDENTIFY to several, or that a gateway has named in their place.
    """

    modules: frozenset[int] = frozenset()

    @abstractmethod
    def _request(
        self,
        cmd: int,
        body: bytes,
        window: float | None,
        attempts: int | None,
        effect: Effect,
        urgent: bool,
        repeatable: bool,
        guard: Callable[[], None] | None,
        token: Token | None,
        to: To | None = None,
    ) -> Reply | Answers:
        """Send a request and wait for what ends it."""

    def request_all(
        self,
        cmd: int,
        body: bytes = b"",
        to: Unicast | Multicast | Broadcast | Iterable[int] = Broadcast(),  # noqa: B008  # it is frozen
        *,
        window: float | None = None,
        attempts: int | None = None,
        repeatable: bool = False,
    ) -> Answers:
        """Send one request to several modules and collect their answers; the caller must check each status.

        The call returns when everybody has answered who is named by `to`, or for a broadcast everybody in
        `modules`; otherwise when the time is up. A broadcast of IDENTIFY always takes its time, and finds
        the `modules`; a gateway names those that it cannot reach, which count as silent. Repeats go only to those
        who have not answered. Stops, and what acts, are treated as by `request`.

        Args:
            cmd: Command code; PROTOCOL.md says which may go to several modules.
            body: Its body; it must fit one frame.
            to: The modules.
            window: Seconds to wait for the answers to each attempt; the policy's if None.
            attempts: Maximum number of transmissions; the policy's if None.
            repeatable: Send it again after a reconnection. Never for a request that moves an arm.

        Returns:
            The reply of each module, and the modules that were named or known and have not answered.

        Raises:
            LinkLostError: As `request`.
            StoppedError: As `request`.
            PreemptedError: As `request`.
            LocalProtocolError: It cannot be sent to several modules in this dialect or over this link.
        """
        self._check_request("request_all", cmd, body, window, attempts)
        if isinstance(to, Unicast):
            to = Multicast((to.module,))
        elif not isinstance(to, Multicast | Broadcast):
            check("request_all", "to", _MODULES, to)
            to = Multicast(to)
        finding = cmd == Command.IDENTIFY and isinstance(to, Broadcast)
        asked = To(to, () if finding else self.modules)
        effect = effect_of(self.connection.dialect, cmd, body)
        if effect is Effect.STOP:
            with self.epochs.stopping():
                answers = self._collect(cmd, body, window, attempts, effect, True, repeatable, None, None, asked)
                if answers.silent or not all(r.status in _OBEYED for r in answers.replies.values()):
                    self.epochs.unconfirmed()
                return answers
        token = self.epochs.of_this_call
        if effect is not Effect.NONE and token is None:
            token = self.epochs.token(command_name(cmd), freeing=effect is not Effect.ACT)
        answers = self._collect(cmd, body, window, attempts, effect, False, repeatable, None, token, asked)
        if cmd == Command.IDENTIFY:
            self.modules |= {module for module, r in answers.replies.items() if r.status == Status.OK}
            if finding:
                self.modules |= answers.silent
                answers = replace(answers, silent=self.modules - answers.replies.keys())
        done = bool(answers.replies) and all(r.status == Status.OK for r in answers.replies.values())
        if effect is Effect.RESUME and token is not None and done and not answers.silent:
            self.epochs.resumed(token)
        return answers

    def _collect(self, *asked: Any) -> Answers:
        answers = self._request(*asked)
        assert isinstance(answers, Answers)
        return answers
