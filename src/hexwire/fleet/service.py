"""Several shared arms in one program: their start, their supervision and their end.

Owns the order of start and shutdown, and that a name is served once. Must not know the command line, nor the file
that names arms.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

from hexwire.control.requests.controlled_arm import ControlledArm
from hexwire.control.sharing.lease import Lease
from hexwire.control.sharing.shared import SharedArm
from hexwire.errors import DeviceError, HexwireError, LinkBusyError, UsageError
from hexwire.system import CLOSE_ON_EXEC, NO_FOLLOW, lock_file

from .address import rights_of
from .names import Keys
from .network import Network, endpoints_of, local_socket, make_socket_folder
from .node import NoAnswerError, Node
from .rights import Kind
from .server import ArmServer, NameGuard

if TYPE_CHECKING:
    from hexwire.control.requests.settings import Settings
    from hexwire.model.state import JointState

    from .service_file import ServedArm

__all__ = ["Service"]

_log = logging.getLogger(__name__)

_LOOK = 0.05
"""Seconds between two checks of `Service.wait_until_shared`."""
_KNOWN = 1.0
"""Time-out for the question whether a router knows this program, seconds."""
_PATIENCE = 11.0
"""Time-out for the end of all arms, seconds."""


Watch = Callable[[str, "Settings"], Callable[["JointState", Mapping[str, float]], object]]
"""Called with the name and settings of each arm before it starts; returns what is called, in its owner's thread,
with each of its states and the last position sent to each joint, radians. It must not wait."""


def _watched(given: ServedArm, settings: Settings, watch: Watch) -> ControlledArm:
    goals: dict[str, float] = {}
    arm = ControlledArm(given.driver, settings, monitored=False, on_sent=lambda sent: goals.update(sent.positions))
    see = watch(given.name, settings)
    arm.owner.observe(lambda state: see(state, goals))
    return arm


class _Served:
    """One arm, from its start to its end, each in a thread; the other methods are called by the main thread."""

    def __init__(self, given: ServedArm, network: Network, wait: bool, server: str, watch: Watch | None) -> None:
        self.name = given.name
        settings = replace(given.settings, connect_timeout=math.inf) if wait else given.settings
        if watch is None:
            self.arm = ControlledArm(given.driver, settings, monitored=False)
        else:
            self.arm = _watched(given, settings, watch)
        self.shared = SharedArm(self.arm, Lease(timeout=given.lease))
        self.error: BaseException | None = None
        self.unsafe: HexwireError | None = None
        self.server: ArmServer | None = None
        self.node: Node | None = None
        self.is_shared = False
        self._network, self._server_text = network, server
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        # How to end it, when it is shared; under the lock with `_ending`.
        self._opened: ExitStack | None = None
        self._lock = threading.Lock()

    def start(self, started: float) -> None:
        self._thread = threading.Thread(target=self._run, args=(started,), name=f"serve {self.name}", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Ask it to end."""
        with self._lock:
            self._ending.set()
            opened, self._opened = self._opened, None
        if opened is not None:
            self._thread = threading.Thread(target=opened.close, name=f"end {self.name}", daemon=True)
            self._thread.start()
        elif not self.is_shared:
            with contextlib.suppress(HexwireError):
                self.arm.owner.give_up()

    def join(self, deadline: float) -> bool:
        """Wait for its end; returns whether it has ended."""
        if self._thread is not None:
            self._thread.join(max(0.0, deadline - time.monotonic()))
        return self._thread is None or not self._thread.is_alive()

    def _run(self, started: float) -> None:
        try:
            with ExitStack() as stack:
                self._share(stack, started)
                with self._lock:
                    if not self._ending.is_set():
                        self._opened, self.is_shared = stack.pop_all(), True
        except HexwireError as error:
            # An interrupted start is no failure.
            if not self._ending.is_set():
                self.error = error
        except BaseException as error:  # noqa: BLE001  # raised again in the main thread, by `Service.check`
            self.error = error

    def _share(self, stack: ExitStack, started: float) -> None:
        path = local_socket(self.name)
        network = replace(self._network, listen=(*endpoints_of([path]), *self._network.listen))
        # In reverse order: no more orders are accepted, then the arm stops if it moves, then its port is closed.
        stack.enter_context(_only_server(self.name, path))
        stack.callback(self.arm.shutdown)
        self.arm.connect()
        self.arm.start()
        stack.callback(self._make_safe)
        self.shared.start()
        self.node = network.open(wait=False)
        stack.callback(self.node.close)
        guard = None
        if self._network.connect:
            guard = NameGuard(replace(self._network, listen=(), access=None), Keys(self.name).alive)
            stack.callback(guard.close)
            guard.open()
        self.server = ArmServer(
            self.shared, self.name, self.node, guard=guard, server=self._server_text, started=started
        )
        stack.callback(self.server.close)
        self.server.start()

    def _make_safe(self) -> None:
        try:
            self.shared.shutdown()
        except HexwireError as error:
            self.unsafe = error


