"""Assembles the analysers: each folder with the tables and the decoder that its program wants beside it.

    python schema/assemble.py           write build/analyzers
    python schema/assemble.py DIR       write DIR

Wireshark, sigrok and Logic 2 load one folder and nothing next to it. So ``analyzers/`` holds what is written by
hand, and this adds the tables and the decoder of ``hexwire.trace``. Needs only the standard library.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import emit_analyzers

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "src"
sys.path.insert(0, str(SOURCE))

from hexwire.trace.reading_tables import TABLES  # noqa: E402  (only now does Python find it)

DECODER = "reading.py"
PYTHON_FOLDERS = ("sigrok/hexwire_host", "sigrok/hexwire_servo", "saleae")


def files() -> dict[str, str]:
    """Path inside the assembled folder -> text of every file."""
    source = ROOT / "analyzers"
    wanted = {
        path.relative_to(source).as_posix(): path.read_text(encoding="utf-8")
        for path in sorted(source.rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts
    }
    decoder = (SOURCE / "hexwire/trace" / DECODER).read_text(encoding="utf-8")
    tables = emit_analyzers.emit_tables(TABLES)
    wanted["wireshark/hexwire_tables.lua"] = emit_analyzers.emit_lua(TABLES)
    for folder in PYTHON_FOLDERS:
        wanted |= {f"{folder}/{DECODER}": decoder, f"{folder}/tables.py": tables}
    line = wanted.pop("sigrok/line.py")
    return wanted | {f"{folder}/line.py": line for folder in PYTHON_FOLDERS if folder.startswith("sigrok/")}


def assemble(into: Path) -> None:
    """Write every file of the assembled folders.

    Raises:
        OSError: A file cannot be read or written.
    """
    for name, text in files().items():
        path = into / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def main(arguments: list[str] | None = None) -> int:
    """Assemble; returns the exit status."""
    parser = argparse.ArgumentParser(description="assemble the analysers for Wireshark, sigrok and Logic 2")
    parser.add_argument("into", nargs="?", type=Path, default=ROOT / "build/analyzers", metavar="DIR")
    into = parser.parse_args(arguments).into
    try:
        assemble(into)
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    sys.stdout.write(f"{into}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
