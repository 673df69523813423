"""Explains the bytes on a line: a tree of fields for each frame or packet, and a line of words for each layer.

Owns the tree (parts lie in their parent, in order, and the leaves cover every byte once), where each field is, what
it means, in words and units, and the layers with their fields for programs; `reading` finds the values and matches
answers with requests. Takes transfers in order and never raises: corrupt bytes are reported in place, with the
reason, and explaining continues after them. Must not know where transfers come from, nor who shows what is found.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from hexwire.errors import HexwireError
from hexwire.link.tap import Direction, Passed
from hexwire.wire import tables as t
from hexwire.wire.addresses import destination_name
from hexwire.wire.command_frame import BODY_OFFSET, command_name, parse_frame, status_name
from hexwire.wire.modules import module_name
from hexwire.wire.registers import Register, Series
from hexwire.wire.robot_bodies import COMMAND_ARRAYS, JointCommands, TrajectoryPoints
from hexwire.wire.servo_packet import parse_status

from .line_reader import LineReader
from .reading import CEILING, COOKED, Field, FrameReading, Inner, packet_problem, to_hex, u16

if TYPE_CHECKING:
    from .reading import Order, RegisterAccess

__all__ = [
    "BODY",
    "FRAME",
    "SERVO",
    "Explained",
    "Explainer",
    "Layer",
    "Meaning",
    "Part",
    "body_meaning",
    "doubt",
    "filled",
    "flag_words",
    "register_meaning",
]


class Meaning(NamedTuple):
    """What a number of a body means.

    Attributes:
        text: In words.
        unit: Unit of value times scale; empty for a bare number.
        scale: See unit.
        names: Names of values.
        bits: Names of single bits, by mask.
    """

    text: str
    unit: str = ""
    scale: float = 1.0
    names: dict[int, str] | None = None
    bits: dict[str, int] | None = None


FRAME: dict[str, str] = {
    "session header": "Who sends to whom, when, and how long the frame is; the same in both dialects.",
    "sync": "The word by which a receiver finds a frame.",
    "time_sec": "Sender's clock, seconds; a board sends the time since it started.",
    "time_nsec": "Sender's clock, nanoseconds of the second.",
    "sn": "The sender's own counter of frames; a reply does not repeat it.",
    "src": "Module that sent the frame.",
    "dst": "Module that it is for.",
    "type": "3 from a host and 8 from a board on a serial line; over UDP and queues the conversation.",
    "size": "Bytes of the whole frame, this header included. It ends the frame, not the tail.",
    "command frame": "What is to be done, or was done.",
    "flag": "Begins the command frame.",
    "proto": "Dialect: 1 is the chapter's, 2 is hexwire's, with a check, limits, a stop and a watchdog.",
    "seq": "The sender's counter of commands; a reply in dialect 2 repeats it.",
    "pad": "Pad bytes after the check, so that the size is a multiple of 4.",
    "len": "Bytes of the body.",
    "cmd": "The command.",
    "cmd_ext": "Dialect 2: bit 7 reply, bit 6 unsolicited, the low 6 bits the status. Dialect 1: 0.",
    "body": "What belongs to the command.",
    "check": "Dialect 2: CRC-16 of everything before it. FFFF means not checked.",
    "padding": "Pad bytes, AA each.",
    "tail": "Ends every frame: 0D 0A.",
    "rest": "Not decoded: the frame is damaged.",
    "garbage": "Bytes that belong to no frame and no packet.",
}
"""Session header and command frame."""

SERVO: dict[str, str] = {
    "servo packet": "What is on the wire between a board or an adapter and the servos.",
    "header": "FF FF begins a packet; a legacy 7Bot servo and a board's own error answer with FF F5.",
    "id": "The servo that is asked, or that answers; 254 is all of them.",
    "length": "Parameters plus 2. In a legacy servo's answer to a ping it is 6, the size of the packet.",
    "instruction": "What the servo is to do.",
    "error": "Faults that the servo reports, one bit each; 0 is none.",
    "address": "First register.",
    "count": "Bytes to read, from that register on.",
    "width": "Bytes for each servo.",
    "params": "Parameters.",
    "checksum": "NOT of the low byte of the sum from the id to the last parameter.",
    "row": "What one servo gets.",
    "packet": "Should be a servo packet, but is none.",
}
"""Servo packets."""

_COUNT = "encoder count"
_MASK = "joints, bit i for row i of IDENTIFY"
_STOP = {0: "hold", 1: "torque off"}
_SERIES = {code: name for name, code in t.SERIES_CODES.items()}
_MODES = {0: "position", 1: "teach"}
_SIGNALS = {1: "stop and hold", 2: "stop without torque", 3: "resume", 4: "torque on", 5: "torque off"}
_OUTPUTS = {"pump": 1, "valve": 2, "buzzer": 4}

_BOARD_CLOCK = "The board's clock when it made the reply; wraps after 71.6 minutes."
_TOWARDS = "Point towards which the joints move."
_PATH_STATES = {code: name for name, code in t.TRAJECTORY_STATES.items()}

BODY: dict[str, Meaning] = {
    "packet": Meaning("A servo packet."),
    "protocol": Meaning("Version of the protocol."),
    "fw_major": Meaning("Firmware version, first number."),
    "fw_minor": Meaning("Firmware version, second number."),
    "fw_patch": Meaning("Firmware version, third number."),
    "boot_id": Meaning("New at every reset of the board."),
    "capabilities": Meaning("What the board can do.", bits=t.CAPABILITIES),
    "max_frame": Meaning("Longest frame that the board takes.", "bytes"),
    "board_flags": Meaning("State of the board.", bits=t.BOARD_FLAGS),
    "robot_flags": Meaning("State of the robot controller.", bits=t.ROBOT_FLAGS),
    "joints": Meaning("Number of rows, one for each joint."),
    "servo_id": Meaning("Servo of the joint; 254 is every joint.", names={t.BROADCAST_ID: "every joint"}),
    "series": Meaning("Series of the servo.", names=_SERIES),
    "present": Meaning("Whether the servo answered its last request.", names={0: "no", 1: "yes"}),
    "fields": Meaning("What each row has besides position and status.", bits=t.STATE_FIELDS),
    "time_us": Meaning("The board's clock at the newest sample; wraps after 71.6 minutes.", "s", 1e-6),
    "spare": Meaning("Not used."),
    "position": Meaning("Position, two's complement.", _COUNT),
    "status": Meaning("State of the servo.", bits=t.SERVO_FLAGS),
    "speed": Meaning("Speed.", "count/s"),
    "load": Meaning("Drive, signed.", "% of full PWM", 0.1),
    "voltage": Meaning("Supply voltage.", "V", 0.1),
    "temperature": Meaning("Temperature.", "degC"),
    "current": Meaning("Motor current.", "A", 0.001),
    "age": Meaning("Time since the sample; 65535 is never.", "s", 0.001, {65535: "never"}),
    "period_ms": Meaning("Time between two reports; 0 ends them.", "s", 0.001, {0: "no reports"}),
    "duration_ms": Meaning("Time for the motion; the reply has what the speed limits made of it.", "s", 0.001),
    "count": Meaning("Number of rows or chunks."),
    "flags": Meaning("Bit 0: what was asked for was changed to fit the limits.", bits={"clamped": 1}),
    "on": Meaning("On or off.", names={0: "off", 1: "on"}),
    "mask": Meaning(f"Which {_MASK}."),
    "mode": Meaning("What a stop does.", names=_STOP),
    "timeout_ms": Meaning("Time limit; 0 is never.", "s", 0.001),
    "version": Meaning("Version of the stored settings."),
    "id": Meaning("Number of the trajectory; the host chooses it."),
    "state": Meaning("State of the trajectory.", names=_PATH_STATES),
    "brake_ms": Meaning("Time in which the joints come to rest on the path when they must.", "s", 0.001),
    "capacity": Meaning("Points that fit."),
    "rate": Meaning("Rate of the host line.", "bit/s"),
    "lead_ms": Meaning("How far ahead of the clock targets are sent.", "s", 0.001),
    "last": Meaning("Whether these are the last points.", names={0: "no", 1: "yes"}),
    "first": Meaning("Index of the first of these points."),
    "next": Meaning("Index of the point after the last one that is there."),
    "free": Meaning("Points that fit now."),
    "late": Meaning("Targets that were sent late."),
    "now": Meaning("Whether it starts at once.", names={0: "no", 1: "yes"}),
    "minimum": Meaning("Lowest position that the board allows.", _COUNT),
    "maximum": Meaning("Highest position that the board allows.", _COUNT),
    "neutral": Meaning("Count at the joint's zero.", _COUNT),
    "sign": Meaning("Direction in which the counts grow: 1 or -1."),
    "reply_length": Meaning("Bytes of the expected answer; 0 is none.", "bytes"),
    "uptime_ms": Meaning("Time since the reset.", "s", 0.001),
    "frames_received": Meaning("Valid frames since the reset."),
    "frames_sent": Meaning("Frames sent since the reset."),
    "bad_checks": Meaning("Frames with a wrong check."),
    "bad_frames": Meaning("Frames with a wrong tail, or cut short."),
    "resyncs": Meaning("Times that the board had to search for the next frame."),
    "bytes_dropped": Meaning("Bytes outside valid frames."),
    "repeats": Meaning("Repeated requests, answered from store."),
    "bus_transactions": Meaning("Requests to servos."),
    "bus_retries": Meaning("Requests to servos that were repeated."),
    "bus_timeouts": Meaning("Requests to servos without an answer."),
    "bus_bad": Meaning("Bad answers of servos."),
    "watchdog_trips": Meaning("Times that the watchdog stopped the arm."),
    "queue_high_water": Meaning("Most requests that waited at once."),
    "loop_us_max": Meaning("Longest turn of the board's loop.", "s", 1e-6),
    "message_id": Meaning("Message to which the chunks belong."),
    "index": Meaning("Which chunk, from 0."),
    "cmd": Meaning("Command of the whole message."),
    "cmd_ext": Meaning("cmd_ext of the whole message."),
    "chunk": Meaning("A part of the message's body."),
    "value": Meaning("Outputs that are on.", bits=_OUTPUTS),
    "signal": Meaning("Signal to the robot controller.", names=_SIGNALS),
    "arrays": Meaning("Which arrays follow the names."),
    "data": Meaning("Names and numbers of the joints."),
    "counts": Meaning("Motor position; counts 5 and 6 of a PUMA 260 also turn with joints 4 and 5.", _COUNT),
    "effort": Meaning("Effort.", "% of full", 0.1),
    "points": Meaning("Number of waypoints."),
    "axes": Meaning("Number of axes."),
    "buttons": Meaning("Buttons that are down, bit i for button i."),
    "axis": Meaning("Position of the axis; 32767 is its end."),
}
"""Fields of bodies, by name."""

_SPECIAL: dict[tuple[str, str], Meaning] = {
    ("TRAJECTORY_BEGIN", "flags"): Meaning("Form of the path, and its end.", bits=t.TRAJECTORY_FLAG),
    ("TRAJECTORY_POINTS", "count"): Meaning("Number of points."),
    ("TRAJECTORY_POINTS", "points"): Meaning("Each: time since the one before, then the joints."),
    ("TRAJECTORY_POINTS", "index"): Meaning(_TOWARDS),
    ("TRAJECTORY_STATUS", "index"): Meaning(_TOWARDS),
    ("TRAJECTORY_POINTS", "time_us"): Meaning(_BOARD_CLOCK, "s", 1e-6),
    ("TRAJECTORY_STATUS", "time_us"): Meaning(_BOARD_CLOCK, "s", 1e-6),
    ("TRAJECTORY_START", "time_us"): Meaning("The board's clock at the start of the path.", "s", 1e-6),
    ("REPORT", "mask"): Meaning(f"Which {_MASK}."),
    ("IO", "mask"): Meaning("Outputs to set; 0 reads.", bits=_OUTPUTS),
    ("ROBOT_MODE", "mode"): Meaning("Mode of the robot controller.", names=_MODES),
    ("ROBOT_PROBE", "mode"): Meaning("Mode of the robot controller.", names=_MODES),
    ("ROBOT_SIGNAL", "mode"): Meaning("Mode of the robot controller.", names=_MODES),
    ("JOINT_TRAJECTORY", "flags"): Meaning("Bit 0: the waypoints have speeds.", bits={"speeds": 1}),
    ("JOINT_TRAJECTORY", "data"): Meaning("Waypoints: time from the start, positions and speeds of every joint."),
    ("TRANSACT", "timeout_ms"): Meaning("Time limit for the answer; 0 is 20 ms.", "s", 0.001),
    ("FRAGMENT", "count"): Meaning("Number of chunks of the message."),
    ("FRAGMENT_MISSING", "count"): Meaning("Number of chunks that are missing; 0: all arrived."),
    ("LIMITS", "speed"): Meaning("Highest speed that the board allows.", "count/s"),
    ("JOINT_STATE", "position"): Meaning("Position at the last sample, two's complement.", _COUNT),
    ("JOINT_MOVE", "position"): Meaning("Target, two's complement.", _COUNT),
}


def body_meaning(command: str, field: str) -> Meaning:
    """What a field means in the body of a command."""
    return _SPECIAL.get((command, field)) or BODY.get(field) or Meaning("")


def flag_words(value: int, bits: dict[str, int]) -> str:
    """Names of the bits that are set; unknown ones as a number."""
    names = [name.replace("_", " ") for name, bit in bits.items() if value & bit]
    rest = value & ~sum(bits.values())
    return ", ".join([*names, *([f"0x{rest:02X}"] if rest else [])]) or "none"


def _flagged(words: str, flags: int) -> str:
    """The words for a body, with the state of the board that it tells."""
    return f"{words} [{flag_words(flags, t.BOARD_FLAGS)}]" if flags else words


def register_meaning(register: Register | None) -> str:
    """What a register is: kind of memory, access, range and what the vendor's tables say; empty if unknown."""
    if register is None:
        return ""
    area = {"eeprom": "Stored", "ram": "Not stored", "factory": "Set at the factory"}[register.area]
    parts = [f"{area}, {'read and write' if register.access == 'rw' else 'read only'}"]
    if register.minimum is not None and register.maximum is not None:
        parts.append(f"{register.minimum} to {register.maximum}")
    if register.default is not None:
        parts.append(f"from the factory {register.default}")
    if register.sign_bit is not None:
        parts.append(f"bit {register.sign_bit} is the sign")
    text = ", ".join(parts) + "."
    return f"{text} {register.note[0].upper()}{register.note[1:]}." if register.note else text


