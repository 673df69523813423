"""`hexwire loopback`: tests a cable and adapter at several rates.

Owns arguments and printing; `hexwire.link.loopback` is the test itself.
"""

from __future__ import annotations

import time

import click

from hexwire.errors import LinkError, UsageError

from .common import json_option, on_terminal, port_option, resolve_url
from .exits import note
from .output import print_json, say_table

__all__ = ["loopback"]


@click.command()
@port_option
@click.option(
    "--baud",
    "rates",
    type=click.IntRange(min=300),
    multiple=True,
    metavar="N",
    help="Test only this rate; repeatable.",
)
@click.option("--bytes", "count", type=click.IntRange(64, 10_000_000), default=2048, show_default=True)
@json_option
def loopback(port: str | None, rates: tuple[int, ...], count: int, as_json: bool) -> None:
    """Test a cable and adapter: connect TX to RX, and every byte must come back.

    Tries the rates that servos and boards use, slowest first. Exit status 1 if one of them fails.
    """
    from hexwire.drivers.board_reset import warn_of_reset
    from hexwire.drivers.bus_checkup import SERVO_RATES
    from hexwire.link.loopback import try_loopback
    from hexwire.link.open import make_link
    from hexwire.link.url import parse_url

    url = resolve_url(port)
    if parse_url(url).scheme != "serial":
        raise UsageError(f"a loopback test needs a serial port, not {url}")
    if "baud=" in url:
        raise UsageError("give the rate with --baud, not in the port")
    warn_of_reset(make_link(url))
    results = []
    for baud in sorted(set(rates or SERVO_RATES)):
        if on_terminal() and not as_json:
            note(f"{baud} baud ...")
        with make_link(f"{url}{'&' if '?' in url else '?'}baud={baud}") as link:
            results.append(try_loopback(link, baud, count, time.monotonic))
    if as_json:
        print_json(
            [
                {
                    "baud": r.baud,
                    "sent": r.sent,
                    "returned": r.returned,
                    "wrong": r.wrong,
                    "wrong_bits": r.wrong_bits,
                    "good": r.good,
                    "seconds": r.seconds,
                }
                for r in results
            ]
        )
    else:
        rows = [[str(r.baud), str(r.sent), str(r.returned), str(r.wrong), r.verdict] for r in results]
        say_table(["baud", "sent", "back", "wrong", "verdict"], rows)
    bad = [str(r.baud) for r in results if not r.good]
    if bad:
        raise LinkError(f"the loopback fails at {', '.join(bad)} baud", url=url)
