"""`firmware`: build, flash and identify the firmware of the controller board.

Owns the options and the output.
"""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path

import click

from hexwire.drivers import firmware as tools
from hexwire.errors import DeviceError

from .exits import note
from .options import (
    RobotOptions,
    attached,
    group_port_option,
    json_option,
    make_robot,
    resolve_url,
    robot_options,
)
from .output import answer, say, say_document

__all__ = ["firmware"]

source_option = click.option(
    "--source", type=click.Path(file_okay=False), metavar="FOLDER", help="Folder with the firmware sources."
)
rate_option = click.option(
    "--host-baud",
    type=click.Choice([str(rate) for rate in tools.HOST_RATES]),
    default="115200",
    show_default=True,
    help="Rate of the line to the host. The servo line stays at 115200.",
)


@click.group()
@group_port_option
def firmware(port: str | None) -> None:
    """Build, flash and identify the controller board's firmware."""


@firmware.command()
@source_option
@rate_option
@json_option
def build(source: str | None, host_baud: str) -> None:
    """Build the firmware for an Arduino Mega 2560."""
    report = tools.build(tools.find_sources(source), host_baud=int(host_baud))
    hex_file = str(report.hex_file)
    words = f"version {report.version}, host line at {report.host_baud}"
    answer(asdict(report) | {"hex_file": hex_file}, hex_file, words, report.size)


@firmware.command()
@click.option(
    "--hex",
    "hex_file",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Flash this file instead of building.",
)
@click.option("--any-port", is_flag=True, help="Do not check the port's USB identity.")
@click.option("--dry-run", is_flag=True, help="Check everything and show the command, but do not write.")
@source_option
@rate_option
@robot_options
def flash(
    options: RobotOptions,
    hex_file: str | None,
    any_port: bool,
    dry_run: bool,
    source: str | None,
    host_baud: str,
) -> None:
    """Write the firmware to the board, and read its version back.

    A wheel brings the firmware; in a copy of the repository, or with --source, it is built first.
    The joints keep their torque, but for some seconds nothing controls them: support the arm.
    """
    from hexwire.drivers.board_reset import warn_of_reset
    from hexwire.link.open import make_link

    device = tools.device_of(resolve_url(options.port))
    guess = "not checked" if any_port else tools.check_board(device)
    image, version = _image(hex_file, source, int(host_baud))
    command = tools.flash_command(device, image)
    note(f"board: {device} ({guess})")
    if dry_run:
        say_document(shlex.join(command))
        return
    # Where the boot loader does not answer in time, the firmware of before begins.
    warn_of_reset(make_link(device))
    tools.run_flash(command)
    note("written and verified; waiting for the board")
    running = _version_of(RobotOptions(device, options.robot, int(host_baud), 2, options.timeout))
    if version is not None and running != version:
        raise DeviceError(f"the board runs {running} after version {version} was written; is it the same board?")
    say(f"the board runs version {running}")


@firmware.command()
@source_option
@robot_options
@json_option
def info(options: RobotOptions, source: str | None) -> None:
    """Show the version of the board's firmware and that of the firmware here."""
    with attached(make_robot(options)) as robot:
        report = robot.probe()
    here, available = _available(source)
    lines = ["the board speaks only the chapter's dialect and does not report its version"]
    if report.firmware:
        lines = [
            f"version {report.firmware}, boot id {report.boot_id:08x}",
            f"supports {', '.join(report.capabilities).replace('_', ' ')}",
        ]
    if available:
        lines.append(f"{here} {available}{' (the same)' if available == report.firmware else ''}")
    answer(
        {
            "firmware": report.firmware or None,
            "dialect": report.dialect,
            "boot_id": report.boot_id,
            "capabilities": list(report.capabilities),
            "sources": available or None,
        },
        *lines,
    )


def _image(hex_file: str | None, source: str | None, host_baud: int) -> tuple[Path, str | None]:
    """The file to flash, and its version if that is known."""
    if hex_file is not None:
        return Path(hex_file), None
    image = tools.find_image(host_baud) if source is None and not tools.has_sources() else None
    if image is not None:
        return image.file, image.version
    report = tools.build(tools.find_sources(source), host_baud=host_baud)
    return report.hex_file, report.version


def _available(source: str | None) -> tuple[str, str]:
    """What is here to flash, in a word, and its version; empty if nothing is."""
    if source is not None or tools.has_sources():
        return "sources", tools.source_version(tools.find_sources(source))
    return "in this package", next((image.version for image in tools.list_images()), "")


def _version_of(options: RobotOptions) -> str:
    with attached(make_robot(options)) as robot:
        return robot.probe().firmware
