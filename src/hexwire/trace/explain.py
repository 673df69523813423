"""What bytes on a line mean, a layer at a time: session header, command frame, servo packet, register values.

Owns the wording and the pairing of answers with their requests. Takes transfers in order and never raises; what is
corrupt is shown where it is, with the reason, and explaining goes on behind it. Must not know where the transfers
come from.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from hexwire.errors import HexwireError
from hexwire.ipc.tap import Direction, Passed
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, command_name, examine, status_name
from hexwire.wire.describe import describe_body, describe_servo
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
from hexwire.wire.session_header import SYNC_BYTES
from hexwire.wire.tables import PROTO_CHAPTER, TAIL

__all__ = ["Explained", "Explainer", "Layer"]

_BOARD_SERIES = {
    servo_id: next(s for s in Series if s.value == name)
    for servo_id, name in zip(tables.BOARD_JOINT_IDS, tables.BOARD_JOINT_SERIES, strict=True)
}
_SERVO_COMMANDS = (Command.PING, Command.READ, Command.SYNC_WRITE)
_COOKED_TAIL = b"\n\n"


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer of an explanation: its name, a line of words, and its fields for programs."""

    name: str
    text: str
    fields: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Explained:
    """One frame, or bytes that are none.

    Attributes:
        direction: Which way it went.
        time: Of its last byte.
        kind: frame, servo packet, bad, or garbage.
        data: Its bytes.
        text: One line.
        layers: From the outermost inward.
        problem: Why it is bad, or what is doubtful; empty if nothing.
    """

    direction: Direction
    time: float
    kind: str
    data: bytes
    text: str
    layers: tuple[Layer, ...] = ()
    problem: str = ""

    def as_fields(self) -> dict[str, Any]:
        """Everything for programs: plain values that JSON takes."""
        fields: dict[str, Any] = {
            "direction": self.direction.value,
            "time_s": self.time,
            "kind": self.kind,
            "text": self.text,
            "hex": self.data.hex(" ").upper(),
        }
        if self.problem:
            fields["problem"] = self.problem
        return fields | {layer.name: layer.fields for layer in self.layers}


@dataclass(slots=True)
class _Asked:
    time: float
    cmd: int
    seq: int
    packet: ServoPacket | None


@dataclass(slots=True)
class _Way:
    """One direction of the line: what has arrived and is not explained yet."""

    data: bytes = b""
    frames: bool = False


