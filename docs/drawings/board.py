"""Drawings of the board, the one-wire circuit, adapters, and RS-485."""

from __future__ import annotations

from .canvas import Canvas

__all__ = ["R1_OHM", "R2_OHM", "adapters", "circuit", "pins", "rs485", "signals"]

R1_OHM, R2_OHM = 22_000, 4_700
"""Base resistor and pull-up of the one-wire circuit."""


def pins() -> Canvas:
    """The pins of the Mega that are used."""
    c = Canvas(300, "Arduino Mega 2560: the pins that the firmware uses")
    c.box(150, 60, 340, 180, r=12)
    c.text(320, 140, "Arduino Mega 2560", anchor="middle", bold=True, size=17)
    c.text(320, 162, "ATmega2560, 16 MHz", anchor="middle", size=13, color="soft")
    c.box(128, 84, 46, 40, fill="paper")
    c.text(116, 102, "USB: to the\ncomputer, UART0", anchor="end", size=13, color="soft")
    c.box(128, 184, 40, 32, fill="paper")
    c.text(116, 198, "supply socket:\nnot needed", anchor="end", size=13, color="soft")
    top = ((360, "TX1 18", "blue"), (430, "RX1 19", "blue"))
    for x, name, color in top:
        c.box(x - 6, 52, 12, 16, fill="paper", stroke=color, r=2)
        c.text(x, 42, name, anchor="middle", color=color, bold=True, size=14)
    c.text(395, 20, "UART1: to the servos", anchor="middle", size=13, color="soft")
    right = ((90, "36 valve"), (122, "37 buzzer"), (154, "40 pump"))
    for y, name in right:
        c.box(482, y, 16, 12, fill="paper", stroke="green", r=2)
        c.text(506, y + 11, name, color="green", bold=True, size=14)
    c.text(506, 192, "outputs: a driver\nstage each", size=13, color="soft")
    bottom = ((230, "RESET", "orange"), (300, "GND", "ink"), (370, "5V", "red"))
    for x, name, color in bottom:
        c.box(x - 6, 232, 12, 16, fill="paper", stroke=color, r=2)
        c.text(x, 268, name, anchor="middle", color=color, bold=True, size=14)
    c.text(
        320,
        290,
        "GND also to the servo supply; 5V feeds the one-wire circuit, never servos",
        anchor="middle",
        size=13,
        color="soft",
    )
    return c


def _resistor(c: Canvas, x: float, y: float, label: str, *, left: bool = False) -> None:
    """An upright resistor from `y` to `y + 60`."""
    c.line((x, y), (x, y + 12))
    c.box(x - 8, y + 12, 16, 36, fill="paper", r=2)
    c.line((x, y + 48), (x, y + 60))
    c.text(x - 14 if left else x + 14, y + 35, label, size=13, anchor="end" if left else "start")


def circuit() -> Canvas:
    """One NPN transistor as an open collector that follows TX."""
    c = Canvas(
        360,
        "One-wire circuit: an NPN transistor, emitter on TX1, base over R1 on 5 V, collector on the bus",
    )
    c.line((250, 50), (500, 50), color="red", width=2.4)
    c.text(244, 55, "5 V", anchor="end", color="red", bold=True)
    # R1 to the base; R2 to the bus.
    _resistor(c, 290, 50, f"R1 {R1_OHM / 1000:g} kΩ", left=True)
    _resistor(c, 430, 50, f"R2 {R2_OHM / 1000:g} kΩ")
    c.dot(290, 50, "red")
    c.dot(430, 50, "red")
    # The transistor lies on its side: emitter left, collector right, base above.
    c.line((290, 110), (290, 142))
    c.circle(290, 166, 34, fill="paper")
    c.line((290, 132), (290, 150))
    c.line((268, 150), (312, 150), width=3.6)
    c.line((278, 150), (256, 178), (110, 178), end=False)
    c.polygon((258, 176), (262, 163), (270, 170), fill="ink")
    c.line((302, 150), (324, 178), (430, 178))
    c.text(290, 216, "Q1, NPN\nS8050 or similar", anchor="middle", size=13, color="soft")
    c.text(250, 198, "E", size=13, anchor="end", color="soft")
    c.text(330, 198, "C", size=13, color="soft")
    c.text(298, 128, "B", size=13, color="soft")
    c.line((430, 110), (430, 178))
    c.dot(430, 178)
    c.line((430, 178), (530, 178), color="blue", width=2.6)
    c.text(538, 173, "bus", bold=True, color="blue")
    c.text(538, 191, "to all servos", size=13, color="soft")
    # RX: the bus itself.
    c.line((430, 178), (430, 262), (110, 262))
    c.text(102, 183, "TX1 18", anchor="end", bold=True)
    c.text(102, 267, "RX1 19", anchor="end", bold=True)
    c.text(
        270,
        282,
        "the bus itself: RX1 also hears what TX1 sends, the echo",
        anchor="middle",
        size=13,
        color="orange",
    )
    c.line((110, 316), (530, 316), width=2.4)
    c.text(102, 321, "GND", anchor="end", bold=True)
    c.text(538, 321, "supply −", size=13, color="soft")
    c.text(
        320,
        346,
        "5 V and GND of the Mega; the servos' own supply only shares the ground",
        anchor="middle",
        size=13,
        color="soft",
    )
    return c


_QUIET = 40.0
_SENT = (1, 0, 1, 1, 0, 0, 1, 0, 1)
_ANSWER = (0, 1, 1, 0, 1, 0, 1, 1)


def _levels(bits: tuple[int, ...]) -> list[tuple[float, int]]:
    return [(17.0, bit) for bit in bits]


