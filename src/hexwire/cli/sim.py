"""`sim`: emulated hardware for other programs: a board, servos on a bus, a PUMA 260, and a hand that moves them.

Owns the options of the emulator, how a device is offered to other programs, and when it ends.
"""

from __future__ import annotations

import functools
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

import click

from hexwire.bus.ids import parse_ids
from hexwire.errors import UsageError
from hexwire.units import decimal

from .exits import note
from .options import FiniteFloat, NumbersCommand, early_port, is_typed, json_option, number_option, resolve_url
from .output import answer, say_document

if TYPE_CHECKING:
    from hexwire.emulator.hand import Hands
    from hexwire.emulator.physics import PhysicsTwin
    from hexwire.emulator.serve import ServedDevice
    from hexwire.emulator.servo import EmulatedServo
    from hexwire.link.poll_link import PollLink
    from hexwire.model.arm import ArmModel

__all__ = ["bus", "hand", "link_option", "parse_address", "puma260", "serve_device", "shown", "sim", "tcp_option"]

tcp_option = click.option(
    "--tcp", metavar="HOST:PORT", help="Offer a TCP port instead of a terminal; port 0 selects a free one."
)
link_option = click.option(
    "--link", metavar="PATH", help="Create a symbolic link to the terminal, as a fixed name."
)


@dataclass(frozen=True, slots=True)
class _Offer:
    """How an emulated device is offered to other programs, and when it ends; all as typed."""

    link: str | None
    tcp: str | None
    until_eof: bool
    view: bool

    def ended(self) -> Callable[[], bool]:
        """Whether the input that keeps the device alive has ended; asked from now on."""
        ended = threading.Event()
        if self.until_eof:
            threading.Thread(target=_wait_for_eof, args=(ended,), daemon=True).start()
        return ended.is_set


def _offer_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """What the emulated board and bus share; the command gets ``offer: _Offer`` and ``faults``."""

    @functools.wraps(command)
    def given(*args: Any, link: str | None, tcp: str | None, until_eof: bool, view: bool, **rest: Any) -> Any:
        return command(*args, offer=_Offer(link, tcp, until_eof, view), **rest)

    packed: Callable[..., Any] = given
    for option in (
        click.option(
            "--until-eof",
            is_flag=True,
            help="End at the end of standard input, so that it does not outlive its user.",
        ),
        link_option,
        tcp_option,
        click.option(
            "--view", is_flag=True, help="With --physics, show the arm in a window; closing it ends the emulator."
        ),
        click.option(
            "--fault",
            "faults",
            multiple=True,
            metavar="SPEC",
            help="Fault to inject, such as silent:4; repeatable.",
        ),
    ):
        packed = option(packed)
    return packed


def _queue_link(name: str) -> PollLink:
    """The server's end of a queue, not open yet; raises UsageError if this system has none, or for a bad name."""
    from hexwire.link.open import build_link
    from hexwire.link.poll_link import PollLink

    link = build_link(f"mq:///{name.removeprefix('/')}?role=server&unlink=1")
    assert isinstance(link, PollLink)
    return link


def parse_address(text: str) -> tuple[str, int]:
    """Parse ``host:port`` or ``:port``; the default host is the loopback address.

    Raises:
        UsageError: The text is malformed.
    """
    from hexwire.link.listener import LOOPBACK
    from hexwire.link.url import split_host_port

    host, port = split_host_port(f"{LOOPBACK}{text}" if text.startswith(":") else text, text)
    return host, port


