"""What a program passes to a public method: of another kind than wanted, it is refused before anything is done.

Owns the kinds of arguments and the text of the refusal. Must not know the methods.
"""

from __future__ import annotations

import inspect
import math
import reprlib
from collections.abc import Callable, Collection, Iterable
from functools import wraps
from typing import Any, NamedTuple, TypeVar, cast

from hexwire.errors import UsageError

__all__ = [
    "DATA",
    "FLAG",
    "NAME",
    "NAMES",
    "PORT",
    "POSE",
    "ROBOT",
    "SECONDS",
    "WHOLE",
    "Wanted",
    "check",
    "checked",
    "one_of",
    "or_none",
    "rows_of",
    "shown",
    "takes",
]

_T = TypeVar("_T")
_M = TypeVar("_M", bound=Callable[..., Any])


class Wanted(NamedTuple):
    """A kind of argument.

    Attributes:
        text: What it is, after "takes".
        fits: Whether a value is one.
        plain: Makes one of another form of it, such as NumPy's; whatever else it leaves as it is.
    """

    text: str
    fits: Callable[[Any], bool]
    plain: Callable[[Any], Any] = lambda value: value


def _plain_number(value: Any) -> Any:
    """Python's own number or truth value of NumPy's, also of an array without dimensions."""
    if isinstance(value, int | float):
        return float(value) if isinstance(value, float) else value
    return value.item() if getattr(value, "ndim", None) == 0 else value


def _plain_names(value: Any) -> Any:
    # An iterator can be gone through only once, and a driver may do so twice.
    return tuple(value) if isinstance(value, Iterable) and not isinstance(value, str | bytes) else value


def _plain_bytes(value: Any) -> Any:
    if isinstance(value, bytes):
        return value
    try:
        view = memoryview(value)
    except TypeError:
        return value
    return bytes(view) if view.itemsize == 1 else value


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and not math.isnan(value)


def _are_names(value: object) -> bool:
    # A text is a collection of letters.
    return isinstance(value, Collection) and not isinstance(value, str) and all(isinstance(x, str) for x in value)


# Any text is true: torque("off") would switch it on.
FLAG = Wanted("True or False", lambda value: isinstance(value, int) and value in (0, 1), _plain_number)
WHOLE = Wanted("a whole number", _is_whole, _plain_number)
SECONDS = Wanted("a number of seconds", _is_number, _plain_number)
DATA = Wanted("bytes, as in b'\\x01'", lambda value: isinstance(value, bytes | bytearray), _plain_bytes)
NAME = Wanted("a name, as in 'J1'", lambda value: isinstance(value, str))
PORT = Wanted(
    "a port, as in '/dev/ttyUSB0', or an address, as in 'sim://hex7bot'", lambda value: isinstance(value, str)
)
POSE = Wanted("the name of a pose, as in 'rest'", lambda value: isinstance(value, str))
NAMES = Wanted("several names, as in ['J1']", _are_names, _plain_names)
ROBOT = Wanted(
    "the driver of a robot: arm.driver of the arm that hexwire.connect() returns, which itself has verbs, "
    "as in arm.move(J1=0.1)",
    lambda value: hasattr(value, "epochs") and not isinstance(value, type),
)


def one_of(kind: type) -> Wanted:
    """A value of a class."""
    return Wanted(f"a {kind.__name__}", lambda value: isinstance(value, kind))


def rows_of(kind: type) -> Wanted:
    """Several of them."""

    def fits(value: object) -> bool:
        return isinstance(value, Collection) and all(isinstance(row, kind) for row in value)

    return Wanted(f"several of {kind.__name__}", fits)


def or_none(wanted: Wanted) -> Wanted:
    """The same, or None."""
    return Wanted(wanted.text, lambda value: value is None or wanted.fits(value), wanted.plain)


def shown(value: object) -> str:
    """A value in a text of one line, cut short if it is long."""
    return reprlib.repr(value).replace("\n", " ")


def check(method: str, argument: str, wanted: Wanted, value: object) -> Any:
    """Refuse an argument of another kind; returns it in Python's own form.

    Args:
        method: Name of the method.
        argument: Name of its argument.
        wanted: Its kind.
        value: What was passed.

    Raises:
        UsageError: It is of another kind.
    """
    found = wanted.plain(value)
    if not wanted.fits(found):
        raise UsageError(f"{method}({argument}) takes {wanted.text}; this is {shown(value)}")
    return found


def checked(method: Callable[..., _T], wanted: dict[str, Wanted]) -> Callable[..., _T]:
    """A method that checks its arguments first.

    Args:
        method: The method; what it calls an argument is the argument's name.
        wanted: The kinds of its arguments, by name; others are not checked.
    """
    code = method.__code__
    if code.co_flags & inspect.CO_VARARGS:
        code = inspect.unwrap(method).__code__  # of a context manager, the arguments are inside
    names = code.co_varnames[1 : code.co_argcount]
    positional = [(name, wanted.get(name)) for name in names]

    @wraps(method)
    def call(self: object, *given: Any, **named: Any) -> _T:
        plain = list(given)
        for at, (name, kind) in enumerate(positional[: len(plain)]):
            if kind is not None:
                plain[at] = check(method.__name__, name, kind, plain[at])
        for name, value in named.items():
            if name in wanted:
                named[name] = check(method.__name__, name, wanted[name], value)
        return method(self, *plain, **named)

    return call


def takes(**wanted: Wanted) -> Callable[[_M], _M]:
    """Have a method check arguments, by name; see `checked`."""

    def checking(method: _M) -> _M:
        return cast("_M", checked(method, wanted))

    return checking