@dataclass(frozen=True, slots=True)
class Part:
    """A layer, a group of fields, or a field.

    Attributes:
        name: Its name, as in PROTOCOL.md.
        start: Offset of its first byte in the frame.
        end: Offset after its last byte.
        words: Its value in words.
        meaning: What it is, in words; empty if unknown.
        value: Its number, or None.
        problem: What is wrong or doubtful about it; empty if nothing is.
        parts: What it consists of, without gaps; empty for a field.
    """

    name: str
    start: int
    end: int
    words: str = ""
    meaning: str = ""
    value: int | float | None = None
    problem: str = ""
    parts: tuple[Part, ...] = ()

    def leaves(self) -> Iterator[Part]:
        """The fields, in the order of their bytes."""
        waiting = [self]
        while waiting:
            part = waiting.pop()
            if part.parts:
                waiting.extend(reversed(part.parts))
            else:
                yield part

    def path(self, offset: int) -> tuple[Part, ...]:
        """The parts that contain a byte, from the whole frame to the field; empty if none does."""
        found: list[Part] = []
        inside: tuple[Part, ...] = (self,)
        while inside:
            part = next((each for each in inside if each.start <= offset < each.end), None)
            if part is None:
                break
            found.append(part)
            inside = part.parts
        return tuple(found)

    def rows(self, depth: int = 0) -> Iterator[tuple[int, Part]]:
        """All parts with their depth, a parent before what it consists of."""
        yield depth, self
        for part in self.parts:
            yield from part.rows(depth + 1)

    def as_fields(self) -> dict[str, Any]:
        """All attributes as plain values for JSON; empty ones are left out."""
        fields: dict[str, Any] = {"name": self.name, "start": self.start, "end": self.end}
        for key in ("words", "meaning", "problem"):
            if getattr(self, key):
                fields[key] = getattr(self, key)
        if self.value is not None:
            fields["value"] = self.value
        if self.parts:
            fields["parts"] = [part.as_fields() for part in self.parts]
        return fields


