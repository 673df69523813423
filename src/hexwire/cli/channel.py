"""Channels and what goes over them past a driver: `conf`, `ioctl`, several boards on one (`gateway`, `--all`).

Owns the presentation of channels, when a board of several counts as missing, and how a user types a special command
and the doors of a gateway. `hexwire.gateway` forwards the frames.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from hexwire.errors import DeviceError, HexwireError, ReplyTimeoutError, ServoError, UsageError

from .exits import ends_when_asked, note
from .options import RobotOptions, confirm, force_option, json_option, open_robot, resolve_url, robot_options
from .output import Column, RowType, answer, say, say_document, wants_json

if TYPE_CHECKING:
    from hexwire.control.loop.power import Torques
    from hexwire.ipc.channel import ChannelConf
    from hexwire.ipc.session import Session
    from hexwire.link.base import Link
    from hexwire.link.listener import Listener
    from hexwire.link.mqueue import QueueLink
    from hexwire.session.events import Answers, Reply

__all__ = ["all_option", "conf", "gateway", "ioctl", "probe_all", "resume_all", "stop_all"]

_LOOK, _LOOKS = 0.3, 2
"""Seconds for all to answer who they are, and how often they are asked."""
_AT_ONCE = 0.25
"""Seconds after which the next question may follow a stop."""
_STOP_WINDOW, _STOP_ATTEMPTS = 0.6, 4
"""A stop takes up to half a second, while the board drops repeats."""

all_option: Callable[[Callable[..., Any]], Callable[..., Any]] = click.option(
    "--all", "everybody", is_flag=True, help="Every board of the channel, such as all behind a gateway."
)


@contextmanager
def _open(options: RobotOptions) -> Iterator[Session]:
    from hexwire.drivers.board_reset import warn_of_reset
    from hexwire.ipc.session import Session

    session = Session.from_url(resolve_url(options.port, options.baud))
    warn_of_reset(session.ipc.link)
    with session:
        yield session


def _names(mask: int) -> str:
    from hexwire.model.arms.hex7bot.joints import HEX7BOT

    return " ".join(name for i, name in enumerate(HEX7BOT.names) if mask >> i & 1) or "none"


def probe_all(options: RobotOptions) -> None:
    """Show who answers on the channel.

    Raises:
        ReplyTimeoutError: Nobody does, or a board that is known does not.
    """
    from hexwire.wire.command_frame import Status
    from hexwire.wire.commands import Identity
    from hexwire.wire.modules import module_name
    from hexwire.wire.tables import BOARD_FLAGS_STOPPED

    with _open(options) as session:
        found = _find(session)
    data: list[dict[str, Any]] = []
    lines = []
    silent = sorted(found.silent | {m for m, reply in found.replies.items() if reply.status != Status.OK})
    for module, reply in found.replies.items():
        if reply.status != Status.OK:
            continue
        identity = Identity.parse(reply.body)
        stopped = bool(identity.board_flags & BOARD_FLAGS_STOPPED)
        present = sum(row.present for row in identity.joints)
        firmware = ".".join(map(str, identity.firmware))
        data.append(
            {
                "module": module,
                "silent": False,
                "firmware": firmware,
                "boot_id": identity.boot_id,
                "stopped": stopped,
                "servos": len(identity.joints),
                "present": present,
            }
        )
        servos = f"{present} of {len(identity.joints)} servos answer"
        lines.append(
            f"{module_name(module)} ({module}): firmware {firmware}, {servos}{', stopped' if stopped else ''}"
        )
    data += ({"module": module, "silent": True} for module in silent)
    answer(data, *lines, *_without_answer(silent))
    _check_all(found.replies, silent, attempts=_LOOKS)


def stop_all(options: RobotOptions, *, torque_off: bool) -> None:
    """Stop every board of the channel by one frame, and find out who has confirmed it.

    Raises:
        ServoError: A joint has not confirmed it.
        ReplyTimeoutError: Nobody has answered, or a board that is there has not.
    """
    from hexwire.wire.command_frame import Command
    from hexwire.wire.commands import parse_stop_reply

    body = bytes((int(torque_off),))
    with _open(options) as session:
        # First the stop. Who is there comes later, and then who has confirmed it; that says what is wrong, too.
        with suppress(HexwireError):
            session.request_all(Command.STOP, body, window=_AT_ONCE, attempts=1)
        _find(session)
        stopped = session.request_all(Command.STOP, body, window=_STOP_WINDOW, attempts=_STOP_ATTEMPTS)
        states = session.request_all(Command.JOINT_STATE, b"\0", window=_LOOK, attempts=_LOOKS).replies
    replies = stopped.replies
    masks = {module: parse_stop_reply(reply.body)[1] if reply.body else 0 for module, reply in replies.items()}
    silent = sorted(stopped.silent)
    does = {module: _torques(masks[module], states.get(module), torque_off) for module in sorted(masks)}
    data = {
        "did": "stopped",
        "confirmed": {str(m): _names(masks[m]).split() for m in does},
        "does": {str(m): asdict(torques) for m, torques in does.items()},
        "silent": silent,
    }
    lines = (f"module {module}: stopped, {torques}" for module, torques in does.items())
    answer(data, *lines, *_without_answer(silent))
    later = "; one that the gateway has lost is stopped when it is back"
    _check_all(replies, silent, {module: mask == 0x7F for module, mask in masks.items()}, later=later)


def resume_all(options: RobotOptions) -> None:
    """End the stop of every board of the channel; a watchdog that caused it is switched off.

    Raises:
        ReplyTimeoutError: Nobody has answered, or a board that is there has not.
        DeviceError: A board has refused.
    """
    from hexwire.wire.addresses import Multicast
    from hexwire.wire.command_frame import Command, Status
    from hexwire.wire.commands import Identity
    from hexwire.wire.tables import BOARD_FLAGS_WATCHDOG_TRIPPED

    with _open(options) as session:
        found = _find(session)
        there = {m: Identity.parse(r.body) for m, r in found.replies.items() if r.status == Status.OK}
        tripped = [m for m, board in there.items() if board.board_flags & BOARD_FLAGS_WATCHDOG_TRIPPED]
        if tripped:
            # Its program is gone, so it would trip again.
            session.request_all(Command.WATCHDOG, b"\0\0\0", Multicast(tripped))
        resumed = session.request_all(Command.RESUME)
    silent = sorted(resumed.silent)
    # Such as those that have another host.
    refusing = {m: _why(reply) for m, reply in sorted(resumed.replies.items()) if reply.status != Status.OK}
    done = sorted(resumed.replies.keys() - refusing.keys())
    lines = [f"module {module}: resumed" for module in done]
    lines += [f"module {module}: not resumed: {why}" for module, why in refusing.items()]
    answer({"resumed": done, "silent": silent}, *lines, *_without_answer(silent))
    _check_all(resumed.replies, silent)
    if refusing:
        why = next(iter(refusing.values()))
        raise DeviceError(f"{_modules(refusing)} {'is' if len(refusing) == 1 else 'are'} not resumed: {why}")


def _why(reply: Reply) -> str:
    """Why a board, or a gateway in front of it, refuses a request."""
    from hexwire.wire.command_frame import status_name

    return reply.body.decode(errors="replace") or status_name(reply.status)


def _torques(mask: int, state: Reply | None, torque_off: bool) -> Torques:
    """What the joints of a board do after a stop, by its state."""
    from hexwire.control.loop.power import Torques
    from hexwire.drivers.values import StopMode
    from hexwire.model.arms.hex7bot.joints import HEX7BOT
    from hexwire.model.state import JointFlag
    from hexwire.wire.command_frame import Status
    from hexwire.wire.commands import JointReport

    status = JointReport.parse(state.body).status if state is not None and state.status == Status.OK else ()
    flags = {name: status[i] if i < len(status) else JointFlag.SILENT for i, name in enumerate(HEX7BOT.names)}
    confirmed = [name for i, name in enumerate(HEX7BOT.names) if mask >> i & 1]
    mode = StopMode.TORQUE_OFF if torque_off else StopMode.HOLD
    return Torques.by_flags(flags).after_stop(confirmed, mode)


def _find(session: Session) -> Answers:
    """Who is there, and who should be."""
    from hexwire.link.base import LinkKind
    from hexwire.wire.command_frame import Command

    link = session.ipc.link
    if link.kind is LinkKind.DATAGRAM:
        raise UsageError(
            f"{link.url}: --all asks all boards who they are, which a queue or UDP cannot carry: give the TCP port "
            "of the gateway, or one board after the other, as in ?to=8"
        )
    found = session.request_all(Command.IDENTIFY, window=_LOOK, attempts=_LOOKS)
    if not found.replies and not found.silent:
        advice = "--all is for boards with hexwire's present firmware, and for a gateway to them"
        raise ReplyTimeoutError("IDENTIFY to all modules", attempts=_LOOKS, advice=advice)
    return found


def _without_answer(silent: list[int]) -> Iterator[str]:
    return (f"module {module}: no answer" for module in silent)


def _check_all(
    replies: dict[int, Reply],
    silent: list[int],
    done: Mapping[int, bool] | None = None,
    *,
    attempts: int = _STOP_ATTEMPTS,
    later: str = "",
) -> None:
    if silent:
        which = "this board" if len(silent) == 1 else "these boards"
        raise ReplyTimeoutError(_modules(silent), attempts=attempts, advice=f"check {which}{later}")
    missing = [module for module in sorted(replies) if done is not None and not done[module]]
    if missing:
        raise ServoError(f"not confirmed by every joint of {_modules(missing)}")


def _modules(numbers: Collection[int]) -> str:
    """As in ``module 9`` or ``modules 8, 9``."""
    return f"module{'' if len(numbers) == 1 else 's'} {', '.join(map(str, numbers))}"


@click.group()
def conf() -> None:
    """Check and convert channel configuration files: ipc_msg.conf, or the same in TOML."""


def _opens(channel: ChannelConf) -> str:
    from hexwire.ipc.conf import link_url

    return link_url(channel)


_CHANNELS: RowType[ChannelConf] = RowType(
    Column("", "line", text=lambda channel: str(channel.line or "-")),
    Column("**", get=asdict),
    Column("module", "module", "module.name"),
    Column("direction", "direction", "direction.value"),
    Column("destination", "destination", "destination.name"),
    Column("interface", "interface", "interface.name"),
    Column("peer", get=lambda channel: channel.peer or None),
    Column("line", get=lambda channel: channel.line or None),
    Column("url", "opens", _opens),
)


@conf.command()
@click.argument("file", metavar="FILE")
@json_option
def check(file: str) -> None:
    """Show the channels in a file; errors name file, line and column."""
    from hexwire.ipc.conf import load_conf

    channels = load_conf(file)
    if channels or wants_json():
        _CHANNELS.show(channels)
        say()
    say(f"{file}: {len(channels)} channel{'s' if len(channels) != 1 else ''}, no error")


@conf.command()
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@force_option
def convert(source: str, target: str, force: bool) -> None:
    """Write the channels of IN to OUT: TOML if OUT ends in .toml, the chapter's format otherwise.

    Comments are lost. OUT may be - for standard output, which gets the format that IN does not have.
    """
    from hexwire.ipc.conf import load_conf, to_conf, to_toml
    from hexwire.new_file import OutputFile

    channels = load_conf(source)
    wanted = Path(target).suffix if target != "-" else ("" if Path(source).suffix == ".toml" else ".toml")
    text = to_toml(channels) if wanted == ".toml" else to_conf(channels)
    if target == "-":
        say_document(text)
        return
    with OutputFile(target, force=force) as out:
        out.file.write(text.encode())


_LARGEST = 0xFF
_LONGEST = 8192
"""Most bytes of a body: no frame has more."""


@click.command()
@click.argument("sub_cmd", metavar="COMMAND")
@click.argument("data", metavar="[HEX]...", nargs=-1)
@click.option("--yes", is_flag=True, help="Do not ask before a command that may move the arm.")
@robot_options
@json_option
def ioctl(sub_cmd: str, data: tuple[str, ...], yes: bool, options: RobotOptions) -> None:
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
    told = {"command": command_name(number), "code": number, "body": body.hex(), "reply": reply.hex()}
    answer(told, *(hex_rows(reply) if reply else ("the reply has no body",)))


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


_NUMBERED = re.compile(r"([A-Za-z_0-9]+)=(.+)")
_LISTEN = "tcp://127.0.0.1:15040"


@click.command()
@click.option(
    "--listen",
    "doors",
    metavar="URL",
    multiple=True,
    default=(_LISTEN,),
    show_default=True,
    help="Where hosts connect: tcp://HOST:PORT, tcps://HOST:PORT?ca=FILE&cert=FILE&key=FILE, or mq:///NAME for "
    "programs of this user. Give it once per queue; there is one port.",
)
@click.option(
    "--board",
    "boards",
    metavar="[MODULE=]URL",
    multiple=True,
    required=True,
    help="Port of a board, and its module id for the host (8, 9, ... if not given). Give it once per board.",
)
def gateway(doors: tuple[str, ...], boards: tuple[str, ...]) -> None:
    """Forward frames between hosts and several boards: one port or several queues up, several lines down.

    A host names a board by its module id, as in --port tcp://HOST:PORT?to=9, or several at once, and has it until
    it leaves; others may only stop it. Long requests are sent to a board in fragments. A stop overtakes everything.
    If a host is lost, its boards are stopped. For boards with hexwire's firmware.
    """
    from hexwire.drivers.board_reset import warn_of_reset
    from hexwire.gateway.service import GatewayService
    from hexwire.ipc.connections import random_number
    from hexwire.link.url import is_loopback
    from hexwire.wire.modules import ModuleType

    port = next((door for door in doors if not _is_queue(door)), None)
    listener = None if port is None else _listener(port)
    links = _links(boards)
    queues = _queues(doors, port, len(links))
    if listener is not None and listener.url.startswith("tcp-") and not is_loopback(listener.host):
        note(f"warning: anyone who reaches TCP on {listener.host} can command these boards; tcps:// prevents that")
    warned: set[str] = set()

    def warn_once(link: Link) -> None:
        # A board that is plugged in later too, and not at each attempt to open its port.
        if link.url not in warned and warn_of_reset(link):
            warned.add(link.url)

    service = GatewayService(
        listener,
        links,
        local=ModuleType.ARM_7BOT_ARDUINO_TRX,
        before_open=warn_once,
        queues=queues,
        numbers=random_number,
    )
    try:
        service.open()
        for url in service.urls:
            say_document(url.replace("-listen://", "://"))
        if sys.stdout.isatty():
            note("modules: " + ", ".join(f"{module} at {link.url}" for module, link in links.items()))
        with ends_when_asked() as ended:
            service.run(ended)
    finally:
        service.close()


def _is_queue(door: str) -> bool:
    return door.lower().startswith("mq:")


def _queues(doors: tuple[str, ...], port: str | None, hosts: int) -> list[QueueLink]:
    """The servers' ends of the queues among the addresses, which have one port at most.

    Args:
        doors: The addresses.
        port: The one that is no queue, or None.
        hosts: How many each queue is for at once: each board may have one.
    """
    from hexwire.link.open import build_link

    queues: list[QueueLink] = []
    for door in doors:
        if not _is_queue(door):
            if door is not port:
                raise UsageError(f"--listen {door}: a gateway has one port, and {port} is given already")
            continue
        added = "role=server" if "unlink=" in door else "role=server&unlink=1"
        link = build_link(f"{door}{'&' if '?' in door else '?'}{added}")
        if any(link.url == queue.url for queue in queues):
            raise UsageError(f"--listen {door} is given twice")
        queues.append(cast("QueueLink", link))
    # Further lines last: where memory for queues is scarce, every queue has its first.
    further = [queue.make_further(number) for number in range(2, hosts + 1) for queue in queues]
    return [*queues, *further]


def _listener(text: str) -> Listener:
    from hexwire.link.listener import Listener, listen_address
    from hexwire.link.tls import TlsFiles
    from hexwire.link.url import parse_url

    url = parse_url(text)
    if url.scheme not in ("tcp", "tcps"):
        raise UsageError(f"{text}: a gateway listens on tcp://, tcps:// or mq://")
    if url.scheme == "tcps":
        return Listener(*listen_address(url), tls=TlsFiles.from_url(url))
    url.check_keys(())
    url.check_no_path()
    return Listener(*listen_address(url))


def _links(boards: tuple[str, ...]) -> dict[int, Link]:
    """The links by module id."""
    from hexwire.gateway.line import GATEWAY_MODULE
    from hexwire.link.open import make_link
    from hexwire.wire.addresses import module_id
    from hexwire.wire.modules import ModuleType

    links: dict[int, Link] = {}
    number = int(ModuleType.ARM_7BOT_ARDUINO_TRX)
    for text in boards:
        match = _NUMBERED.fullmatch(text)
        if match is not None and "://" not in match[1]:
            number, text = module_id(match[1]), match[2]
        if number >= GATEWAY_MODULE:
            raise UsageError(f"--board {text}: module ids behind a gateway are 0 to {GATEWAY_MODULE - 1}")
        if number in links:
            raise UsageError(f"--board {text}: module {number} is {links[number].url} already")
        if any(link.url == make_link(text).url for link in links.values()):
            raise UsageError(f"--board {text} is given twice")
        links[number] = make_link(text)
        if getattr(links[number], "raise_to", 0):
            raise UsageError(f"--board {text}: a gateway does not raise the rate of a line; leave out raise")
        number += 1
    return links
