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
_PARTS = ("arms", "router", "reader")


def run() -> Iterator[str]:
    yield f"arms at {_FLEET_RATE:g} Hz in {_FLEET_PROCESSES} processes behind one router, read by one program."
    yield "  A complete arm has an owner, a lease and a session. Many of them would be the limit of two cores: the"
    yield "  other rows are only states, sent by processes with one session each:"
    replayed = []
    for role, count in (("arms", _FLEET[0]), *(("replay", count) for count in _FLEET)):
        row = _fleet(role, count)
        if role == "replay":
            replayed.append(row)
        each = ", ".join(
            f"{part} {row[part]:.1%} ({row[part] / count:.3%} an arm, {row[f'{part} us']:.0f} us a state)"
            for part in _PARTS
        )
        yield (
            f"  {count:3} {'complete' if role == 'arms' else 'states'}: {row['rate']:.1f} Hz an arm sent, "
            f"{row['delivered']:.2%} of it delivered, {row['lost']:.0f} lost, p50 / p99 {row['p50']:.2f} / "
            f"{row['p99']:.2f} ms; CPU of one core: {each}"
        )
    ratios = ", ".join(f"{part} {replayed[-1][f'{part} us'] / replayed[0][f'{part} us']:.2f}" for part in _PARTS)
    yield f"  CPU a state with {_FLEET[-1]} arms, times that with {_FLEET[0]}: {ratios}; linear growth is at most 1"


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
    seen, lost = (sum(row[i] for row in found["arms"]) for i in range(2))
    cores = {"arms": sum(shares[1:]), "router": shares[0], "reader": found["cpu"] / _FLEET_SECONDS}
    # A machine without room for the rate sends less: CPU time is related to what was sent.
    sent = (seen + lost) / _FLEET_SECONDS
    return {
        **quantiles(found["ages"]),
        **cores,
        **{f"{part} us": 1e6 * share / sent for part, share in cores.items()},
        "rate": sent / count,
        "delivered": seen / (seen + lost),
        "lost": float(lost),
    }