def filled(parts: Iterable[Part], start: int, end: int, name: str = "rest", meaning: str = "") -> tuple[Part, ...]:
    """The parts in a range, with a part of this name for each gap.

    Parts without bytes, and what overlaps an earlier part or is outside of the range, are left out.
    """
    found: list[Part] = []
    at = start
    for part in parts:
        if not at <= part.start < part.end <= end:
            continue
        if at < part.start:
            found.append(Part(name, at, part.start, meaning=meaning))
        found.append(part)
        at = part.end
    if at < end:
        found.append(Part(name, at, end, meaning=meaning))
    return tuple(found)


_HEADER_NAMES = tuple(name for name, _, _ in t.HEADER_FIELDS)
_HEADER = struct.Struct("<" + "".join({"u32": "I", "i32": "i"}[kind] for _, kind, _ in t.HEADER_FIELDS))
_COOKED = "tail 0A 0A: the port was left with ICRNL, and every 0D in it became 0A"
_NO_FRAME = "not part of a frame"
_NO_PACKET = "not a servo packet"
_CEILING = f"hazard: {CEILING}"
_OTHER_SERIES = "the header of another series"
_BOARD_ERROR = "board error "
_LEGACY = Series.SEVEN_BOT.value
_FLAGGED = {
    name for name, row in t.COMMAND_ROWS.items() if any(field[0] == "board_flags" for field in row.reply.fields)
}
_SAMPLE = 16
_DOUBT = " ! "