def serve_device(
    device: ServedDevice,
    *,
    tcp: str | None,
    link: str | None,
    baud: int,
    reset_on_open: bool = False,
    hands: Hands | None = None,
    rate: Callable[[], int] | None = None,
    stop: Callable[[], bool],
    announce: Callable[[str], None],
    shows: bool = False,
) -> None:
    """Serve a device until told to stop; arguments as of `PtyServer`, `TcpServer` and `DeviceServer.serve`.

    Raises:
        UsageError: Options that exclude each other, or this system has no pseudo-terminals for it.
    """
    if tcp is None:
        try:
            from hexwire.emulator.serve_pty import PtyServer
        except ImportError:
            no_terminals()
        server = PtyServer(device, link=link, baud=baud, reset_on_open=reset_on_open, hands=hands, rate=rate)
        server.serve(stop, announce, shows=shows)
        return
    from hexwire.emulator.serve_tcp import TcpServer
    from hexwire.link.url import is_loopback

    if link is not None:
        raise UsageError("--link names a terminal, and --tcp makes none; leave out one of them")
    host, port = parse_address(tcp)
    if not is_loopback(host):
        note(f"warning: anyone who reaches TCP on {host} can command this emulated arm")
    tcp_server = TcpServer(device, host, port, baud=baud, reset_on_open=reset_on_open, hands=hands)
    tcp_server.serve(stop, announce, shows=shows)


def no_terminals() -> NoReturn:
    """Say that this system lacks the terminals that emulated arms use; raises UsageError."""
    raise UsageError(f"no pseudo-terminals for emulated arms on {sys.platform}; add --tcp 127.0.0.1:0") from None


@contextmanager
def shown(
    twin: PhysicsTwin | None, servos: Sequence[EmulatedServo], stop: Callable[[], bool], *, view: bool
) -> Iterator[Callable[[], bool]]:
    """A window with a twin while the block runs, if `view`; gives what tells the emulator to stop, and shows it.

    Args:
        twin: None if there are no physics.
        servos: The servos of the twin.
        stop: What else tells the emulator to stop.
        view: Show a window.

    Raises:
        UsageError: There are no physics to show, or no window can be opened.
    """
    if not view:
        yield stop
        return
    if twin is None:
        raise UsageError("--view needs --physics")
    from hexwire.emulator.serve_view import TwinView

    window = TwinView(twin, servos)
    try:
        yield lambda: stop() or not window.step(time.monotonic())
    finally:
        window.close()


_SERVO_BAUD = 115200
"""Rate of the emulated servo bus if the line is paced, as set by the chapter's sketch."""


@click.group()
def sim() -> None:
    """Emulate hardware for other programs."""


@sim.command()
@click.option(
    "--baud",
    type=click.IntRange(min=0),
    default=115200,
    show_default=True,
    metavar="N|0",
    help="Simulate this line rate; 0 means as fast as possible.",
)
@click.option(
    "--dialect",
    type=click.IntRange(1, 2),
    default=2,
    show_default=True,
    metavar="1|2",
    help="1 for the chapter's board, 2 for hexwire's firmware.",
)
@click.option("--seed", type=int, default=0, metavar="N", help="Seed of the random generator.")
@click.option("--physics", is_flag=True, help="Simulate weight, sag and a table with MuJoCo.")
@number_option("--payload", "GRAMS", "With --physics, the payload of the tool.", minimum=0)
@click.option("--queue", metavar="NAME", help="Offer the POSIX message queue mq:///NAME to a program of this user.")
@click.option("--reset-on-open", is_flag=True, help="Reset the board when the port is opened, like a real Mega.")
@_offer_options
def board(
    baud: int,
    dialect: int,
    seed: int,
    physics: bool,
    payload: float | None,
    queue: str | None,
    reset_on_open: bool,
    faults: tuple[str, ...],
    offer: _Offer,
) -> None:
    """Emulate a Hex7Bot: prints the port to open, and runs until stopped."""
    from hexwire.emulator.board import make_hex7bot_board
    from hexwire.emulator.hand import Hands
    from hexwire.emulator.serve_tcp import serve_queue
    from hexwire.ipc.connections import random_number
    from hexwire.model.arms.hex7bot.joints import HEX7BOT

    if queue is not None and (offer.tcp is not None or offer.link is not None or reset_on_open):
        raise UsageError("--queue offers a queue instead of a port: leave out --tcp, --link and --reset-on-open")
    if queue is not None and dialect == 1:
        raise UsageError("--queue: the chapter's board has no conversations; it needs a serial line or --tcp")
    messages = None if queue is None else _queue_link(queue)
    device = make_hex7bot_board(
        dialect=dialect,
        baud=_SERVO_BAUD if baud else 0,
        faults=faults,
        seed=seed,
        start=time.monotonic(),
        # Only a terminal has a rate that a host can change.
        host_rate=baud if offer.tcp is None and queue is None else 0,
        numbers=None if queue is None else random_number,
    )
    twin = None
    if physics:
        from hexwire.emulator.physics import PhysicsTwin
        from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel

        twin = PhysicsTwin(device.wire.servos, Hex7BotModel(), payload=(payload or 0.0) / 1000)
    elif payload is not None:
        raise UsageError("--payload needs --physics")
    announce = _announcing("hexwire state", "the board")
    with shown(twin, device.wire.servos, offer.ended(), view=offer.view) as stop:
        if messages is not None:
            serve_queue(device, messages, stop=stop, announce=announce, shows=offer.view)
            return
        serve_device(
            device,
            tcp=offer.tcp,
            link=offer.link,
            baud=baud,
            reset_on_open=reset_on_open,
            hands=Hands(device.wire.servos, HEX7BOT),
            rate=(lambda: device.host_rate) if device.host_rate else None,
            stop=stop,
            announce=announce,
            shows=offer.view,
        )


