"""Every reader with as many spoilt files as wanted: `python -m tests.property.fuzz_readers 5000`.

Prints how many were read and how many refused. Anything but a value or a HexwireError that names the file ends it
with a traceback, and the file stays where it is.
"""

from __future__ import annotations

import random
import sys
import tempfile
from pathlib import Path

from tests.property.test_readers import HOSTILE, TOKENS, make_readers, outcome


def spoil(good: bytes, rng: random.Random) -> bytes:
    """A file with up to four faults: bytes put in, taken out, made others, or cut off."""
    spoilt = bytearray(good)
    for _ in range(rng.randint(1, 4)):
        at = rng.randint(0, len(spoilt))
        piece = rng.choice((rng.randbytes(rng.randint(0, 6)), rng.choice(TOKENS).encode(), good[at : at + 40]))
        spoilt[at : at + rng.choice((0, 1, 2, 6, 40))] = piece
    return bytes(spoilt[: rng.randint(0, len(spoilt))] if rng.random() < 0.1 else spoilt)


def main(times: int, seed: int = 1) -> None:
    """Try every reader `times` times."""
    folder = Path(tempfile.mkdtemp(prefix="readers-"))
    readers = make_readers(folder)
    (folder / "tried").mkdir()
    (folder / "tried" / "ca.pem").write_bytes(readers["trusted authority"].good)
    print(f"{'reader':26}{'tried':>8}{'read':>8}{'refused':>9}")
    for name, reader in readers.items():
        rng, refused = random.Random(f"{name} {seed}"), 0
        path = folder / "tried" / f"spoilt{reader.suffix}"
        contents = [*HOSTILE.values(), *(spoil(reader.good, rng) for _ in range(times))]
        for content in contents:
            path.write_bytes(content)
            # The one that is made of a folder says its name and not the file's.
            refused += bool(outcome(reader, path, names_file=name != "firmware sources"))
        print(f"{name:26}{len(contents):8}{len(contents) - refused:8}{refused:9}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:] or ["500"]))
