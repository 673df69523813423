"""Many arms behind one router, in several processes: what arrives, how late, and what an arm more costs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack

from fleet_blocks import Block, Process, free_port, quantiles

_FLEET = (10, 50, 200)
_FLEET_RATE = 50.0
_FLEET_SECONDS = 3.0
_FLEET_PROCESSES = 4


def run() -> Iterator[str]:
    yield (
        f"arms at {_FLEET_RATE:g} Hz in {_FLEET_PROCESSES} processes behind one router, each with its own session, "
        "read by one program;"
    )
    yield "  replayed: only states, since the owners of so many arms would be the limit of two cores:"
    replayed = []
    for role, count in (("arms", _FLEET[0]), *(("replay", count) for count in _FLEET)):
        row = _fleet(role, count)
        if role == "replay":
            replayed.append(row)
        yield (
            f"  {count:3} {'complete' if role == 'arms' else 'replayed'}: delivered {row['share']:.2%}, "
            f"lost {row['lost']:.0f}, p50 / p99 {row['p50']:.2f} / {row['p99']:.2f} ms; CPU of one core: arms "
            f"{row['arms']:.1%} ({row['arms'] / count:.3%} an arm), router {row['router']:.1%} "
            f"({row['router'] / count:.3%}), reader {row['reader']:.1%} ({row['reader'] / count:.3%})"
        )
    for part in ("arms", "router", "reader"):
        low, middle, high = (row[part] for row in replayed)
        first = (middle - low) / (_FLEET[1] - _FLEET[0])
        second = (high - middle) / (_FLEET[2] - _FLEET[1])
        yield (
            f"  {part}: an arm more costs {second:.3%} of a core from {_FLEET[1]} to {_FLEET[2]}, "
            f"{second / first:.2f} times what it costs from {_FLEET[0]} to {_FLEET[1]}: linear is 1"
        )


def _fleet(role: str, count: int) -> Block:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        router = Process(stack, "router", endpoint).ready()
        share = [count // _FLEET_PROCESSES + (i < count % _FLEET_PROCESSES) for i in range(_FLEET_PROCESSES)]
        servers = [
            Process(stack, role, endpoint, sum(share[:i]), some, _FLEET_RATE) for i, some in enumerate(share)
        ]
        for server in servers:
            server.ready()
        reader = Process(stack, "watcher", endpoint).ready()
        time.sleep(1.0)
        before = [process.ask("cpu") for process in (router, *servers)]
        found = reader.ask("read", seconds=_FLEET_SECONDS)
        after = [process.ask("cpu") for process in (router, *servers)]
        shares = [(b["cpu"] - a["cpu"]) / (b["now"] - a["now"]) for a, b in zip(before, after, strict=True)]
    rows = found["arms"]
    return {
        **quantiles(found["ages"]),
        "share": sum(seen for seen, _ in rows) / (count * _FLEET_RATE * _FLEET_SECONDS),
        "lost": float(sum(lost for _, lost in rows)),
        "router": shares[0],
        "arms": sum(shares[1:]),
        "reader": found["cpu"] / _FLEET_SECONDS,
    }
