"""`ioctl`: one special command to the robot, byte for byte.

Owns how a user types a command and its body. Must not know what a command does.
"""

from __future__ import annotations

import re

import click

from hexwire.errors import UsageError

from .common import RobotOptions, confirm, json_option, open_robot, robot_options
from .output import print_json, say

__all__ = ["ioctl"]

_LARGEST = 0xFF
_LONGEST = 8192
"""Most bytes of a body: no frame has more."""


@click.command()
@click.argument("sub_cmd", metavar="COMMAND")
@click.argument("data", metavar="[HEX]...", nargs=-1)
@click.option("--yes", is_flag=True, help="Do not ask before a command that may move the arm.")
@robot_options
@json_option
def ioctl(sub_cmd: str, data: tuple[str, ...], yes: bool, options: RobotOptions, as_json: bool) -> None:
    """Send a special command to the robot, and print the body of its reply in hex.

    COMMAND is a name or number of PROTOCOL.md, section 6.1, such as STATS or 0x1B; HEX is its body. The chapter's
    board knows PING, READ and SYNC_WRITE (section 5), each with a servo packet. Nothing is
    checked on the host: no limit, no path, no watchdog. Commands that may move the arm ask first.
    """
    from hexwire.trace.chapter_log import hex_rows
    from hexwire.wire.command_frame import command_name

    number, body = _number(sub_cmd), _body(data)
    with open_robot(options) as robot:
        if robot.may_move(number, body):
            danger = f"{command_name(number)} may move {robot.model.name}, and nothing checks where to"
            confirm(f"{danger}. Send it?", yes, alone=f"{danger}; --yes sends it")
        reply = robot.ioctl(number, body)
    if as_json:
        print_json({"command": command_name(number), "code": number, "body": body.hex(), "reply": reply.hex()})
    else:
        say(*(hex_rows(reply) if reply else ("the reply has no body",)))


def _number(text: str) -> int:
    from hexwire.wire.command_frame import Command

    name = text.upper().replace("-", "_")
    if name in Command.__members__:
        return Command[name]
    if re.fullmatch(r"0[Xx][0-9A-Fa-f]{1,2}", text):
        return int(text, 16)
    if re.fullmatch(r"[0-9]{1,3}", text) and int(text) <= _LARGEST:
        return int(text)
    known = ", ".join(Command.__members__)
    raise UsageError(f"no command {text[:40]!r}; there are numbers from 0 to {_LARGEST} (0xFF) and {known}")


def _body(words: tuple[str, ...]) -> bytes:
    text = "".join(words).replace(" ", "")
    if not re.fullmatch(r"(?:[0-9A-Fa-f]{2})*", text):
        raise UsageError(f"the body {' '.join(words)[:60]!r} is not hex: two digits a byte are needed, as in 00 1F")
    if len(text) > 2 * _LONGEST:
        raise UsageError(f"a body of {len(text) // 2} bytes is too long; the most are {_LONGEST}")
    return bytes.fromhex(text)
