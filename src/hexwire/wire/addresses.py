"""The destination of a frame: one module, several, or all modules of a channel.

Owns the form of `dst` in PROTOCOL.md section 6.9. Knows neither which modules there are nor who answers.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from hexwire.errors import UsageError

from .modules import MAX_MODULE, known_modules, module_name, module_named
from .tables import ADDRESS_BROADCAST, ADDRESS_MULTICAST, ADDRESS_MULTICAST_MODULES

__all__ = ["Address", "Broadcast", "Multicast", "Unicast", "address_of", "destination_name", "module_id"]

_ALL, _SEVERAL, _MOST = ADDRESS_BROADCAST, ADDRESS_MULTICAST, ADDRESS_MULTICAST_MODULES


def module_id(module: int | str) -> int:
    """The id of a module, given as its id or by a name of the chapter or a registered one.

    Raises:
        UsageError: There is no such module.
    """
    if isinstance(module, str):
        named = module_named(module.upper())
        if named is not None:
            return int(named)
        if not module.isascii() or not module.isdecimal() or len(module) > len(str(MAX_MODULE)):
            known = ", ".join(each.name for each in known_modules())
            raise UsageError(f"no module {module!r}; known: {known}, or a number")
        module = int(module)
    if not 0 <= module <= MAX_MODULE:
        raise UsageError(f"a module is a number from 0 to {MAX_MODULE}, not {module}")
    return int(module)


@dataclass(frozen=True, slots=True)
class Unicast:
    """One module.

    Args:
        module: Its id.
    """

    module: int

    @property
    def dst(self) -> int:
        """The field `dst`."""
        return self.module

    def names(self, module: int) -> bool:
        """Whether a frame to this address is for a module."""
        return module == self.module

    def __str__(self) -> str:
        return module_name(self.module)


@dataclass(frozen=True, slots=True, init=False)
class Multicast:
    """Several modules of a channel.

    Args:
        modules: Their ids, 0 to 29, at least one.

    Raises:
        UsageError: None is named, or one has no place in the mask.
    """

    modules: frozenset[int]

    def __init__(self, modules: Iterable[int]) -> None:
        object.__setattr__(self, "modules", frozenset(int(module) for module in modules))
        far = [module for module in self.modules if not 0 <= module < _MOST]
        if far or not self.modules:
            what = f"cannot name module {far[0]}" if far else "names nobody"
            raise UsageError(f"a multicast {what}: it names modules from 0 to {_MOST - 1}")

    @property
    def dst(self) -> int:
        """The field `dst`."""
        return _SEVERAL | sum(1 << module for module in self.modules)

    def names(self, module: int) -> bool:
        """Whether a frame to this address is for a module."""
        return module in self.modules

    def __str__(self) -> str:
        return ", ".join(module_name(module) for module in sorted(self.modules))


@dataclass(frozen=True, slots=True)
class Broadcast:
    """Every module of a channel."""

    @property
    def dst(self) -> int:
        """The field `dst`."""
        return _ALL

    def names(self, module: int) -> bool:
        """Whether a frame to this address is for a module: always."""
        return True

    def __str__(self) -> str:
        return "all modules"


Address = Unicast | Multicast | Broadcast


def address_of(dst: int) -> Address | None:
    """The address that a frame's `dst` stands for; None for a value that stands for none."""
    if dst == _ALL:
        return Broadcast()
    if 0 <= dst <= MAX_MODULE:
        return Unicast(dst)
    mask = dst ^ _SEVERAL
    if not 0 < mask < 1 << _MOST:
        return None
    return Multicast(module for module in range(_MOST) if mask >> module & 1)


def destination_name(dst: int) -> str:
    """The modules that a dialect-2 frame's `dst` names, in words."""
    return str(address_of(dst) or module_name(dst))
