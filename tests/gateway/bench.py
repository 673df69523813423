"""A gateway, its host and its boards in simulated time."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.emulator.serve import PacedLine
from hexwire.gateway.line import BoardLine
from hexwire.gateway.router import Gateway
from hexwire.session.connection import Connection, Role
from hexwire.session.events import Answers, Event, Reply, TimedOut
from hexwire.session.several import To
from hexwire.wire import tables
from hexwire.wire.addresses import Broadcast, Multicast
from hexwire.wire.command_frame import Command, Frame, parse_frame

ARDUINO = 8
EVERYBODY = Broadcast()
STEP = 0.001
START = 1000.0


class Bench:
    """A host connection above a gateway, emulated boards below it.

    Args:
        modules: Ids of the boards for the host.
        baud: Rate of the boards' lines; 0 is without pace.

    Attributes:
        dead: Boards whose line carries nothing.
        to_boards: Frames that left for each board.
    """

    def __init__(self, modules: Iterable[int] = (8, 9, 10), *, baud: int = 0) -> None:
        self.now = START
        self.seen: list[Event] = []
        self.boards: dict[int, EmulatedBoard] = {m: make_hex7bot_board(start=START) for m in modules}
        self.gateway = Gateway(BoardLine(m, local=ARDUINO, baud=baud) for m in self.boards)
        self.host = self.connect()
        self.dead: set[int] = set()
        self.to_boards: dict[int, list[Frame]] = {m: [] for m in self.boards}
        self._down = {m: PacedLine(baud) for m in self.boards}
        self._up = {m: PacedLine(baud) for m in self.boards}
        self.drop: Callable[[int, Frame], bool] = lambda module, frame: False

    def connect(self) -> Connection:
        """A host that has just connected."""
        if hasattr(self, "side") and self.side in self.gateway.hosts:
            self.gateway.host_gone(self.side, self.now, broken=False)
        self.side = self.gateway.host_came("the bench")
        self.seen = []
        self.host = Connection(
            Role.HOST, local=7, remote=ARDUINO, type=1, max_frame=tables.MAX_NETWORK_FRAME, epoch=START
        )
        return self.host

    def run(self, seconds: float = 0.3, *, until: Callable[[], bool] = lambda: False) -> None:
        """Let time pass."""
        end = self.now + seconds
        while self.now < end and not until():
            self.now += STEP
            self._turn()

    def _turn(self) -> None:
        now, gateway = self.now, self.gateway
        due = self.host.next_timeout()
        if due is not None and due <= now:
            self.host.handle_timeout(now)
        for data in self.host.data_to_send():
            gateway.receive_host(self.side, data, now)
        gateway.handle_timeout(now)
        for module, board in self.boards.items():
            while data := gateway.lines[module].next_frame(now):
                frame = parse_frame(data)
                self.to_boards[module].append(frame)
                if module not in self.dead and not self.drop(module, frame):
                    self._down[module].put(data, now)
            if data := self._down[module].take(now):
                board.receive(data, now)
            board.step(now)
            out = board.data_to_send()
            if out and module not in self.dead:
                self._up[module].put(out, now)
            if data := self._up[module].take(now):
                gateway.receive_board(module, data, now)
        self.host.receive(gateway.host_data(self.side), now)
        while (event := self.host.next_event()) is not None:
            self.seen.append(event)

    def ask(self, cmd: int, body: bytes = b"", to: int = ARDUINO, *, within: float = 2.0) -> Reply:
        """Ask one board and wait for its answer."""
        self.host.remote = to
        ticket = self.host.request(cmd, body, self.now)
        end = self.wait(ticket, within)
        assert isinstance(end, Reply), end
        return end

    def ask_all(
        self, cmd: int, body: bytes = b"", to: Multicast | Broadcast = EVERYBODY, *, within: float = 2.0
    ) -> Answers:
        """Ask several boards and wait for the end."""
        known = tuple(self.boards) if isinstance(to, Broadcast) else ()
        return self.end_of(self.host.several.request(To(to, known), cmd, body, self.now), within)

    def who(self, to: Multicast | Broadcast = EVERYBODY) -> tuple[list[int], set[int]]:
        """Ask which boards there are: those that answer, and those that should."""
        ticket = self.host.several.request(To(to), Command.IDENTIFY, b"", self.now, window=0.3)
        answers = self.end_of(ticket)
        return list(answers.replies), set(answers.silent)

    def end_of(self, ticket: int, within: float = 2.0) -> Answers:
        """Wait for the end of a request to several."""
        end = self.wait(ticket, within)
        assert isinstance(end, Answers), end
        return end

    def wait(self, ticket: int, within: float = 2.0) -> Reply | Answers | TimedOut:
        """Wait for the end of a request."""

        def found() -> list[Reply | Answers | TimedOut]:
            ends = (e for e in self.seen if isinstance(e, Reply | Answers | TimedOut))
            return [e for e in ends if e.ticket == ticket]

        self.run(within, until=lambda: bool(found()))
        assert found(), "no end"
        return found()[0]

    def stopped(self) -> dict[int, bool]:
        """Which boards are stopped."""
        return {module: board.state.stopped for module, board in self.boards.items()}
