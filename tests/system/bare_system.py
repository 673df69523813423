"""Runs hexwire as on a system that has little: what only POSIX or Linux has is taken away from its modules.

Only from hexwire's own: pyserial and the standard library of this machine need what they were made for. Prints one
line of JSON: the modules that could not be imported, with the reason, and what a bus on a terminal and one behind
TCP answered.
"""

from __future__ import annotations

import builtins
import importlib
import json
import pkgutil
import sys
import types
from typing import Any

# Modules that Windows lacks, and names that it lacks in others (docs.python.org, "Availability").
MODULES = {"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty", "posix_ipc", "evdev"}
NAMES = {
    "os": {
        *("EFD_CLOEXEC", "EFD_NONBLOCK", "O_CLOEXEC", "O_DIRECTORY", "O_NOCTTY", "O_NOFOLLOW", "O_NONBLOCK"),
        *("O_PATH", "eventfd", "fork", "getegid", "geteuid", "getgid", "getuid", "getpgid", "killpg", "major"),
        *("makedev", "minor", "mkfifo", "openpty", "set_blocking", "setsid", "statvfs", "ttyname", "uname"),
    },
    "select": {"epoll", "poll", "PIPE_BUF", "POLLIN", "POLLOUT", "POLLERR", "POLLHUP", "EPOLLIN", "EPOLLOUT"},
    "socket": {"AF_UNIX", "SO_PEERCRED", "SOCK_SEQPACKET", "recvmsg_into", "SCM_RIGHTS"},
    "signal": {"SIGHUP", "SIGALRM", "SIGUSR1", "SIGUSR2", "alarm", "setitimer", "pthread_kill", "sigwait"},
}


def _without(module: types.ModuleType, names: set[str]) -> types.ModuleType:
    """A copy that does not have some names."""
    copy = types.ModuleType(module.__name__)
    copy.__dict__.update({name: value for name, value in vars(module).items() if name not in names})
    return copy


def take_away() -> None:
    """From here on, hexwire's modules find nothing of it."""
    real = builtins.__import__
    copies = {name: _without(importlib.import_module(name), gone) for name, gone in NAMES.items()}

    def look(
        name: str,
        globals: dict[str, Any] | None = None,  # the interpreter's names
        locals: dict[str, Any] | None = None,
        fromlist: tuple[str, ...] = (),
        level: int = 0,
    ) -> Any:
        ours = str((globals or {}).get("__name__", "")).split(".")[0] == "hexwire"
        if ours and level == 0 and name.split(".")[0] in MODULES:
            raise ImportError(f"No module named {name!r}", name=name)
        if ours and level == 0 and name in copies:
            return copies[name]
        return real(name, globals, locals, fromlist, level)

    builtins.__import__ = look  # type: ignore[assignment]


def import_all() -> dict[str, str]:
    """Import every module; returns those that refuse, with what they say."""
    import hexwire

    refused = {}
    # `__main__` runs the command line; `ros1.node` needs Debian's rospy.
    for found in pkgutil.walk_packages(hexwire.__path__, "hexwire."):
        if found.name.endswith("__main__") or found.name == "hexwire.ros1.node":
            continue
        try:
            importlib.import_module(found.name)
        except ImportError as error:
            refused[found.name] = str(error)
    return refused


def ask(url: str) -> list[int | None]:
    """Ping the servos of a bus, set one's acceleration and read it back."""
    from hexwire.bus.servo_bus import ServoBus

    with ServoBus.from_url(url) as bus:
        bus.write_raw(1, "acceleration", 7)
        answers = [servo for servo in (1, 2, 3) if bus.ping(servo).ok]
        return [*answers, bus.read(1, "acceleration").raw]


def try_out(call: Any) -> str:
    """The error of a call that must fail."""
    try:
        call()
    except Exception as error:  # noqa: BLE001  # its kind is part of the result
        return f"{type(error).__name__}: {error}"
    return "no error"


if __name__ == "__main__":
    take_away()
    from hexwire.link.open import make_link

    refused = import_all()
    results = {url: ask(url) for url in sys.argv[1:]}
    queue = try_out(lambda: make_link("mq:///arm"))
    print(json.dumps({"refused": refused, "answers": results, "queue": queue}))
