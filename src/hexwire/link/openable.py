"""Base of what is opened and closed: ``with thing:`` opens it, and closes it at the end.

Owns that rule. Must not know what is opened.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self

__all__ = ["Openable"]


class Openable(ABC):
    """Has `open` and `close`, and is open inside ``with``."""

    @abstractmethod
    def open(self) -> None:
        """Open it."""

    @abstractmethod
    def close(self) -> None:
        """Close it; what is closed stays closed."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
