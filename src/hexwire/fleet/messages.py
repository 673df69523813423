"""What travels between the server of an arm and its clients: MessagePack with a version.

Owns the messages, their limits and their bytes. A payload is one byte, the version of the schema, then MessagePack.
Whatever arrives, `decode` returns a message of the expected kind or raises `RemoteProtocolError`. Must not know
Zenoh, robots or clocks.
"""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

import msgspec

from hexwire.errors import RemoteProtocolError, UsageError
from hexwire.model.arm import MAX_ACCELERATION, MAX_JERK

__all__ = [
    "VERSION",
    "Answer",
    "Ask",
    "Beat",
    "Cancel",
    "Envelope",
    "Facts",
    "Follow",
    "Goal",
    "Joint",
    "LeaseRequest",
    "Leave",
    "Question",
    "State",
    "StopRequest",
    "Stream",
    "Take",
    "convert",
    "decode",
    "encode",
    "lease_key",
]

VERSION = 1
"""Version of the schema. It grows when a program of an older version could misunderstand a message."""
SHORT = 1 << 15
"""Most bytes of a question, a stop or a request for the lease, which many may send: decoding longer ones would take
time that the others need."""
LARGEST = 1 << 21
"""Most bytes of a message: a trajectory of 10,000 points is smaller."""

_Text = Annotated[str, msgspec.Meta(max_length=4096)]
_Name = Annotated[str, msgspec.Meta(max_length=64)]
_Names = Annotated[tuple[_Name, ...], msgspec.Meta(max_length=64)]
_Floats = Annotated[tuple[float, ...], msgspec.Meta(max_length=64)]
_Rows = Annotated[tuple[float, ...], msgspec.Meta(max_length=640_000)]
_Count = Annotated[int, msgspec.Meta(ge=0, le=2**53)]


class _Message(msgspec.Struct, array_like=True, gc=False):
    pass


# -- states -----------------------------------------------------------------------------------------------


class Stream(_Message, tag=2):
    """What became of the set-points that the holder of the lease publishes, since nobody answers them.

    Attributes:
        lease: Number of its lease, which says whose they are but proves nothing.
        dealt: Number of its last order that was done or refused before the values of the state were sampled.
        refused: How many of them were refused under this lease.
        last: Number of the last of these.
        kind: Why it was, as in `Answer`; and the following.
        text: Its text.
        details: Further values of the error.
        clamped: Joints of the last one that was done whose position was limited; as in `SentTarget`.
        silent: And those that did not answer.
    """

    lease: _Count
    dealt: _Count = 0
    refused: _Count = 0
    last: _Count = 0
    kind: _Name = ""
    text: _Text = ""
    details: dict[str, Any] = {}
    clamped: _Names = ()
    silent: _Names = ()


class State(_Message, tag=1):
    """A state of the arm, and of its lease.

    Attributes:
        server: Number of the server that sends it, another one after each start.
        sequence: Number of the message; one greater each time.
        stamp: Owner's monotonic clock at the newest sample, seconds.
        sent: The same clock when the message was sent.
        wall: Owner's wall clock then, seconds since 1970.
        names: Joint names; no joint if the robot is not connected.
        position: And the following: as in `JointState`.
        holder: Who holds the lease, in words; empty if nobody does.
        held: Why the arm holds; empty if it does not.
        reason: Why the arm is stopped, if it is known.
        error: Why the robot is not connected; empty if it is.
        done: Number of orders that were done before the values were sampled.
        stalled: As in `JointState`, of an arm that is emulated in the server, but in milliseconds.
        stream: What became of the holder's set-points; None if nobody holds the lease.
    """

    server: _Count
    sequence: _Count
    stamp: float
    sent: float
    wall: float
    names: _Names
    position: _Floats
    velocity: _Floats
    load: _Floats
    current: _Floats
    voltage: _Floats
    temperature: _Floats
    flags: Annotated[tuple[_Count, ...], msgspec.Meta(max_length=64)]
    age: _Floats
    board_time: float
    stopped: bool
    tripped: bool
    maintenance: bool
    holder: _Text = ""
    held: _Text = ""
    reason: _Text = ""
    error: _Text = ""
    done: _Count = 0
    stalled: _Count = 0
    # Servers of an older version do not send this.
    stream: Stream | None = None


# -- the lease --------------------------------------------------------------------------------------------


class Take(_Message, tag=1):
    """Take the lease.

    Attributes:
        client: Name of the client, for display.
        force: Pre-empt the holder.
        watchdog: Seconds without a call of the client's program after which the arm is stopped; 0 for never.
        mode: How it is stopped then, as `StopMode`.
        key: Key of the lease that the client holds, and keeps; 0 if it has none.
    """

    client: _Text
    force: bool = False
    watchdog: float = 0.0
    mode: int = 0
    key: _Count = 0


class Beat(_Message, tag=2):
    """Renew the lease.

    Attributes:
        key: Key of the lease.
        idle: Seconds since the client's program last used the arm.
    """

    key: _Count
    idle: float = 0.0