def signals() -> Canvas:
    """Levels on TX1, the bus and RX1 while the Mega sends and a servo answers."""
    c = Canvas(
        270, "Levels on TX1, on the bus and on RX1: first the Mega sends and hears its echo, then a servo answers"
    )
    x = 110.0
    sent, answer = _levels(_SENT[1:]), _levels(_ANSWER)
    span = 17.0 * 8
    idle = [(_QUIET, 1)]
    both = [*idle, *sent, (90.0, 1), *answer, (_QUIET, 1)]
    only = [*idle, *sent, (90.0 + span + _QUIET, 1)]
    for y, name, levels, color in ((90, "TX1", only, "ink"), (150, "bus", both, "blue"), (210, "RX1", both, "ink")):
        c.text(x - 16, y - 8, name, anchor="end", bold=True, color=color)
        c.wave(x, y, levels, color=color)
    first, second = x + _QUIET, x + _QUIET + span + 90
    for at, text in ((first, "the Mega sends"), (second, "a servo answers")):
        c.line((at, 48), (at + span, 48), color="soft", width=1.2, both=True)
        c.text(at + span / 2, 38, text, anchor="middle", size=13, color="soft")
    c.box(first - 6, 176, span + 12, 44, fill="paper", stroke="orange", dash="5 4")
    c.wave(x, 210, both, color="ink")
    c.text(first + span / 2, 244, "echo", anchor="middle", color="orange", bold=True)
    c.text(second + span / 2, 244, "answer", anchor="middle", color="green", bold=True)
    return c


def adapters() -> Canvas:
    """The two ways to use an adapter."""
    c = Canvas(300, "A servo adapter on USB, and the same adapter as the one-wire circuit of a Mega")
    c.text(16, 30, "On USB: no board", bold=True)
    c.labelled(16, 46, 110, 62, "Computer")
    c.labelled(216, 46, 200, 62, "Adapter", sub="USB chip · one-wire circuit")
    c.labelled(506, 46, 118, 62, "Servos")
    c.line((126, 77), (216, 77), color="blue", both=True, width=2.4)
    c.text(171, 68, "USB", anchor="middle", size=13, color="blue")
    c.line((416, 77), (506, 77), color="blue", both=True, width=2.4)
    c.text(461, 68, "one wire", anchor="middle", size=13, color="blue")
    c.line((316, 132), (316, 108), color="red", end=True, width=2.2)
    c.text(324, 130, "supply on the screw terminals", size=13, color="red")
    c.line((16, 152), (624, 152), color="soft", dash="3 5", width=1.2)
    c.text(16, 180, "Behind a board: its UART pins instead of USB", bold=True)
    c.labelled(16, 196, 110, 62, "Mega 2560")
    c.labelled(216, 196, 200, 62, "Adapter", sub="only the one-wire circuit")
    c.labelled(506, 196, 118, 62, "Servos")
    c.line((126, 212), (216, 212), color="blue", end=True, width=2.4)
    c.text(171, 206, "TX1", anchor="middle", size=13, color="blue")
    c.line((216, 238), (126, 238), color="blue", end=True, width=2.4)
    c.text(171, 256, "RX1", anchor="middle", size=13, color="blue")
    c.line((416, 227), (506, 227), color="blue", both=True, width=2.4)
    c.text(461, 218, "one wire", anchor="middle", size=13, color="blue")
    c.line((316, 282), (316, 258), color="red", end=True, width=2.2)
    c.text(324, 280, "supply; grounds joined", size=13, color="red")
    return c


def rs485() -> Canvas:
    """TTL against RS-485, and the converter."""
    c = Canvas(
        330, "TTL has one data wire against ground, RS-485 two wires against each other; a converter is between"
    )
    bits = (1, 0, 1, 1, 0, 0, 1)
    levels = [(22.0, bit) for bit in bits]
    inverse = [(22.0, 1 - bit) for bit in bits]
    c.text(16, 28, "TTL: one data wire, 0 and 5 V against ground", bold=True)
    c.wave(120, 76, levels, h=30, color="blue")
    c.text(108, 66, "data", anchor="end", size=13)
    c.line((120, 84), (274, 84), color="soft", dash="3 4", width=1.2)
    c.text(108, 90, "GND", anchor="end", size=13, color="soft")
    c.text(300, 62, "three wires a servo:\nsupply, ground, data", size=13, color="soft")
    c.text(16, 128, "RS-485: two data wires against each other", bold=True)
    c.wave(120, 168, levels, h=22, color="blue")
    c.wave(120, 204, inverse, h=22, color="orange")
    c.text(108, 162, "D+", anchor="end", size=13)
    c.text(108, 198, "D−", anchor="end", size=13)
    c.text(300, 164, "four wires a servo:\nsupply, ground, D+, D−", size=13, color="soft")
    c.labelled(16, 236, 120, 62, "Computer")
    c.labelled(226, 236, 176, 62, "RS-485 converter", sub="turns its direction itself")
    c.labelled(504, 236, 120, 62, "RS-485\nservos")
    c.line((136, 267), (226, 267), color="blue", both=True, width=2.4)
    c.text(181, 258, "USB", anchor="middle", size=13, color="blue")
    c.line((402, 258), (504, 258), color="blue", both=True, width=2.4)
    c.line((402, 276), (504, 276), color="orange", both=True, width=2.4)
    c.text(453, 250, "D+", anchor="middle", size=13, color="blue")
    c.text(453, 294, "D−", anchor="middle", size=13, color="orange")
    c.text(
        320,
        320,
        "never one of these servos on a TTL bus, nor the other way round",
        anchor="middle",
        size=13,
        color="red",
    )
    return c
