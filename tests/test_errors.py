"""The exception tree: who catches what, and what the texts say."""

from __future__ import annotations

import pickle
import re

import pytest

from hexwire import errors
from hexwire.wire.command_frame import Command, Status

CLASSES = [getattr(errors, name) for name in errors.__all__]


def test_all_names_every_exception_of_the_module() -> None:
    defined = {name for name, value in vars(errors).items() if isinstance(value, type)}
    assert defined == set(errors.__all__)


def test_everything_is_a_hexwire_error() -> None:
    assert [cls for cls in CLASSES if not issubclass(cls, errors.HexwireError)] == []


@pytest.mark.parametrize(
    ("cls", "builtin"),
    [
        (errors.UsageError, ValueError),
        (errors.LinkError, OSError),
        (errors.LinkTimeoutError, TimeoutError),
        (errors.ReplyTimeoutError, TimeoutError),
    ],
)
def test_python_s_own_classes_catch_it_too(cls: type[Exception], builtin: type[Exception]) -> None:
    assert issubclass(cls, builtin)


def test_the_tree_in_the_docstring_is_the_tree() -> None:
    """Each drawn line stands under its parent, and every class is drawn once."""
    drawn: dict[str, str] = {}
    path: list[str] = []
    for line in (errors.__doc__ or "").splitlines():
        match = re.match(r"(?P<stem>[ │├└─]*)(?P<name>[A-Z]\w*Error)\b", line)
        if match is None:
            continue
        depth = len(match["stem"]) // 4 - 1
        path[depth:] = [match["name"]]
        drawn[match["name"]] = path[depth - 1] if depth else ""
    assert drawn.pop("HexwireError") == ""
    assert drawn == {cls.__name__: cls.__bases__[0].__name__ for cls in CLASSES if cls is not errors.HexwireError}


@pytest.mark.parametrize(
    ("where", "text"),
    [
        ({}, "no channel"),
        ({"file": "ipc_msg.conf"}, "ipc_msg.conf: no channel"),
        ({"file": "ipc_msg.conf", "line": 3}, "ipc_msg.conf:3: no channel"),
        ({"file": "ipc_msg.conf", "line": 3, "column": 7}, "ipc_msg.conf:3:7: no channel"),
        ({"file": "ipc_msg.conf", "column": 7}, "ipc_msg.conf: no channel"),
    ],
)
def test_config_error_says_where(where: dict[str, str | int], text: str) -> None:
    error = errors.ConfigError("no channel", **where)
    assert str(error) == text
    assert (error.file, error.line, error.column) == (
        where.get("file", ""),
        where.get("line", 0),
        where.get("column", 0),
    )


def test_link_error_carries_its_address_and_shows_its_text() -> None:
    error = errors.LinkBusyError("another program has it open", url="serial:///dev/ttyUSB0")
    assert str(error) == "another program has it open"
    assert error.url == "serial:///dev/ttyUSB0"


@pytest.mark.parametrize(
    ("attempts", "instead", "advice", "text"),
    [
        (1, "", "", "no answer to PING 3 after 1 attempt; nothing arrived"),
        (3, "PING 4", "", "no answer to PING 3 after 3 attempts; instead: PING 4"),
        (2, "", "is it on?", "no answer to PING 3 after 2 attempts; nothing arrived (is it on?)"),
    ],
)
def test_a_missing_reply_says_what_was_asked(attempts: int, instead: str, advice: str, text: str) -> None:
    error = errors.ReplyTimeoutError("PING 3", attempts=attempts, instead=instead, advice=advice)
    assert str(error) == text
    assert (error.asked, error.attempts, error.instead) == ("PING 3", attempts, instead)


def test_a_refusal_carries_command_and_status() -> None:
    error = errors.StoppedError("MOVE", 6, "the arm is stopped; resume first")
    assert str(error) == "the arm is stopped; resume first"
    assert (error.command, error.status, error.reason) == ("MOVE", 6, "the arm is stopped; resume first")


def test_that_an_arm_is_stopped_is_not_said_in_commands_of_the_wire() -> None:
    for name in Command.__members__:
        for make in (errors.StoppedError, errors.StoppedError.unsent):
            assert name not in str(make(name, 6, "the arm is stopped"))
    assert str(errors.StoppedError.unsent("a move", 6, "stopped")) == "a move was not sent: stopped"
    assert errors.StoppedError.STATUS == Status.STOPPED


def test_a_servo_error_names_the_servo() -> None:
    error = errors.ServoError("servo 4 is too hot", servo_id=4, status=0x04)
    assert (str(error), error.servo_id, error.status) == ("servo 4 is too hot", 4, 4)


@pytest.mark.parametrize("name", ["HexwireError", "UsageError", "RemoteProtocolError", "PreemptedError"])
def test_plain_errors_cross_a_process_border(name: str) -> None:
    error = getattr(errors, name)("what happened")
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error)
    assert copy.args == error.args


def test_an_error_that_quotes_a_file_is_one_printable_line_of_bounded_length() -> None:
    error = errors.ConfigError("unknown \x1b[2J key\n" + "y" * 5000 + "; known: a", file="a.toml", line=3)
    assert str(error).startswith("a.toml:3: unknown \\x1b[2J key\\ny")
    assert str(error).endswith("y; known: a")
    assert str(error).isprintable()
    assert len(str(error)) < 1700


def test_another_device_is_told_in_place_of_an_answer() -> None:
    error = errors.WrongDeviceError("it is a servo bus")
    assert (error.asked, error.attempts, error.instead) == ("who is there", 1, "it is a servo bus")
    assert str(error) == "it is a servo bus"


def test_what_can_be_printed_is_told_as_it_is() -> None:
    assert str(errors.ConfigError("a\\b: µ – → \x1b")).endswith("a\\b: µ – → \\x1b")
    assert str(errors.ConfigError("a\\b 'µ'")) == "a\\b 'µ'"
