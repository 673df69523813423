"""Drawings of bytes and frames on a line, their levels and times computed by hexwire's own code."""

from __future__ import annotations

from hexwire.link.diagnose import avr_baud_error
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, serialize_frame
from hexwire.wire.servo_packet import make_read

from .canvas import Canvas

__all__ = ["byte_8n1", "exchange", "frame", "framing", "rate"]

BAUD = 115200
BYTE = 0x38
BIT_US = 1e6 / BAUD
RETURN_DELAY_US = 250.0
REQUEST = make_read(0, BYTE, 2)


def bits_of(byte: int) -> list[int]:
    """Levels of a byte with its start and stop bit, in the order of the line."""
    return [0, *((byte >> i) & 1 for i in range(8)), 1]


def byte_8n1() -> Canvas:
    """One byte: start bit, eight bits, stop bit."""
    c = Canvas(250, f"One byte 8N1 on the line: 0x{BYTE:02X}, start bit, eight data bits, lowest first, stop bit")
    x, w, low = 62.0, 48.0, 150.0
    bits = bits_of(BYTE)
    c.wave(x - 46, low, [(46, 1), *((w, bit) for bit in bits), (50, 1)], h=64)
    for i in range(11):
        c.line((x + i * w, low - 76), (x + i * w, low + 12), color="soft", width=0.8, dash="3 4")
    for i, bit in enumerate(bits):
        middle = x + (i + 0.5) * w
        c.text(middle, low - 86, str(bit), anchor="middle", bold=True, mono=True)
        name = "start" if i == 0 else "stop" if i == 9 else f"b{i - 1}"
        c.text(middle, low + 32, name, anchor="middle", size=13, color="orange" if i in (0, 9) else "soft")
        c.line((middle, low + 2), (middle, low - 4), color="green", width=2.2)
    c.text(12, low - 72, "idle", size=12, color="soft")
    c.line((x, low + 52), (x + 10 * w, low + 52), color="blue", width=1.2, both=True)
    c.text(
        x + 5 * w,
        low + 70,
        f"10 bits = {10 * BIT_US:.1f} µs at {BAUD}, {10.0:.0f} µs at 1 Mbaud",
        anchor="middle",
        size=13,
        color="blue",
    )
    c.text(x + 5 * w, 28, f"0x{BYTE:02X} = {BYTE:08b}, lowest bit first", anchor="middle", bold=True)
    c.text(
        x + 5 * w,
        low + 90,
        "green: where the receiver looks, in the middle of each bit",
        anchor="middle",
        size=13,
        color="green",
    )
    return c


def rate() -> Canvas:
    """Where a receiver looks if the rates differ."""
    error = avr_baud_error(BAUD)
    c = Canvas(260, "A receiver whose clock is off looks too early or late, more with every bit")
    x, w = 130.0, 46.0
    bits = bits_of(0x55)
    rows = ((90.0, error, "green"), (190.0, 0.06, "red"))
    for low, off, color in rows:
        c.wave(x - 20, low, [(20, 1), *((w, bit) for bit in bits), (20, 1)], h=40)
        for i in range(10):
            at = x + (i + 0.5) * w * (1 + off)
            c.line((at, low + 10), (at, low - 48), color=color, width=1.8)
        c.text(x - 30, low - 26, f"{100 * off:.1f} %", anchor="end", bold=True, color=color)
    c.text(x - 30, 84, "off", anchor="end", size=13, color="soft")
    c.text(x - 30, 184, "off", anchor="end", size=13, color="soft")
    c.text(x + 5 * w, 120, f"the Mega at {BAUD}: still in the stop bit", anchor="middle", size=13, color="green")
    c.text(
        x + 5 * w,
        220,
        "the last bit is read from the stop bit: a wrong byte",
        anchor="middle",
        size=13,
        color="red",
    )
    c.text(
        320,
        24,
        "each line: where a receiver looks that began at the start bit",
        anchor="middle",
        size=13,
        color="soft",
    )
    return c


def exchange() -> Canvas:
    """A read of two bytes over the board, to scale."""
    byte = 10 * BIT_US / 1000
    frame = 52 * byte
    packet, delay = 8 * byte, RETURN_DELAY_US / 1000
    total = 2 * frame + 2 * packet + delay
    c = Canvas(250, "A read over the board at 115200, to scale: the frames on the host line take most of the time")
    x, scale = 110.0, 510.0 / total

    def span(row: float, start: float, length: float, color: str, text: str) -> None:
        left, wide = x + start * scale, length * scale
        c.box(left, row, wide, 30, stroke=color, r=3)
        c.text(left + wide / 2, row + 20, text, anchor="middle", size=13)

    c.text(100, 68, "host line", anchor="end", size=13, bold=True)
    c.text(100, 128, "servo line", anchor="end", size=13, bold=True)
    c.line((x, 84), (x + 514, 84), color="soft", width=1)
    c.line((x, 144), (x + 514, 144), color="soft", width=1)
    span(48, 0, frame, "blue", "request, 52 bytes")
    span(48, total - frame, frame, "blue", "reply, 52 bytes")
    at = frame
    span(108, at, packet, "orange", "8")
    span(108, at + packet + delay, packet, "green", "8")
    c.text(
        x + (at + packet) * scale + delay * scale / 2, 100, "servo's delay", anchor="middle", size=12, color="soft"
    )
    for when in range(int(total) + 1):
        c.line((x + when * scale, 150), (x + when * scale, 156), color="soft", width=1.2)
        if when % 2 == 0:
            c.text(x + when * scale, 172, f"{when}", anchor="middle", size=12, color="soft")
    c.text(624, 172, "ms", anchor="end", size=12, color="soft")
    each = 1000 / total
    c.text(
        320,
        204,
        f"{total:.1f} ms for one position: {each:.0f} a second, {each / 7:.0f} for all seven joints",
        anchor="middle",
        bold=True,
    )
    c.text(
        320,
        226,
        "one state report has all joints in one frame, and servos answer while it travels",
        anchor="middle",
        size=13,
        color="soft",
    )
    return c


