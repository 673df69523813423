"""One peer on an emulated bus, in a process of its own: `python bus_peers.py PEER PATH BAUD OP COUNT CPU`.

Prints one JSON object: microseconds a call (p50, p99, mean), CPU microseconds a call, calls a second, and how many
calls raised, gave all values or a part; and how many values were wrong. Positions are 1000 + 100 * id, or 2048 once
a goal was written.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

IDS = (1, 2, 3, 4, 5, 6, 7)
GOAL = 2048
LOWEST, HIGHEST = -32767, 32767
"""What a goal position takes."""
PEERS = ("bare Python", "bare with time-out", "hexwire", "rustypot", "feetech-servo-sdk", "lerobot")
_NEEDS = {"rustypot": "rustypot", "feetech-servo-sdk": "scservo_sdk", "lerobot": "lerobot"}


def installed() -> list[str]:
    """Peers that can run here."""
    return [peer for peer in PEERS if peer not in _NEEDS or importlib.util.find_spec(_NEEDS[peer]) is not None]


class Bare:
    """What a careful hand writes first: build, write, read, check.

    It checks what hexwire checks: header, id, length, error byte and checksum of each answer, and the range of each
    goal, which may be another one each time. It has no time-out, so a lost byte ends it; hexwire pays for one with
    a `poll` before each read. See `BareWithTimeout`.
    """

    def __init__(self, path: str, baud: int) -> None:
        import tty

        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.fd)
        self.goals = dict.fromkeys(IDS, GOAL)

    def _build(self, servo_id: int, instruction: int, params: bytes) -> bytes:
        body = bytes((servo_id, len(params) + 2, instruction)) + params
        return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))

    def _ask(self, request: bytes, ids: Sequence[int]) -> list[int]:
        os.write(self.fd, request)
        data = self._receive(8 * len(ids))
        values = []
        for i, servo_id in enumerate(ids):
            packet = data[8 * i : 8 * i + 8]
            if packet[0] != 0xFF or packet[1] != 0xFF or packet[2] != servo_id or packet[3] != 4:
                raise OSError("wrong header")
            if packet[4]:
                raise OSError("a servo reports a fault")
            if sum(packet[2:]) & 0xFF != 0xFF:
                raise OSError("wrong checksum")
            values.append(packet[5] | packet[6] << 8)
        return values

    def _receive(self, wanted: int) -> bytes:
        data = os.read(self.fd, 256)
        while len(data) < wanted:
            data += os.read(self.fd, 256)
        return data

    def read(self) -> list[int | None]:
        return list(self._ask(self._build(1, 2, b"\x38\x02"), (1,)))

    def sync_read(self) -> list[int | None]:
        return list(self._ask(self._build(0xFE, 0x82, b"\x38\x02" + bytes(IDS)), IDS))

    def sync_write(self) -> None:
        rows = b""
        for servo_id, goal in self.goals.items():
            if not LOWEST <= goal <= HIGHEST:
                raise ValueError("no such position")
            if goal < 0:
                goal = -goal | 0x8000
            rows += bytes((servo_id, goal & 0xFF, goal >> 8))
        os.write(self.fd, self._build(0xFE, 0x83, b"\x2a\x02" + rows))


class BareWithTimeout(Bare):
    """The same with a time-out for each piece of an answer, as on a line that may lose one."""

    def __init__(self, path: str, baud: int) -> None:
        import select

        super().__init__(path, baud)
        poll = select.poll()
        poll.register(self.fd, select.POLLIN)
        self.poll = poll.poll

    def _receive(self, wanted: int) -> bytes:
        data = b""
        while len(data) < wanted:
            if not self.poll(100):
                raise TimeoutError("no answer")
            data += os.read(self.fd, 256)
        return data


class Hexwire:
    def __init__(self, path: str, baud: int) -> None:
        from hexwire.bus.servo_bus import ServoBus
        from hexwire.link.serial import SerialLink

        self.bus = ServoBus(SerialLink(path, baud or 1_000_000))
        self.bus.open()
        self.goals = dict.fromkeys(IDS, GOAL)

    def read(self) -> list[int | None]:
        return [self.bus.read(1, "present_position").raw]

    def sync_read(self) -> Sequence[int | None]:
        return self.bus.sync_read("present_position", IDS).raw

    def sync_write(self) -> None:
        self.bus.sync_write_raw("goal_position", self.goals)


class Rustypot:
    def __init__(self, path: str, baud: int) -> None:
        import rustypot

        self.bus = rustypot.Sts3215PyController(path, baud or 1_000_000, 0.1)
        self.ids, self.goals = list(IDS), [GOAL] * len(IDS)

    def read(self) -> list[int | None]:
        return list(self.bus.read_raw_present_position(1))

    def sync_read(self) -> list[int | None]:
        return list(self.bus.sync_read_raw_present_position(self.ids))

    def sync_write(self) -> None:
        self.bus.sync_write_raw_goal_position(self.ids, self.goals)


class VendorSdk:
    def __init__(self, path: str, baud: int) -> None:
        import scservo_sdk as sdk

        self.port = sdk.PortHandler(path)
        self.port.openPort()
        self.port.setBaudRate(baud or 1_000_000)
        self.packets = sdk.PacketHandler(0)
        self.reader = sdk.GroupSyncRead(self.port, self.packets, 56, 2)
        self.writer = sdk.GroupSyncWrite(self.port, self.packets, 42, 2)
        for servo_id in IDS:
            self.reader.addParam(servo_id)

    def _check(self, result: int) -> None:
        if result:
            raise OSError(self.packets.getTxRxResult(result))

    def read(self) -> list[int | None]:
        value, result, _ = self.packets.read2ByteTxRx(self.port, 1, 56)
        self._check(result)
        return [value]

    def sync_read(self) -> list[int | None]:
        self._check(self.reader.txRxPacket())
        return [self.reader.getData(servo_id, 56, 2) for servo_id in IDS]

    def sync_write(self) -> None:
        self.writer.clearParam()
        for servo_id in IDS:
            self.writer.addParam(servo_id, [GOAL & 0xFF, GOAL >> 8])
        self._check(self.writer.txPacket())


class Lerobot:
    def __init__(self, path: str, baud: int) -> None:
        from lerobot.motors import Motor, MotorNormMode
        from lerobot.motors.feetech import FeetechMotorsBus

        motors = {f"m{i}": Motor(i, "sts3215", MotorNormMode.RANGE_M100_100) for i in IDS}
        self.bus = FeetechMotorsBus(path, motors)
        self.bus.connect()
        if baud and baud != 1_000_000:
            self.bus.set_baudrate(baud)
        self.goals = {f"m{i}": GOAL for i in IDS}

    def read(self) -> list[int | None]:
        return [self.bus.read("Present_Position", "m1", normalize=False)]

    def sync_read(self) -> list[int | None]:
        return list(self.bus.sync_read("Present_Position", normalize=False).values())

    def sync_write(self) -> None:
        self.bus.sync_write("Goal_Position", self.goals, normalize=False)


CLASSES: dict[str, Callable[[str, int], Any]] = {
    "bare Python": Bare,
    "bare with time-out": BareWithTimeout,
    "hexwire": Hexwire,
    "rustypot": Rustypot,
    "feetech-servo-sdk": VendorSdk,
    "lerobot": Lerobot,
}


def main() -> None:
    peer_name, path, baud, op, count, cpu = sys.argv[1:7]
    if cpu != "-":
        os.sched_setaffinity(0, {int(cpu)})
    peer = CLASSES[peer_name](path, int(baud))
    call = _operation(peer, op)
    for _ in range(20):
        _quietly(call)
    took, raised, wrong, partial, whole = [], 0, 0, 0, 0
    clock = time.perf_counter
    budget = float(os.environ.get("HEXWIRE_BENCH_SECONDS", "1.5"))
    cpu_start, start = time.process_time(), clock()
    for _ in range(int(count)):
        begin = clock()
        try:
            values = call()
        except Exception:  # noqa: BLE001  # every peer has errors of its own
            values = None
            raised += 1
        end = clock()
        took.append(end - begin)
        if values is not None:
            good = sum(v in (1000 + 100 * i, GOAL) for i, v in zip(IDS, values, strict=False))
            missing = sum(v is None for v in values)
            wrong += len(values) - good - missing
            whole += good == len(values)
            partial += 0 < good < len(values)
        if end - start > budget:
            break
    total, cpu_used = clock() - start, time.process_time() - cpu_start
    took.sort()
    n = len(took)
    print(
        json.dumps(
            {
                "p50": took[n // 2] * 1e6,
                "p99": took[n * 99 // 100] * 1e6,
                "mean": total / n * 1e6,
                "cpu": cpu_used / n * 1e6,
                "rate": n / total,
                "calls": n,
                "raised": raised,
                "wrong": wrong,
                "partial": partial,
                "whole": whole,
            }
        )
    )


def _operation(peer: Any, op: str) -> Callable[[], Any]:
    if op == "cycle":

        def cycle() -> Any:
            peer.sync_write()
            return peer.sync_read()

        return cycle
    return getattr(peer, op)  # type: ignore[no-any-return]


def _quietly(call: Callable[[], Any]) -> None:
    with contextlib.suppress(Exception):
        call()


if __name__ == "__main__":
    main()