class Leave(_Message, tag=3):
    """Give the lease back.

    Attributes:
        key: Key of the lease.
        finish: A motion that was begun runs to its end.
    """

    key: _Count
    finish: bool = False


LeaseRequest = Take | Beat | Leave


# -- orders -----------------------------------------------------------------------------------------------


class Write(_Message, tag=1):
    """Send a target; see `RobotDriver.write`."""

    names: _Names
    position: _Floats
    duration: float
    # Clients of an older version do not send this.
    guided: bool = False


class Torque(_Message, tag=2):
    """Switch torque; see `RobotDriver.torque`. No names mean all joints."""

    on: bool
    names: _Names | None


class Resume(_Message, tag=3):
    """End a stop."""


class Watchdog(_Message, tag=4):
    """Arm the watchdog of the lease; a time-out of 0 disarms it."""

    timeout: float
    mode: int = 0


class Ioctl(_Message, tag=5):
    """Send a special command; see `RobotDriver.ioctl`."""

    sub_cmd: _Count
    data: Annotated[bytes, msgspec.Meta(max_length=4096)]


class Follow(_Message, tag=6):
    """Follow a trajectory from a time on; the owner follows it, and the answer has its number.

    Attributes:
        names: Its joints.
        times: Seconds from the start, rising.
        positions: Radians, one row of joints after the other.
        velocities: Radians per second, in the same order; empty for none.
        accelerations: Radians per second squared, in the same order; empty for none.
        start: Owner's monotonic clock at the start, as the client estimates it, seconds.
        check: Only check the path, from its own first point; the answer has its duration.
        confirm: It begins only if a `Confirm` comes in time.
    """

    names: _Names
    times: Annotated[tuple[float, ...], msgspec.Meta(max_length=10_000)]
    positions: _Rows
    velocities: _Rows = ()
    accelerations: _Rows = ()
    start: float = 0.0
    check: bool = False
    confirm: bool = False


class Cancel(_Message, tag=7):
    """End a trajectory; the joints hold.

    Attributes:
        number: The trajectory's.
    """

    number: _Count


class Confirm(_Message, tag=8):
    """Let a trajectory begin at its time. A server that does not know this message refuses it.

    Attributes:
        number: The trajectory's.
    """

    number: _Count


Order = Write | Torque | Resume | Watchdog | Ioctl | Follow | Cancel | Confirm


class Envelope(_Message, tag=10):
    """An order with the proof of its right. It is asked; a `Write` may be published, and `Stream` answers it.

    Attributes:
        key: Key of the lease.
        sequence: Number of the order, greater than all before.
        made: Owner's clock when it was made, as the client estimates it, seconds.
        doubt: Uncertainty of the estimate, seconds.
        order: The order.
    """

    key: _Count
    sequence: _Count
    made: float
    doubt: float
    order: Order


# -- questions --------------------------------------------------------------------------------------------


class Ask(_Message, tag=1):
    """A question that moves nothing.

    Attributes:
        what: ``facts``, ``state``, ``clock``, ``goal``, ``probe``, ``ping`` or ``counters``.
        number: Id of a servo, or number of a goal.
    """

    what: _Name
    number: int = 0


class StopRequest(_Message, tag=2):
    """Stop the arm.

    Attributes:
        client: Who stops it, for display.
        mode: As `StopMode`; where only a stop that holds is done, that is done whatever it says.
        key: Key of the client's lease; 0 if it has none.
        sequence: Number of the client's last order before the stop: what it overtakes on the way is void.
        own: Stop it only if no other client has taken the lease with that key.
    """

    client: _Text
    mode: int = 0
    key: _Count = 0
    sequence: _Count = 0
    own: bool = False


Question = Ask | StopRequest


class Joint(_Message, tag=1):
    """A joint's model; see `JointModel`."""

    name: _Name
    servo_id: int
    series: _Name
    neutral: int
    sign: int
    offset: float
    scale: float
    minimum: float
    maximum: float
    max_speed: float
    # Servers of an older version do not send these.
    max_acceleration: float = MAX_ACCELERATION
    max_jerk: float = MAX_JERK
    free_speed: float = 0.0


class Facts(_Message, tag=2):
    """What a client knows of an arm before its first state.

    Attributes:
        robot: Name of the arm's model.
        joints: Its joints.
        rate: States published per second.
        command_rate: Targets per second that it accepts.
        max_age: Greatest age of a set-point, seconds.
        timeout: Seconds of silence after which a lease is lost.
        server: Host, process and version of the server, in words.
        port: URL of the robot at the server.
        holder: Who holds the lease.
        error: Why the robot is not connected; empty if it is.
        clock: Owner's monotonic clock, seconds.
        host: Name of the server's computer.
        watchdog: The robot has a watchdog of its own.
        kept: Where a stop is kept after the server has ended, as `RobotDriver.stop_kept_by`.
        geometry: Robot whose geometry the arm has; empty if it is that of `robot`.
        times_motion: Its board executes trajectories.
    """

    robot: _Name
    joints: Annotated[tuple[Joint, ...], msgspec.Meta(max_length=64)]
    rate: float
    command_rate: float
    max_age: float
    timeout: float
    server: _Text
    port: _Text
    holder: _Text
    error: _Text
    clock: float
    host: _Text = ""
    watchdog: bool = False
    kept: _Name = "board"
    geometry: _Name = ""
    times_motion: bool = False


