"""Boards that tests can drive in simulated time: the firmware's core on this computer, and its ELF under simavr.

Owns building the firmware and its simulator, and joining a board's servo line to emulated servos byte by byte,
each at its time. Knows nothing of what a frame means.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from hexwire.emulator.bus_arms import make_hex7bot_servos
from hexwire.emulator.faults import FaultPlan
from hexwire.emulator.servo_wire import ServoWire

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = ROOT / "firmware"
BUILD = FIRMWARE / "build"
CLOCK_HZ = 16_000_000
HOST, BUS = 0, 1
WRONG = 0x5B  # makes another byte of one that is heard at a wrong rate


@contextmanager
def _lock(name: str) -> Iterator[None]:
    """Whatever is built is built once at a time: the tests run in several processes."""
    BUILD.mkdir(exist_ok=True)
    with (BUILD / f".lock-{name}").open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def make(target: str, *, fails: bool = False, **variables: str | int) -> str:
    """`make` a target of the firmware's Makefile, which works or `fails`; returns what it printed."""
    arguments = [f"{name}={value}" for name, value in variables.items()]
    chip = target in ("mega2560", "size")
    with _lock(str(variables.get("BUILD", "build")).replace("/", "-") if chip else target):
        done = subprocess.run(
            ["make", "-C", str(FIRMWARE), target, *arguments],
            capture_output=True,
            text=True,
            check=False,
            env={k: v for k, v in os.environ.items() if not k.startswith("MAKE")},
        )
    assert (done.returncode != 0) == fails, done.stdout + done.stderr
    return done.stdout


@cache
def built(target: str, **variables: str | int) -> None:
    """`make`, but only once in this process: nearly every test wants a board."""
    make(target, **variables)


def elf(host_baud: int = 115200) -> Path:
    """The firmware for the chip, built if it is not up to date."""
    build = "build" if host_baud == 115200 else f"build/{host_baud}"
    built("mega2560", BUILD=build, HOST_BAUD=host_baud)
    return FIRMWARE / build / "mega2560/hexwire.elf"


def _simulator() -> ctypes.CDLL:
    source, library = Path(__file__).with_name("simboard.c"), BUILD / "simboard.so"
    with _lock("simulator"):
        if not library.exists() or library.stat().st_mtime < source.stat().st_mtime:
            command = ["gcc", "-O2", "-shared", "-fPIC", "-o", str(library), str(source), "-lsimavr", "-lelf"]
            subprocess.run(command, check=True, capture_output=True)
    lib = ctypes.CDLL(str(library))
    u8p, u64p = ctypes.POINTER(ctypes.c_uint8), ctypes.POINTER(ctypes.c_uint64)
    board, u64, unsigned = ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint
    lib.sim_new.restype, lib.sim_new.argtypes = board, [ctypes.c_char_p, ctypes.c_uint32, ctypes.c_uint32]
    lib.sim_run.restype, lib.sim_run.argtypes = u64, [board, u64]
    lib.sim_put.restype, lib.sim_put.argtypes = None, [board, ctypes.c_int, ctypes.c_char_p, unsigned, u64]
    lib.sim_get.restype = unsigned
    lib.sim_get.argtypes = [board, ctypes.c_int, u8p, u64p, unsigned, u64]
    lib.sim_in_free.restype, lib.sim_in_free.argtypes = u64, [board, ctypes.c_int]
    lib.sim_overruns.restype, lib.sim_overruns.argtypes = u64, [board, ctypes.c_int]
    lib.sim_line_rate.restype, lib.sim_line_rate.argtypes = None, [board, ctypes.c_int, ctypes.c_uint32]
    lib.sim_spoil.restype, lib.sim_spoil.argtypes = None, [board, ctypes.c_int, unsigned]
    lib.sim_chip_rate.restype, lib.sim_chip_rate.argtypes = ctypes.c_uint32, [board]
    lib.sim_eeprom.restype = None
    lib.sim_eeprom.argtypes = [board, ctypes.c_uint16, ctypes.c_char_p, ctypes.c_uint16, ctypes.c_int]
    lib.sim_peek.restype, lib.sim_peek.argtypes = ctypes.c_uint8, [board, ctypes.c_uint16]
    lib.sim_poke_flash.restype = None
    lib.sim_poke_flash.argtypes = [board, ctypes.c_uint32, ctypes.c_uint16]
    for name, kind in (
        ("sim_delete", None),
        ("sim_reset", None),
        ("sim_resets", u64),
        ("sim_cycle", u64),
        ("sim_pc", ctypes.c_uint32),
        ("sim_in_interrupt", ctypes.c_int),
        ("sim_sleeping", ctypes.c_int),
    ):
        function = getattr(lib, name)
        function.restype, function.argtypes = kind, [board]
    return lib


