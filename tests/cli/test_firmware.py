"""`hexwire firmware`, with the real compiler and the real flasher against an emulated boot loader."""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from tests.avr.machines import CoreBoard, make
from tests.avr.pty import FlashableBoard, on_pty

from hexwire.cli.main import cli
from hexwire.drivers import firmware
from hexwire.drivers import firmware as tools
from hexwire.link.ports import PortInfo
from hexwire.wire import tables

# The first one builds.

Ports = Callable[..., None]
VERSION = f"{tables.VERSION_MAJOR}.{tables.VERSION_MINOR}.{tables.VERSION_PATCH}"


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, ["firmware", *words])


@pytest.fixture(scope="module", autouse=True)
def _built() -> None:
    """Build under the tests' lock: afterwards the command finds nothing to do, beside whoever else builds."""
    make("mega2560")


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch) -> Ports:
    def pretend(*found: PortInfo) -> None:
        monkeypatch.setattr(tools, "list_ports", lambda: list(found))

    return pretend


def test_build() -> None:
    built = run("build", "--json")
    assert built.exit_code == 0, built.output
    report = json.loads(built.stdout)
    assert Path(report["hex_file"]).read_text().startswith(":")
    assert report["version"] == VERSION
    assert report["size"].startswith("flash ")


def test_build_without_a_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    built = run("build")
    assert built.exit_code == 2
    assert "apt-get install gcc-avr binutils-avr make" in built.stderr


def test_build_from_a_folder_without_firmware(tmp_path: Path) -> None:
    built = run("build", "--source", str(tmp_path))
    assert built.exit_code == 2
    assert "is not the firmware's folder" in built.stderr


def test_a_build_that_fails_says_why(tmp_path: Path) -> None:
    (tmp_path / "core").mkdir()
    (tmp_path / "core/generated.h").write_text("VERSION_MAJOR = 1;\nVERSION_MINOR = 2;\nVERSION_PATCH = 3;\n")
    (tmp_path / "Makefile").write_text("mega2560:\n\t@echo no such register >&2; exit 1\n")
    built = run("build", "--source", str(tmp_path))
    assert built.exit_code == 1
    assert "the build failed: no such register" in built.stderr
    assert tools.source_version(tmp_path) == "1.2.3"


def test_a_dry_run_shows_the_command_and_writes_nothing(ports: Ports) -> None:
    ports(PortInfo("/dev/ttyACM7", 0x2341, 0x0042, guess="Arduino Mega 2560", likely_board=True))
    done = run("flash", "--port", "/dev/ttyACM7", "--dry-run")
    assert done.exit_code == 0, done.output
    words = shlex.split(done.stdout)
    assert words[0] == "avrdude"
    assert words[words.index("-p") + 1] == "atmega2560"
    assert words[words.index("-P") + 1] == "/dev/ttyACM7"
    assert words[words.index("-c") + 1] == "wiring"
    assert "-F" not in words  # which would override the look at the signature
    assert words[-1].startswith("flash:w:/")


@pytest.mark.parametrize(
    ("port", "why"),
    [
        (
            PortInfo("/dev/ttyACM7", 0x1A86, 0x55D3, guess="CH343: a newer servo adapter"),
            "is not a Mega 2560 but CH343",
        ),
        (PortInfo("/dev/ttyACM7", 0x1234, 0x5678, guess="unknown USB device 1234:5678"), "is not a Mega 2560"),
        (PortInfo("/dev/ttyS9"), "is not a USB serial port"),
    ],
)
def test_a_wrong_board_is_refused(ports: Ports, port: PortInfo, why: str) -> None:
    ports(port)
    done = run("flash", "--port", "/dev/ttyACM7", "--dry-run")
    assert done.exit_code == 2
    assert why in done.stderr
    assert run("flash", "--port", "/dev/ttyACM7", "--dry-run", "--any-port").exit_code == 0


def test_only_a_serial_port_can_be_flashed() -> None:
    done = run("flash", "--port", "tcp://arm:15030", "--dry-run")
    assert done.exit_code == 2
    assert "through its serial port" in done.stderr


