"""Explains the bytes on a line, layer by layer: session header, command frame, servo packet, register values.

Owns the layers and their fields; `reading` owns the wording and matches answers with requests. Takes transfers in
order and never raises: corrupt bytes are reported in place, with the reason, and explaining continues after them.
Must not know where the transfers come from.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from hexwire.errors import HexwireError
from hexwire.link.tap import Direction, Passed
from hexwire.wire import tables
from hexwire.wire.addresses import destination_name
from hexwire.wire.command_frame import BODY_OFFSET, Command, Frame, command_name, parse_frame, status_name
from hexwire.wire.commands import JointReport, MaintenanceReply
from hexwire.wire.modules import module_name
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    Instruction,
    ServoPacket,
    StatusPacket,
    board_error_name,
    parse_packet,
    parse_status,
    parse_sync_write,
)
from hexwire.wire.tables import PROTO_CHAPTER, TAIL

from .line_reader import LineReader
from .reading import CEILING, COOKED, Reading, has_ceiling_hazard, u16

__all__ = ["Explained", "Explainer", "Layer"]

_SERVO_COMMANDS = (Command.PING, Command.READ, Command.SYNC_WRITE)
_COOKED = "tail 0A 0A: the port was left with ICRNL, and every 0D in it became 0A"
_NO_FRAME = "not part of a frame"
_NO_PACKET = "not a servo packet"
_CEILING = f"hazard: {CEILING}"
_OTHER_SERIES = "the header of another series"


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

    def feed(self, passed: Passed) -> Iterator[Explained]:
        """Explain the frames that this transfer completes."""
        yield from map(self.explain, self.lines.feed(passed))

    def finish(self) -> Iterator[Explained]:
        """Explain the incomplete bytes at the end."""
        yield from map(self.explain, self.lines.finish())

    def explain(self, reading: Reading) -> Explained:
        """Explain one frame, packet, or bytes that are neither."""
        if reading.kind == "frame":
            return self._frame(reading)
        if reading.kind == "packet":
            return self._packet(reading)
        data = reading.data
        problem = reading.problem or (_NO_PACKET if reading.line == "bus" else _NO_FRAME)
        sample = data[:16].hex(" ").upper() + (" ..." if len(data) > 16 else "")
        text = f"{reading.kind}, {len(data)} bytes, {problem}: {sample}"
        return Explained(reading.way, reading.time, reading.kind, data, text, (), problem, reading.text)

    # -- frames -------------------------------------------------------------------------------------

    def _frame(self, reading: Reading) -> Explained:
        raw = reading.data
        is_cooked = raw.endswith(COOKED)
        frame = parse_frame(raw[:-2] + TAIL)
        layers = [self._session_layer(frame), self._command_layer(frame, raw)]
        asked = reading.answers
        if frame.cmd in _SERVO_COMMANDS and frame.body:
            layers.append(self._servo_layer(frame.body, reading))
        elif frame.cmd == Command.TRANSACT and frame.body:
            packet = frame.body if frame.is_reply else frame.body[2:]
            if packet:
                layers.append(self._servo_layer(packet, reading, swapped=False))
        elif frame.body:
            layers.append(self._body_layer(frame, reading.words))
        if asked is not None:
            took, seq = (reading.time - asked.time) * 1000, asked.data[34]
            text = f"answers seq {seq}" + (f" after {took:.1f} ms" if reading.time and asked.time else "")
            layers.append(Layer("pairing", text, {"request_seq": seq, "took_ms": round(took, 3)}))
        problem = _COOKED if is_cooked else ""
        return Explained(reading.way, reading.time, "frame", raw, str(frame), tuple(layers), problem, reading.text)

    def _session_layer(self, frame: Frame) -> Layer:
        name = module_name if frame.proto == PROTO_CHAPTER else destination_name
        text = (
            f"{module_name(frame.src)} -> {name(frame.dst)}, sn {frame.sn}, time {frame.time:.6f} s, "
            f"type {frame.type}, size {frame.size}"
        )
        fields = {name: getattr(frame, name) for name, _, _ in tables.HEADER_FIELDS if name != "sync"}
        return Layer("session", text, fields | {"time": frame.time})

    def _command_layer(self, frame: Frame, raw: bytes) -> Layer:
        at = BODY_OFFSET + len(frame.body)
        check = int.from_bytes(raw[at : at + 2], "little")
        fields: dict[str, Any] = {
            "dialect": frame.proto,
            "seq": frame.seq,
            "cmd": frame.cmd,
            "name": command_name(frame.cmd),
            "cmd_ext": frame.cmd_ext,
            "length": len(frame.body),
            "check": f"{check:04X}",
        }
        text = (
            f"dialect {frame.proto}, {command_name(frame.cmd)}, seq {frame.seq}, {len(frame.body)} bytes of body, "
        )
        if frame.proto == PROTO_CHAPTER:
            verdict = "not checked" if check == tables.UNCHECKED else "of an unknown kind, not verified"
            hazard = TAIL in raw[4:-2]
            if hazard:
                verdict += "; 0D 0A inside: the chapter's board truncates this frame"
                fields["hazard"] = "0D 0A inside"
        else:
            verdict = "good"
            if frame.is_reply:
                fields["status"] = status_name(frame.status)
                text += f"reply: {status_name(frame.status)}, "
            elif frame.is_unsolicited:
                text += "unsolicited, "
        fields["check_verdict"] = verdict
        return Layer("command", f"{text}check {check:04X} {verdict}", fields)

    @staticmethod
    def _body_layer(frame: Frame, words: str) -> Layer:
        fields: dict[str, Any] = {"text": words}
        flags = 0
        with suppress(HexwireError):
            if frame.cmd == Command.JOINT_STATE and (frame.is_reply or frame.is_unsolicited):
                flags = JointReport.parse(frame.body).board_flags
            elif frame.cmd == Command.MAINTENANCE and frame.is_reply:
                flags = MaintenanceReply.parse(frame.body).board_flags
        if flags:
            names = [name.replace("_", " ") for name, bit in tables.BOARD_FLAGS.items() if flags & bit]
            fields["board_flags"] = names
            words += f" [{', '.join(names)}]"
        return Layer("body", words, fields)

    # -- servo packets ------------------------------------------------------------------------------

    def _packet(self, reading: Reading) -> Explained:
        layer = self._servo_layer(reading.data, reading, bus=True)
        return Explained(
            reading.way, reading.time, "servo packet", reading.data, layer.text, (layer,), "", reading.text
        )

    def _servo_layer(self, data: bytes, reading: Reading, *, swapped: bool = True, bus: bool = False) -> Layer:
        """Fields of a packet in a frame or on a bus; `swapped`: a board may have swapped the bytes of a value."""
        if not reading.answer:
            packet = _try_packet(data)
            if packet is not None:
                return Layer("servo", reading.words, self._request_fields(packet))
        try:
            status = parse_status(data, as_it_is=True)
        except HexwireError as error:
            return Layer("servo", reading.words, {"problem": str(error)})
        asked = None if reading.answers is None else _try_packet(_packet_of(reading.answers))
        return self._status_layer(status, asked, reading.words, swapped=swapped, bus=bus)

    def _request_fields(self, packet: ServoPacket) -> dict[str, Any]:
        series = self._series(packet.servo_id)
        known = packet.instruction in tuple(Instruction)
        fields: dict[str, Any] = {
            "id": packet.servo_id,
            "instruction": Instruction(packet.instruction).name.lower() if known else packet.instruction,
            "checksum": "good",
        }
        rows: tuple[tuple[int, bytes], ...] = ()
        address = packet.params[0] if packet.params else 0
        if packet.instruction in (Instruction.WRITE, Instruction.REG_WRITE) and packet.params:
            rows = ((packet.servo_id, packet.params[1:]),)
            if series:
                fields["registers"] = _values(series, address, packet.params[1:])
        elif packet.instruction == Instruction.SYNC_WRITE:
            with suppress(HexwireError):
                address, rows = parse_sync_write(packet)
        elif packet.instruction in (Instruction.READ, Instruction.SYNC_READ) and packet.params and series:
            register = series.at(address)
            fields["register"] = register.name if register else f"0x{address:02X}"
        if any(has_ceiling_hazard(self.lines.reader.series_of(servo_id), address, data) for servo_id, data in rows):
            fields["hazard"] = _CEILING
        return fields

    def _status_layer(
        self, status: StatusPacket, asked: ServoPacket | None, words: str, *, bus: bool, swapped: bool
    ) -> Layer:
        named = None if bus else board_error_name(status)
        fields: dict[str, Any] = {"id": status.servo_id, "error": status.error, "checksum": "good"}
        if named is not None:
            return Layer("servo", words, fields | {"board_error": named})
        series = self._series(status.servo_id) or (Series.SEVEN_BOT if status.legacy else Series.HLS)
        if (series is Series.SEVEN_BOT) != status.legacy:
            fields["hazard"] = _OTHER_SERIES
            words += f", {_OTHER_SERIES}: is this the right servo?"
        params = status.params
        if asked is not None and asked.instruction == Instruction.READ and asked.params and params:
            if len(params) == 2 and series is Series.SEVEN_BOT and swapped and not bus:
                # The board has swapped the two bytes, so that the host gets little-endian values from every servo.
                params = params[::-1]
            fields["registers"] = _values(series, asked.params[0], params)
        return Layer("servo", words, fields)

    def _series(self, servo_id: int) -> Series | None:
        name = self.lines.reader.series_of(servo_id)
        return None if name is None else Series(name)


def _packet_of(request: Reading) -> bytes:
    """The servo packet of a request."""
    if request.kind == "packet":
        return request.data
    body = request.data[BODY_OFFSET : BODY_OFFSET + u16(request.data, 36)]
    return body[2:] if request.data[38] == Command.TRANSACT else body


def _try_packet(data: bytes) -> ServoPacket | None:
    try:
        return parse_packet(data)
    except HexwireError:
        return None


def _values(series: Series, address: int, data: bytes) -> list[dict[str, Any]]:
    values, at = [], 0
    while at < len(data):
        register = series.at(address + at)
        if register is None or at + register.size > len(data):
            values.append({"address": address + at, "raw": data[at]})
            at += 1
            continue
        raw = register.decode(data[at : at + register.size])
        entry: dict[str, Any] = {"address": register.address, "name": register.name, "raw": raw}
        if register.si_unit:
            entry["value"], entry["unit"] = round(register.to_si(raw), 6), register.si_unit
        values.append(entry)
        at += register.size
    return values
