"""Drawings of the arms: their parts, their wiring, the joints of the Hex7Bot."""

from __future__ import annotations

import math

from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.links import link_set

from .canvas import Canvas, Point

__all__ = ["hex7bot_parts", "joints", "so101_parts"]

_SERIES_COLOR = {"seven_bot": "orange", "hls": "green"}


def _servo(c: Canvas, x: float, y: float, head: str, sub: str, color: str) -> None:
    c.box(x, y, 70, 54, stroke=color)
    c.text(x + 35, y + 23, head, anchor="middle", bold=True)
    c.text(x + 35, y + 42, sub, anchor="middle", size=13, color="soft")


def hex7bot_parts() -> Canvas:
    """From the computer to the seven servos."""
    c = Canvas(
        420, "Hex7Bot: a computer, a Mega 2560 on USB, a circuit that makes one wire of two, seven servos on it"
    )
    c.labelled(16, 24, 150, 84, "PC or\nRaspberry Pi", sub="hexwire")
    c.labelled(240, 24, 150, 84, "Mega 2560", sub="hexwire's firmware\nor the chapter's")
    c.labelled(474, 24, 150, 84, "One-wire circuit", sub="URT-1,\nor one transistor")
    c.line((166, 66), (240, 66), color="blue", both=True, width=2.4)
    c.text(203, 56, "USB", anchor="middle", size=13, color="blue")
    c.text(203, 88, "115200", anchor="middle", size=13, color="soft")
    c.line((390, 50), (474, 50), color="blue", end=True, width=2.4)
    c.line((474, 84), (390, 84), color="blue", end=True, width=2.4)
    c.text(432, 43, "TX1 18", anchor="middle", size=13, color="blue")
    c.text(432, 102, "RX1 19", anchor="middle", size=13, color="blue")
    # The bus and the servos on it.
    y = 190
    c.line((549, 108), (549, y), color="blue", width=2.4)
    c.text(541, 140, "one data wire, 115200", anchor="end", size=13, color="blue")
    c.line((51, y), (591, y), color="blue", width=2.4)
    for i, joint in enumerate(HEX7BOT.joints):
        x = 16 + i * 90
        c.line((x + 35, y), (x + 35, 226), color="blue", width=2.4)
        c.dot(x + 35, y, "blue")
        _servo(c, x, 226, joint.name, f"id {joint.servo_id}", _SERIES_COLOR[joint.series])
        c.line((x + 24, 280), (x + 24, 318), color="red", width=2.0)
        c.line((x + 46, 280), (x + 46, 340), width=2.0)
        c.dot(x + 24, 318, "red")
        c.dot(x + 46, 340)
    c.line((40, 318), (580, 318), color="red", width=2.4)
    c.line((62, 340), (602, 340), width=2.4)
    c.labelled(240, 362, 160, 46, "Servo supply", sub="")
    c.line((280, 362), (280, 318), color="red", width=2.4)
    c.dot(280, 318, "red")
    c.line((360, 362), (360, 340), width=2.4)
    c.dot(360, 340)
    c.text(16, 376, "orange: legacy 7Bot servos\ngreen: HLS servos", size=13, color="soft")
    c.text(624, 376, "lower rail: ground, joined\nto that of the Mega", size=13, color="soft", anchor="end")
    return c


def so101_parts() -> Canvas:
    """From the computer to the six servos of an SO-101, without a board."""
    c = Canvas(
        330,
        "SO-101: a computer, a USB servo adapter, six servos in a chain; the supply is connected to the adapter",
    )
    c.labelled(16, 24, 150, 84, "PC or\nRaspberry Pi", sub="hexwire")
    c.labelled(250, 24, 190, 84, "Servo adapter", sub="URT-1 or Waveshare:\nUSB and one wire")
    c.line((166, 66), (250, 66), color="blue", both=True, width=2.4)
    c.text(208, 56, "USB", anchor="middle", size=13, color="blue")
    c.text(208, 88, "1 Mbaud", anchor="middle", size=13, color="soft")
    c.labelled(510, 24, 114, 84, "Supply", sub="by the label\nof the servos")
    c.line((510, 54), (440, 54), color="red", end=True, width=2.4)
    c.line((510, 80), (440, 80), width=2.4)
    c.text(475, 46, "+", anchor="middle", color="red", bold=True)
    c.text(475, 98, "ground", anchor="middle", size=13, color="soft")
    names = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
    y = 190
    for dx, color in ((-10, "red"), (0, "blue"), (10, "ink")):
        c.line((345 + dx, 108), (345 + dx, 140 + dx), (51 + dx, 140 + dx), (51 + dx, y), color=color, width=2.0)
    for i, name in enumerate(names):
        x = 16 + i * 106
        _servo(c, x, y, f"id {i + 1}", "STS3215", "green")
        c.text(x + 35, y + 76 + (20 if i % 2 else 0), name, anchor="middle", size=13, color="soft")
        if i:
            for dy, color in ((17, "red"), (27, "blue"), (37, "ink")):
                c.line((x - 36, y + dy), (x, y + dy), color=color, width=2.0)
    c.text(
        320,
        318,
        "each cable has three wires: supply (red), data (blue), ground",
        anchor="middle",
        size=13,
        color="soft",
    )
    return c