def _announcing(command: str, what: str) -> Callable[[str], None]:
    """What prints the address of an emulated device, and tells people how to reach it.

    Args:
        command: A command that reaches it.
        what: The device.
    """

    def announce(url: str) -> None:
        # From the address to listen on to the address to connect to.
        url = url.replace("-listen://", "://").partition("?")[0]
        say_document(url)
        if sys.stdout.isatty():
            note(f"try '{command} --port {url}' in another terminal; Ctrl-C ends {what}")

    return announce


def _wait_for_eof(ended: threading.Event) -> None:
    # Not through sys.stdin: a thread that holds its lock would abort the interpreter's shutdown.
    while os.read(0, 4096):
        pass
    ended.set()


_ARM_BAUD = 1_000_000
"""Factory setting of the servos of an arm."""
_NUMBER = "[0-9]{1,9}"
_SHOWN = 40
"""Number of typed characters that an error text repeats."""


def _parse_rates(text: str) -> list[int]:
    parts = [part.strip() for part in text.split(",")]
    if not all(re.fullmatch(_NUMBER, part) for part in parts):
        raise UsageError(
            f"{text[:_SHOWN]!r} is not a list of rates: write 1000000, or 1000000,500000 with one for each id"
        )
    rates = [int(part) for part in parts]
    if 0 in rates and len(rates) > 1:
        raise UsageError("a rate of 0 matches any rate: give it alone, for all servos")
    return rates