class ServoLine:
    """Emulated servos at the end of a board's servo line.

    Args:
        wire: The bus with its servos.
        deliver: Called with bytes and the time at which the first of them begins.
    """

    def __init__(self, wire: ServoWire, deliver: Callable[[bytes, float], None]) -> None:
        self.wire = wire
        self.sent: list[tuple[float, bytes]] = []  # begin and bytes of every packet of the board
        self.ends: list[float] = []
        self.babble = b""  # comes right after every answer
        self._deliver = deliver
        self._packet = bytearray()
        self._begin = 0.0
        self._byte = 10 / wire.baud

    def byte_sent(self, byte: int, end: float) -> None:
        """The board sent a byte whose stop bit is over at `end`."""
        if not self._packet:
            self._begin = end - self._byte
        self._packet.append(byte)
        if len(self._packet) < 4 or len(self._packet) < self._packet[3] + 4:
            return
        packet = bytes(self._packet)
        self._packet.clear()
        self.sent.append((self._begin, packet))
        self.ends.append(end)
        heard, over = self.wire.transact(packet, self._begin)
        if self.wire.echo:
            self._deliver(heard[: len(packet)], self._begin)
            heard = heard[len(packet) :]
        heard += self.babble
        if heard:
            # Where servos answer in turn, the pauses between them are taken before the first.
            self._deliver(heard, max(over - self._byte * len(heard), end))

    def cut(self) -> None:
        """The board fell silent in the middle of a packet."""
        self._packet.clear()


class Machine:
    """What all simulated boards share: a host line, a servo line, and time.

    Attributes:
        received: Bytes that came out on the host line, and not taken yet.
        stamps: The time at which each of them was over.
    """

    name = ""

    def __init__(self, faults: tuple[str, ...], *, seed: int = 0) -> None:
        plan = FaultPlan(faults, seed=seed)
        self.wire = ServoWire(make_hex7bot_servos(seed=seed), baud=115200, faults=plan)
        self.line = ServoLine(self.wire, self._bus_put)
        self.received = bytearray()
        self.stamps: list[float] = []

    @property
    def now(self) -> float:
        raise NotImplementedError

    def send(self, data: bytes) -> None:
        """Put bytes on the host line; they begin now, or when the line is free."""
        raise NotImplementedError

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        raise NotImplementedError

    def set_rate(self, baud: int) -> None:
        """Change the host's rate of the host line; at any other than the board's, bytes arrive as others."""
        raise NotImplementedError

    def reset(self) -> None:
        """Press the reset button."""
        raise NotImplementedError

    def _bus_put(self, data: bytes, begin: float) -> None:
        raise NotImplementedError

    def take(self) -> bytes:
        """What came on the host line since the last call."""
        data = bytes(self.received)
        self.received.clear()
        self.stamps.clear()
        return data

    def exchange(self, request: bytes, within: float = 0.25, quiet: float = 0.004) -> bytes:
        """Send a request; what came back until the line was quiet, at most `within` seconds later."""
        self.take()
        self.send(request)
        end = self.now + len(request) * 10 / 115200 + within
        while self.now < end:
            self.advance(0.001)
            if self.stamps and self.now - self.stamps[-1] > quiet:
                break
        return self.take()

    def settle(self, seconds: float = 0.15) -> None:
        """Let the board start and know its servos."""
        self.advance(seconds)
        self.take()

    def close(self) -> None:
        """Give everything back."""


