"""The log of the program on ``/rosout``, where ROS's tools look for it.

Owns the handler that turns log records into messages. Must not know what is logged, nor the console.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from .parts import MessageCodec

__all__ = ["LOG", "TIME", "RosoutHandler"]

LOG, TIME = "rcl_interfaces/msg/Log", "builtin_interfaces/msg/Time"
_WAITING = 1000
"""Most records that wait; the oldest are dropped."""
_LONGEST = 16 * 1024


class RosoutHandler(logging.Handler):
    """Publishes log records. Whoever logs does not wait for it.

    Args:
        name: Of the node's logger, with dots.
        own: Name of the logger in Python whose records have the node's name; those of loggers below it have their
            own part behind it. All other records have the node's name, too, and tell their module in `file`.
        types: The types `LOG` and `TIME`.
        publish: Publishes a message.
        wake: Asks for a call of `flush` soon, in a thread that may publish.
    """

    def __init__(
        self,
        name: str,
        own: str,
        types: tuple[MessageCodec, MessageCodec],
        publish: Callable[[Any], None],
        wake: Callable[[], object],
    ) -> None:
        super().__init__()
        self._name, self._own = name, own
        self._log, self._time = types
        self._publish, self._wake = publish, wake
        self._waiting: deque[logging.LogRecord] = deque(maxlen=_WAITING)
        self._flushing = threading.RLock()

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record for the next `flush`."""
        # What the text is made of may change before it is published.
        record = logging.makeLogRecord(record.__dict__)
        record.msg, record.args = self.format(record), None
        self._waiting.append(record)
        self._wake()

    def flush(self) -> None:
        """Publish what waits."""
        with self._flushing:
            while self._waiting:
                self._publish(self._message(self._waiting.popleft()))

    def _message(self, record: logging.LogRecord) -> Any:
        seconds, rest = divmod(int(record.created * 1e9), 10**9)
        below = record.name.removeprefix(f"{self._own}.") if record.name.startswith(f"{self._own}.") else ""
        return self._log(
            stamp=self._time(sec=seconds, nanosec=rest),
            level=max(0, min(record.levelno, 255)),
            name=f"{self._name}.{below}" if below else self._name,
            msg=_text(record.msg),
            file=_text(record.pathname),
            function=_text(record.funcName or ""),
            line=max(0, record.lineno),
        )


def _text(text: str) -> str:
    """Text that can be serialized."""
    return text[:_LONGEST].replace("\0", "�").encode(errors="replace").decode()
