"""Run the benchmarks: all of them, or those named. `python -m tests.bench codec bus`."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

_PREFIX = "bench_"
_SLOW = ("bus", "fleet", "firmware", "path", "ros2")


def main(wanted: list[str]) -> int:
    """Print each benchmark's lines, in the order of their names; returns the exit status."""
    files = {p.stem.removeprefix(_PREFIX): p for p in sorted(Path(__file__).parent.glob(f"{_PREFIX}*.py"))}
    # Quick ones first: who waits for the peers on a paced bus has the other figures meanwhile.
    names = [name.removeprefix(_PREFIX) for name in wanted] or sorted(files, key=lambda name: name in _SLOW)
    unknown = [name for name in names if name not in files]
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(files)}", file=sys.stderr)
        return 2
    for name in names:
        print(f"{name}:", flush=True)
        for line in _load(files[name]).run():
            print(f"  {line}", flush=True)
    return 0


def _load(file: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[file.stem] = module
    spec.loader.exec_module(module)
    return module


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
