"""The one owner of a moving robot. Knows no front: no middleware, no terminal, no page.

Owns the public names for programs that run motions; they load on first use, since most commands move nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .loop.owner import RobotOwner
    from .motion.motions import MotionObserver, MotionOptions, MotionResult, check_path, run_motion

__all__ = ["MotionObserver", "MotionOptions", "MotionResult", "RobotOwner", "check_path", "run_motion"]


if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Import a public name on its first use (PEP 562)."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        return getattr(import_module(".loop.owner" if name == "RobotOwner" else ".motion.motions", __name__), name)
