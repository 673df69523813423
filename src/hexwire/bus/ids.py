"""Lists of servo ids as people write them.

Owns the notation.
"""

from __future__ import annotations

import re

from hexwire.errors import UsageError

__all__ = ["parse_ids"]

_NUMBER = "[0-9]{1,9}"
_LONGEST = 1000
"""Characters: more than all ids one by one."""
_SHOWN = 40
"""Number of typed characters that an error text repeats."""


def parse_ids(text: str) -> list[int]:
    """Parse servo ids such as ``1-7``, ``1,2,5`` or a mixture.

    Returns:
        The ids in the order in which they are written; one that is written twice is there twice.

    Raises:
        UsageError: The text is malformed.
    """
    if len(text) > _LONGEST:
        raise UsageError(f"a list of servo ids has at most {_LONGEST} characters")
    ids: list[int] = []
    for part in text.split(","):
        found = re.fullmatch(rf"({_NUMBER})(?:-({_NUMBER}))?", part.strip())
        if found is None:
            raise UsageError(f"{text[:_SHOWN]!r} is not a list of servo ids: write 1-7 or 1,2,5")
        low, high = int(found[1]), int(found[2] or found[1])
        if low > high:
            raise UsageError(f"{part.strip()!r} is not a list of servo ids: write the lower id first")
        if high > 253:
            raise UsageError(f"{part.strip()!r} is not a list of servo ids: they are from 0 to 253")
        ids.extend(range(low, high + 1))
    return ids