class ChipBoard(Machine):
    """The ELF on a simulated ATmega2560."""

    name = "chip"

    def __init__(self, faults: tuple[str, ...] = (), *, host_baud: int = 115200, seed: int = 0) -> None:
        super().__init__(faults, seed=seed)
        self._lib = _simulator()
        self._board = self._lib.sim_new(str(elf(host_baud)).encode(), host_baud, 115200)
        assert self._board
        self._bytes = (ctypes.c_uint8 * 512)()
        self._ends = (ctypes.c_uint64 * 512)()
        self._resets = self._lib.sim_resets(self._board)

    @property
    def now(self) -> float:
        return self._lib.sim_cycle(self._board) / CLOCK_HZ

    @property
    def resets(self) -> int:
        """Resets since the start."""
        return self._lib.sim_resets(self._board)

    @property
    def overruns(self) -> int:
        """Bytes the chip's receivers lost because the program was too slow."""
        return sum(self._lib.sim_overruns(self._board, line) for line in (HOST, BUS))

    @property
    def asleep(self) -> bool:
        """Whether the processor is stopped until the next interrupt."""
        return bool(self._lib.sim_sleeping(self._board))

    @property
    def chip_rate(self) -> int:
        """The rate of the host line that the program has set, bits a second."""
        return self._lib.sim_chip_rate(self._board)

    def set_rate(self, baud: int) -> None:
        self._lib.sim_line_rate(self._board, HOST, baud)

    def spoil(self, every: int) -> None:
        """Damage every so-manieth byte of the host line from now on; 0 ends that."""
        self._lib.sim_spoil(self._board, HOST, every)

    @property
    def host_free(self) -> float:
        """When the last byte given to the host line will have arrived."""
        return self._lib.sim_in_free(self._board, HOST) / CLOCK_HZ

    def send(self, data: bytes) -> None:
        self._lib.sim_put(self._board, HOST, data, len(data), 0)

    def _bus_put(self, data: bytes, begin: float) -> None:
        self._lib.sim_put(self._board, BUS, data, len(data), int(begin * CLOCK_HZ))

    def advance(self, seconds: float) -> None:
        end = self._lib.sim_cycle(self._board) + round(seconds * CLOCK_HZ)
        while (now := self._lib.sim_cycle(self._board)) < end:
            self._advance_to(min(end, now + CLOCK_HZ // 4))

    def _advance_to(self, end: int) -> None:
        while True:
            reached = self._lib.sim_run(self._board, end)
            assert reached, "the simulated chip crashed"
            if self._lib.sim_resets(self._board) != self._resets:
                self._resets = self._lib.sim_resets(self._board)
                self.line.cut()
            for byte, stop in self._get(BUS, 2**63):
                self.line.byte_sent(byte, stop / CLOCK_HZ)
            if reached >= end:
                break
        self.wire.step(self.now)
        for byte, stop in self._get(HOST, end):
            self.received.append(byte)
            self.stamps.append(stop / CLOCK_HZ)

    def _get(self, line: int, until: int) -> list[tuple[int, int]]:
        got: list[tuple[int, int]] = []
        while count := self._lib.sim_get(self._board, line, self._bytes, self._ends, 512, until):
            got += [(self._bytes[i], self._ends[i]) for i in range(count)]
        return got

    def reset(self) -> None:
        self._lib.sim_reset(self._board)

    def hang(self) -> Callable[[], None]:
        """Make the program loop for ever where it is; returns what mends it."""
        while self._lib.sim_in_interrupt(self._board):
            self.advance(1e-6)
        at = self._lib.sim_pc(self._board)
        old = self._flash_word(at)
        self._lib.sim_poke_flash(self._board, at, 0xCFFF)  # rjmp to itself
        return lambda: self._lib.sim_poke_flash(self._board, at, old)

    def _flash_word(self, at: int) -> int:
        # In a file of its own: other workers do the same.
        with tempfile.TemporaryDirectory() as folder:
            binary = Path(folder) / "hexwire.bin"
            subprocess.run(["avr-objcopy", "-O", "binary", "-R", ".eeprom", str(elf()), str(binary)], check=True)
            return int.from_bytes(binary.read_bytes()[at : at + 2], "little")

    def eeprom(self, offset: int, size: int) -> bytes:
        """Bytes of the chip's EEPROM."""
        data = ctypes.create_string_buffer(size)
        self._lib.sim_eeprom(self._board, offset, data, size, 0)
        return data.raw

    def write_eeprom(self, offset: int, data: bytes) -> None:
        """Change the chip's EEPROM behind its back."""
        self._lib.sim_eeprom(self._board, offset, data, len(data), 1)

    def peek(self, address: int) -> int:
        """A byte of the chip's data memory: registers first, then RAM."""
        return self._lib.sim_peek(self._board, address)

    def close(self) -> None:
        if self._board:
            self._lib.sim_delete(self._board)
            self._board = None


def _ends(count: int, begin_us: float, byte_us: float) -> ctypes.Array[ctypes.c_uint64]:
    """When each of some bytes in a row is over, microseconds."""
    return (ctypes.c_uint64 * count)(*(round(begin_us + (i + 1) * byte_us) for i in range(count)))


class CoreBoard(Machine):
    """The same core, compiled for this computer."""

    name = "core"
    _STEP_US = 50

    def __init__(self, faults: tuple[str, ...] = (), *, seed: int = 0) -> None:
        super().__init__(faults, seed=seed)
        built("host")
        lib = ctypes.CDLL(str(BUILD / "host/libhexwire.so"))
        board, u8p = ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint8)
        lib.hexwire_new.restype, lib.hexwire_new.argtypes = board, []
        u32, u64, u64p = ctypes.c_uint32, ctypes.c_uint64, ctypes.POINTER(ctypes.c_uint64)
        lib.hexwire_run.restype = u64
        lib.hexwire_run.argtypes = [board, u64, u64, u32, u8p, u64p, u32, ctypes.POINTER(u32)]
        for name in ("hexwire_host_put", "hexwire_bus_put"):
            getattr(lib, name).restype = None
            getattr(lib, name).argtypes = [board, ctypes.c_char_p, u64p, u32]
        lib.hexwire_bus_out.argtypes = [board, u8p, u32]
        lib.hexwire_line_rate.restype, lib.hexwire_line_rate.argtypes = None, [board, u32]
        lib.hexwire_bus_free.restype, lib.hexwire_bus_free.argtypes = ctypes.c_uint64, [board]
        lib.hexwire_storage.restype, lib.hexwire_storage.argtypes = u8p, [board]
        lib.hexwire_storage_writes.restype = ctypes.POINTER(ctypes.c_uint32)
        lib.hexwire_storage_writes.argtypes = [board]
        lib.hexwire_begin.restype, lib.hexwire_begin.argtypes = None, [board, ctypes.c_uint32, ctypes.c_uint8]
        lib.hexwire_storage_broken.restype = None
        lib.hexwire_storage_broken.argtypes = [board, ctypes.c_int]
        lib.hexwire_host_rate.restype, lib.hexwire_host_rate.argtypes = ctypes.c_uint32, [board]
        lib.hexwire_outputs.restype, lib.hexwire_outputs.argtypes = ctypes.c_uint8, [board]
        lib.hexwire_delete.restype, lib.hexwire_delete.argtypes = None, [board]
        self._lib = lib
        self._board = lib.hexwire_new()
        self._us = 0
        self._boots = 0
        self._bytes = (ctypes.c_uint8 * 512)()
        self._ends = (ctypes.c_uint64 * 512)()
        self._count = ctypes.c_uint32()
        self._in_free = 0
        self.set_rate(115200)
        self.reset()

    @property
    def now(self) -> float:
        return self._us / 1e6

    @property
    def storage(self) -> ctypes.Array[ctypes.c_uint8]:
        """The 4096 bytes that survive a reset."""
        return self._lib.hexwire_storage(self._board)

    @property
    def storage_writes(self) -> list[int]:
        """How often each of those bytes has been written."""
        return list(self._lib.hexwire_storage_writes(self._board)[:4096])

    @property
    def outputs(self) -> int:
        """The digital outputs."""
        return self._lib.hexwire_outputs(self._board)

    def break_storage(self, broken: bool) -> None:
        """Writes to storage are lost from now on, or no longer."""
        self._lib.hexwire_storage_broken(self._board, broken)

    def reset(self) -> None:
        self._boots += 1
        self._lib.hexwire_begin(self._board, self._boots, 0)

    def set_rate(self, baud: int) -> None:
        self._rate = baud
        self._lib.hexwire_line_rate(self._board, baud)

    def send(self, data: bytes) -> None:
        begin, byte_us = max(self._us, self._in_free), 10e6 / self._rate
        self._lib.hexwire_host_put(self._board, data, _ends(len(data), begin, byte_us), len(data))
        self._in_free = round(begin + len(data) * byte_us)

    def _bus_put(self, data: bytes, begin: float) -> None:
        self._lib.hexwire_bus_put(self._board, data, _ends(len(data), begin * 1e6, 10e6 / 115200), len(data))

    def advance(self, seconds: float) -> None:
        end = self._us + round(seconds * 1e6)
        while self._us < end:
            self._us = self._lib.hexwire_run(
                self._board, self._us, end, self._STEP_US, self._bytes, self._ends, 512, self._count
            )
            for i in range(self._count.value):
                self.received.append(self._bytes[i])
                self.stamps.append(self._ends[i] / 1e6)
            count = self._lib.hexwire_bus_out(self._board, self._bytes, 512)
            for i in range(count):
                over = self._lib.hexwire_bus_free(self._board) / 1e6 - (count - 1 - i) * 87e-6
                self.line.byte_sent(self._bytes[i], over)
        self.wire.step(self.now)

    def leap(self, seconds: float) -> None:
        """Let time pass at once, without what would happen meanwhile."""
        self._us += round(seconds * 1e6)
        self.advance(0.01)

    def close(self) -> None:
        if self._board:
            self._lib.hexwire_delete(self._board)
            self._board = None
