"""The kinds of motion that a page may hold: each is begun for a tab, and ends with its entry.

Owns the table of kinds. Must not know sockets or pages, nor what makes a motion safe.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from hexwire.errors import UsageError

if TYPE_CHECKING:
    from hexwire.control.motion.hold_to_run import HeldMotion
    from hexwire.epochs import Token

    from .source import Source
    from .tabs import Tab

__all__ = ["Begin", "Change", "Holds"]

Begin = Callable[["Tab", "HeldMotion", Mapping[str, object], "Token"], object]
"""Begins a motion for a tab, then calls `HoldToRun.begun` with how it ends. Runs in a thread and may wait. Raises
`HexwireError` if it is refused. The token says when it was asked for: a stop since then voids it."""

Change = Callable[["Tab", Mapping[str, object]], object]
"""Changes what a tab holds; must not wait. Raises `HexwireError` if it is refused."""

_JOGS = ("joint", "space", "drag")


class Holds:
    """The kinds, by name.

    Args:
        source: What is open.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._kinds: dict[str, Begin] = {}
        self._changes: dict[str, Change] = {}
        self._present: dict[str, str] = {}

    def add(self, kind: str, begin: Begin, change: Change | None = None) -> None:
        """Add a kind of motion, such as ``goto``; one that can be changed while it is held names what does that."""
        self._kinds[kind] = begin
        if change is not None:
            self._changes[kind] = change

    def begin(self, tab: Tab, entry: HeldMotion, kind: str, args: Mapping[str, object], arrived: Token) -> None:
        """Begin a motion; raises `HexwireError` if it is refused."""
        self._source.need_control(tab)
        if kind in _JOGS:
            self._source.need_arm().begin_jog(tab, entry, kind, args, arrived)
            # Only now: a change that overtakes the beginning must not meet the jog before.
            self._present[tab.key] = kind
            return
        found = self._kinds.get(kind)
        if found is None:
            raise UsageError(f"there is no motion {kind[:20]!r} to hold")
        found(tab, entry, args, arrived)
        self._present[tab.key] = kind

    def update(self, tab: Tab, args: Mapping[str, object]) -> None:
        """Change what a tab holds, if that can be changed. Raises `HexwireError` if it is refused."""
        kind = self._present.get(tab.key, "")
        if kind in _JOGS:
            self._source.need_arm().update_jog(kind, args)
        elif kind in self._changes:
            self._changes[kind](tab, args)

    def forget(self, tab: Tab) -> None:
        """A tab is gone, or is about to hold something else."""
        self._present.pop(tab.key, None)
