"""`make resolvable`: hexwire and each of its extras can be installed from wheels only, without a compiler.

    python release/resolve.py --uv PATH

Asks uv to resolve the core and every extra for each Python and each kind of machine that hexwire names. Owns that
list. Needs the package index, so it is no test of `make test`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ("3.11", "3.12", "3.13")
PLATFORMS = ("x86_64-manylinux_2_28", "aarch64-manylinux_2_28")


def extras(root: Path = ROOT) -> list[str]:
    """Names of the extras; the first is empty and means the core."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return ["", *project["optional-dependencies"]]


def resolve(uv: str, root: Path, python: str, platform: str, extra: str) -> str:
    """What uv says against it; empty if everything has a wheel."""
    command = [uv, "pip", "compile", "--quiet", "--no-config", "--only-binary", ":all:", "--no-header"]
    command += ["--python-version", python, "--python-platform", platform]
    command += ["--extra", extra] if extra else []
    # Without a folder of its own uv takes the versions of another output for granted.
    with tempfile.TemporaryDirectory() as folder:
        command += [str(root / "pyproject.toml"), "-o", f"{folder}/requirements.txt"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else done.stderr.strip() or "uv failed"


def main(arguments: list[str] | None = None) -> int:
    """Resolve all; returns the exit status."""
    parser = argparse.ArgumentParser(description="check that wheels are enough")
    parser.add_argument("--uv", default="uv", help="the program uv")
    parser.add_argument("--root", type=Path, default=ROOT, help="folder with pyproject.toml")
    options = parser.parse_args(arguments)
    cases = list(product(PYTHONS, PLATFORMS, extras(options.root)))
    with ThreadPoolExecutor(2) as pool:
        told = list(pool.map(lambda case: resolve(options.uv, options.root, *case), cases))
    for (python, platform, extra), text in zip(cases, told, strict=True):
        if text:
            sys.stderr.write(f"Python {python}, {platform}, {extra or 'core'}: {text}\n")
    if any(told):
        return 1
    sys.stdout.write(f"{len(cases)} combinations of Python, machine and extra need wheels only\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
