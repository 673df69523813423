"""What is computed of files for pages, in a process of its own: `-m hexwire.studio.page_work FOLDER LARGEST`.

Owns the loop that carries out one order after the other, the bounds of the process, and what is in its memory: open
files of traffic, columns of recordings. It reads pickled orders from its input and ends with it. What is large, it
leaves in a file whose path it is given. Must not know requests or pages.
"""

from __future__ import annotations

import json
import logging
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from hexwire.errors import HexwireError, UsageError
from hexwire.model.arms import simulated_arms
from hexwire.trace.foxglove import nanoseconds
from hexwire.trace.library import Library
from hexwire.trace.pictures import RecordedPictures
from hexwire.trace.series import column_name, write_csv, write_mcap
from hexwire.trace.sources import saved_traffic

from .columns import history_columns, series_columns
from .geometry import make_geometry
from .page_process import BEAT
from .plotted import Plotted
from .twins import model_of, twin_for
from .wire_files import WireFiles

if TYPE_CHECKING:
    from array import array

    from hexwire.control.requests.history import Rows
    from hexwire.link.tap import Passed
    from hexwire.model.arm import ArmModel

__all__ = ["PageWork", "main"]

_log = logging.getLogger(__name__)

_MEMORY = 2 << 30
"""Bytes of memory, on systems that can bound it."""
_LATER = 10
"""How much later than the arm it has its turn at the processor."""
_BEAT = 1.0
"""Seconds between two signs of life."""

_Columns = Sequence[tuple[str, str]]


class PageWork:
    """What can be ordered: the public methods.

    Args:
        folder: Of the recordings.
        largest: Bytes of a file that is added to them.
    """

    def __init__(self, folder: Path, largest: int) -> None:
        self._library = Library(folder, largest=largest)
        self._plotted = Plotted(self._library)
        self._files = WireFiles()
        # Of the recording that was asked for last.
        self._pictures: tuple[tuple[str, int, float], RecordedPictures] | None = None

    # -- the history of an arm ------------------------------------------------------------------------------

    def history(
        self, path: str, head: dict[str, Any], columns: _Columns, rows: Rows, endings: tuple[str, ...]
    ) -> None:
        """Leave rows as columns for the browser; raises as `history_columns`."""
        Path(path).write_bytes(history_columns(head, columns, rows, endings))

    def csv(self, path: str, columns: _Columns, wanted: Sequence[str], rows: Rows, offset: float) -> None:
        """Leave some columns as CSV."""
        places = [i for i, column in enumerate(columns) if not wanted or column_name(*column) in wanted]
        chosen = ((at, [row[i] for i in places]) for at, row in rows)
        with Path(path).open("wb") as out:
            write_csv(out, [columns[i] for i in places], chosen, offset)

    def mcap(self, path: str, columns: _Columns, rows: Rows, offset: float, robot: str) -> None:
        """Leave rows as a recording; raises as `write_mcap`."""
        write_mcap(path, columns, rows, offset, robot=robot)

    # -- recordings -----------------------------------------------------------------------------------------

    def listed(self, without: str, joints: Sequence[str] | None, rest: dict[str, Any]) -> bytes:
        """The recordings as JSON, with the rest of the answer.

        Args:
            without: Name of the one that is being written: it is not damaged.
            joints: Of the open arm; None if none is open.
            rest: What else is told.
        """
        rows = [asdict(one) for one in self._library.entries(without=without)]
        for row in rows:
            row["fits"] = bool(row["joints"]) and joints is not None and set(row["joints"]) <= set(joints)
            row["twin"] = twin_for(row["robot"], row["joints"])
        return _json({"remark": self._library.remark, "entries": rows, **rest})

    def find(self, name: str) -> str:
        """The emulated arm that can play a recording, empty if none can; raises as `Library.find`."""
        found = self._library.find(name)
        return twin_for(found.robot, found.joints)

    def recording(self, path: str, name: str, topic: str | None) -> None:
        """Leave the columns of a recording; raises as `Library.series`."""
        Path(path).write_bytes(series_columns(self._plotted.series(name, topic)))

    def compared(
        self, path: str, a: tuple[str, str | None], b: tuple[str, str | None], align: str, lag: float
    ) -> None:
        """Leave a comparison; raises as `Plotted.compared`."""
        Path(path).write_bytes(self._plotted.compared(a, b, align, lag))

    def positions(self, name: str, topic: str | None) -> tuple[tuple[str, ...], array[float], list[array[float]]]:
        """Joints, times and positions of a recording; raises as `Library.series`."""
        series = self._plotted.series(name, topic)
        return series.names, series.times, [series.columns[joint, "position"] for joint in series.names]

    def picture(self, path: str, name: str, topic: str, at: float) -> None:
        """Leave the JPEG that a camera of a recording had made last at a time; raises as `RecordedPictures.at`.

        Args:
            path: Where it is left.
            name: The recording.
            topic: Of the camera.
            at: Seconds since 1970.
        """
        with self._library.open(name) as file:
            status = os.fstat(file.fileno())
            key = name, status.st_size, status.st_mtime
            if self._pictures is None or self._pictures[0] != key:
                self._pictures = key, RecordedPictures(file, name)
            jpeg = self._pictures[1].at(file, topic, nanoseconds(at))
        Path(path).write_bytes(jpeg)

    def add(self, name: str, path: str) -> tuple[str, str]:
        """Add a file; its name and what is wrong with it. Raises as `Library.add`."""
        with Path(path).open("rb") as file:
            found = self._library.add(name, file)
        return found.name, found.problem

    def recover(self, name: str) -> str:
        """Recover a recording; the name of the new one. Raises as `Library.recover`."""
        return self._library.recover(name).name

    # -- shapes ---------------------------------------------------------------------------------------------

    def geometry(self, arm: ArmModel, links: str) -> bytes:
        """Shapes of an arm as JSON; raises as `make_geometry`."""
        return _json({"geometry": make_geometry(arm, links)})

    def geometry_of(self, robot: str) -> bytes:
        """Shapes of an arm that can be emulated.

        Raises:
            UsageError: It cannot.
        """
        if robot not in simulated_arms():
            raise UsageError("the shapes of this arm are not known")
        return _json({"geometry": make_geometry(model_of(robot))})

    # -- traffic --------------------------------------------------------------------------------------------

    def wire_open(self, tab: str, path: str, name: str, series: str) -> None:
        """Show a file to a tab; raises as `WireFiles.open`."""
        self._files.open(tab, Path(path).read_bytes(), name, series)

    def wire_close(self, tab: str) -> None:
        """Show no file to a tab any more."""
        self._files.close(tab)

    def wire_series(self, tab: str, series: str) -> bool:
        """Read it as the traffic of other servos; False if there is none. Raises as `WireFiles.set_series`."""
        return self._files.set_series(tab, series)

    def wire_rows(self, tab: str, since: int, wanted: str) -> bytes | None:
        """Rows of a tab's file as JSON; None if there is none. Raises as `View.rows`."""
        view = self._files.view(tab)
        return None if view is None else _json(view.rows(since, wanted))

    def wire_frame(self, tab: str, number: int) -> bytes | None:
        """A frame of a tab's file as JSON; None if there is no file. Raises as `View.frame`."""
        view = self._files.view(tab)
        return None if view is None else _json(view.frame(number))

    def wire_save(self, path: str, tab: str, form: str) -> bool:
        """Leave a tab's file in another format; False if there is none. Raises as `saved_traffic`."""
        view = self._files.view(tab)
        if view is None:
            return False
        Path(path).write_bytes(saved_traffic(view.transfers, form))
        return True

    def traffic(self, path: str, transfers: Sequence[Passed], offset: float, form: str) -> None:
        """Leave traffic as a file; raises as `saved_traffic`."""
        Path(path).write_bytes(saved_traffic(transfers, form, offset=offset))