class Service:
    """Shares arms, each with a thread of its own: one that waits for its port delays no other.

    Call `start`, then `check` regularly, finally `close`; or use it as a context manager, which starts it and waits
    until all arms are shared.

    Args:
        arms: The arms, checked, with different names and ports.
        network: How others reach them, besides programs of this user on this machine.
        wait: Wait for a port that is not there yet however long that takes, and not for `connect_timeout`.
        server: This program, in words.
        watch: Sees all states, besides those who read the arms; None for nobody.
    """

    def __init__(
        self,
        arms: Sequence[ServedArm],
        network: Network | None = None,
        *,
        wait: bool = False,
        server: str = "",
        watch: Watch | None = None,
    ) -> None:
        _check_system(sys.platform)
        self._network = network or Network()
        if self._network.listen and len(arms) > 1:
            raise UsageError(
                "several arms cannot listen at one endpoint; start 'hexwire fleet router', and name it"
            )
        if self._network.cert:
            _check_certificate(self._network.cert, [arm.name for arm in arms])
        self._arms = [_Served(arm, self._network, wait, server, watch) for arm in arms]
        self._told: set[str] = set()
        self._waits_for: dict[str, str] = {}
        self._has_router, self._has_asked = True, False

    def __enter__(self) -> Self:
        try:
            self.start()
            self.wait_until_shared()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Begin to share the arms; returns at once.

        Raises:
            UsageError: A name is too long for a socket, or the folder of the sockets cannot be made.
        """
        for served in self._arms:
            local_socket(served.name)
        make_socket_folder()
        started = time.time()
        for served in self._arms:
            served.start(started)

    def wait_until_shared(self) -> None:
        """Wait until all arms are shared; raises as `check`."""
        while not all(served.is_shared for served in self._arms):
            self.check()
            time.sleep(_LOOK)

    def close(self) -> None:
        """Make all arms safe and end: a motion is stopped, and the joints keep their torque.

        Raises:
            DeviceError: An arm that moved did not confirm its stop; its board's watchdog must stop it.
        """
        for served in self._arms:
            served.end()
        deadline = time.monotonic() + _PATIENCE
        late = [served.name for served in self._arms if not served.join(deadline)]
        unsafe = [f"{served.name}: the stop was not confirmed: {served.unsafe}" for served in self._arms]
        texts = [text for text, served in zip(unsafe, self._arms, strict=True) if served.unsafe is not None]
        texts += [f"{name}: its thread does not end" for name in late]
        if texts:
            raise DeviceError("; ".join(texts))

    def news(self) -> list[str]:
        """What was shared since the last call, and what waits for its port: a line for each arm."""
        lines = []
        where = "".join(f", also at {endpoint}" for endpoint in self._network.listen)
        for served in self._arms:
            owner = served.arm.owner
            if served.is_shared and served.name not in self._told:
                self._told.add(served.name)
                lines.append(f"{served.name}: {owner.robot.url} as zenoh:{served.name}{where}")
            elif not served.is_shared and owner.waits_for != self._waits_for.get(served.name, ""):
                self._waits_for[served.name] = owner.waits_for
                lines.append(f"{served.name}: waiting: {owner.waits_for}")
        return lines

    def check(self) -> None:
        """Check that nothing has failed, and log the loss and the return of the router.

        Raises:
            HexwireError: An arm cannot be shared any more.
        """
        for served in self._arms:
            name = served.name
            if isinstance(served.error, HexwireError):
                several = f"{name}: " if len(self._arms) > 1 else ""
                kind = UsageError if isinstance(served.error, UsageError) else DeviceError
                raise kind(f"{several}{served.error}") from served.error if several else None
            if served.error is not None:
                raise served.error
            if served.arm.owner.crash is not None:
                raise DeviceError(f"{name}: the program failed: {served.arm.owner.crash}")
            if served.server is not None and served.server.conflict:
                raise LinkBusyError(served.server.conflict)
        self._look_for_router()

    def _look_for_router(self) -> None:
        nodes = [served.node for served in self._arms if served.is_shared and served.node is not None]
        if not self._network.connect or not nodes:
            return
        has_router = any(node.routers for node in nodes)
        if has_router != self._has_router:
            where = ", ".join(self._network.connect)
            if has_router:
                _log.warning("connected to the router at %s", where)
            else:
                _log.warning("no connection to the router at %s; it is tried again", where)
            self._has_asked = False
        self._has_router = has_router
        if has_router and self._network.cert and not self._has_asked:
            self._has_asked = True
            try:
                nodes[0].ask_neighbours(_KNOWN)
            except NoAnswerError as none:
                if none.absent:
                    _log.warning(
                        "the router does not know the certificate %s, so that nobody sees the arm; write its "
                        "access file again with 'hexwire fleet config', and start it again",
                        self._network.cert,
                    )


def _check_system(system: str) -> None:
    if system == "win32":
        raise UsageError("sharing an arm needs Linux or macOS; Windows can use a shared arm through its router")


def _check_certificate(cert: str, names: Sequence[str]) -> None:
    """Check that a certificate allows serving these arms; Zenoh drops forbidden messages silently."""
    rights = rights_of(cert)
    if rights is None or rights.kind is not Kind.ARM:
        what = f"is for the role {rights}" if rights is not None else "names no role"
        raise UsageError(f"{cert} {what}; serving needs one from 'hexwire cert issue --role arm --for {names[0]}'")
    for name in names:
        if not rights.covers(name):
            raise UsageError(f"{cert} is for {', '.join(rights.arms)}, not for {name}")


@contextlib.contextmanager
def _only_server(name: str, path: Path) -> Iterator[None]:
    """Claim a name: this user has no other server of that name on this machine.

    The system gives the lock back when a program dies, so that a file which was left means nothing.
    """
    file = path.with_suffix(".name")
    try:
        lock = os.open(file, os.O_RDWR | os.O_CREAT | NO_FOLLOW | CLOSE_ON_EXEC, 0o600)
    except OSError as error:
        raise UsageError(f"{file} cannot be opened: {error.strerror}; remove it") from None
    try:
        if not lock_file(lock):
            raise LinkBusyError(f"the name {name} is already served on this machine; choose another --name")
        yield
    finally:
        os.close(lock)
