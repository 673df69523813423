"""No wrong value through a real terminal: an emulated bus whose adapter echoes, on a machine that is kept busy.

``python -m tests.property.servo_pty 120 --busy 4`` reads for two minutes beside four busy loops, prints what came,
and ends with status 1 if a value was wrong. `test_servo_pty` does it for a moment.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from hexwire.bus.servo_bus import ServoBus

__all__ = ["main", "read_for"]

_IDS = (1, 2, 3, 4, 5, 6, 7)
_FIRST, _STEP = 2048, 3
"""Where the emulated servos stand: each a little beside the one before."""
_OUTCOMES = ("asked", "right", "missing", "wrong")
_HIGHEST = 4095
_NAMES = ("present_position", "present_position", "present_position", "max_position_limit", "id")


@contextmanager
def _served(options: list[str]) -> Iterator[str]:
    command = [sys.executable, "-m", "hexwire.cli", "sim", "bus", "--ids", "1-7", "--until-eof", *options]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip()
        finally:
            process.stdin.close()
            process.wait(timeout=30)


@contextmanager
def _busy() -> Iterator[None]:
    program = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: sum(range(100000))"
    with subprocess.Popen([sys.executable, "-c", program]) as process:
        try:
            yield
        finally:
            process.kill()


def read_for(seconds: float, busy: int, options: list[str]) -> Counter[str]:
    """Read registers of all servos, one by one and together, and count what came."""
    count: Counter[str] = Counter()
    with ExitStack() as stack:
        path = stack.enter_context(_served(options))
        for _ in range(busy):
            stack.enter_context(_busy())
        bus = stack.enter_context(ServoBus.from_url(path))
        end = time.monotonic() + seconds
        turn = 0
        while time.monotonic() < end:
            turn += 1
            name = _NAMES[turn % len(_NAMES)]
            readings = list(bus.sync_read(name, _IDS)) if turn % 3 else [bus.read(1 + turn % 7, name)]
            for reading in readings:
                count["asked"] += 1
                wanted = {"id": reading.servo_id, "max_position_limit": _HIGHEST}.get(
                    name, _FIRST + _STEP * (reading.servo_id - 1)
                )
                if reading.raw is None:
                    count["missing"] += 1
                else:
                    count["right" if reading.raw == wanted and not reading.status else "wrong"] += 1
        count["echoes"] = bus.counters.echoes
        count["repeats"] = bus.counters.repeats
        count["settled"] = bus.counters.settled
    return count


def main() -> int:
    """Read as long as the command line says."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("seconds", type=float, nargs="?", default=60.0, help="how long (default: %(default)s)")
    parser.add_argument("--busy", type=int, default=0, help="busy loops beside it (default: %(default)s)")
    parser.add_argument("--fault", action="append", default=[], help="as of `hexwire sim bus`; repeatable")
    options = parser.parse_args()
    faults = [word for fault in options.fault for word in ("--fault", fault)]
    count = read_for(options.seconds, options.busy, ["--echo", *faults])
    print(", ".join(f"{name} {count[name]}" for name in (*_OUTCOMES, "echoes", "repeats", "settled")))
    return 1 if count["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