@pytest.fixture
def wheel(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An installation from a wheel: firmware ready to flash, and no sources."""
    image = tmp_path / "mega2560-115200.hex"
    image.write_text(":00000001FF\n")
    row = {"file": image.name, "board": "mega2560", "host_baud": 115200}
    row["sha256"] = hashlib.sha256(image.read_bytes()).hexdigest()
    (tmp_path / "firmware.json").write_text(json.dumps({"version": "7.8.9", "images": [row]}))
    monkeypatch.setattr(firmware, "FOLDER", tmp_path)
    monkeypatch.setattr(tools, "_SOURCES", tmp_path / "none")
    monkeypatch.setenv("PATH", "")  # neither a compiler nor a flasher
    return image


def test_a_wheel_flashes_what_it_brings_without_a_compiler(ports: Ports, wheel: Path) -> None:
    ports(PortInfo("/dev/ttyACM7", 0x2341, 0x0042, likely_board=True))
    done = run("flash", "--port", "/dev/ttyACM7", "--dry-run")
    assert done.exit_code == 0, done.output
    assert shlex.split(done.stdout)[-1] == f"flash:w:{wheel}:i"
    other = run("flash", "--port", "/dev/ttyACM7", "--dry-run", "--host-baud", "500000")
    assert other.exit_code == 2
    assert "only for mega2560 at 115200" in other.stderr
    wheel.write_text("damaged")
    damaged = run("flash", "--port", "/dev/ttyACM7", "--dry-run")
    assert damaged.exit_code == 2
    assert "install hexwire again" in damaged.stderr


def test_a_wheel_builds_from_given_sources_only(ports: Ports, wheel: Path) -> None:
    ports(PortInfo("/dev/ttyACM7", 0x2341, 0x0042, likely_board=True))
    assert "give its folder with --source" in run("build").stderr
    given = run(
        "flash", "--port", "/dev/ttyACM7", "--dry-run", "--source", str(Path(__file__).parents[2] / "firmware")
    )
    assert "build tools are missing" in given.stderr


def test_info_says_what_the_board_runs_and_what_is_here(bench: Any) -> None:
    board, _, here = bench.ok("firmware", "info").splitlines()
    assert board.startswith(f"version {VERSION}, boot id ")
    assert here == f"sources {VERSION} (the same)"


@pytest.mark.usefixtures("wheel")
def test_info_in_a_wheel_names_the_firmware_that_it_brings_or_is_given(bench: Any, tmp_path: Path) -> None:
    assert bench.ok("firmware", "info").splitlines()[-1] == "in this package 7.8.9"
    assert bench.json("firmware", "info")["sources"] == "7.8.9"
    sources = tmp_path / "sources"
    (sources / "core").mkdir(parents=True)
    (sources / "Makefile").touch()
    (sources / "core/generated.h").write_text("VERSION_MAJOR = 1;\nVERSION_MINOR = 2;\nVERSION_PATCH = 3;\n")
    assert bench.ok("firmware", "info", "--source", str(sources)).splitlines()[-1] == "sources 1.2.3"
    (tmp_path / "firmware.json").unlink()
    assert bench.ok("firmware", "info").splitlines()[-1].startswith("supports ")


def test_no_such_image(ports: Ports, tmp_path: Path) -> None:
    ports(PortInfo("/dev/ttyACM7", 0x2341, 0x0042, likely_board=True))
    done = run("flash", "--port", "/dev/ttyACM7", "--hex", str(tmp_path / "none.hex"))
    assert done.exit_code == 2
    assert "build it first" in done.stderr


@pytest.mark.slow
@pytest.mark.system
def test_flash_and_read_the_version_back() -> None:
    with on_pty(FlashableBoard(CoreBoard())) as board:
        assert isinstance(board, FlashableBoard)
        done = run("flash", "--port", board.path, "--any-port")
        assert done.exit_code == 0, done.output
        assert f"the board runs version {VERSION}" in done.stdout
        assert board.writes > 50
        make("mega2560")
        image = tools.find_sources() / "build/mega2560/hexwire.hex"
        first = bytes.fromhex(image.read_text().splitlines()[0][9:-2])
        assert board.flash.startswith(first)
        info = run("info", "--port", board.path, "--json")
        assert json.loads(info.stdout)["firmware"] == VERSION


@pytest.mark.system
def test_another_chip_is_refused_before_anything_is_written() -> None:
    with on_pty(FlashableBoard(CoreBoard(), "1E950F")) as board:
        assert isinstance(board, FlashableBoard)
        done = run("flash", "--port", board.path, "--any-port")
        assert done.exit_code == 1
        assert "its signature is 1e 95 0f, not 1e 98 01; nothing was written" in done.stderr
        assert board.writes == 0


def test_without_the_flasher(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    image = tmp_path / "some.hex"
    image.write_text(":00000001FF\n")
    monkeypatch.setenv("PATH", str(tmp_path))
    done = run("flash", "--port", "/dev/ttyACM7", "--any-port", "--hex", str(image))
    assert done.exit_code == 2
    assert "avrdude is not installed" in done.stderr
