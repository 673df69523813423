"""Arms of every kind in a person's hands: each is reached another way. They run in threads of this process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import pytest
from tests.cli.shared_arm import patient, patient_line
from tests.fleet.emulated import emulated

import hexwire
from hexwire import Arm
from hexwire.control import motions

KINDS = {
    "board": "dialect 2",
    "bus": "so101",
    "shared board": "dialect 2",
    "shared bus": "so101",
    "chapter's board": "dialect 1",
    "puma260": "puma260",
}
"""How an arm is reached, and which robot it is."""


@contextmanager
def connected(kind: str, folder: Path) -> Iterator[Arm]:
    """An arm of a kind, with the files of its user in a folder."""
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        for variable in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "XDG_CONFIG_HOME"):
            patch.setenv(variable, str(folder))
        patient(patch)
        patient_line(patch)
        # A path in the board's own time ends where a busy machine sends no points for a while.
        patch.setattr(motions, "MotionOptions", partial(motions.MotionOptions, host_timed=True, grace=20.0))
        settings = stack.enter_context(emulated(KINDS[kind]))
        if kind.startswith("shared"):
            from hexwire.fleet.service import Service
            from hexwire.fleet.service_file import read_arms

            stack.enter_context(Service(read_arms({"lab/a": {"watchdog": 5.0} | settings}, lease=5.0)))
            arm = hexwire.connect("zenoh:lab/a", speed=1.0)
        else:
            arm = hexwire.connect(str(settings["port"]), str(settings["robot"]), speed=1.0)
        with arm:
            yield arm
