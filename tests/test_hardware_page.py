"""docs/hardware.md, serial-basics.md and arduino-ide.md: their drawings are legible, and their figures right."""

from __future__ import annotations

import math
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest

from hexwire.link.diagnose import avr_baud_error
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.wire import tables
from hexwire.wire.registers import Series

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS))

from drawings import DRAWINGS, board, canvas, serial  # noqa: E402  # found by the line above

PAGES = {
    name: (DOCS / f"{name}.md").read_text(encoding="utf-8")
    for name in ("hardware", "serial-basics", "arduino-ide", "chapter")
}
SVG = "{http://www.w3.org/2000/svg}"
LETTER, EQUAL_LETTER = 0.54, 0.61
"""Width of a letter by its height, in the widest of the usual fonts: on average, and where all have the same."""


def cells(page: str, first: str) -> list[str]:
    """The cells of the table row that begins with a text, without it."""
    (row,) = [line for line in PAGES[page].splitlines() if line.startswith(f"| {first} |")]
    return [cell.strip(" `*") for cell in row.strip("|").split("|")][1:]


# -- drawings ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DRAWINGS)
def test_a_drawing_is_on_a_page_with_its_title_for_those_who_do_not_see_it(name: str) -> None:
    drawn = DRAWINGS[name]()
    shown = [alt for text in PAGES.values() for alt in re.findall(rf"!\[([^\]]*)\]\(pictures/{name}\.svg\)", text)]
    assert shown == [drawn.title]


@pytest.mark.parametrize("name", DRAWINGS)
def test_a_drawing_is_whole_and_needs_nothing_else(name: str) -> None:
    text = (DOCS / "pictures" / f"{name}.svg").read_text(encoding="utf-8")
    assert text == DRAWINGS[name]().svg()
    assert "prefers-color-scheme:dark" in text
    assert not re.search(r"href|url\(|@import|<script|<image", text)
    drawing = ET.fromstring(text)
    width, height = (float(drawing.attrib[key]) for key in ("width", "height"))
    for word in drawing.iter(f"{SVG}text"):
        size, x, y = (float(word.attrib[key]) for key in ("font-size", "x", "y"))
        kinds = word.attrib["class"].split()
        letter = (EQUAL_LETTER if "m" in kinds else LETTER) * (1.05 if "b" in kinds else 1.0)
        length = len(word.text or "") * size * letter
        left = x - {"start": 0.0, "middle": 0.5, "end": 1.0}[word.attrib["text-anchor"]] * length
        assert size >= 12, f"{word.text}: too small on a phone"
        assert left >= 0, f"{word.text}: cut at the left"
        assert left + length <= width, f"{word.text}: cut at the right"
        assert size <= y <= height, f"{word.text}: cut above or below"


def _luminance(color: str) -> float:
    parts = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("colors", [canvas._LIGHT, canvas._DARK], ids=["light", "dark"])
def test_every_colour_is_legible_on_its_ground(colors: dict[str, str]) -> None:
    for ground in ("paper", "box"):
        for name in colors.keys() - {"paper", "box"}:
            one, other = sorted((_luminance(colors[name]), _luminance(colors[ground])))
            assert (other + 0.05) / (one + 0.05) >= 4.5, f"{name} on {ground}"


def test_a_text_of_the_page_that_is_drawn_cannot_break_the_file() -> None:
    drawn = canvas.Canvas(50, "a < b & c")
    drawn.text(10, 20, "x < y & z")
    assert [word.text for word in ET.fromstring(drawn.svg()).iter(f"{SVG}text")] == ["x < y & z"]


# -- figures ----------------------------------------------------------------------------------------------


def test_the_byte_is_drawn_as_the_line_has_it() -> None:
    assert serial.bits_of(0x38) == [0, 0, 0, 0, 1, 1, 1, 0, 0, 1]
    assert serial.bits_of(0x01) == [0, 1, 0, 0, 0, 0, 0, 0, 0, 1]


@pytest.mark.parametrize("baud", [115200, 500000, 1000000])
def test_times_on_the_line(baud: int) -> None:
    bit = 1e6 / baud
    shown = [float(cell.split()[0]) for cell in cells("serial-basics", str(baud))]
    assert shown == [round(bit, 2), round(10 * bit, 1), round(80 * bit / 1e3, 2), round(520 * bit / 1e3, 2)]


def test_the_rate_of_the_mega() -> None:
    assert f"{100 * avr_baud_error(115200):.1f} % too fast" in PAGES["serial-basics"]
    assert [avr_baud_error(baud) for baud in (250000, 500000, 1000000)] == [0, 0, 0]


def test_the_values_of_the_circuit() -> None:
    """With 0.7 V at the base, 500 pF on the bus, and 2 V for a 1."""
    base = (5.0 - 0.7) / board.R1_OHM
    pull_up = 5.0 / board.R2_OHM
    rise = board.R2_OHM * 500e-12 * math.log(5.0 / (5.0 - 2.0))
    r1, r2 = cells("hardware", "R1"), cells("hardware", "R2")
    assert (r1[0], r2[0]) == (f"{board.R1_OHM / 1000:g} kΩ", f"{board.R2_OHM / 1000:g} kΩ")
    assert f"{1000 * base:.2f} mA" in r1[1]
    assert 20 * base == pytest.approx(0.004, rel=0.05)
    assert f"{1000 * pull_up:.1f} mA" in r2[1]
    assert f"{1e6 * rise:.1f} µs: {100 * rise * 115200:.0f} % of a bit" in r2[1]
    assert rise > 1e-6, "at 1 Mbaud it is longer than a bit"
    assert 1000 / board.R2_OHM * rise < 0.3e-6


