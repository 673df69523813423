"""Exit of the command line: exit status, one-line errors, warnings, signals.

Owns the mapping from exceptions to exit status (0 ok, 1 device, 2 usage, 130 Ctrl-C) and everything written to
standard error. Must not know any command.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import click

from hexwire.errors import HexwireError, UsageError
from hexwire.extras import extras_named
from hexwire.system import END_SIGNALS

from .output import shown, write

if TYPE_CHECKING:
    from hexwire.link.tap import Missed

__all__ = [
    "DEVICE",
    "INTERRUPTED",
    "OK",
    "USAGE",
    "ends_like_ctrl_c",
    "ends_when_asked",
    "fill_standard_streams",
    "note",
    "run",
    "run_node",
    "shielded",
    "show_more",
    "speak",
    "tell_missed",
    "warnings_shown",
]

_NEAR = 0.7
"""How alike an option and what was typed must be, from 0 to 1, for the one to be meant by the other."""

OK = 0
DEVICE = 1
USAGE = 2
INTERRUPTED = 130


def run(call: Callable[[], object]) -> int:
    """Call a command and return the exit status; an error is one line on standard error.

    A bug is not caught: the maintainers need its traceback.
    """
    try:
        with extras_named():
            result = call()
        sys.stdout.flush()
    except (KeyboardInterrupt, click.Abort):
        return INTERRUPTED
    except SystemExit as error:
        # click raises this when the reader of a pipe has gone.
        return error.code if isinstance(error.code, int) else DEVICE
    except click.exceptions.NoArgsIsHelpError as error:
        for line in error.format_message().splitlines():
            note(line)
        return USAGE
    except click.ClickException as error:
        if isinstance(error, click.NoSuchOption):
            error = _without_far_suggestions(error)
        context = getattr(error, "ctx", None)
        see = f" (see '{context.command_path} --help')" if context else ""
        _say("error", error.format_message().rstrip(".") + see)
        return error.exit_code
    except HexwireError as error:
        _say("error", str(error))
        return USAGE if isinstance(error, UsageError) else DEVICE
    except BrokenPipeError:
        # The reader of our output has closed the pipe.
        _forget_output()
        return DEVICE
    except OSError as error:
        what = f"{error.filename}: " if error.filename else ""
        _say("error", f"{what}{error.strerror or error}")
        try:
            sys.stdout.flush()
        except OSError:
            _forget_output()
        return DEVICE
    return result if isinstance(result, int) else OK


def _forget_output() -> None:
    """Have buffered output not be written again at exit; Python 3.13 would end with status 120."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _without_far_suggestions(error: click.NoSuchOption) -> click.UsageError:
    """The error with only those options that somebody may have meant: click compares the dashes, too."""
    from difflib import SequenceMatcher

    word = error.option_name.lstrip("-")
    if word == "wait":
        return click.UsageError(f"{error.message} The command waits without it.", error.ctx)
    near = [
        name for name in error.possibilities or () if SequenceMatcher(None, word, name.lstrip("-")).ratio() >= _NEAR
    ]
    return click.NoSuchOption(error.option_name, error.message, near, error.ctx)


def run_node(call: Callable[[], object]) -> int:
    """As `run`, for a ROS node: SIGTERM and SIGHUP end it like Ctrl-C, and a second signal ends it at once."""
    ends_like_ctrl_c()
    status = run(call)
    # The arm is safe. A second Ctrl-C ends the rest, such as ROS's own shutdown, without a traceback.
    for number in (signal.SIGINT, *END_SIGNALS):
        signal.signal(number, signal.SIG_DFL)
    return status


def note(text: str) -> None:
    """Print one line on standard error, apart from the output that a program may read.

    Never fails: a command does not fail because a note cannot be printed.
    """
    with suppress(OSError):
        speak(text)


def speak(text: str) -> None:
    """As `note`, but raises an error if the line cannot be written.

    Raises:
        OSError: Standard error is closed, or its disk is full. Later lines are discarded.
    """
    try:
        write(sys.stderr, shown(text) + "\n", flush=True)
    except OSError:
        # Buffered text must not be written again at exit: that would change the exit status.
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115  # open until the program ends
        raise


def tell_missed(who: str, missed: Missed) -> None:
    """Print one line about what an observer missed, if anything; the exit status of the command does not change."""
    if missed.first is None:
        return
    why = missed.first
    text = (why.strerror if isinstance(why, OSError) else "") or str(why) or type(why).__name__
    times = "once" if missed.count == 1 else f"{missed.count} times"
    _say("warning", f"{who} has gaps, it failed {times}: {text}; the command was not affected")


@contextmanager
def warnings_shown() -> Iterator[None]:
    """Print the library's log messages of level warning and above, one line each, on standard error."""
    logger = logging.getLogger("hexwire")
    handler = _OneLine()
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)


def show_more(verbosity: int) -> None:
    """Inside `warnings_shown`: 0 shows warnings only, 1 also events, 2 every detail."""
    logging.getLogger("hexwire").setLevel((logging.WARNING, logging.INFO, logging.DEBUG)[min(verbosity, 2)])


def fill_standard_streams() -> None:
    """Open the null device in place of closed standard streams, as some service managers leave them.

    A stop must not fail because its message cannot be printed, and a serial port must not get the descriptor of
    standard error.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
    for name, number, mode in (("stdin", 0, "r"), ("stdout", 1, "w"), ("stderr", 2, "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))


def ends_like_ctrl_c() -> None:
    """Make SIGTERM and SIGHUP end the program like Ctrl-C: open things are closed, an arm is left safe."""
    for number in END_SIGNALS:
        # A program started by `nohup` keeps ignoring SIGHUP.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


@contextmanager
def shielded() -> Iterator[None]:
    """Protect a step that must be completed, such as switching torque off, from signals."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, *END_SIGNALS)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def ends_when_asked() -> Iterator[Callable[[], bool]]:
    """For work that must not be interrupted between two steps: gives whether a signal has asked to end it."""
    asked: list[int] = []
    # Scripts start background programs with SIGINT ignored, and launchers send it to end them.
    numbers = [signal.SIGINT, *(n for n in END_SIGNALS if signal.getsignal(n) is not signal.SIG_IGN)]
    before = {number: signal.signal(number, lambda number, frame: asked.append(number)) for number in numbers}
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _OneLine(logging.Handler):
    """Writes to the present `sys.stderr`, which a live view replaces."""

    def emit(self, record: logging.LogRecord) -> None:
        _say(record.levelname.lower(), record.getMessage())


def _say(kind: str, text: str) -> None:
    note(f"{kind}: {' '.join(text.split())}")


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
