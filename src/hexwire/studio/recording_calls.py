"""What the page Recordings asks of the server: the list, and what is done with recordings.

Owns these calls. Nothing here moves a real arm. Files themselves go over HTTP (`files`). Must not know sockets.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

import msgspec

from hexwire.control.requests.motion_service import read_motion
from hexwire.errors import UsageError

from .access import Right
from .calls import Arguments, Asked, CallLane, Named, call

__all__: list[str] = []


class _Robot(Arguments, frozen=True):
    robot: str


class _Record(Arguments, frozen=True):
    cameras: bool = False


class _Twin(Arguments, frozen=True):
    name: str
    topic: str = ""
    part: dict[str, Any] = msgspec.field(default_factory=dict)


@contextmanager
def _folder() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(f"the folder of recordings failed: {error.strerror or error}") from None


@call("recordings", Arguments, lane=CallLane.FILES)
def _list(asked: Asked, args: Arguments) -> msgspec.Raw:
    studio, recordings, arm = asked.studio, asked.studio.recordings, asked.studio.source.arm
    state = recordings.recorder.state
    rest = {
        "folder": str(recordings.library.folder),
        "largest": recordings.library.largest,
        "recorder": asdict(state),
        "twin": {**asdict(recordings.twin.state), "busy": recordings.twin.busy},
        "cameras": list(studio.cameras.rows),
        "robot": arm.settings.model.name if arm is not None else "",
    }
    joints = arm.settings.model.names if arm is not None else None
    with _folder():
        return msgspec.Raw(asked.files.ask("listed", state.name, joints, rest))


@call("recordings.geometry", _Robot, lane=CallLane.FILES)
def _geometry(asked: Asked, args: _Robot) -> msgspec.Raw:
    """The shapes of the open arm, or of one that can be emulated; None if its lengths are unknown."""
    arm = asked.studio.source.arm
    if arm is not None and arm.settings.model.name == args.robot:
        return msgspec.Raw(asked.files.ask("geometry", arm.settings.model, arm.settings.links))
    return msgspec.Raw(asked.files.ask("geometry_of", args.robot))


@call("recordings.record", _Record, right=Right.OPERATE)
def _record(asked: Asked, args: _Record) -> str:
    studio = asked.studio
    cameras = studio.cameras.rows.values() if args.cameras else ()
    with _folder():
        return studio.recordings.recorder.start(studio.source.need_arm(), cameras)


@call("recordings.end", Arguments, right=Right.OPERATE)
def _end(asked: Asked, args: Arguments) -> str:
    with _folder():
        return asked.studio.recordings.recorder.stop()


@call("recordings.recover", Named, right=Right.OPERATE, lane=CallLane.FILES)
def _recover(asked: Asked, args: Named) -> str:
    """The name of the new one."""
    with _folder():
        return str(asked.files.ask("recover", args.name))


@call("recordings.remove", Named, right=Right.OPERATE)
def _remove(asked: Asked, args: Named) -> None:
    with _folder():
        asked.studio.recordings.library.remove(args.name)


@call("recordings.twin", _Twin, right=Right.OPERATE)
def _twin(asked: Asked, args: _Twin) -> None:
    """Play it on an emulated arm."""
    name, recordings = args.name, asked.studio.recordings
    part = read_motion({**args.part, "what": "play"})
    with _folder():
        robot = recordings.twin_of(name)
        if not robot:
            raise UsageError(f"there is no emulated arm with the joints of {name}")
        # The table of the open arm is the twin's, too.
        arm = asked.studio.source.arm
        table = arm.settings.table if arm is not None else 0.0
        recordings.twin.play(
            robot,
            name,
            lambda joints: recordings.taught(name, args.topic or None, joints),
            begin=part.begin,
            end=part.end,
            factor=part.factor,
            settings={"check_table": False} if table is None else {"table_height": table},
        )


@call("recordings.end_twin", Arguments, right=Right.OPERATE)
def _end_twin(asked: Asked, args: Arguments) -> None:
    asked.studio.recordings.twin.stop("stopped")
