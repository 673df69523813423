"""Arms of every kind in a person's hands: each is reached another way. They run in threads of this process."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.cli.shared_arm import patient
from tests.defaults import default
from tests.fleet.emulated import emulated

import hexwire
from hexwire import Arm
from hexwire.control.motion.motion_options import MotionOptions

KINDS = {
    "board": "dialect 2",
    "bus": "so101",
    "shared board": "dialect 2",
    "shared bus": "so101",
    "chapter's board": "dialect 1",
    "puma260": "puma260",
}
"""How an arm is reached, and which robot it is."""
TIMED = {"timed board": "dialect 2", "shared timed board": "dialect 2"}
"""Those whose board executes a motion: it ends where a busy machine sends no points for a while."""

QUICK = ("bus", "board")


def marked(kinds: Iterable[str], quick: Collection[str] = QUICK) -> list[Any]:
    """Parameters of a test: these kinds, of which only the quick ones run in `make test`."""
    return [kind if kind in quick else pytest.param(kind, marks=pytest.mark.slow) for kind in kinds]


@contextmanager
def connected(kind: str, folder: Path) -> Iterator[Arm]:
    """An arm of a kind, with the files of its user in a folder."""
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        for variable in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "XDG_CONFIG_HOME"):
            patch.setenv(variable, str(folder))
        patient(patch)
        default(patch, MotionOptions, host_timed=kind not in TIMED, grace=20.0)
        settings = stack.enter_context(emulated((KINDS | TIMED)[kind]))
        if kind.startswith("shared"):
            from hexwire.fleet.service import Service
            from hexwire.fleet.service_file import read_arms

            stack.enter_context(Service(read_arms({"lab/a": {"watchdog": 5.0} | settings}, lease=5.0)))
            arm = hexwire.connect("zenoh:lab/a", speed=1.0)
        else:
            arm = hexwire.connect(str(settings["port"]), str(settings["robot"]), speed=1.0)
        with arm:
            yield arm
