"""The process whose figures the studio's benchmark takes: an owner alone, or one with the studio around it.

    python tests/bench/studio_process.py owner  --port URL     the arm, opened as the studio opens it; no pages
    python tests/bench/studio_process.py studio --port URL     `hexwire studio`
    python tests/bench/studio_process.py camera --port URL     the same with a camera of pictures made before
    python tests/bench/studio_process.py full   --port URL     the same with ten minutes of history from the start

A line on stdin asks how late the owner's cycles began since the last line; the answer is a line of JSON, seconds.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from hexwire.control.loop import loop
from hexwire.control.loop.shutdown import Shutdown

_SWITCH = 0.00002
"""As `hexwire studio` sets it."""


def main(words: list[str]) -> None:
    """Run until stdin ends."""
    delays: list[float] = []
    wait = loop.RateLoop._wait_until

    def noted(self: loop.RateLoop, deadline: float) -> float:
        delay = wait(self, deadline)
        delays.append(delay)
        return delay

    loop.RateLoop._wait_until = noted  # type: ignore[method-assign]  # eyes on the loop
    kind, *rest = words
    answer = threading.Thread(target=_answer, args=(delays,), daemon=True)
    if kind in ("studio", "camera", "full"):
        from hexwire.cli.main import cli

        answer.start()
        if kind == "camera":
            _show_pictures()
            rest += ["--camera", "all"]
        if kind == "full":
            _fill_histories()
        cli(["studio", *rest])
        return
    from hexwire.studio.source import Source

    sys.setswitchinterval(_SWITCH)
    shutdown = Shutdown(12.0)
    shutdown.listen()
    source = Source()
    options = dict(zip(rest[::2], rest[1::2], strict=True))
    source.open(options["--port"], options.get("--robot"))
    print("operate: none", flush=True)
    answer.start()
    while not shutdown.wait(1.0):
        pass
    source.close()


def _show_pictures() -> None:
    """Let `--camera` show pictures as a camera sends them: JPEGs of 640 x 480 with noise, 15 a second."""
    import io

    import numpy as np
    from matplotlib.image import imsave

    from hexwire.studio import v4l2
    from hexwire.studio.cameras import HEIGHT, RATE, WIDTH, Camera, CameraPicture, Cameras

    noise, pictures = np.random.default_rng(1), []
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    for i in range(RATE):
        grey = 128 + 80 * np.sin(x / 30 + i) + 40 * np.cos(y / 17) + noise.normal(0, 9, x.shape)
        file = io.BytesIO()
        imsave(file, np.dstack([grey] * 3).clip(0, 255).astype("uint8"), format="jpg")
        pictures.append(file.getvalue())

    class Pictures:
        def __init__(self, device: str) -> None:
            self._next, self._count = time.monotonic(), 0

        def read(self, timeout: float) -> CameraPicture:
            self._next, self._count = self._next + 1 / RATE, self._count + 1
            time.sleep(max(0.0, self._next - time.monotonic()))
            # A copy, as that of what the kernel has.
            return CameraPicture(bytes(bytearray(pictures[self._count % RATE])), time.monotonic())

        def close(self) -> None:
            pass

    v4l2.find_cameras = lambda devices, library=None: Cameras([Camera("/dev/video0", Pictures)])


def _fill_histories() -> None:
    """Give every arm that is opened ten minutes of history."""
    from tests.studio.running import fill_history

    from hexwire.studio.arm_source import ArmSource

    start = ArmSource.start

    def started(arm: ArmSource) -> None:
        start(arm)
        while arm.arm.owner.state is None:
            time.sleep(0.01)
        fill_history(arm)

    ArmSource.start = started  # type: ignore[method-assign]


def _answer(delays: list[float]) -> None:
    for _ in sys.stdin:
        rows, delays[:] = delays[:], []
        print(json.dumps(rows), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
