"""A stress test of the bus: reads as fast as possible, errors by servo, a histogram of the times. Nothing moves.

Owns its bounds and what a page is told; `bus.latency` owns the test.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hexwire.bus.latency import StressTest
from hexwire.errors import UsageError
from hexwire.studio.calls import Arguments, Asked, call

__all__ = ["MOST", "tested"]

MOST = 100_000
"""Reads of one test."""


class _Test(Arguments, frozen=True):
    count: float | None
    servos: list[int] | None = None


@call("stress.run", _Test, control=True)
def _run(asked: Asked, args: _Test) -> dict[str, Any]:
    ids = asked.bus.bench.servo_ids if args.servos is None else asked.known(*args.servos)
    test = tested(asked, ids, args.count)
    if not test.reads:
        return {"facts": [], "bins": [], "missing": []}
    bins = test.took.bins()
    last = len(bins.edges) - 1
    return {
        "facts": [
            ("Reads", f"{test.reads} in {test.seconds:.2f} s"),
            ("Per second", f"{test.reads / test.seconds:.0f}"),
            ("Median", f"{bins.p50 * 1e3:.2f} ms"),
            ("99 of 100 within", f"{bins.p99 * 1e3:.2f} ms"),
            ("Longest", f"{bins.longest * 1e3:.2f} ms"),
            ("Values missing", f"{test.lost} of {test.values} ({test.lost / test.values:.2%})"),
        ],
        "bins": [
            (f"{'' if i < last else 'above '}{edge * 1e3:.2f} ms", count)
            for i, (edge, count) in enumerate(zip(bins.edges, bins.counts, strict=True))
        ],
        "missing": [(f"servo {i}", str(count)) for i, count in test.missing.items() if count],
    }


def tested(asked: Asked, ids: Sequence[int], count: float | None) -> StressTest:
    """Run the test until it is done, cancelled or stopped.

    Raises:
        UsageError: The number of reads is out of bounds, or no servo is known.
        HexwireError: The bus cannot be read.
    """
    if count is None or not 1 <= count <= MOST or count != int(count):
        raise UsageError(f"the number of reads is a whole number from 1 to {MOST}")
    if not ids:
        raise UsageError("no servo is known; search first")
    test = StressTest(tuple(ids))
    # Live values would come between, and distort the times.
    with asked.bus.bench.working("a stress test", alone=True) as job:

        def go_on() -> bool:
            job.share = test.reads / count
            return job.go_on()

        test.run(asked.bus.bus, int(count), go_on=go_on)
    return test
