"""What bytes on a line mean, a layer at a time: session header, command frame, servo packet, register values.

Owns the wording and the pairing of answers with their requests. Takes transfers in order and never raises; what is
corrupt is shown where it is, with the reason, and explaining goes on behind it. Must not know where the transfers
come from.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hexwire.errors import HexwireError
from hexwire.link.tap import Direction, Passed
from hexwire.wire import tables
from hexwire.wire.command_frame import BODY_OFFSET, Command, Frame, command_name, examine, status_name
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
from hexwire.wire.tables import PROTO_CHAPTER, SYNC_BYTES, TAIL

from .reading import CEILING, answers, cut_packets, has_ceiling_hazard, read_frame, read_request, read_status

__all__ = ["Explained", "Explainer", "Layer"]

_BOARD_SERIES = {
    servo_id: next(s for s in Series if s.value == name)
    for servo_id, name in zip(tables.BOARD_JOINT_IDS, tables.BOARD_JOINT_SERIES, strict=True)
}
_SERVO_COMMANDS = (Command.PING, Command.READ, Command.SYNC_WRITE)
_COOKED_TAIL = b"\n\n"
_COOKED = "tail 0A 0A: the port was left with ICRNL, and every 0D in it became 0A"
_NO_FRAME = "belongs to no frame"
_CEILING = f"hazard: {CEILING}"


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
        reading: The same short line that the project's analysers show (`reading`).
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
        """Everything for programs: plain values that JSON takes."""
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


@dataclass(slots=True)
class _Asked:
    time: float
    cmd: int
    seq: int
    packet: ServoPacket | None


@dataclass(slots=True)
class _Way:
    """One direction of the line.

    Attributes:
        data: What has arrived lately.
        done: So many bytes of it are explained.
        frames: A sync word has come.
        bus: It is taken for a bus of servos.
    """

    data: bytes = b""
    done: int = 0
    frames: bool = False
    bus: bool = False


class Explainer:
    """Explains the traffic of one link, transfer by transfer.

    Args:
        series: Series of servos by id; those of the Hex7Bot's board if None.
        bus: The line is a bus of servos, without a board. If None, it is one if it begins with a servo packet.
    """

    def __init__(self, series: Mapping[int, Series] | None = None, *, bus: bool | None = None) -> None:
        self._series = _BOARD_SERIES if series is None else series
        self._bus = bus
        self._ways = {direction: _Way() for direction in Direction}
        self._by_seq: dict[int, _Asked] = {}
        self._last: _Asked | None = None

    def feed(self, passed: Passed) -> Iterator[Explained]:
        """Explain what is whole after this transfer."""
        way = self._ways[passed.direction]
        way.data, way.done = way.data[way.done :] + passed.data, 0
        if self._bus or (self._bus is None and not way.frames and self._begins_bus(way.data)):
            way.bus = True
            yield from self._servo_traffic(way, passed.direction, passed.time)
            return
        way.bus = False
        way.frames = way.frames or SYNC_BYTES in way.data
        yield from self._take(way, passed.direction, passed.time)

    def finish(self) -> Iterator[Explained]:
        """Explain what is left unfinished at the end."""
        for direction, way in self._ways.items():
            if way.bus:
                yield from self._servo_traffic(way, direction, 0.0, final=True)
            else:
                yield from self._take(way, direction, 0.0, final=True)

    def _take(self, way: _Way, direction: Direction, time: float, *, final: bool = False) -> Iterator[Explained]:
        """Cut whole frames off the front; at most one unfinished frame stays.

        Every step moves on in the same bytes: cutting them anew for each frame would take the square of a long
        capture's time.
        """
        data = way.data
        at = way.done
        while True:
            start = data.find(SYNC_BYTES, at)
            if start < 0:
                keep = 0 if final else next((n for n in (3, 2, 1) if data.endswith(SYNC_BYTES[:n])), 0)
                yield from self._passed_over(way, max(len(data) - keep, way.done), direction, time)
                return
            result = examine(data, start, tables.MAX_NETWORK_FRAME)
            if isinstance(result, str) and result.startswith("head:"):
                at = start + 1
                continue
            yield from self._passed_over(way, start, direction, time)
            if isinstance(result, int) and not final:
                return
            frame, end, problem = self._judged(data, start, result)
            raw = data[start:end]
            way.done = at = end
            if frame is not None:
                yield self._frame(frame, raw, direction, time, problem)
            else:
                yield self._spoilt(raw, direction, time, problem)

    def _passed_over(self, way: _Way, end: int, direction: Direction, time: float) -> Iterator[Explained]:
        if end > way.done:
            lost, way.done = way.data[way.done : end], end
            yield self._spoilt(lost, direction, time, _NO_FRAME)

    @staticmethod
    def _judged(data: bytes, start: int, result: Frame | str | int) -> tuple[Frame | None, int, str]:
        """What stands at `start`: a frame or None, where it ends, and what is wrong with it."""
        if isinstance(result, Frame):
            return result, start + result.size, ""
        size, problem = len(data) - start, "cut short by the end"
        if isinstance(result, str):
            size, problem = int.from_bytes(data[start + 28 : start + 32], "little"), result
            if data[start + size - 2 : start + size] == _COOKED_TAIL:
                mended = examine(data[start : start + size - 2] + TAIL, 0, tables.MAX_NETWORK_FRAME)
                if isinstance(mended, Frame):
                    return mended, start + size, _COOKED
        # Bad bytes reach to where the next frame may begin.
        following = data.find(SYNC_BYTES, start + 1, start + size)
        return None, following if following > 0 else start + size, problem

    # -- frames -------------------------------------------------------------------------------------

    def _frame(self, frame: Frame, raw: bytes, direction: Direction, time: float, problem: str) -> Explained:
        layers = [self._session_layer(frame), self._command_layer(frame, raw)]
        asked = self._pair(frame, direction, time)
        if frame.cmd in _SERVO_COMMANDS and frame.body:
            layers.append(self._servo_layer(frame.body, asked if direction is Direction.RECEIVED else None))
        elif frame.cmd == Command.TRANSACT and frame.body:
            packet = frame.body if frame.is_reply else frame.body[2:]
            if packet:
                layers.append(
                    self._servo_layer(packet, asked if direction is Direction.RECEIVED else None, swapped=False)
                )
        elif frame.body:
            text = describe_body(frame)
            layers.append(Layer("body", text, {"text": text}))
        if asked is not None and direction is Direction.RECEIVED:
            took = (time - asked.time) * 1000
            text = f"answers seq {asked.seq}" + (f" after {took:.1f} ms" if time and asked.time else "")
            layers.append(Layer("pairing", text, {"request_seq": asked.seq, "took_ms": round(took, 3)}))
        question = asked.packet if asked else None
        reading = read_frame(frame, raw, question, self._series, cooked=raw.endswith(_COOKED_TAIL))
        return Explained(direction, time, "frame", raw, str(frame), tuple(layers), problem, reading)

    def _session_layer(self, frame: Frame) -> Layer:
        text = (
            f"{module_name(frame.src)} -> {module_name(frame.dst)}, sn {frame.sn}, time {frame.time:.6f} s, "
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
            verdict = "not checked" if check == tables.UNCHECKED else "of unknown kind, not verified"
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
        return Layer("command", f"{text}check {check:04X} {verdict}", fields)

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

    def _servo_layer(self, data: bytes, asked: _Asked | None, *, swapped: bool = True) -> Layer:
        packet = _try_packet(data)
        answers = asked is not None and asked.packet is not None
        if packet is not None and not answers and packet.instruction in tuple(Instruction):
            return self._request_layer(packet, data)
        try:
            status = parse_status(data, as_it_is=True)
        except HexwireError as error:
            text = f"bad servo packet, {error}: {data.hex(' ').upper()}"
            return Layer("servo", text, {"problem": str(error)})
        return self._status_layer(status, asked.packet if asked else None, swapped=swapped)

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
            if has_ceiling_hazard(series, packet.params[0], packet.params[1:]):
                fields["hazard"] = _CEILING
                text += f"; {_CEILING}"
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
            if has_ceiling_hazard(self._series.get(servo_id), address, data):
                fields["hazard"] = _CEILING
                return f"; servo {servo_id}: {_CEILING}"
        return ""

    def _status_layer(
        self, status: StatusPacket, request: ServoPacket | None, *, bus: bool = False, swapped: bool = True
    ) -> Layer:
        named = None if bus else board_error_name(status)
        fields: dict[str, Any] = {"id": status.servo_id, "error": status.error, "checksum": "good"}
        if named is not None:
            fields["board_error"] = named
            return Layer("servo", f"board error: {named}", fields)
        series = self._series.get(status.servo_id) or (Series.SEVEN_BOT if status.legacy else Series.HLS)
        text = f"servo {status.servo_id}, {series.value}, error {status.error:02X}"
        if (series is Series.SEVEN_BOT) != status.legacy:
            fields["hazard"] = "the header of another series"
            text += ", the header of another series: is this the servo that is meant?"
        params = status.params
        if request is not None and request.instruction == Instruction.READ and request.params and params:
            if len(params) == 2 and series is Series.SEVEN_BOT and swapped and not bus:
                # The board has swapped the two bytes, so that the host sees little-endian for every id.
                params = params[::-1]
            values = _values(series, request.params[0], params)
            fields["registers"] = values
            text += _in_units(values)
        elif params:
            text += f", data {params.hex(' ').upper()}"
        return Layer("servo", text, fields)

    @staticmethod
    def _begins_bus(data: bytes) -> bool:
        return data[:2] in (tables.SERVO_HEADER, tables.LEGACY_HEADER) and SYNC_BYTES not in data

    def _servo_traffic(
        self, way: _Way, direction: Direction, time: float, *, final: bool = False
    ) -> Iterator[Explained]:
        """A bus without a board: packets go out, status packets come in, perhaps several at once."""
        data = way.data[way.done :]
        begin = way.done
        for kind, start, end, reason in cut_packets(data, final=final):
            piece, way.done = data[start:end], begin + end
            if kind == "packet":
                yield self._servo_packet(piece, direction, time)
                continue
            reading = f"bad packet: {reason}" if kind == "bad" else f"garbage: {len(piece)} bytes"
            text = f"{len(piece)} bytes, {reason or 'no servo packet'}: {piece[:16].hex(' ').upper()}"
            yield Explained(direction, time, kind, piece, text, (), reason or "no servo packet", reading)

    def _servo_packet(self, data: bytes, direction: Direction, time: float) -> Explained:
        asked = self._last.packet if self._last else None
        if answers(data, asked):
            status = parse_status(data, as_it_is=True)
            layer = self._status_layer(status, asked, bus=True)
            reading = read_status(status, asked, self._series)
            if asked is not None and asked.instruction != Instruction.SYNC_READ:
                self._last = None
        else:
            packet = parse_packet(data)
            layer = self._request_layer(packet, data)
            reading = read_request(data, self._series)
            self._last = _Asked(time, 0, 0, packet)
        return Explained(direction, time, "servo packet", data, layer.text, (layer,), "", reading)

    @staticmethod
    def _spoilt(data: bytes, direction: Direction, time: float, problem: str) -> Explained:
        kind = "bad" if data.startswith(SYNC_BYTES) else "garbage"
        sample = data[:16].hex(" ").upper() + (" ..." if len(data) > 16 else "")
        reading = f"garbage: {len(data)} bytes" if problem == _NO_FRAME else f"bad frame: {problem}"
        text = f"{kind}, {len(data)} bytes, {problem}: {sample}"
        return Explained(direction, time, kind, data, text, (), problem, reading)


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


def _in_units(values: list[dict[str, Any]]) -> str:
    words = [
        f"{v.get('name', hex(v['address']))} {v['raw']}"
        + (f" = {v['value']:g} {v['unit']}" if "value" in v else "")
        for v in values
    ]
    return f": {', '.join(words)}"
