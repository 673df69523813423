"""Another user of the machine, as far as a test can have one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

STRANGER = 54321
BelongsTo = Callable[[Path, int], None]