def doubt(reading: FrameReading) -> str:
    """What is wrong or doubtful about a frame; empty if nothing is."""
    if reading.kind in ("bad", "garbage"):
        return reading.problem or FRAME["garbage"]
    return reading.text.partition(_DOUBT)[2]


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer of an explanation: its name, a line of text, and its fields for programs."""

    name: str
    text: str
    fields: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Explained:
    """One frame, or bytes that are not a frame.

    Attributes:
        direction: Sent or received.
        time: Time of its last byte.
        kind: frame, servo packet, bad, or garbage.
        data: Its bytes.
        text: One line.
        layers: From the outermost to the innermost.
        problem: Why it is bad, or what is doubtful; empty if nothing is.
        reading: The short line that the project's analysers show (`reading`).
    """

    direction: Direction
    time: float
    kind: str
    data: bytes
    text: str
    layers: tuple[Layer, ...] = ()
    problem: str = ""
    reading: str = ""

    def as_fields(self) -> dict[str, Any]:
        """All attributes as plain values for JSON."""
        fields: dict[str, Any] = {
            "direction": self.direction.value,
            "time_s": self.time,
            "kind": self.kind,
            "text": self.text,
            "reading": self.reading,
            "hex": self.data.hex(" ").upper(),
        }
        if self.problem:
            fields["problem"] = self.problem
        return fields | {layer.name: layer.fields for layer in self.layers}


class Explainer:
    """Explains the traffic of one link, transfer by transfer.

    Args:
        series: Name of the series of all servos, or board: the series of each Hex7Bot servo, by id.
        bus: Whether the line is a servo bus without a board. If None, it is if it begins with a servo packet.
    """

    def __init__(self, series: str = "board", *, bus: bool | None = None) -> None:
        self.lines = LineReader(series, bus=bus)
        self._reader = self.lines.reader

    def feed(self, passed: Passed) -> Iterator[Explained]:
        """Explain the frames that this transfer completes."""
        yield from map(self.explain, self.lines.feed(passed))

    def finish(self) -> Iterator[Explained]:
        """Explain the incomplete bytes at the end."""
        yield from map(self.explain, self.lines.finish())

    def explain(self, reading: FrameReading) -> Explained:
        """Explain one frame, packet, or bytes that are neither."""
        if reading.kind == "frame":
            return self._explain_frame(reading)
        if reading.kind == "packet":
            return self._explain_packet(reading)
        data = reading.data
        problem = reading.problem or (_NO_PACKET if reading.line == "bus" else _NO_FRAME)
        sample = data[:16].hex(" ").upper() + (" ..." if len(data) > 16 else "")
        text = f"{reading.kind}, {len(data)} bytes, {problem}: {sample}"
        return Explained(reading.way, reading.time, reading.kind, data, text, (), problem, reading.text)

    def dissect(self, reading: FrameReading) -> Part:
        """The tree of one frame, packet, or bytes that are neither; its leaves cover every byte once."""
        size = len(reading.data)
        if reading.kind == "frame":
            parts = self._frame(reading)
        elif reading.kind == "packet":
            parts = (self._packet(Inner(reading.data, 0, "bus", None), 0, reading),)
        elif reading.kind == "bad":
            parts = _bad_packet(reading) if reading.line == "bus" else _bad_frame(reading)
        else:
            parts = (Part("garbage", 0, size, to_hex(reading.data, _SAMPLE), FRAME["garbage"]),)
        name = reading.kind
        if name == "bad":
            name = "damaged packet" if reading.line == "bus" else "damaged frame"
        return Part(name, 0, size, reading.text, "", None, doubt(reading), filled(parts, 0, size))

    # -- layers -------------------------------------------------------------------------------------

    def _explain_frame(self, reading: FrameReading) -> Explained:
        raw = reading.data
        layers = [_session_layer(raw), _command_layer(raw)]
        inner = self._inner(reading)
        if inner is None and u16(raw, 36):
            layers.append(self._body_layer(reading))
        elif inner is not None and inner.packet:
            layers.append(self._servo_layer(inner.packet, reading, inner.where))
        asked = reading.answers
        if asked is not None:
            took, seq = (reading.time - asked.time) * 1000, asked.data[34]
            text = f"answers seq {seq}" + (f" after {took:.1f} ms" if reading.time and asked.time else "")
            layers.append(Layer("pairing", text, {"request_seq": seq, "took_ms": round(took, 3)}))
        problem = _COOKED if raw.endswith(COOKED) else ""
        text = str(parse_frame(raw[:-2] + t.TAIL))
        return Explained(reading.way, reading.time, "frame", raw, text, tuple(layers), problem, reading.text)

    def _body_layer(self, reading: FrameReading) -> Layer:
        fields: dict[str, Any] = {"text": reading.words}
        flags = self._board_flags(reading)
        if flags:
            names = [name.replace("_", " ") for name, bit in t.BOARD_FLAGS.items() if flags & bit]
            fields["board_flags"] = names
        return Layer("body", _flagged(reading.words, flags), fields)

    def _explain_packet(self, reading: FrameReading) -> Explained:
        layer = self._servo_layer(reading.data, reading, "bus")
        return Explained(
            reading.way, reading.time, "servo packet", reading.data, layer.text, (layer,), "", reading.text
        )

    def _servo_layer(self, data: bytes, reading: FrameReading, where: str) -> Layer:
        """Fields of a packet in a frame or on a bus."""
        words, reader = reading.words, self._reader
        try:
            parse_status(data, as_it_is=True)
        except HexwireError as error:
            return Layer("servo", words, {"problem": str(error)})
        fields: dict[str, Any] = {"id": data[2]}
        series = reader.series_of(data[2])
        if _is_status(reading, data):
            fields |= {"error": data[4], "checksum": "good"}
            if words.startswith(_BOARD_ERROR):
                name = words.removeprefix(_BOARD_ERROR).partition(",")[0].replace(" ", "_")
                return Layer("servo", words, fields | {"board_error": name})
            if series and (series == _LEGACY) != (data[1] == t.LEGACY_HEADER[1]):
                fields["hazard"] = _OTHER_SERIES
                words += f", {_OTHER_SERIES}: is this the right servo?"
            asked = self._asked(reading)
            items = reader.answer_items(data, asked, where)
            if items and asked is not None:
                fields["registers"] = list(_values(items, Series(series or _LEGACY), asked[5]))
            return Layer("servo", words, fields)
        name = reader.tables["instructions"].get(data[4])
        fields |= {"instruction": name.replace(" ", "_") if name else data[4], "checksum": "good"}
        access = reader.access(data)
        series = None if access is None else self._series(access, data)
        if access is not None and series:
            table = Series(series)
            if name in ("write", "reg write"):
                items = reader.register_items(series, access.address, data[6:-1], None)
                fields["registers"] = list(_values(items, table, access.address))
            elif name in ("read", "sync read"):
                register = table.at(access.address)
                fields["register"] = register.name if register else f"0x{access.address:02X}"
        if words.endswith(CEILING):
            fields["hazard"] = _CEILING
        return Layer("servo", words, fields)

    # -- frames -------------------------------------------------------------------------------------

    def _inner(self, reading: FrameReading) -> Inner | None:
        """The servo packet in the body of a frame; None if its command has none."""
        data = reading.data
        return self._reader.inner_packet(data, data[BODY_OFFSET : BODY_OFFSET + u16(data, 36)], reading.answer)

    def _asked(self, reading: FrameReading) -> bytes | None:
        """The servo packet of the request that a packet, or the one in a frame, answers; None if unknown."""
        request = reading.answers
        if request is None or request.kind == "packet":
            return None if request is None else request.data
        inner = self._inner(request)
        return None if inner is None else inner.packet

    def _frame(self, reading: FrameReading) -> tuple[Part, ...]:
        data = reading.data
        end = BODY_OFFSET + u16(data, 36)
        parts = list(_command_header(data))
        if end > BODY_OFFSET:
            parts.append(self._body(reading, data[BODY_OFFSET:end]))
        parts += _closing(data, end, "")
        header, words = tuple(_header(data)), _session_words(_header_values(data), data[33])
        session = Part("session header", 0, 32, words, FRAME["session header"], parts=header)
        return (session, _layer("command frame", 32, len(data), _command_words(data), parts))

    def _board_flags(self, reading: FrameReading) -> int:
        """The state of the board in a frame's body; 0 if it does not tell."""
        if command_name(reading.data[38]) not in _FLAGGED:
            return 0
        rows = self._rows(reading)
        return next((item.value or 0 for item in rows[0] if item.name == "board_flags"), 0) if rows else 0

    def _rows(self, reading: FrameReading) -> list[list[Field]] | None:
        """The fields of a frame's body, then those of each row; None if it does not fit its command."""
        data, layout = reading.data, self._reader.layout(reading.data)
        body = data[BODY_OFFSET : BODY_OFFSET + u16(data, 36)]
        return self._reader.body_items(body, layout) if layout else None

    def _body(self, reading: FrameReading, body: bytes) -> Part:
        data, at, end = reading.data, BODY_OFFSET, BODY_OFFSET + len(body)
        inner = self._inner(reading)
        name = command_name(data[38])
        if inner is not None:
            before = [
                _number(name, Field(each, at + i, at + i + 1, body[i], "")) for i, each in _transact(inner.start)
            ]
            start = at + inner.start
            if start >= end:
                packet = None
            elif packet_problem(inner.packet):
                problem = packet_problem(inner.packet)
                text = to_hex(inner.packet, _SAMPLE)
                packet = Part("packet", start, end, text, SERVO["packet"], None, problem)
            else:
                packet = self._packet(inner, start, reading)
            if packet is not None and not before:
                return packet
            parts = (*before, *([packet] if packet is not None else []))
            return Part("body", at, end, reading.words, t.COMMAND_DOCS.get(name, ""), parts=filled(parts, at, end))
        rows = self._rows(reading)
        if rows is None:
            problem = "the body does not fit the command" if data[38] in self._reader.tables["commands"] else ""
            return Part("body", at, end, to_hex(body, _SAMPLE), FRAME["body"], None, problem)
        parts_of = [*self._items(name, rows[0], body, at)]
        for number, items in enumerate(rows[1:]):
            fields = tuple(self._items(name, items, body, at))
            text = ", ".join(f"{field.name} {field.words}" for field in fields)
            parts_of.append(Part(f"row {number}", fields[0].start, fields[-1].end, text, parts=fields))
        return Part(
            "body",
            at,
            end,
            _flagged(reading.words, self._board_flags(reading)),
            t.COMMAND_DOCS.get(name, ""),
            parts=filled(parts_of, at, end),
        )

    def _items(self, command: str, items: list[Field], body: bytes, at: int) -> Iterator[Part]:
        for item in items:
            if item.value is not None:
                yield _number(command, item._replace(start=at + item.start, end=at + item.end))
            elif item.end > item.start:
                data = body[item.start : item.end]
                parts = tuple(_arrays(command, body, item.start, at))
                meaning = body_meaning(command, item.name).text
                yield Part(item.name, at + item.start, at + item.end, to_hex(data, _SAMPLE), meaning, parts=parts)

    # -- servo packets ------------------------------------------------------------------------------

    def _packet(self, inner: Inner, at: int, reading: FrameReading) -> Part:
        """A valid servo packet at an offset in the frame."""
        data = inner.packet
        end = at + len(data)
        status = _is_status(reading, data)
        if status:
            bits = flag_words(data[4], t.STATUS_BITS)
            words = reading.words if reading.words.startswith("board error") else bits
            fourth = Part("error", at + 4, at + 5, words, SERVO["error"], data[4])
        else:
            name = self._reader.tables["instructions"].get(data[4], f"0x{data[4]:02X}")
            fourth = Part("instruction", at + 4, at + 5, name, SERVO["instruction"], data[4])
        params = self._answer(inner, self._asked(reading)) if status else self._request(data, inner.order)
        parts = [
            *_packet_head(data, at),
            fourth,
            *(_moved(part, at + 5) for part in params),
            Part("checksum", end - 1, end, f"{data[-1]:02X} good", SERVO["checksum"], data[-1]),
        ]
        filling = filled(parts, at, end, "params", SERVO["params"])
        filling = tuple(_with_bytes(part, data, at) for part in filling)
        return Part("servo packet", at, end, reading.words, SERVO["servo packet"], parts=filling)

    def _answer(self, inner: Inner, asked: bytes | None) -> list[Part]:
        data = inner.packet
        items = self._reader.answer_items(data, asked, inner.where)
        series = self._reader.series_of(data[2]) or ("seven_bot" if data[1] == 0xF5 else None)
        return [] if items is None or asked is None else list(_registers(items, series, asked[5]))

    def _series(self, access: RegisterAccess, data: bytes) -> str | None:
        """The series whose registers a request names: that of its first servo."""
        return self._reader.series_of((access.servos or data[2:3])[0])

    def _request(self, data: bytes, order: Order | None) -> list[Part]:
        access, inst = self._reader.access(data), data[4]
        if access is None:
            return []
        parts = [_address(self._series(access, data), access.address)]
        if inst in (t.INSTRUCTIONS["WRITE"], t.INSTRUCTIONS["REG_WRITE"]):
            return parts + self._written(data[2], access.address, 1, data[6:-1], None)
        if access.size is None:
            return []
        several = inst == t.INSTRUCTIONS["SYNC_WRITE"]
        name = "width" if several else "count"
        parts.append(Part(name, 1, 2, f"{access.size} bytes", SERVO[name], access.size))
        for servo, start in zip(access.servos, access.starts, strict=True):
            number = Part("id", start - 1, start, f"servo {servo}", SERVO["id"], servo)
            if several:
                values = data[5 + start : 5 + start + access.length]
                parts.append(_row(number, self._written(servo, access.address, start, values, order), values))
            elif inst == t.INSTRUCTIONS["SYNC_READ"]:
                parts.append(number)
        return parts

    def _written(self, servo: int, address: int, start: int, data: bytes, order: Order | None) -> list[Part]:
        """The registers that one servo gets, from `start` in the parameters; none if its series is unknown."""
        series = self._reader.series_of(servo)
        if not series:
            return []
        items = self._reader.register_items(series, address, data, order)
        return [_moved(part, start) for part in _registers(items, series, address)]