def joints() -> Canvas:
    """Side view of the Hex7Bot with its joints, to scale for link set A, all joints at neutral."""
    c = Canvas(390, "Hex7Bot from the side, to scale: where its joints are, and which servo turns each")
    k = link_set("A")
    scale = 1150.0

    def at(forward: float, up: float) -> Point:
        return 150 + forward * scale, 350 - up * scale

    shoulder = (k.d, k.e)
    elbow = (k.d, k.e + k.a)
    corner = (k.d, k.e + k.a + k.h)
    wrist = (k.d + k.c, k.e + k.a + k.h)
    tip = (k.d + k.c + k.f, k.e + k.a + k.h)
    c.line((40, 350), (600, 350), color="soft")
    c.box(at(0, 0)[0] - 60, 350 - k.e * scale + 26, 120, k.e * scale - 26, r=4)
    c.line(at(0, k.e - 0.02), at(*shoulder), width=7, color="soft")
    for first, second in ((shoulder, elbow), (elbow, corner), (corner, wrist)):
        c.line(at(*first), at(*second), width=7, color="soft")
    c.line(at(*wrist), at(*tip), width=5, color="soft")
    # The gripper, behind the tip.
    x, y = at(*tip)
    c.line((x, y - 12), (x, y + 12), width=4, color="soft")
    c.line((x, y - 12), (x + 46, y - 12), width=4, color="soft")
    c.line((x, y + 12), (x + 46, y + 12), width=4, color="soft")
    places = {"J1": at(0, 0.02), "J2": at(*shoulder), "J3": at(*elbow)}
    places["J4"] = at(k.d + 0.5 * k.c, corner[1])
    places["J5"], places["J6"] = at(*wrist), (x - 2, y)
    places["J7"] = (x + 46, y)
    says = {
        "J1": ("turns the arm", 70, 5, "start"),
        "J2": ("upper arm", 22, 6, "start"),
        "J3": ("forearm, by a crank from the base", 22, 38, "start"),
        "J4": ("rolls the forearm", 0, 30, "middle"),
        "J5": ("wrist", -6, -26, "middle"),
        "J6": ("rolls the hand", 10, 34, "middle"),
        "J7": ("gripper", 26, 5, "start"),
    }
    for joint in HEX7BOT.joints:
        color = _SERIES_COLOR[joint.series]
        px, py = places[joint.name]
        c.circle(px, py, 11, stroke=color)
        c.text(px, py + 4, joint.name[1], anchor="middle", size=13, bold=True, color=color)
        text, dx, dy, anchor = says[joint.name]
        c.text(px + dx, py + dy, text, size=13, color="soft", anchor=anchor)
    width = math.hypot(*(a - b for a, b in zip(at(*corner), at(*wrist), strict=True)))
    c.line((at(*corner)[0], 40), (at(*corner)[0] + width, 40), color="blue", width=1.2, both=True)
    c.text(at(*corner)[0] + width / 2, 32, f"{k.c * 1000:g} mm", anchor="middle", size=13, color="blue")
    c.line((116, at(*shoulder)[1]), (116, at(*elbow)[1]), color="blue", width=1.2, both=True)
    c.text(
        108, (at(*shoulder)[1] + at(*elbow)[1]) / 2 + 4, f"{k.a * 1000:g} mm", anchor="end", size=13, color="blue"
    )
    c.text(
        624,
        306,
        "orange: legacy 7Bot servos, ids 0 to 3\ngreen: HLS servos, ids 4 to 6",
        size=13,
        color="soft",
        anchor="end",
    )
    return c
