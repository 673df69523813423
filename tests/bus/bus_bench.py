"""A servo bus on emulated servos in this process, in simulated time, for the test files of this folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hexwire.bus.servo_bus import ServoBus
from hexwire.emulator.bus_device import BusDevice, make_servos
from hexwire.emulator.faults import FaultPlan
from hexwire.emulator.serve import BoardLink
from hexwire.emulator.servo import EmulatedServo
from hexwire.model.calibration import JointCalibration
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import Instruction, ServoPacket


class BusLink(BoardLink):
    """A link in simulated time whose rate can be changed, as a serial port's can."""

    rates: list[int]

    @property
    def baud(self) -> int:
        return self.rates[0]

    def set_baud(self, baud: int) -> None:
        self.rates[0] = baud


def make_bus(
    ids: Sequence[int] = (1, 2, 3, 4, 5, 6, 7),
    series: Sequence[Series] = (Series.STS_SMS,),
    *,
    faults: FaultPlan | None = None,
    echo: bool = False,
    paced: bool = True,
    baud: int = 0,
    retries: int = 2,
) -> tuple[ServoBus, BusDevice]:
    """An open bus and the servos behind it."""
    servos = make_servos(series, ids, baud=baud)
    rate = baud or servos[0].baud
    rates = [rate]
    device = BusDevice(servos, paced=paced, faults=faults, echo=echo, host_baud=lambda: rates[0])
    link = BusLink(device)
    link.rates = rates
    kinds = list(series) * len(ids) if len(series) == 1 else list(series)
    bus = ServoBus(link, series=kinds[0], servos=dict(zip(ids, kinds, strict=True)), retries=retries)
    bus.open()
    return bus, device


def exchange_by(bus: ServoBus, exchange: Callable[..., bytes]) -> None:
    """Let a function take all requests of a bus that have an answer, instead of the `exchange` of its link."""
    line, sent = bus._line, list[bytes]()
    line.exchange = exchange
    line.ask = sent.append
    line.collect = lambda window, rest=None: exchange(sent.pop(), window, rest)


def lose_reads(servo: EmulatedServo, name: str) -> None:
    """Let every read of one register be lost."""
    receive, address = servo.receive, servo.series.register(name).address

    def deaf(packet: ServoPacket, now: float) -> bytes | None:
        lost = packet.instruction == Instruction.READ and packet.params[0] == address
        return None if lost else receive(packet, now)

    servo.receive = deaf  # type: ignore[method-assign]


def put_calibration(servo: EmulatedServo, row: JointCalibration) -> None:
    """Let a servo have a calibration in its registers, as if it had been stored there."""
    servo.registers.put("position_offset", row.servo_offset or 0)
    servo.registers.put("min_position_limit", row.low)
    servo.registers.put("max_position_limit", row.high)
