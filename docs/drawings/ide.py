"""Drawings of the Arduino IDE, simplified: what to choose where."""

from __future__ import annotations

from .canvas import Canvas

__all__ = ["choose_board", "open_sketch", "upload"]


def _window(c: Canvas, title: str, *, board: str) -> None:
    """Menu bar, tool bar with the board, editor and output."""
    c.box(12, 12, 616, c.height - 24, fill="paper", r=8)
    c.box(12, 12, 616, 30, r=8)
    c.text(320, 32, title, anchor="middle", size=13, color="soft")
    for x, name in ((28, "File"), (68, "Edit"), (112, "Sketch"), (172, "Tools"), (224, "Help")):
        c.text(x, 62, name, size=14)
    c.line((12, 74), (628, 74), color="soft", width=1)
    for x, sign in ((36, "✓"), (72, "→")):
        c.circle(x, 96, 14, fill="box", stroke="green")
        c.text(x, 101, sign, anchor="middle", bold=True, color="green", size=14)
    c.box(104, 82, 280, 28, stroke="blue")
    c.text(116, 101, board, size=13)
    c.text(370, 101, "▾", anchor="middle", size=13, color="soft")
    c.line((12, 118), (628, 118), color="soft", width=1)


def _mark(c: Canvas, x: float, y: float, number: str) -> None:
    c.circle(x, y, 12, fill="orange", stroke="")
    c.text(x, y + 5, number, anchor="middle", bold=True, color="paper", size=14)


def open_sketch() -> Canvas:
    """File > Open and the folder."""
    c = Canvas(330, "Arduino IDE: open firmware/boards/mega2560/mega2560.ino")
    _window(c, "Arduino IDE", board="Select Board")
    c.box(20, 68, 150, 70, fill="box")
    c.text(32, 90, "New Sketch", size=14, color="soft")
    c.text(32, 112, "Open…", size=14, bold=True)
    _mark(c, 184, 107, "1")
    c.box(220, 136, 392, 170, fill="box")
    c.text(236, 160, "Open", bold=True, size=14)
    for i, name in enumerate(("hexwire", "firmware", "boards", "mega2560")):
        c.text(250 + i * 20, 186 + i * 22, f"▸ {name}", size=14, color="soft")
    c.text(330, 278, "mega2560.ino", size=14, bold=True, color="blue")
    _mark(c, 474, 273, "2")
    c.text(28, 180, "the folder is the\nsketch; its code is\nin src/core", size=13, color="soft")
    return c


def choose_board() -> Canvas:
    """Tools > Board, Processor, Port."""
    c = Canvas(340, "Arduino IDE: Tools, Board: Arduino Mega or Mega 2560, and Tools, Port")
    _window(c, "mega2560 | Arduino IDE", board="Arduino Mega or Mega 2560")
    c.box(160, 68, 230, 190, fill="box")
    rows = (
        "Auto Format",
        "Serial Monitor",
        "Board",
        "Port",
        "Processor: ATmega2560",
        "Programmer",
        "Burn Bootloader",
    )
    for i, text in enumerate(rows):
        chosen = i in (2, 3, 4)
        c.text(172, 92 + i * 25, text, size=14, bold=chosen, color="ink" if chosen else "soft")
        if i in (2, 3, 4, 5):
            c.text(380, 92 + i * 25, "▸", size=14, anchor="end", color="soft")
    c.box(396, 112, 216, 58, fill="box", stroke="blue")
    c.text(408, 134, "Arduino AVR Boards", size=14)
    c.text(408, 157, "Arduino Mega or 2560", size=14, bold=True, color="blue")
    c.line((384, 138), (396, 138), color="blue", width=1.4)
    c.box(396, 182, 216, 58, fill="box", stroke="blue")
    c.text(408, 204, "Linux: /dev/ttyACM0", size=14, color="blue", bold=True)
    c.text(408, 227, "Windows: COM3", size=14, color="soft")
    c.line((372, 163), (384, 163), (384, 200), (396, 200), color="blue", width=1.4)
    _mark(c, 146, 138, "1")
    _mark(c, 146, 163, "2")
    _mark(c, 146, 188, "3")
    c.text(
        28,
        290,
        "1 the board · 2 the port that hexwire ports names · 3 the chip, with the board chosen",
        size=13,
        color="soft",
    )
    c.text(28, 310, "a clone with a CH340 is /dev/ttyUSB0", size=13, color="soft")
    return c


def upload() -> Canvas:
    """Verify, upload, and what the output says."""
    c = Canvas(330, "Arduino IDE: the arrow uploads; the output names flash and RAM")
    _window(c, "mega2560 | Arduino IDE", board="Arduino Mega or Mega 2560")
    _mark(c, 72, 128, "1")
    for i, text in enumerate(("void setup() {", "  …", "}", "void loop() {", "  …", "}")):
        c.text(110, 144 + i * 17, text, size=13, mono=True, color="soft")
    c.line((12, 236), (628, 236), color="soft", width=1)
    c.text(28, 256, "Output", bold=True, size=13)
    c.text(28, 276, "Sketch uses … bytes of program storage space.", size=13, mono=True)
    c.text(28, 294, "Global variables use … bytes of dynamic memory.", size=13, mono=True)
    c.text(28, 312, "Done uploading.", size=13, mono=True, bold=True, color="green")
    _mark(c, 176, 307, "2")
    c.text(330, 150, "✓ compiles only\n→ compiles and uploads", size=14)
    c.text(330, 200, "hold the arm: the joints keep torque,\nbut nothing controls them", size=13, color="red")
    return c
