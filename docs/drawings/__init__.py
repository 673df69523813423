"""The drawings of the hardware pages, made by `docs/make_pictures.py`."""

from __future__ import annotations

from collections.abc import Callable

from . import arm, board, ide, robots, serial
from .canvas import Canvas

DRAWINGS: dict[str, Callable[[], Canvas]] = {
    "hex7bot-parts": arm.hex7bot_parts,
    "so101-parts": arm.so101_parts,
    "hex7bot-joints": arm.joints,
    "board-pins": board.pins,
    "one-wire-circuit": board.circuit,
    "one-wire-signals": board.signals,
    "adapters": board.adapters,
    "rs485": board.rs485,
    "driver-hierarchy": robots.hierarchy,
    "serial-8n1": serial.byte_8n1,
    "serial-rate": serial.rate,
    "serial-exchange": serial.exchange,
    "serial-frame": serial.frame,
    "serial-framing": serial.framing,
    "ide-open": ide.open_sketch,
    "ide-board": ide.choose_board,
    "ide-upload": ide.upload,
}
"""Name of the file without its end -> what draws it."""