class Explainer:
    """Explains the traffic of one link, transfer by transfer.

    Args:
        series: Series of servos by id; those of the Hex7Bot's board if None.
    """

    def __init__(self, series: dict[int, Series] | None = None) -> None:
        self._series = _BOARD_SERIES if series is None else series
        self._ways = {direction: _Way() for direction in Direction}
        self._by_seq: dict[int, _Asked] = {}
        self._last: _Asked | None = None

    def feed(self, passed: Passed) -> Iterator[Explained]:
        """Explain what is whole after this transfer."""
        way = self._ways[passed.direction]
        if not way.frames and SYNC_BYTES not in passed.data and passed.data[:2] in (b"\xff\xff", b"\xff\xf5"):
            yield from self._servo_traffic(passed)
            return
        way.frames = way.frames or SYNC_BYTES in passed.data
        way.data += passed.data
        yield from self._take(way, passed.direction, passed.time)

    def finish(self) -> Iterator[Explained]:
        """Explain what is left unfinished at the end."""
        for direction, way in self._ways.items():
            rest, way.data = way.data, b""
            if rest:
                problem = "cut short by the end" if rest.startswith(SYNC_BYTES) else "belongs to no frame"
                yield self._spoilt(rest, direction, 0.0, problem)

    def _take(self, way: _Way, direction: Direction, time: float) -> Iterator[Explained]:
        """Cut whole frames off the front. At most one unfinished frame stays."""
        at = 0
        while True:
            data = way.data
            start = data.find(SYNC_BYTES, at)
            if start < 0:
                keep = next((n for n in (3, 2, 1) if data.endswith(SYNC_BYTES[:n])), 0)
                lost, way.data = data[: len(data) - keep], data[len(data) - keep :]
                if lost:
                    yield self._spoilt(lost, direction, time, "belongs to no frame")
                return
            result = examine(data, start, tables.MAX_NETWORK_FRAME)
            if isinstance(result, str) and result.startswith("head:"):
                at = start + 1
                continue
            if start:
                yield self._spoilt(data[:start], direction, time, "belongs to no frame")
                data = way.data = data[start:]
                at = 0
            if isinstance(result, int):
                return
            size = result.size if isinstance(result, Frame) else int.from_bytes(data[28:32], "little")
            raw, problem = data[:size], ""
            if isinstance(result, str):
                problem = result
                mended = examine(raw[:-2] + TAIL, 0, tables.MAX_NETWORK_FRAME) if raw.endswith(_COOKED_TAIL) else ""
                if isinstance(mended, Frame):
                    result = mended
                    problem = "tail 0A 0A: the port was left with ICRNL, and every 0D in it became 0A"
                else:
                    # Bad bytes reach to where the next frame may begin.
                    following = data.find(SYNC_BYTES, 1)
                    raw = data[:following] if 0 < following < size else raw
            way.data = data[len(raw) :]
            at = 0
            if isinstance(result, Frame):
                yield self._frame(result, raw, direction, time, problem)
            else:
                yield self._spoilt(raw, direction, time, problem)

    # -- frames -------------------------------------------------------------------------------------

    def _frame(self, frame: Frame, raw: bytes, direction: Direction, time: float, problem: str) -> Explained:
        layers = [self._session_layer(frame), self._command_layer(frame, raw)]
        asked = self._pair(frame, direction, time)
        if frame.cmd in _SERVO_COMMANDS and frame.body:
            layers.append(self._servo_layer(frame.body, asked if direction is Direction.RECEIVED else None))
        elif frame.cmd == Command.TRANSACT and frame.body:
            packet = frame.body if frame.is_reply else frame.body[2:]
            if packet:
                layers.append(self._servo_layer(packet, asked if direction is Direction.RECEIVED else None))
        elif frame.body:
            text = describe_body(frame)
            layers.append(Layer("body", text, {"text": text}))
        if asked is not None and direction is Direction.RECEIVED:
            took = (time - asked.time) * 1000
            text = f"answers seq {asked.seq}" + (f" after {took:.1f} ms" if time and asked.time else "")
            layers.append(Layer("pairing", text, {"request_seq": asked.seq, "took_ms": round(took, 3)}))
        return Explained(direction, time, "frame", raw, str(frame), tuple(layers), problem)

    def _session_layer(self, frame: Frame) -> Layer:
        header = frame.header
        text = (
            f"{module_name(frame.src)} -> {module_name(frame.dst)}, sn {frame.sn}, time {header.time:.6f} s, "
            f"type {frame.type}, size {frame.size}"
        )
        return Layer("session", text, header._asdict() | {"time": header.time})

    def _command_layer(self, frame: Frame, raw: bytes) -> Layer:
        fields: dict[str, Any] = {
            "dialect": frame.proto,
            "seq": frame.seq,
            "cmd": frame.cmd,
            "name": command_name(frame.cmd),
            "cmd_ext": frame.cmd_ext,
            "length": len(frame.body),
            "check": f"{frame.check:04X}",
        }
        text = (
            f"dialect {frame.proto}, {command_name(frame.cmd)}, seq {frame.seq}, {len(frame.body)} bytes of body, "
        )
        if frame.proto == PROTO_CHAPTER:
            verdict = "not checked" if frame.check == tables.UNCHECKED else "of unknown kind, not verified"
            hazard = TAIL in raw[4:-2]
            if hazard:
                verdict += "; 0D 0A inside: a board of the chapter cuts this frame"
                fields["hazard"] = "0D 0A inside"
        else:
            verdict = "good"
            if frame.is_reply:
                fields["status"] = status_name(frame.status)
                text += f"reply: {status_name(frame.status)}, "
            elif frame.is_unsolicited:
                text += "unsolicited, "
        fields["check_verdict"] = verdict
        return Layer("command", f"{text}check {frame.check:04X} {verdict}", fields)

    def _pair(self, frame: Frame, direction: Direction, time: float) -> _Asked | None:
        if direction is Direction.SENT:
            packet = None
            if frame.cmd in _SERVO_COMMANDS or frame.cmd == Command.TRANSACT:
                packet = _try_packet(frame.body[2:] if frame.cmd == Command.TRANSACT else frame.body)
            asked = _Asked(time, frame.cmd, frame.seq, packet)
            if frame.proto == PROTO_CHAPTER:
                self._last = asked
            else:
                self._by_seq[frame.seq] = asked
            return None
        if frame.proto == PROTO_CHAPTER:
            asked1, self._last = self._last, None
            return asked1
        return self._by_seq.pop(frame.seq, None) if frame.is_reply else None

    # -- servo packets ------------------------------------------------------------------------------

    def _servo_layer(self, data: bytes, asked: _Asked | None) -> Layer:
        packet = _try_packet(data)
        answers = asked is not None and asked.packet is not None
        if packet is not None and not answers and packet.instruction in tuple(Instruction):
            return self._request_layer(packet, data)
        try:
            status = parse_status(data)
        except HexwireError as error:
            text = f"bad servo packet, {error}: {data.hex(' ').upper()}"
            return Layer("servo", text, {"problem": str(error)})
        return self._status_layer(status, asked.packet if asked else None)

    def _request_layer(self, packet: ServoPacket, data: bytes) -> Layer:
        series = self._series.get(packet.servo_id)
        fields: dict[str, Any] = {
            "id": packet.servo_id,
            "instruction": Instruction(packet.instruction).name.lower(),
            "checksum": "good",
        }
        text = describe_servo(data, series, reply=False)
        if packet.instruction in (Instruction.WRITE, Instruction.REG_WRITE) and packet.params and series:
            values = _values(series, packet.params[0], packet.params[1:])
            fields["registers"] = values
            hazard = _ceiling_hazard(series, packet.params[0], packet.params[1:])
            if hazard:
                fields["hazard"] = hazard
                text += f"; {hazard}"
            text += _in_units(values)
        elif packet.instruction == Instruction.SYNC_WRITE:
            text += self._sync_write_hazard(packet, fields)
        elif packet.instruction in (Instruction.READ, Instruction.SYNC_READ) and packet.params and series:
            register = series.at(packet.params[0])
            fields["register"] = register.name if register else f"0x{packet.params[0]:02X}"
        return Layer("servo", text, fields)

    def _sync_write_hazard(self, packet: ServoPacket, fields: dict[str, Any]) -> str:
        try:
            address, rows = parse_sync_write(packet)
        except HexwireError:
            return ""
        for servo_id, data in rows:
            series = self._series.get(servo_id)
            hazard = _ceiling_hazard(series, address, data) if series else ""
            if hazard:
                fields["hazard"] = hazard
                return f"; servo {servo_id}: {hazard}"
        return ""

    def _status_layer(self, status: StatusPacket, request: ServoPacket | None) -> Layer:
        named = board_error_name(status)
        fields: dict[str, Any] = {"id": status.servo_id, "error": status.error, "checksum": "good"}
        if named is not None:
            fields["board_error"] = named
            return Layer("servo", f"board error: {named}", fields)
        series = self._series.get(status.servo_id) or (Series.SEVEN_BOT if status.legacy else Series.HLS)
        text = f"servo {status.servo_id}, {series.value}, error {status.error:02X}"
        params = status.params
        if request is not None and request.instruction == Instruction.READ and request.params and params:
            if len(params) == 2 and series is Series.SEVEN_BOT:
                # The board has swapped the two bytes, so that the host sees little-endian for every id.
                params = params[::-1]
            values = _values(series, request.params[0], params)
            fields["registers"] = values
            text += _in_units(values)
        elif params:
            text += f", data {params.hex(' ').upper()}"
        return Layer("servo", text, fields)

    def _servo_traffic(self, passed: Passed) -> Iterator[Explained]:
        """A bus without a board: packets go out, status packets come in, perhaps several at once."""
        data, at = passed.data, 0
        while at < len(data):
            end = _packet_end(data, at)
            if end is None:
                rest = data[at:]
                text = f"{len(rest)} bytes, no servo packet: {rest[:16].hex(' ').upper()}"
                yield Explained(passed.direction, passed.time, "garbage", rest, text, (), "no servo packet")
                return
            piece = data[at:end]
            asked = self._last if passed.direction is Direction.RECEIVED else None
            layer = self._servo_layer(piece, asked)
            if passed.direction is Direction.SENT:
                self._last = _Asked(passed.time, 0, 0, _try_packet(piece))
            problem = layer.fields.get("problem", "")
            yield Explained(passed.direction, passed.time, "servo packet", piece, layer.text, (layer,), problem)
            at = end

    @staticmethod
    def _spoilt(data: bytes, direction: Direction, time: float, problem: str) -> Explained:
        kind = "bad" if data.startswith(SYNC_BYTES) else "garbage"
        sample = data[:16].hex(" ").upper() + (" ..." if len(data) > 16 else "")
        return Explained(
            direction, time, kind, data, f"{kind}, {len(data)} bytes, {problem}: {sample}", (), problem
        )


def _try_packet(data: bytes) -> ServoPacket | None:
    try:
        return parse_packet(data)
    except HexwireError:
        return None


def _packet_end(data: bytes, at: int) -> int | None:
    if data[at : at + 2] not in (b"\xff\xff", b"\xff\xf5") or at + 6 > len(data):
        return None
    length = data[at + 3]
    quirk = data[at + 1] == 0xF5 and length == 6 and at + 10 > len(data)
    end = at + (6 if quirk else 4 + length)
    return end if at + 6 <= end <= len(data) else None


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


def _in_units(values: list[dict[str, Any]]) -> str:
    words = [
        f"{v.get('name', hex(v['address']))} {v['raw']}"
        + (f" = {v['value']:g} {v['unit']}" if "value" in v else "")
        for v in values
    ]
    return f": {', '.join(words)}"


def _ceiling_hazard(series: Series, address: int, data: bytes) -> str:
    """The chapter's 4-byte block on an HLS servo: its run time lands in the current ceiling."""
    if series is not Series.HLS:
        return ""
    if address == Series.HLS.register("goal_position").address and len(data) == 4:
        return "hazard: run time in the current ceiling of an HLS servo"
    return ""
