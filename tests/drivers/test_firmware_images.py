"""Firmware that a wheel brings: it is found by rate, and a damaged file is refused."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from hexwire.drivers.firmware import LIST, FirmwareImage, find_image, list_images
from hexwire.errors import ConfigError, UsageError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rows = []
    for rate in (115200, 500000):
        data = f":00000001FF at {rate}\n".encode()
        (tmp_path / f"mega2560-{rate}.hex").write_bytes(data)
        digest = hashlib.sha256(data).hexdigest()
        rows.append({"file": f"mega2560-{rate}.hex", "board": "mega2560", "host_baud": rate, "sha256": digest})
    (tmp_path / LIST).write_text(json.dumps({"version": "9.8.7", "compiler": {}, "images": rows}))
    return tmp_path


def test_a_checkout_brings_none(tmp_path: Path) -> None:
    assert list_images(tmp_path) == ()
    assert find_image(115200, folder=tmp_path) is None


def test_the_file_for_a_rate(folder: Path) -> None:
    image = find_image(500000, folder=folder)
    assert image is not None
    assert (image.file, image.version) == (folder / "mega2560-500000.hex", "9.8.7")
    assert [found.host_baud for found in list_images(folder)] == [115200, 500000]
    assert isinstance(image, FirmwareImage)


def test_another_rate_or_board_says_what_there_is(folder: Path) -> None:
    with pytest.raises(
        UsageError, match="at 57600 in this installation, only for mega2560 at 115200, mega2560 at 500000"
    ):
        find_image(57600, folder=folder)
    with pytest.raises(UsageError, match="no firmware for uno at 115200"):
        find_image(115200, "uno", folder=folder)


def test_a_damaged_or_missing_file_is_not_flashed(folder: Path) -> None:
    file = folder / "mega2560-115200.hex"
    file.write_bytes(file.read_bytes() + b" ")
    with pytest.raises(UsageError, match="is damaged; install hexwire again"):
        find_image(115200, folder=folder)
    file.unlink()
    with pytest.raises(UsageError, match="is damaged; install hexwire again"):
        find_image(115200, folder=folder)


@pytest.mark.parametrize("text", ["{", "{}", '{"version": "1", "images": [{"file": 3}]}', "[]"])
def test_a_damaged_list_says_so(folder: Path, text: str) -> None:
    (folder / LIST).write_text(text)
    with pytest.raises(ConfigError, match=r"firmware\.json"):
        list_images(folder)


def test_a_list_names_no_file_elsewhere(folder: Path) -> None:
    row = {"file": "../../etc/x.hex", "board": "mega2560", "host_baud": 115200, "sha256": "0"}
    (folder / LIST).write_text(json.dumps({"version": "1", "images": [row]}))
    assert list_images(folder)[0].file == folder / "x.hex"
