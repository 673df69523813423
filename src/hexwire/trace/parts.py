"""A tree of layers and fields over the bytes of a frame.

Owns the tree and what must hold of it: parts lie in their parent, in order, and the leaves cover every byte once.
Must not know any protocol.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

__all__ = ["Part", "filled"]


@dataclass(frozen=True, slots=True)
class Part:
    """A layer, a group of fields, or a field.

    Attributes:
        name: Its name, as in PROTOCOL.md.
        start: Offset of its first byte in the frame.
        end: Offset after its last byte.
        words: Its value in words.
        meaning: What it is, in words; empty if unknown.
        value: Its number, or None.
        problem: What is wrong or doubtful about it; empty if nothing is.
        parts: What it consists of, without gaps; empty for a field.
    """

    name: str
    start: int
    end: int
    words: str = ""
    meaning: str = ""
    value: int | float | None = None
    problem: str = ""
    parts: tuple[Part, ...] = ()

    def leaves(self) -> Iterator[Part]:
        """The fields, in the order of their bytes."""
        waiting = [self]
        while waiting:
            part = waiting.pop()
            if part.parts:
                waiting.extend(reversed(part.parts))
            else:
                yield part

    def path(self, offset: int) -> tuple[Part, ...]:
        """The parts that contain a byte, from the whole frame to the field; empty if none does."""
        found: list[Part] = []
        inside: tuple[Part, ...] = (self,)
        while inside:
            part = next((each for each in inside if each.start <= offset < each.end), None)
            if part is None:
                break
            found.append(part)
            inside = part.parts
        return tuple(found)

    def rows(self, depth: int = 0) -> Iterator[tuple[int, Part]]:
        """All parts with their depth, a parent before what it consists of."""
        yield depth, self
        for part in self.parts:
            yield from part.rows(depth + 1)

    def as_fields(self) -> dict[str, Any]:
        """All attributes as plain values for JSON; empty ones are left out."""
        fields: dict[str, Any] = {"name": self.name, "start": self.start, "end": self.end}
        for key in ("words", "meaning", "problem"):
            if getattr(self, key):
                fields[key] = getattr(self, key)
        if self.value is not None:
            fields["value"] = self.value
        if self.parts:
            fields["parts"] = [part.as_fields() for part in self.parts]
        return fields


def filled(parts: Iterable[Part], start: int, end: int, name: str = "rest", meaning: str = "") -> tuple[Part, ...]:
    """The parts in a range, with a part of this name for each gap.

    Parts without bytes, and what overlaps an earlier part or is outside of the range, are left out.
    """
    found: list[Part] = []
    at = start
    for part in parts:
        if not at <= part.start < part.end <= end:
            continue
        if at < part.start:
            found.append(Part(name, at, part.start, meaning=meaning))
        found.append(part)
        at = part.end
    if at < end:
        found.append(Part(name, at, end, meaning=meaning))
    return tuple(found)