class Goal(_Message, tag=3):
    """What became of a trajectory; see `GoalReport`."""

    number: _Count
    start: float
    outcome: _Name = ""
    reason: _Name = ""
    text: _Text = ""
    moved: float | None = None
    slips: _Count = 0
    # Servers of an older version do not send these.
    ready: _Name = ""
    doubt: float = 0.0


# -- answers ----------------------------------------------------------------------------------------------


class Answer(_Message, tag=20):
    """What became of an order or a question.

    Attributes:
        kind: Empty if it was done; otherwise the kind of error, see `failures`.
        text: Its text.
        details: Further values of the error.
        value: The result: numbers, texts, lists and tables.
        clock: Owner's monotonic clock, seconds.
        done: Number of orders done so far, this one included; a state with values from after it has at least this
            number.
    """

    kind: _Name
    text: _Text = ""
    details: dict[str, Any] = {}
    value: Any = None
    clock: float = 0.0
    done: _Count = 0


_M = TypeVar("_M")

_encoder = msgspec.msgpack.Encoder()
# Here, and so before any second thread: two threads that make decoders of one kind crash the program (msgspec), and
# Zenoh decodes in many threads.
_decoders: dict[Any, msgspec.msgpack.Decoder[Any]] = {
    kind: msgspec.msgpack.Decoder(kind)
    for kind in (
        *(State, Take, Beat, Leave, LeaseRequest, Envelope),
        *(Ask, StopRequest, Question, Joint, Facts, Goal, Answer),
    )
}
_SHORT_KINDS = frozenset((Take, Beat, Leave, LeaseRequest, Ask, StopRequest, Question))
_HEAD = bytes([VERSION])


_ENVELOPE = bytes([VERSION, 0x96, 10])
"""How an `Envelope` begins: version, an array of six, its tag."""
_UINTS = {0xCC: 1, 0xCD: 2, 0xCE: 4, 0xCF: 8}
"""Bytes of an integer by MessagePack's code for it; smaller than 0x80, the code is the integer."""


def encode(message: _Message) -> bytes:
    """Serialize a message.

    Raises:
        UsageError: A number in it is too large.
    """
    try:
        return _HEAD + _encoder.encode(message)
    except OverflowError:
        raise UsageError("a number is too large for a message: whole numbers are below 2**63") from None


def decode(payload: bytes, kind: type[_M]) -> _M:
    """Parse a message.

    Args:
        payload: What arrived: any bytes.
        kind: Class of the expected message, or a union of such classes; one of those with a decoder.

    Raises:
        RemoteProtocolError: It is not such a message, or its version is another one.
    """
    _check(payload, SHORT if kind in _SHORT_KINDS else LARGEST)
    decoder = _decoders[kind]
    try:
        return decoder.decode(memoryview(payload)[1:])  # type: ignore[no-any-return]  # the decoder is of that kind
    except (msgspec.MsgspecError, ValueError, RecursionError, OverflowError) as error:
        raise RemoteProtocolError(f"not a valid message: {str(error)[:200]}") from None


def convert(value: object, kind: type[_M]) -> _M:
    """The value of an answer, or details of it, as a message or a dataclass.

    Raises:
        RemoteProtocolError: It is not one of that kind.
    """
    try:
        return msgspec.convert(value, kind)
    except (msgspec.MsgspecError, TypeError, ValueError, RecursionError, OverflowError) as error:
        raise RemoteProtocolError(f"not a valid answer: {str(error)[:200]}") from None


def lease_key(payload: bytes) -> int:
    """The key in an `Envelope`, in a time that does not grow with the order in it.

    Args:
        payload: What arrived: any bytes.

    Raises:
        RemoteProtocolError: It does not begin like an envelope, or its version is another one.
    """
    _check(payload, LARGEST)
    if payload[:3] == _ENVELOPE:
        code = payload[3] if len(payload) > 3 else 0xC1
        size = 0 if code < 0x80 else _UINTS.get(code)
        if size is not None and len(payload) >= 4 + size:
            return int.from_bytes(payload[4 : 4 + size], "big") if size else code
    raise RemoteProtocolError("not a valid message: it does not start like an order")


def _check(payload: bytes, largest: int) -> None:
    if not payload:
        raise RemoteProtocolError("an empty message")
    if len(payload) > largest:
        raise RemoteProtocolError(f"a message of {len(payload)} bytes is longer than {largest}")
    version = payload[0]
    if version != VERSION:
        older = "the other program is older than this one" if version < VERSION else "this program is older"
        raise RemoteProtocolError(f"a message of version {version}, not {VERSION}: {older}; update the older one")
