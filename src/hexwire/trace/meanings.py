"""What each field of a frame, a body and a servo packet means, in words.

Owns these words and the units of body fields; where the fields are, `reading` knows. Must not know bytes.
"""

from __future__ import annotations

from typing import NamedTuple

from hexwire.wire import tables as t
from hexwire.wire.registers import Register

__all__ = ["BODY", "FRAME", "SERVO", "Meaning", "body_meaning", "flag_words", "register_meaning"]


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
