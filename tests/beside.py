"""Work in a thread beside a block of a test, and its end with the block."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tests.waits import PATIENCE


@contextmanager
def beside(work: Callable[[threading.Event], object]) -> Iterator[None]:
    """Run something in a thread while the block runs.

    Args:
        work: Gets an event that is set when the block has ended.
    """
    ended = threading.Event()
    thread = threading.Thread(target=work, args=(ended,))
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(PATIENCE)