def _session_layer(raw: bytes) -> Layer:
    fields: dict[str, Any] = _header_values(raw)
    words = _session_words(fields, raw[33])
    del fields["sync"]
    return Layer("session", words, fields | {"time": _seconds_of(fields)})


def _command_layer(raw: bytes) -> Layer:
    check, verdict = _check_words(raw)
    fields: dict[str, Any] = {
        "dialect": raw[33],
        "seq": raw[34],
        "cmd": raw[38],
        "name": command_name(raw[38]),
        "cmd_ext": raw[39],
        "length": u16(raw, 36),
        "check": check,
    }
    words = _command_words(raw)
    if _has_marker(raw):
        fields["hazard"] = "0D 0A inside"
        verdict = words[words.rindex(verdict) :]
    elif raw[33] != t.PROTO_CHAPTER and raw[39] & t.EXT_REPLY:
        fields["status"] = status_name(raw[39] & t.EXT_STATUS_MASK)
    return Layer("command", words, fields | {"check_verdict": verdict})


def _values(items: Iterable[Field], series: Series, address: int) -> Iterator[dict[str, Any]]:
    for item in items:
        register, raw = series.at(address + item.start), item.value
        if register is None or register.name != item.name or raw is None:
            yield {"address": address + item.start, "raw": raw}
            continue
        if register.sign_bit is not None and raw > 0:
            # Bits above the sign mean nothing; the words show them all the same.
            raw &= (1 << register.sign_bit) - 1
        entry: dict[str, Any] = {"address": register.address, "name": register.name, "raw": raw}
        if register.si_unit:
            entry["value"], entry["unit"] = round(register.to_si(raw), 6), register.si_unit
        yield entry