@sim.command()
@click.option(
    "--arm",
    metavar="NAME",
    help="The six servos of this arm, assembled but not calibrated, with its mechanical stops.",
)
@click.option("--leader", is_flag=True, help="With --arm, a leader arm, whose gears a hand moves easily.")
@click.option("--physics", is_flag=True, help="With --arm, simulate weight, friction and a table with MuJoCo.")
@click.option(
    "--series",
    default="sts_sms",
    show_default=True,
    metavar="S[,S...]",
    help="sts, sms, scs, hls or seven_bot: one for all, or one for each id.",
)
@click.option(
    "--ids", default="1-6", show_default=True, metavar="IDS", help="Such as 1-6 or 1,2,9; duplicate ids collide."
)
@click.option(
    "--baud",
    default="1000000",
    show_default=True,
    metavar="N[,N...]|0",
    help="Rate of the servos: one for all, or one for each id; 0 takes no time and matches any rate.",
)
@click.option("--echo", is_flag=True, help="The adapter echoes what it sends.")
@click.option("--seed", type=int, default=1, metavar="N", help="Seed of the random generator.")
@_offer_options
def bus(
    arm: str | None,
    leader: bool,
    physics: bool,
    series: str,
    ids: str,
    baud: str,
    echo: bool,
    seed: int,
    faults: tuple[str, ...],
    offer: _Offer,
) -> None:
    """Emulate servos on a bus adapter: prints the port to open, and runs until stopped.

    'hexwire sim hand' moves them by hand.
    """
    from hexwire.bus.servos import as_series
    from hexwire.emulator.bus_arms import make_bus_arm
    from hexwire.emulator.bus_device import BusDevice, make_servos
    from hexwire.emulator.faults import FaultPlan
    from hexwire.emulator.hand import Hands

    rates = _parse_rates(baud)
    model: ArmModel | None = None
    twin = None
    if arm is not None:
        if wrong := [f"--{name}" for name in ("series", "ids") if is_typed(name)]:
            raise UsageError(f"the servos of {arm} are known; leave out {' and '.join(wrong)}")
        if rates not in ([0], [_ARM_BAUD]):
            raise UsageError(f"the servos of {arm} are set to {_ARM_BAUD} baud; leave out --baud, or make it 0")
        made = make_bus_arm(arm, leader=leader, seed=seed, start=time.monotonic())
        servos, model = made.servos, made.model
        if physics:
            from hexwire.emulator.physics import PhysicsTwin

            twin = PhysicsTwin(servos, model)
    elif leader or physics:
        raise UsageError(f"{'--leader' if leader else '--physics'} needs --arm")
    else:
        kinds = [as_series(name.strip()) for name in series.split(",")]
        servos = make_servos(kinds, parse_ids(ids), baud=rates, seed=seed, start=time.monotonic())
    plan = FaultPlan.for_bus(faults, seed=seed, start=time.monotonic())
    announce = _announcing("hexwire bus scan", "the bus")
    with shown(twin, servos, offer.ended(), view=offer.view) as stop:
        if offer.tcp is not None:
            device = BusDevice(servos, paced=bool(rates[0]), faults=plan, echo=echo)
            hands = Hands(servos, model)
            serve_device(device, tcp=offer.tcp, link=offer.link, baud=0, hands=hands, stop=stop, announce=announce)
            return
        try:
            from hexwire.emulator.serve_pty import serve_bus
        except ImportError:
            no_terminals()
        serve_bus(
            servos,
            baud=rates[0],
            stop=stop,
            announce=announce,
            link=offer.link,
            faults=plan,
            echo=echo,
            arm=model,
        )


_ALL_THE_WAY = 1.0
"""Degrees within which the joint has gone all the way."""


@sim.command(cls=NumbersCommand)
@click.argument("joint", metavar="JOINT|ID")
@click.argument("degrees", metavar="±DEGREES", type=FiniteFloat("degrees"))
@number_option("--duration", "SECONDS", "Duration of the motion (60 degrees a second).", above=0)
@number_option("--hold", "SECONDS", "Time to hold the joint at the end of the motion.", minimum=0, default=0.0)
@number_option(
    "--strength", "PERCENT", "Torque of the hand, as a percentage of the servo's maximum.", above=0, default=60.0
)
@click.option(
    "--port",
    metavar="URL",
    envvar="HEXWIRE_PORT",
    show_envvar=True,
    help="Port or address of the emulated arm. Optional if only one runs.",
)
@json_option
def hand(
    joint: str,
    degrees: float,
    duration: float | None,
    hold: float,
    strength: float,
    port: str | None,
) -> None:
    """Move a joint of an emulated arm by hand, while other programs use the arm.

    A joint without torque follows; one with torque gives way a little and returns. It ends at the mechanical
    stops of the arm. JOINT is a name such as elbow_flex or J2, or a servo's id.

    --port is the port of 'hexwire sim board' or 'hexwire sim bus', with --tcp one of this machine, or an address
    such as sim://so101 that another program of yours has open and reads, such as 'hexwire serve'. If several do,
    give each a name, as in sim://so101?name=left.
    """
    from hexwire.emulator.hand import HandOrder, usual_seconds
    from hexwire.emulator.serve_hand import move_by_hand

    port = early_port(port)
    if port is not None:
        port = resolve_url(port)
    seconds = usual_seconds(degrees) if duration is None else duration
    result = move_by_hand(port, HandOrder(joint, degrees, seconds, hold, strength / 100))
    moved = f"{decimal(result.moved)} deg"
    if result.torque:
        words = f"has torque: it gave way by {moved} and returns"
    elif result.blocked:
        words = f"moved by {moved}, to its stop"
    elif abs(result.moved - degrees) > _ALL_THE_WAY:
        words = f"moved by {moved}, not {decimal(degrees)}: the hand is too weak or too fast"
    else:
        words = f"moved by {moved}"
    row = {"joint": result.joint, "moved_deg": result.moved, "torque": result.torque, "blocked": result.blocked}
    answer(row, f"{result.joint} {words}")


