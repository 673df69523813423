"""Somebody without a browser who holds a motion of the studio's arm."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from typing import TYPE_CHECKING, Any

from tests.studio.running import PATIENCE, Visitor

if TYPE_CHECKING:
    from tests.studio.running import RunningStudio

__all__ = ["JOG", "Holder", "set_silence"]

_MOVED = 0.02
"""Radians from which on a joint has moved."""

JOG = {"directions": {"J1": 1}, "speed": 0.15}


def set_silence(studio: RunningStudio, seconds: float) -> None:
    """After how many seconds without a beat a motion ends from now on."""
    source = studio.studio.source.arm
    assert source is not None
    source.hold_to_run.silence = seconds


class Holder:
    """Somebody without a browser who holds a jog, and beats."""

    def __init__(self, studio: RunningStudio) -> None:
        self.studio, self.visitor = studio, Visitor(studio, studio.studio.access.operate_token)
        key = self.visitor.page()
        tab = studio.studio.tabs.find(key, self.visitor.cookie.partition("=")[2])
        assert tab is not None
        self.tab = tab
        studio.studio.take(tab, force=True)
        self._stack = contextlib.ExitStack()
        # Hardly anything of it is read: what arrives must not keep the farewell away.
        opened = self.visitor.socket(f"/live?tab={key}", max_queue=None)
        self.line: Any = self._stack.enter_context(opened)
        self._quiet = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)
        self.number = 0

    def hold(self) -> None:
        """Hold a jog until it moves; again if it is refused, or ends, as when the machine was busy for a moment."""
        refusals: list[str] = []
        deadline = time.monotonic() + PATIENCE
        while (why := self._begins() or self._moves(deadline)) is not None:
            refusals.append(why)
            assert time.monotonic() < deadline, f"no jog moves: {refusals}"
            time.sleep(0.1)

    def _moves(self, deadline: float) -> str | None:
        """Wait until the first joint has moved; None, or why it has not."""
        source = self.studio.studio.source.arm
        assert source is not None
        owner = source.arm.owner
        first = owner.state.positions["J1"]
        while abs(owner.state.positions["J1"] - first) < _MOVED:
            if not source.jog.busy or time.monotonic() > deadline:
                return f"the jog {'lasts' if source.jog.busy else 'ended'}, {source.jog.note!r}, {owner.state}"
            time.sleep(0.01)
        return None

    def _begins(self) -> str | None:
        """Ask for a jog; None once it has begun, otherwise why it was refused."""
        source = self.studio.studio.source.arm
        assert source is not None
        self.number += 1
        # Away from the nearer end: on a busy machine some of these motions lead to it.
        way = -1 if source.arm.owner.state.positions["J1"] > 0 else 1
        args = JOG | {"directions": {"J1": way}}
        order = {"do": "hold", "id": self.number, "kind": "joint", "args": args, "stops": source.stops}
        self.line.send(json.dumps(order))
        if self._thread.ident is None:
            self._thread.start()
        while True:
            message = self.line.recv(timeout=PATIENCE)
            if isinstance(message, bytes):
                continue
            found = json.loads(message)
            if found.get("id") == self.number and found["kind"] in ("held", "ended"):
                return None if found["kind"] == "held" else str(found["why"])

    def _beat(self) -> None:
        while not self._quiet.wait(0.05):
            with contextlib.suppress(OSError, Exception):
                self.line.send(json.dumps({"do": "beat", "id": self.number}))

    def fall_silent(self) -> None:
        self._quiet.set()
        set_silence(self.studio, 0.5)

    def abort(self) -> None:
        """The network is gone: no farewell."""
        self.line.socket.shutdown(socket.SHUT_RDWR)

    def end(self) -> None:
        self._quiet.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._stack.close()
