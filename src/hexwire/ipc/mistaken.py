"""Detects the wrong kind of device: which servos, board or other robot is where another one was expected.

Owns the short searches on an open link on which what was asked for is silent, and the errors that name what is
there and the `--robot` to use. Nothing is changed and nothing moves; the rate of the link is restored. Must not
know joints, nor its callers.

The search for servos sends a few pings at the servos' factory rate. They are harmless: servos only answer them, and
a board at its own, slower rate receives a byte or two of noise per ping, outside any frame. It is only used on a
silent line, never with a board that answers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import monotonic

from hexwire.errors import UsageError, WrongDeviceError
from hexwire.link.base import Link, LinkKind
from hexwire.session.connection import Connection
from hexwire.session.negotiate import Negotiated, NegotiationFailed, Negotiator
from hexwire.session.policy import RetryPolicy
from hexwire.wire.modules import ModuleType, module_name
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import BOARD_ID, BROADCAST_ID, iter_status, make_ping
from hexwire.wire.tables import PROTO_CHAPTER, PROTO_HEXWIRE

from .connections import host_connection
from .handle import IpcHandle

__all__ = ["find_robot", "find_servos", "is_board", "is_puma", "is_servo_bus"]

_SERVO_RATE = Series.STS_SMS.baud
_NEAR = 0.1
"""Share by which rates must differ so that a receiver gets no valid packet."""
_FIRST_IDS = range(9)
_MORE_IDS = range(9, 32)
_PING_TIME = 0.003
"""Seconds for one ping and its answer on the line: 0.12 ms of bytes at 1 Mbaud, and a return delay of 0.5 ms."""
_LAST_TIME = 0.035
"""Seconds for the last answers: an adapter with a latency timer delays them by 16 ms."""
_BOARD, _PUMA = ModuleType.ARM_7BOT_ARDUINO_TRX, ModuleType.PUMA260_RBT_IO_SVR
_HOSTS = {_PUMA: ModuleType.PUMA260_HOST_IO_TRX, _BOARD: ModuleType.ARM_7BOT_SERIAL_TRX}
"""The module of each known robot -> that of a host which speaks to it."""
_PINGED = (0, 1)
"""Arms have a servo of one of these ids, and a board with the chapter's firmware answers every ping."""
_ROBOT_PING_TIME = 0.3


def find_servos(link: Link, *, baud: int = _SERVO_RATE) -> tuple[int, ...]:
    """Search for servos, by default at their factory rate, for a tenth of a second.

    Args:
        link: An open link.
        baud: The rate.

    Returns:
        Ids of servos that answered; empty if none did, or if the link's rate cannot be changed or is already this
        rate: then a board would receive the pings, and servos answer those in the board's frames.
    """
    set_baud = getattr(link, "set_baud", None)
    before = getattr(link, "baud", 0)
    if set_baud is None or not before or abs(before - baud) < _NEAR * baud:
        return ()
    try:
        set_baud(baud)
    except UsageError:
        return ()
    try:
        link.flush_input()
        found, heard = _ping(link, (BROADCAST_ID, *_FIRST_IDS))
        if not found and heard:
            # Something answers at this rate, perhaps several servos at the same time.
            found, _ = _ping(link, (BROADCAST_ID, *_MORE_IDS))
        return found
    finally:
        set_baud(before)
        link.flush_input()


def _ping(link: Link, ids: Iterable[int]) -> tuple[tuple[int, ...], bool]:
    """Ids that answered, and whether anything other than echoes arrived."""
    clock: Callable[[], float] = getattr(link, "clock", monotonic)
    data = b""
    pings = [make_ping(servo_id) for servo_id in ids]
    for ping in pings:
        link.post(ping)
        data += _listen(link, clock() + _PING_TIME, clock)
    data += _listen(link, clock() + _LAST_TIME, clock)
    if make_ping(BROADCAST_ID) in data:
        # No servo has that id, so the adapter echoes. Otherwise bytes equal to a ping are the answer of a servo
        # with a low supply.
        for ping in pings:
            data = data.replace(ping, b"", 1)
    # A board whose line knows no rates may be late: what it says of its own is no servo's.
    found = {status.servo_id for status in iter_status(data) if not status.params and status.servo_id != BOARD_ID}
    return tuple(sorted(found)), bool(data)


def _listen(link: Link, until: float, clock: Callable[[], float]) -> bytes:
    data = b""
    while True:
        more = link.read(until)
        data += more
        if not more or clock() >= until:
            return data