_PUMA_PORT = 15030
"""The port in the chapter."""


@sim.command()
@click.option(
    "--tcp",
    metavar="HOST:PORT",
    default=f"127.0.0.1:{_PUMA_PORT}",
    show_default=True,
    help="Address for TCP hosts; port 0 selects a free port.",
)
@click.option("--ca", metavar="FILE", help="TLS: certificate authority of the clients; needs --cert and --key.")
@click.option(
    "--cert", metavar="FILE", help="TLS: certificate of this server; 'hexwire cert new' creates the three files."
)
@click.option("--key", metavar="FILE", help="TLS: private key of this server.")
@click.option("--udp", metavar="HOST:PORT", help="Address for UDP hosts.")
@click.option(
    "--peer", metavar="HOST", help="The only host accepted; needed with --udp on an address that others reach."
)
@click.option(
    "--queue", metavar="NAME", help="Offer the POSIX message queue mq:///NAME to one program of this user, too."
)
def puma260(
    tcp: str,
    ca: str | None,
    cert: str | None,
    key: str | None,
    udp: str | None,
    peer: str | None,
    queue: str | None,
) -> None:
    """Emulate a PUMA 260 controller: prints its URLs, and runs until stopped.

    It serves the four channels of the chapter's configuration file on one port, for several dozen hosts at once. On
    an address that others reach, and without TLS, it obeys anyone who connects.
    """
    from hexwire.emulator.puma import EmulatedPuma
    from hexwire.emulator.serve_puma import serve_puma
    from hexwire.link.listener import Listener
    from hexwire.link.tls import TlsFiles
    from hexwire.link.udp import UdpServer
    from hexwire.link.url import is_loopback

    if peer and not udp:
        raise UsageError("--peer needs --udp")
    tls = None
    if ca or cert or key:
        if not (ca and cert and key):
            raise UsageError("TLS needs --ca, --cert and --key together; 'hexwire cert new' creates the files")
        tls = TlsFiles(ca, cert, key)
    host, port = parse_address(tcp)
    listener = Listener(host, port, tls=tls)
    link = UdpServer(*parse_address(udp), peer=peer or "") if udp else None
    if tls is None and not is_loopback(host):
        note(
            f"warning: anyone who reaches TCP on {host} can command this robot; --ca, --cert and --key prevent that"
        )
    if udp and not is_loopback(parse_address(udp)[0]):
        note(f"warning: over UDP anyone can pretend to be {peer}; TCP with --ca, --cert and --key prevents that")
    serve_puma(
        EmulatedPuma(start=time.monotonic()),
        listener=listener,
        udp=link,
        queue=None if queue is None else _queue_link(queue),
        stop=lambda: False,
        announce=_announcing("hexwire --robot puma260 state", "it"),
    )
