"""One setting as a row of a table, and strict reading of its value, which collects every fault.

Owns types of values, bounds and the wording of faults. Must not know arms.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, ClassVar

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import MOST_FAULTS, Item, first_faults

__all__ = ["Default", "Faults", "Setting", "rate_setting"]

Default = str | float | bool | tuple[str, ...] | Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting.

    Attributes:
        name: As users write it.
        default: Its type is the type of the setting. Numbers are floats.
        help: What it does, in one line.
        unit: Unit of a number; empty if it has none.
        low: Lower bound of a number.
        high: Upper bound of a number.
        above: The lower bound itself is not allowed.
        zero: 0 is allowed too, below `low`.
    """

    name: str
    default: Default
    help: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    zero: bool = False

    @property
    def bounds(self) -> str:
        """The bounds in words; empty if there are none."""
        if self.high == math.inf:
            words = (
                "" if self.low == -math.inf else f"above {self.low:g}" if self.above else f"{self.low:g} or more"
            )
        elif self.above:
            words = f"above {self.low:g} and at most {self.high:g}"
        else:
            words = f"{self.low:g} to {self.high:g}"
        return f"0, or {words}" if self.zero else words

    @property
    def default_text(self) -> str:
        """The default as written in a file of parameters."""
        if isinstance(self.default, bool):
            return str(self.default).lower()
        if isinstance(self.default, str):
            return self.default or '""'
        if isinstance(self.default, float):
            return str(self.default)
        return "{}" if isinstance(self.default, Mapping) else "[]"

    @property
    def description(self) -> str:
        """What it does, with its bounds and unit."""
        limits = f"{self.bounds} {self.unit}".strip()
        return f"{self.help} ({limits})" if limits else self.help

    def take(self, item: Item) -> Any:
        """The value of the setting, of the type of its default.

        Raises:
            ConfigError: It is of another type, or out of bounds.
        """
        if isinstance(self.default, bool):
            return item.flag()
        if isinstance(self.default, float):
            return self._number(item)
        value = item.value
        if isinstance(self.default, str):
            if not isinstance(value, str):
                raise item.wrong_kind("text")
            return value
        if isinstance(self.default, Mapping):
            if not isinstance(value, Mapping):
                raise item.wrong_kind("a table of names and values")
            return {str(key): each for key, each in value.items()}
        if not isinstance(value, list | tuple) or not all(isinstance(each, str) for each in value):
            raise item.wrong_kind("a list of names")
        return tuple(value)

    def _number(self, item: Item) -> float:
        value = item.number()
        if not self.allows(value):
            raise item.fault(f"{value:g} must be {self.bounds}{f' {self.unit}' if self.unit else ''}")
        return value

    def allows(self, value: float) -> bool:
        """Whether a number is within the bounds."""
        if self.zero and value == 0.0:
            return True
        return (self.low < value if self.above else self.low <= value) and value <= self.high


def rate_setting(name: str, default: float, text: str, high: float = 1000.0) -> Setting:
    """A rate above 0, hertz."""
    return Setting(name, default, text, "Hz", low=0.0, high=high, above=True)


@dataclass(slots=True)
class Faults:
    """Collects faults, so that all of them can be reported together.

    A front that writes settings differently derives a class.

    Attributes:
        texts: For example ``watchdog: -1 must be 0, or 0.05 to 60``.
    """

    noun: ClassVar[str] = "setting"
    """What the front calls a setting."""
    mark: ClassVar[str] = ""
    """Prefix of the name of a setting."""
    quoting: ClassVar[str] = "in quotes"
    """How users write a number that is meant as text."""
    listing: ClassVar[str] = ""
    """Where users find all names; empty to list them."""
    separator: ClassVar[str] = "/"
    """What separates the parts of a nested name where users write it."""

    texts: list[str] = field(default_factory=list)

    def add(self, name: str, text: object) -> None:
        """Add a fault of the setting `name`; for a nested one, `name` is a path with slashes."""
        # Texts from elsewhere may have several lines.
        shown = name.replace("/", self.separator)
        self.texts.append(f"{self.mark}{shown}: {' '.join(str(text).split())}")

    def check(self, file: str = "") -> None:
        """Raise the first faults as one error.

        Args:
            file: Where they are.

        Raises:
            UsageError: There are faults.
        """
        if self.texts:
            n = len(self.texts)
            texts = "; ".join(first_faults(self.texts))
            place = f"{file}: " if file else ""
            raise UsageError(f"{place}{n} {self.noun}{'s are' if n > 1 else ' is'} wrong: {texts}")

    def read(self, row: Setting, value: object, name: str = "") -> Any:
        """The value of a setting; if it is wrong, that becomes a fault, and the default is returned.

        Args:
            row: The setting, or what values of its kind have in common.
            value: As it was given.
            name: Where it is nested, a path with slashes; the setting's name if empty.
        """
        name, is_number = name or row.name, isinstance(value, int | float) and not isinstance(value, bool)
        if isinstance(row.default, str) and is_number:
            self.add(name, f"{value} must be text: {self.quoting}")
            return row.default
        try:
            found = row.take(Item(value))
        except ConfigError as error:
            self.add(name, error)
            return {} if isinstance(row.default, Mapping) else row.default
        if isinstance(found, tuple):
            for each, times in Counter(found).items():
                if times > 1:
                    self.add(name, f"{each} is given twice")
            return tuple(dict.fromkeys(found))
        return found

    def only(self, table: Mapping[str, object], known: Collection[str], above: str = "") -> dict[str, object]:
        """The values of a table under known names; each other name becomes a fault.

        Args:
            table: Values by name.
            known: Valid names.
            above: What is before the names, a path that ends in a slash.
        """
        for name in table:
            if name not in known:
                self.unknown(f"{above}{name}", known)
        return {name: value for name, value in table.items() if name in known}

    def unknown(self, name: str, known: Collection[str]) -> None:
        """Add a fault for a name that is not one of the `known` names at the same depth.

        Args:
            name: A path with slashes, for example ``safety/patience``.
            known: Valid names.
        """
        above, slash, last = name.rpartition("/")
        # The search takes 0.1 ms, and a file of 1 MiB has room for 100,000 names.
        near = get_close_matches(last, known, n=1) if len(self.texts) < MOST_FAULTS else ()
        if near:
            right = f"{above}{slash}{near[0]}".replace("/", self.separator)
            self.add(name, f"unknown, did you mean {self.mark}{right}?")
        elif slash or not self.listing:
            self.add(name, f"unknown, there are {', '.join(known)}")
        else:
            self.add(name, f"unknown, {self.listing}")