def _is_status(reading: FrameReading, packet: bytes) -> bool:
    """Whether a packet, or the one in a frame, is an answer of a servo or of a board."""
    return reading.answer or packet[1] == t.LEGACY_HEADER[1]


def _transact(start: int) -> Iterator[tuple[int, str]]:
    """The fields before the packet of TRANSACT."""
    return enumerate(("reply_length", "timeout_ms")[:start])


def _layer(name: str, start: int, end: int, words: str, parts: list[Part]) -> Part:
    return Part(name, start, end, words, FRAME[name], parts=filled(parts, start, end))


def _moved(part: Part, by: int) -> Part:
    inside = tuple(_moved(each, by) for each in part.parts)
    return Part(
        part.name, part.start + by, part.end + by, part.words, part.meaning, part.value, part.problem, inside
    )


def _with_bytes(part: Part, data: bytes, at: int) -> Part:
    """A field without words, with its bytes as words."""
    if part.words or part.parts:
        return part
    text = to_hex(data[part.start - at : part.end - at], _SAMPLE)
    return Part(part.name, part.start, part.end, text, part.meaning, part.value, part.problem)


def _header(data: bytes) -> Iterator[Part]:
    """The fields of the session header, as far as the bytes reach."""
    for name, kind, at in t.HEADER_FIELDS:
        end = at + 4
        if end > len(data):
            return
        value = int.from_bytes(data[at:end], "little", signed=kind[0] == "i")
        words = str(value)
        if name in ("src", "dst"):
            words = f"{value} {module_name(value)}" if value in t.MODULES.values() else words
        elif name == "sync":
            words = to_hex(data[at:end])
        yield Part(name, at, end, words, FRAME[name], value)


