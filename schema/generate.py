"""Writes every file that comes from ``schema/*.toml``, or checks that they are up to date.

    python schema/generate.py           write
    python schema/generate.py --check   exit 1 and name the stale files

Outputs: ``src/hexwire/wire/tables.py``, the marked tables of ``PROTOCOL.md``, and, where that folder exists,
``firmware/core/generated.h``. ``assemble.py`` writes the analysers' tables. Needs only the standard library.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import emit_header
import emit_markdown
import emit_python
from load import Schema, SchemaError, load

ROOT = Path(__file__).resolve().parent.parent


def outputs(schema: Schema, root: Path = ROOT) -> dict[Path, str]:
    """Path -> wanted text of every generated file of the tree at ``root``."""
    wanted = {root / "src/hexwire/wire/tables.py": emit_python.emit(schema)}
    protocol = root / "PROTOCOL.md"
    if protocol.is_file():
        wanted[protocol] = emit_markdown.fill(protocol.read_text(encoding="utf-8"), schema)
    core = root / "firmware/core"
    if core.is_dir():
        wanted[core / "generated.h"] = emit_header.emit(schema, emit_header.names_used(root / "firmware"))
    return wanted


def main(arguments: list[str] | None = None) -> int:
    """Write or check; returns the exit status."""
    parser = argparse.ArgumentParser(description="write the files that come from schema/*.toml")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a file is stale")
    parser.add_argument("--root", type=Path, default=ROOT, help="tree to write into (default: this one)")
    options = parser.parse_args(arguments)
    try:
        schema = load(options.root / "schema")
        wanted = outputs(schema, options.root)
    except SchemaError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    stale = 0
    for path, text in wanted.items():
        present = path.read_text(encoding="utf-8") if path.is_file() else None
        if present == text:
            continue
        stale += 1
        if options.check:
            sys.stderr.write(f"{path.relative_to(options.root)} is stale: run python schema/generate.py\n")
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    return 1 if options.check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
