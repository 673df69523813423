"""An emulated PUMA 260 behind real sockets, in a thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from hexwire.emulator.puma import EmulatedPuma
from hexwire.emulator.serve_puma import serve_puma
from hexwire.link.listener import Listener
from hexwire.link.udp import UdpServer


@dataclass
class Served:
    robot: EmulatedPuma
    listener: Listener
    udp_link: UdpServer
    urls: list[str] = field(default_factory=list)

    @property
    def tcp(self) -> str:
        return f"tcp://127.0.0.1:{self.listener.port}"

    @property
    def udp(self) -> str:
        return f"udp://127.0.0.1:{self.udp_link.port}"


@contextmanager
def served_puma() -> Iterator[Served]:
    served = Served(EmulatedPuma(start=time.monotonic()), Listener(), UdpServer())
    bound, end = threading.Event(), threading.Event()

    def announce(url: str) -> None:
        served.urls.append(url)
        if len(served.urls) == 2:
            bound.set()

    thread = threading.Thread(
        target=serve_puma,
        args=(served.robot,),
        kwargs={"listener": served.listener, "udp": served.udp_link, "stop": end.is_set, "announce": announce},
    )
    thread.start()
    try:
        assert bound.wait(30)
        yield served
    finally:
        end.set()
        thread.join(30)