def _header_values(frame: bytes) -> dict[str, int]:
    """The numbers of a session header by name."""
    return dict(zip(_HEADER_NAMES, _HEADER.unpack_from(frame), strict=True))


def _session_words(header: Mapping[str, int], dialect: int) -> str:
    name = module_name if dialect == t.PROTO_CHAPTER else destination_name
    return (
        f"{module_name(header['src'])} -> {name(header['dst'])}, sn {header['sn']}, "
        f"time {_seconds_of(header):.6f} s, type {header['type']}, size {header['size']}"
    )


def _seconds_of(header: Mapping[str, int]) -> float:
    return header["time_sec"] + header["time_nsec"] / 1e9


def _check_words(frame: bytes) -> tuple[str, str]:
    """The check of a frame, and what it is worth."""
    check = u16(frame, BODY_OFFSET + u16(frame, 36))
    if check == t.UNCHECKED:
        return f"{check:04X}", "not checked"
    return f"{check:04X}", "good" if frame[33] == t.PROTO_HEXWIRE else "of an unknown kind, not verified"


def _command_words(frame: bytes) -> str:
    """The command frame in words."""
    told = _ext_words(frame[33], frame[39]).strip()
    told = f"{told}, " if told not in ("", "request") else ""
    hazard = "; 0D 0A inside: the chapter's board truncates this frame" if _has_marker(frame) else ""
    name, size = command_name(frame[38]), u16(frame, 36)
    check = " ".join(_check_words(frame))
    return f"dialect {frame[33]}, {name}, seq {frame[34]}, {size} bytes of body, {told}check {check}{hazard}"


def _has_marker(frame: bytes) -> bool:
    """Whether the chapter's board cuts this frame short, since it contains the end of one."""
    return frame[33] == t.PROTO_CHAPTER and t.TAIL in frame[4:-2]


def _command_header(data: bytes) -> Iterator[Part]:
    fields = (("flag", 32, 1), ("proto", 33, 1), ("seq", 34, 1), ("pad", 35, 1))
    for name, at, size in (*fields, ("len", 36, 2), ("cmd", 38, 1), ("cmd_ext", 39, 1)):
        if at + size > len(data):
            return
        value = int.from_bytes(data[at : at + size], "little")
        words, meaning = str(value), FRAME[name]
        if name == "flag":
            words = f"{value:02X}"
        elif name == "proto":
            words = f"dialect {value}"
        elif name == "cmd":
            words = f"{value:02X} {command_name(value)}"
            meaning = t.COMMAND_DOCS.get(command_name(value), meaning)
        elif name == "cmd_ext":
            words = f"{value:02X}" + _ext_words(data[33], value)
        yield Part(name, at, at + size, words, meaning, value)


def _ext_words(dialect: int, value: int) -> str:
    if dialect != t.PROTO_HEXWIRE:
        return ""
    if value & t.EXT_REPLY:
        return f" reply: {status_name(value & t.EXT_STATUS_MASK)}"
    return " unsolicited" if value & t.EXT_UNSOLICITED else " request"


def _closing(data: bytes, end: int, problem: str) -> Iterator[Part]:
    """Check, pad bytes and tail of a frame whose body ends there, as far as the bytes reach."""
    if len(data) < end + 2:
        return
    check, verdict = _check_words(data)
    wrong = problem if problem.startswith("check") else ""
    verdict = "wrong" if wrong else verdict if not problem else ""
    yield Part("check", end, end + 2, f"{check} {verdict}".rstrip(), FRAME["check"], u16(data, end), wrong)
    tail = end + 2 + data[35]
    if data[35] and len(data) >= tail:
        yield Part("padding", end + 2, tail, to_hex(data[end + 2 : tail]), FRAME["padding"])
    if len(data) >= tail + 2:
        found = data[tail : tail + 2]
        wrong = "" if found == t.TAIL else f"is {to_hex(found)}, not 0D 0A"
        yield Part("tail", tail, tail + 2, to_hex(found), FRAME["tail"], None, wrong)


def _bad_frame(reading: FrameReading) -> tuple[Part, ...]:
    data = reading.data
    size = len(data)
    header = tuple(_header(data[:32]))
    rest = filled(header, 0, min(size, 32), "rest", FRAME["rest"])
    session = Part("session header", 0, min(size, 32), "", FRAME["session header"], parts=rest)
    if size <= 32:
        return (session,)
    parts = list(_command_header(data))
    if size >= BODY_OFFSET:
        end = BODY_OFFSET + u16(data, 36)
        if BODY_OFFSET < end <= size:
            text = to_hex(data[BODY_OFFSET:end], _SAMPLE)
            parts.append(Part("body", BODY_OFFSET, end, text, FRAME["body"]))
        parts += _closing(data, end, reading.problem)
    inside = filled(parts, 32, size, "rest", FRAME["rest"])
    return (session, Part("command frame", 32, size, "", FRAME["command frame"], None, reading.problem, inside))