def _root(f: Callable[[float], float], low: float, high: float) -> float:
    """Where a falling function is 0."""
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if f(middle) > 0 else (low, middle)
    return low


def _bus(
    tx: float, gain: float, backwards: float, *, pull_up: float, servo: float = math.inf
) -> tuple[float, float]:
    """Voltage of the bus and current into a servo's output, by the model of Ebers and Moll; ohms and volts."""

    def diode(volts: float) -> float:
        return 1e-14 * (math.exp(min(volts / 0.02585, 60.0)) - 1.0)

    def excess(bus: float) -> float:
        base = _root(
            lambda v: (5.0 - v) / board.R1_OHM - diode(v - tx) / gain - diode(v - bus) / backwards, -1.0, 6.0
        )
        collector = diode(base - tx) - diode(base - bus) * (1.0 + 1.0 / backwards)
        return (5.0 - bus) / pull_up - collector - bus / servo

    volts = _root(excess, -0.5, 5.2)
    return volts, volts / servo


def test_the_levels_of_the_circuit() -> None:
    kinds = [(gain, backwards) for gain in (40.0, 100.0, 300.0) for backwards in (1.0, 5.0, 20.0)]
    with_servos = 1 / (1 / board.R2_OHM + 7 / 10_000)
    sent = max(_bus(0.05, *kind, pull_up=with_servos)[0] for kind in kinds)
    answers = [_bus(5.0, *kind, pull_up=board.R2_OHM, servo=50.0) for kind in kinds]
    text = PAGES["hardware"].replace("\n", " ")
    assert f"at most {math.ceil(100 * sent) / 100:.2f} V when the board sends" in text
    assert f"{math.ceil(100 * max(answers)[0]) / 100:.2f} V when a servo answers" in text
    assert f"up to {1000 * max(answers)[1]:.0f} mA" in text
    assert max(sent, max(answers)[0]) < 0.45, "what an HLS3606M reads as low"
    assert _bus(5.0, 100.0, 5.0, pull_up=board.R2_OHM)[0] > 4.9


def test_the_data_sheet_has_the_series_of_the_register_tables() -> None:
    names = ["seven_bot", "scs", "sts_sms", "hls"]
    series = [Series(name) for name in names]
    assert f"| in hexwire | {' | '.join(f'`{name}`' for name in names)} |" in PAGES["hardware"]
    assert cells("hardware", "counts in a range") == [
        f"{one.counts_per_rev} in {one.range_deg:.0f}°" for one in series
    ]
    assert cells("hardware", "neutral") == [str(one.neutral) for one in series]
    assert cells("hardware", "byte order") == [one.byte_order for one in series]
    assert cells("hardware", "answers begin with") == [one.reply_header.hex(" ").upper() for one in series]
    assert cells("hardware", "longest read, bytes") == [str(one.max_read) for one in series]
    assert cells("hardware", "all in one request (sync read)") == [["no", "yes"][one.sync_read] for one in series]
    found = [one.at(0x2C) for one in series]
    assert [row and row.name for row in found] == ["run_time", "goal_time", "goal_pwm_or_time", "goal_torque"]
    found = [one.at(0x30) for one in series]
    assert [row and row.name for row in found] == [None, "lock", "torque_limit", "torque_limit"]


def test_the_arm_has_the_servos_of_the_page() -> None:
    assert "| servos | ids 0 to 3 legacy 7Bot, 4 to 6 HLS3606M | ids 1 to 6 STS3215 |" in PAGES["hardware"]
    legacy = [joint.servo_id for joint in HEX7BOT.joints if joint.series == "seven_bot"]
    assert (legacy, [joint.servo_id for joint in HEX7BOT.joints]) == ([0, 1, 2, 3], list(range(7)))
    assert tuple(legacy) == tables.BOARD_JOINT_IDS[:4]


def test_the_pins_are_those_of_the_sketch() -> None:
    sketch = (ROOT / "firmware/boards/mega2560/mega2560.ino").read_text(encoding="utf-8")
    pins = dict(re.findall(r"k(Pump|Valve|Buzzer)Pin = (\d+);", sketch))
    assert f"| {pins['Pump']}, {pins['Valve']}, {pins['Buzzer']} | pump, valve and buzzer" in PAGES["hardware"]
    drawn = board.pins().svg()
    assert all(f">{number} {name.lower()}<" in drawn for name, number in pins.items())


def test_the_limits_of_the_chip_are_those_of_the_makefile() -> None:
    makefile = (ROOT / "firmware" / "Makefile").read_text(encoding="utf-8")
    limits = dict(re.findall(r"^(FLASH|RAM)_LIMIT := (\d+)$", makefile, re.MULTILINE))
    flash, ram = int(limits["FLASH"]), int(limits["RAM"])
    assert f"{flash // 1024} KB of flash and {ram // 1024} KB of RAM" in PAGES["arduino-ide"]


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    from tests.test_chapter_page import slugs

    for target, anchor in re.findall(r"\]\(([^)#]+)(#[^)]*)?\)", PAGES[page]):
        path = (DOCS / target).resolve()
        assert path.is_file(), target
        assert not anchor or anchor[1:] in slugs(path), target + anchor