def is_servo_bus(url: str, servo_ids: Iterable[int], *, baud: int = 0) -> WrongDeviceError:
    """The error for a servo bus where a board is expected.

    Args:
        url: URL of the link.
        servo_ids: Ids of the servos that answered.
        baud: The rate, if it must be given on the command line; otherwise 0.
    """
    ids = sorted(servo_ids)
    who = f"servo {ids[0]} answers" if len(ids) == 1 else f"servos {', '.join(map(str, ids))} answer"
    at, robot, rate = (f" at {baud} baud", "robot and rate", f" --baud {baud}") if baud else ("", "robot", "")
    return WrongDeviceError(
        f"{url} is a servo bus ({who}{at}), not a board: name its {robot}, as in --robot so101{rate}, or try "
        f"`hexwire bus scan{rate}`"
    )


def is_board(url: str, board: Negotiated, wanted: str = "a servo bus") -> WrongDeviceError:
    """The error for a board where something else is expected, such as a servo bus."""
    firmware = f", firmware {'.'.join(map(str, board.identity.firmware))}" if board.identity else ""
    return WrongDeviceError(
        f"{url} is a controller board (dialect {board.dialect}{firmware}), not {wanted}: use --robot hex7bot, "
        "or `hexwire probe`"
    )


def is_puma(url: str, wanted: str) -> WrongDeviceError:
    """The error for the controller of a PUMA 260 where something else is expected."""
    return WrongDeviceError(f"{url} is a puma260, not {wanted}: use --robot puma260")


def find_robot(link: Link, asked: int | None = None, *, pings: bool = False) -> WrongDeviceError | None:
    """Search for another robot, for a quarter of a second; with `pings`, for 0.4 s more.

    Args:
        link: An open link; what arrives meanwhile is lost to its user.
        asked: The module that does not answer; None if servos do not.
        pings: Search for a board of the chapter, too, and for servos unless `asked` is None.

    Returns:
        The error that says which robot it is; None if there is none.
    """
    # No PUMA 260 is on a serial line: a board that boots there is not kept waiting.
    serial = hasattr(link, "set_baud")
    modules = [module for module in _HOSTS if module != asked and not (serial and module == _PUMA)]
    for module, found in zip(modules, _negotiate(link, modules, PROTO_HEXWIRE), strict=True):
        if isinstance(found, Negotiated):
            return _error(link.url, module, found, asked)
        if found.greeting:
            error = found.as_error(link.url)
            assert isinstance(error, WrongDeviceError)
            return error
    if pings and link.kind is not LinkKind.DATAGRAM:
        (found,) = _negotiate(link, [_BOARD], PROTO_CHAPTER)
        # A board that was asked in the other dialect only is no other robot.
        if isinstance(found, Negotiated) and asked != _BOARD:
            return _error(link.url, _BOARD, found, asked)
        if asked is not None and isinstance(found, NegotiationFailed) and found.servo_id is not None:
            return is_servo_bus(link.url, [found.servo_id])
    return None


def _error(url: str, module: ModuleType, found: Negotiated, asked: int | None) -> WrongDeviceError:
    if asked is not None and asked not in _HOSTS:
        return WrongDeviceError(
            f"{url}: {module_name(asked)} does not answer, but {module_name(module)} does; check its board, "
            "and ?to= of the address"
        )
    wanted = "a servo bus" if asked is None else "a puma260" if asked == _PUMA else "a hex7bot"
    return is_puma(url, wanted) if module == _PUMA else is_board(url, found, wanted)


def _negotiate(link: Link, modules: list[ModuleType], dialect: int) -> list[Negotiated | NegotiationFailed]:
    """Ask all of them at once; what became of each."""
    clock: Callable[[], float] = getattr(link, "clock", monotonic)
    asking: list[tuple[Connection, Negotiator]] = []
    for module in modules:
        ipc = IpcHandle.from_link(link, _HOSTS[module], module)
        connection = host_connection(ipc, None, None, None, policy=RetryPolicy(), epoch=0.0)
        window = _ROBOT_PING_TIME if dialect == PROTO_CHAPTER else 0.0
        negotiator = Negotiator(connection, clock(), boot_window=window, ping_ids=_PINGED, dialect=dialect)
        asking.append((connection, negotiator))
    while True:
        dues = [due for connection, _ in asking if (due := connection.next_timeout()) is not None]
        for connection, _ in asking:
            for frame in connection.data_to_send():
                link.post(frame)
        data = link.read(min(dues, default=clock()))
        for connection, negotiator in asking:
            if data:
                connection.receive(data, clock(), end_of_message=link.kind is LinkKind.DATAGRAM)
            connection.handle_timeout(clock())
            while (event := connection.next_event()) is not None:
                negotiator.handle(event, clock())
        outcomes = [negotiator.outcome for _, negotiator in asking]
        if any(isinstance(outcome, Negotiated) for outcome in outcomes) or None not in outcomes:
            return [outcome or NegotiationFailed(0, 0, 0) for outcome in outcomes]