def _bad_packet(reading: FrameReading) -> tuple[Part, ...]:
    data, size = reading.data, len(reading.data)
    parts = list(_packet_head(data, 0))
    whole = size > 5 and size == data[3] + 4
    if size > 4:
        parts.append(
            Part("instruction", 4, 5, f"{data[4]:02X}", "Instruction, or the error of an answer.", data[4])
        )
    if whole:
        text = f"{data[-1]:02X} wrong"
        parts.append(Part("checksum", size - 1, size, text, SERVO["checksum"], data[-1], reading.problem))
    inside = filled(parts, 0, size, "params", SERVO["params"])
    inside = tuple(_with_bytes(part, data, 0) for part in inside)
    return (Part("servo packet", 0, size, "", SERVO["servo packet"], None, reading.problem, inside),)


def _packet_head(data: bytes, at: int) -> Iterator[Part]:
    kind = {0xFF: "packet", 0xF5: "answer of a legacy servo or a board"}.get(data[1] if len(data) > 1 else -1, "")
    yield Part("header", at, at + min(2, len(data)), f"{to_hex(data[:2])} {kind}".strip(), SERVO["header"])
    if len(data) > 2:
        who = "all servos" if data[2] == t.BROADCAST_ID else f"servo {data[2]}"
        yield Part("id", at + 2, at + 3, who, SERVO["id"], data[2])
    if len(data) > 3:
        yield Part("length", at + 3, at + 4, str(data[3]), SERVO["length"], data[3])


def _number(command: str, item: Field) -> Part:
    """A field of a body; the item's place is that in the frame."""
    meaning, value = body_meaning(command, item.name), item.value or 0
    words = str(value)
    if meaning.names is not None and value in meaning.names:
        words += f" = {meaning.names[value]}"
    elif meaning.bits is not None:
        words = f"0x{value:02X} = {flag_words(value, meaning.bits)}"
    elif meaning.unit and meaning.scale != 1.0:
        words += f" = {value * meaning.scale:.6g} {meaning.unit}"
    elif meaning.unit:
        words += f" {meaning.unit}"
    return Part(item.name, item.start, item.end, words, meaning.text, value)


def _row(number: Part, written: list[Part], data: bytes) -> Part:
    """What one servo gets of a sync write, with its id before it."""
    start, end = number.start, number.end + len(data)
    told = ", ".join(f"{part.name} {part.words}" for part in written) or to_hex(data, _SAMPLE)
    parts = filled([number, *written], start, end, "params", SERVO["params"])
    return Part("row", start, end, f"{number.words}: {told}", SERVO["row"], parts=parts)


def _address(series: str | None, address: int) -> Part:
    register = Series(series).at(address) if series else None
    name = f" {register.name}" if register is not None else ""
    return Part("address", 0, 1, f"0x{address:02X}{name}", SERVO["address"], address)


def _registers(items: list[Field], series: str | None, address: int) -> Iterator[Part]:
    """The values of registers; their places are those in the bytes after the address."""
    for item in items:
        register = Series(series).at(address + item.start) if series else None
        if register is not None and register.size != item.end - item.start:
            register = None
        words = item.words.removeprefix(item.name).strip()
        yield Part(item.name, item.start, item.end, words, register_meaning(register), item.value)


def _arrays(command: str, body: bytes, start: int, at: int) -> Iterator[Part]:
    """Names and numbers of a robot controller's command, from `start` in its body; nothing if they do not fit."""
    try:
        if command == "JOINT_COMMANDS":
            yield from _joint_commands(JointCommands.parse(body), start, at)
        elif command == "JOINT_TRAJECTORY":
            yield from _trajectory(TrajectoryPoints.parse(body), body, start, at)
    except HexwireError:
        return


def _joint_commands(command: JointCommands, start: int, at: int) -> Iterator[Part]:
    place = at + start
    for name in command.name:
        size = len(name.encode())
        length = Part("name_length", place, place + 1, str(size), "Bytes of the joint's name.", size)
        text = Part("name", place + 1, place + 1 + size, name, "The joint.")
        yield Part(name, place, place + 1 + size, name, "A joint.", parts=(length, text))
        place += 1 + size
    for array in COMMAND_ARRAYS:
        values = getattr(command, array)
        if not values:
            continue
        inside = tuple(
            Part(joint, place + 8 * i, place + 8 * i + 8, f"{value:.6g}", f"{array} of the joint.", value)
            for i, (joint, value) in enumerate(zip(command.name, values, strict=True))
        )
        words = " ".join(part.words for part in inside)
        yield Part(array, place, place + 8 * len(values), words, "An array of float64.", parts=inside)
        place += 8 * len(values)


def _trajectory(trajectory: TrajectoryPoints, body: bytes, start: int, at: int) -> Iterator[Part]:
    joints = len(trajectory.positions[0])
    names = ["time", *(f"position {i + 1}" for i in range(joints))]
    if trajectory.velocities:
        names += [f"speed {i + 1}" for i in range(joints)]
    units = {"time": "s", "position": "rad", "speed": "rad/s"}
    for number in range(len(trajectory.times)):
        first = start + 8 * len(names) * number
        values = struct.unpack_from(f"<{len(names)}d", body, first)
        fields = tuple(
            Part(
                name, at + first + 8 * i, at + first + 8 * i + 8, f"{value:.6g} {units[name.split()[0]]}", "", value
            )
            for i, (name, value) in enumerate(zip(names, values, strict=True))
        )
        text = f"at {values[0]:.6g} s"
        yield Part(f"point {number}", fields[0].start, fields[-1].end, text, "A waypoint.", parts=fields)