def _bytes(c: Canvas, x: float, y: float, data: bytes, color: str, *, w: float = 27.5) -> float:
    for i, value in enumerate(data):
        c.box(x + i * w, y, w, 28, stroke=color, r=2)
        c.text(x + (i + 0.5) * w, y + 19, f"{value:02X}", anchor="middle", mono=True, size=13)
    return x + len(data) * w


def frame() -> Canvas:
    """A whole frame with a servo packet inside, with its bytes."""
    c = Canvas(
        330, "A frame of the chapter byte by byte: session header, command frame, and a servo packet as its body"
    )
    whole = serialize_frame(
        Frame(1752865499, 278837000, 47, 7, 8, 3, tables.PROTO_CHAPTER, 47, Command.READ, REQUEST)
    )
    head, command, body, rest = whole[:32], whole[32:40], whole[40:48], whole[48:]
    x = 170.0
    c.text(158, 34, "session header", anchor="end", bold=True, color="blue")
    c.text(158, 52, "32 bytes", anchor="end", size=13, color="soft")
    _bytes(c, x, 16, head[:16], "blue")
    _bytes(c, x, 48, head[16:], "blue")
    c.text(x, 92, "sync · time s, ns · sn  |  src · dst · type · size", size=12, color="soft")
    c.text(158, 128, "command", anchor="end", bold=True, color="orange")
    c.text(158, 146, "8 bytes", anchor="end", size=13, color="soft")
    _bytes(c, x, 110, command, "orange")
    c.text(x, 154, "82 · dialect · seq · pad · length · command · ext", size=12, color="soft")
    c.text(158, 190, "servo packet", anchor="end", bold=True, color="green")
    c.text(158, 208, "the body", anchor="end", size=13, color="soft")
    end = _bytes(c, x, 172, body, "green")
    c.text(end + 10, 191, "reads 2 bytes at 38 of servo 0", size=13, color="soft")
    c.text(x, 216, "FF FF · id · length · read · register · count · check sum", size=12, color="soft")
    c.text(158, 252, "end", anchor="end", bold=True, color="orange")
    _bytes(c, x, 234, rest, "orange")
    c.text(x, 278, "check (FF FF: none, in dialect 1) · tail 0D 0A", size=12, color="soft")
    c.text(
        320,
        314,
        f"{len(whole)} bytes, {len(whole) * 10 * BIT_US / 1000:.1f} ms at {BAUD}; the header says {whole[28]}",
        anchor="middle",
        bold=True,
    )
    return c


def framing() -> Canvas:
    """How a receiver finds where a frame begins and ends: HDLC, servos, hexwire."""
    c = Canvas(
        330, "Three ways to find a frame: HDLC's flag, the servos' FF FF with a length, a sync word with a size"
    )
    rows = (
        (
            30.0,
            "HDLC",
            bytes((0x7E, 0x31, 0x7D, 0x5E, 0x32, 0x7E)),
            ("red", "ink", "orange", "orange", "ink", "red"),
        ),
        (130.0, "servo packet", REQUEST, ("red", "red", "ink", "blue", "ink", "ink", "ink", "green")),
    )
    for y, name, data, colors in rows:
        c.text(16, y + 20, name, bold=True)
        for i, value in enumerate(data):
            _bytes(c, 150 + i * 40, y, bytes((value,)), colors[i], w=40)
    c.text(150, 80, "on a serial line 7E marks both ends; a 7E inside is sent as 7D 5E,", size=13, color="soft")
    c.text(150, 97, "so the flag is never data", size=13, color="soft")
    c.text(150, 180, "FF FF, then a length; nothing is escaped, so FF FF may also be", size=13, color="soft")
    c.text(150, 197, "data: only length and check sum together tell a packet", size=13, color="soft")
    c.text(16, 250, "frame", bold=True)
    at = _bytes(c, 150, 230, tables.SYNC_BYTES, "red", w=40)
    c.box(at, 230, 120, 28, r=2)
    c.text(at + 60, 249, "24 bytes", anchor="middle", size=13)
    at = _bytes(c, at + 120, 230, bytes((52, 0, 0, 0)), "blue", w=40)
    c.text(150, 280, "a sync word of four bytes and a size, then a check over everything;", size=13, color="soft")
    c.text(150, 297, "the tail 0D 0A may occur inside as well, and is only compared", size=13, color="soft")
    c.text(
        320,
        320,
        "red: where it begins or ends · blue: how long it is · green: whether it is whole",
        anchor="middle",
        size=12,
        color="soft",
    )
    return c
