"""ROS's program `roslaunch`, loaded once for many calls: loading takes longer than a call that starts no node.

Owns a process of ROS's own interpreter that forks for each call, so that no call sees what another one left. Knows
nothing of launch files.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

# ROS's programs run on the interpreter that they were packaged for.
ROS_PYTHON = "/usr/bin/python3"
# Each line is a command line, an environment and two files; the answer is the exit status.
_PROGRAM = """
import json, os, sys, tempfile, traceback
import roslaunch
for line in sys.stdin:
    args, env, out, err = json.loads(line)
    pid = os.fork()
    if not pid:
        status = 1
        try:
            for number, name in ((0, os.devnull), (1, out), (2, err)):
                os.dup2(os.open(name, os.O_RDWR | os.O_CREAT), number)
            os.environ.clear()
            os.environ.update(env)
            tempfile.tempdir = None
            sys.argv = ["roslaunch", *args]
            roslaunch.main(sys.argv)
            status = 0
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""


class Launcher:
    """Calls `roslaunch`.

    Args:
        env: The environment in which it is loaded; a call has its own.
    """

    def __init__(self, env: Mapping[str, str]) -> None:
        self._process = subprocess.Popen(
            [ROS_PYTHON, "-c", _PROGRAM], env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def call(self, env: Mapping[str, str], folder: Path, *args: str) -> str:
        """What `roslaunch` prints with these arguments; it must succeed. The folder is for its output."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        out, err = folder / "roslaunch.out", folder / "roslaunch.err"
        for file in (out, err):
            file.write_bytes(b"")
        self._process.stdin.write(json.dumps([args, dict(env), str(out), str(err)]) + "\n")
        self._process.stdin.flush()
        status = self._process.stdout.readline().strip()
        assert status == "0", f"roslaunch ended with status {status or 'none'}: {err.read_text()}"
        return out.read_text()

    def __enter__(self) -> Launcher:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.__exit__(kind, error, trace)
