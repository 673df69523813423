"""No wrong value from a dialect-1 board: what the chapter's sketch hands up, with every combination of faults.

The sketch sends on whatever it heard on its bus, up to 16 bytes, with bytes 5 and 6 of it exchanged for a legacy
servo. Part of ``python -m tests.property.servo_values``.
"""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import dataclass, fields

from hexwire.session.dialect1 import Pending1, match_reply
from hexwire.wire.command_frame import Command
from hexwire.wire.servo_packet import make_read, make_status, parse_status

__all__ = ["Noise", "all_noise", "ask_board"]

_STACK = 16
_AWKWARD = b"\xff\xff\xff\xf5\x00\x01\x02\x04\x38"


@dataclass(frozen=True)
class Noise:
    """What the board hears besides the answer.

    Attributes:
        echo: The request, once or twice.
        earlier: The echo of an earlier request.
        junk: Random bytes before the echo, before the answer or behind it.
        loss: Bytes are missing.
        flip: One bit of a packet is wrong.
        short: A packet lacks its end.
    """

    echo: bool = False
    earlier: bool = False
    junk: bool = False
    loss: bool = False
    flip: bool = False
    short: bool = False

    def __str__(self) -> str:
        return "dialect 1: " + (" ".join(f.name for f in fields(self) if getattr(self, f.name)) or "none")


def all_noise() -> list[Noise]:
    """Every combination."""
    names = [f.name for f in fields(Noise)]
    return [Noise(**{n: bool(k >> i & 1) for i, n in enumerate(names)}) for k in range(1 << len(names))]


def ask_board(noise: Noise, values: int, seed: int) -> Counter[str]:
    """Match so many replies, as a driver does that knows each servo's kind, and count what became of them."""
    dice = random.Random(f"{seed}/{noise}")
    count: Counter[str] = Counter()
    for _ in range(values):
        servo_id, legacy = dice.randrange(7), dice.random() < 0.5
        request = make_read(servo_id, dice.choice((0x38, 0x2A, 0x3A)), 2)
        error = dice.choice((0, 0, 0, 2, 4, 0x20))
        value = dice.choice((dice.randrange(1 << 16), dice.randrange(4096), 0x0238, 0x3802))
        packet = make_status(servo_id, error, value.to_bytes(2, "big" if legacy else "little"), legacy=legacy)
        before = make_read(servo_id, dice.randrange(80), 2)
        heard = _heard(noise, request, before, packet, dice)[:_STACK]
        body = heard[:5] + heard[6:7] + heard[5:6] + heard[7:] if legacy and len(heard) > 6 else heard
        found = match_reply(body, Pending1(1, Command.READ, request, 0.2, 3), (before, request))
        status = None if found is None else parse_status(found)
        count["asked"] += 1
        if status is None or status.legacy != legacy:
            count["missing"] += 1
        elif (int.from_bytes(status.params, "little"), status.error) == (value, error):
            count["right"] += 1
        else:
            params = status.params[::-1] if legacy else status.params
            made = make_status(servo_id, status.error, params, legacy=legacy)
            count["forged" if made in heard and made[2:] not in (request[2:], before[2:]) else "wrong"] += 1
    return count


def _heard(noise: Noise, request: bytes, before: bytes, packet: bytes, dice: random.Random) -> bytes:
    parts = [request] * dice.choice((1, 1, 2)) if noise.echo else []
    if noise.earlier and dice.random() < 0.3:
        parts.insert(0, before)
    parts = [_spoil(noise, part, dice) for part in [*parts, packet]]
    if noise.junk and dice.random() < 0.7:
        junk = bytes(
            dice.choice(_AWKWARD) if dice.random() < 0.4 else dice.randrange(256) for _ in range(dice.randint(1, 7))
        )
        parts.insert(dice.choice((0, 0, 0, dice.randint(0, len(parts)))), junk)
    return b"".join(parts)


def _spoil(noise: Noise, part: bytes, dice: random.Random) -> bytes:
    if noise.loss and dice.random() < 0.2:
        at = dice.randrange(len(part))
        part = part[:at] + part[at + 1 :]
    if noise.flip and dice.random() < 0.2:
        at = dice.randrange(len(part))
        part = part[:at] + bytes((part[at] ^ 1 << dice.randrange(8),)) + part[at + 1 :]
    if noise.short and dice.random() < 0.2:
        part = part[: dice.randrange(len(part))]
    return part
