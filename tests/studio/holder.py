"""Somebody without a browser who holds a motion of the studio's arm."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from typing import TYPE_CHECKING, Any

from tests.studio.running import Visitor

if TYPE_CHECKING:
    from tests.studio.running import RunningStudio

__all__ = ["JOG", "Holder", "set_silence"]

JOG = {"directions": {"J1": 1}, "speed": 0.15}


def set_silence(studio: RunningStudio, seconds: float) -> None:
    """After how many seconds without a beat a motion ends from now on."""
    source = studio.studio.source.arm
    assert source is not None
    source.attended.silence = seconds


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
        # It reads nothing: what arrives must not keep the farewell away.
        opened = self.visitor.socket(f"/live?tab={key}", max_queue=None)
        self.line: Any = self._stack.enter_context(opened)
        self._quiet = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)
        self.number = 0

    def hold(self) -> None:
        source = self.studio.studio.source.arm
        assert source is not None
        self.number += 1
        # Away from the nearer end: on a busy machine some of these motions lead to it.
        way = -1 if source.arm.owner.state.positions["J1"] > 0 else 1
        args = JOG | {"directions": {"J1": way}}
        order = {"do": "hold", "id": self.number, "kind": "joint", "args": args, "stops": source.stops}
        self.line.send(json.dumps(order))
        self._thread.start()

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