def _json(value: object) -> bytes:
    return json.dumps(value, allow_nan=False, separators=(",", ":")).encode()


class _Answers:
    """Outcomes, and signs of life while something is being done.

    Args:
        out: To the program that asks.
    """

    def __init__(self, out: IO[bytes]) -> None:
        self._out = out
        self._lock = threading.Lock()
        self._busy = False
        threading.Thread(target=self._beat, name="beat", daemon=True).start()

    def begin(self) -> None:
        """Something is being done."""
        with self._lock:
            self._busy = True

    def end(self, kind: str, value: object) -> None:
        """It is done, with this outcome."""
        with self._lock:
            self._busy = False
            self._out.write(b"=")
            pickle.dump((kind, value), self._out, pickle.HIGHEST_PROTOCOL)
            self._out.flush()

    def _beat(self) -> None:
        while True:
            time.sleep(_BEAT)
            with self._lock:
                if not self._busy:
                    continue
                try:
                    self._out.write(BEAT)
                    self._out.flush()
                except OSError:
                    # Whoever asked is gone.
                    os._exit(1)


def _bound() -> None:
    """The arm goes first, and memory is bounded, where the system can do that."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform != "win32":
        import resource

        os.nice(_LATER)
        # macOS refuses it.
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))


def main() -> None:
    """Carry out orders until the input ends."""
    _bound()
    # What a library prints must not come between the answers.
    answers = _Answers(os.fdopen(os.dup(sys.stdout.fileno()), "wb"))
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    work = PageWork(Path(sys.argv[1]), int(sys.argv[2]))
    while True:
        try:
            what, args = pickle.load(sys.stdin.buffer)  # from the program that began this one
        except EOFError:
            return
        answers.begin()
        try:
            outcome: tuple[str, object] = "done", getattr(work, what)(*args)
        except HexwireError as error:
            outcome = "refused", str(error)
        except OSError as error:
            outcome = "os", (error.errno, error.strerror)
        except MemoryError:
            # What is in its memory goes with it.
            answers.end("full", f"this needs more than {_MEMORY >> 30} GiB of memory")
            return
        except Exception as error:  # noqa: BLE001  # logged and told as what it is
            _log.exception("%s failed", what)
            outcome = "refused", f"the studio failed at this: {type(error).__name__}: {error}"
        answers.end(*outcome)
        del args, outcome


if __name__ == "__main__":
    with suppress(BrokenPipeError):
        main()
