"""Options and arguments of commands that are numbers.

Owns their types and bounds. Must not know what the numbers mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import click

__all__ = ["FiniteFloat", "NumbersCommand", "is_number", "number_option", "numbers_argument"]

_F = TypeVar("_F", bound=Callable[..., Any])


class NumbersCommand(click.Command):
    """A command some of whose arguments may be negative: -30 is a number there, and any other -word an option."""

    ignore_unknown_options = True

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        options = {
            name: param
            for param in self.get_params(ctx)
            if isinstance(param, click.Option)
            for name in (*param.opts, *param.secondary_opts)
        }
        words = iter(args[: args.index("--")] if "--" in args else args)
        for word in words:
            if not word.startswith("-") or word == "-" or is_number(word):
                continue
            name, given, _ = word.partition("=")
            option = options.get(name)
            if option is None:
                raise click.NoSuchOption(name, possibilities=options, ctx=ctx)
            if not given and not option.is_flag:
                for _ in range(option.nargs):
                    next(words, None)
        return super().parse_args(ctx, args)


def is_number(word: str) -> bool:
    """Whether a word is a number, be it infinite or NaN."""
    try:
        float(word)
    except ValueError:
        return False
    return True


class FiniteFloat(click.ParamType[float]):
    """A number that is neither infinite nor NaN, with bounds.

    Args:
        name: Name in the help text, such as ``SECONDS``.
        minimum: Smallest value.
        above: Exclusive lower bound.
    """

    def __init__(self, name: str, *, minimum: float = -math.inf, above: float = -math.inf) -> None:
        self.name = name
        self._minimum = minimum
        self._above = above

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a number", param, ctx)
        if number < self._minimum:
            self.fail(f"{value} is less than {self._minimum:g}", param, ctx)
        if number <= self._above:
            self.fail(f"{value} is not above {self._above:g}", param, ctx)
        return number


def number_option(
    name: str,
    metavar: str,
    help_text: str,
    *,
    minimum: float = -math.inf,
    above: float = -math.inf,
    default: float | None = None,
) -> Callable[[_F], _F]:
    """An option that takes a finite number within bounds; a default stands in its help."""
    kind = FiniteFloat(metavar.lower(), minimum=minimum, above=above)
    shown = default is not None
    return click.option(name, type=kind, default=default, show_default=shown, metavar=metavar, help=help_text)


def numbers_argument(name: str, metavar: str, kind: FiniteFloat) -> Callable[[_F], _F]:
    """An argument of several numbers, named by its metavar in usage and errors.

    Args:
        name: Name of the command's parameter.
        metavar: One word per number, such as ``X Y Z``.
        kind: Type of each number.
    """
    count = len(metavar.split())

    def check(ctx: click.Context, param: click.Parameter, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) != count:
            raise click.UsageError(f"{metavar} takes {count} values, not {len(value)}", ctx)
        return value

    return click.argument(name, nargs=-1, required=True, type=kind, metavar=metavar, callback=check)
