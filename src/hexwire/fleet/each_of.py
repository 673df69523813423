"""A call for several arms at the same time.

Owns the threads, and who did not answer in time. Must not know what is called.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from hexwire.errors import DeviceError, HexwireError

__all__ = ["SilentError", "each_of"]

_T = TypeVar("_T")
_A = TypeVar("_A")


class SilentError(HexwireError):
    """There was no result in time."""


def each_of(
    arms: Mapping[str, _A], call: Callable[[_A], _T], patience: float, *, together: bool = False
) -> tuple[dict[str, _T], dict[str, HexwireError]]:
    """Call for all arms at the same time, so that none delays another.

    Args:
        arms: The arms by name.
        call: What to do.
        patience: Seconds to wait; an interruption ends the wait at once.
        together: The first failure ends the wait.

    Returns:
        Results and errors by name.
    """
    done: dict[str, _T] = {}
    failed: dict[str, HexwireError] = {}
    changed = threading.Condition()

    def run(name: str, arm: _A) -> None:
        result: Any = None
        error: HexwireError | None = None
        try:
            result = call(arm)
        except HexwireError as problem:
            error = problem
        except Exception as problem:  # noqa: BLE001  # the other arms must learn of it
            error = DeviceError(f"the program failed: {problem}")
        with changed:
            if error is not None:
                failed[name] = error
            else:
                done[name] = result
            changed.notify_all()

    for name, arm in arms.items():
        threading.Thread(target=run, args=(name, arm), name=f"play {name}", daemon=True).start()
    deadline = time.monotonic() + patience
    with changed:
        while len(done) + len(failed) < len(arms) and not (together and failed):
            left = deadline - time.monotonic()
            if left <= 0:
                break
            changed.wait(min(left, 0.5))
        errors = dict(failed)
        if not together or not errors:
            for name in arms:
                if name not in done and name not in errors:
                    errors[name] = SilentError(f"no answer in {patience:.1f} s")
        return dict(done), errors
