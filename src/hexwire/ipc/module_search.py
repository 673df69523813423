"""Which robot is on a link where the one that was asked for is silent?

Owns a short search for the modules of the robots that are known, and for what answers a ping of the chapter: a
board with its firmware, or servos. It only asks; nothing is changed and nothing moves. The error names the
`--robot` to use. Must not know joints, nor who asks.
"""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import TYPE_CHECKING

from hexwire.errors import WrongDeviceError
from hexwire.link.base import LinkKind
from hexwire.session.connection import Connection
from hexwire.session.negotiate import Negotiated, NegotiationFailed, Negotiator
from hexwire.session.policy import RetryPolicy
from hexwire.wire.modules import ModuleType, module_name
from hexwire.wire.tables import PROTO_CHAPTER, PROTO_HEXWIRE

from .connections import host_connection
from .handle import IpcHandle
from .mistaken import is_board, is_puma, is_servo_bus

if TYPE_CHECKING:
    from hexwire.link.base import Link

__all__ = ["find_robot"]

_BOARD, _PUMA = ModuleType.ARM_7BOT_ARDUINO_TRX, ModuleType.PUMA260_RBT_IO_SVR
_HOSTS = {_PUMA: ModuleType.PUMA260_HOST_IO_TRX, _BOARD: ModuleType.ARM_7BOT_SERIAL_TRX}
"""The module of each known robot -> that of a host which speaks to it."""
_PINGED = (0, 1)
"""Arms have a servo of one of these ids, and a board with the chapter's firmware answers every ping."""
_PING_TIME = 0.3
_WRITE_TIME = 1.0


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
        window = _PING_TIME if dialect == PROTO_CHAPTER else 0.0
        negotiator = Negotiator(connection, clock(), boot_window=window, ping_ids=_PINGED, dialect=dialect)
        asking.append((connection, negotiator))
    while True:
        dues = [due for connection, _ in asking if (due := connection.next_timeout()) is not None]
        for connection, _ in asking:
            for frame in connection.data_to_send():
                link.write(frame, clock() + _WRITE_TIME)
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
