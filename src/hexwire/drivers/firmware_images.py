"""Firmware that a wheel brings ready to flash, so that no compiler is needed.

Owns where these files are and that they are whole. `make dist` puts them there; a checkout has none and builds its
own, see `firmware.py`. Must not know how a file is flashed.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from hexwire.errors import UsageError
from hexwire.inputs import parse_json, read_bytes

__all__ = ["LIST", "FirmwareImage", "find_image", "list_images"]

FOLDER = Path(__file__).resolve().parents[1] / "share" / "firmware"
LIST = "firmware.json"
"""Name of the file in the folder that says what each other file is."""


@dataclass(frozen=True, slots=True)
class FirmwareImage:
    """A firmware file.

    Attributes:
        file: The file, Intel HEX.
        board: The board that it is for, as in ``mega2560``.
        host_baud: Host-line rate that it was built for.
        version: As in ``1.0.0``.
        sha256: Digest of the file, hexadecimal.
    """

    file: Path
    board: str
    host_baud: int
    version: str
    sha256: str


def list_images(folder: Path | None = None) -> tuple[FirmwareImage, ...]:
    """List the files that this installation brings; empty in a checkout.

    Args:
        folder: Where they are; that of this package if None.

    Raises:
        ConfigError: The list is damaged.
    """
    where = FOLDER if folder is None else folder
    path = where / LIST
    if not path.is_file():
        return ()
    listed = parse_json(read_bytes(path), str(path)).table(needed=("version", "images"))
    images = []
    for item in listed["images"].rows(most=100):
        row = item.table(needed=("file", "board", "host_baud", "sha256"))
        file = where / Path(row["file"].text()).name
        rate = row["host_baud"].integer(1, 10_000_000)
        images.append(
            FirmwareImage(file, row["board"].text(), rate, listed["version"].text(), row["sha256"].text())
        )
    return tuple(images)


def find_image(host_baud: int, board: str = "mega2560", folder: Path | None = None) -> FirmwareImage | None:
    """Find the file for a board and a rate; None if this installation brings none.

    Raises:
        UsageError: The file is damaged, or there are only files for other rates.
    """
    images = list_images(folder)
    if not images:
        return None
    rates = []
    for image in images:
        if image.board == board and image.host_baud == host_baud:
            if not image.file.is_file() or hashlib.sha256(read_bytes(image.file)).hexdigest() != image.sha256:
                raise UsageError(f"{image.file} is damaged; install hexwire again")
            return image
        rates.append(f"{image.board} at {image.host_baud}")
    raise UsageError(f"no firmware for {board} at {host_baud} in this installation, only for {', '.join(rates)}")
