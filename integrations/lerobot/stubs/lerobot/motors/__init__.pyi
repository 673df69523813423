from dataclasses import dataclass
from enum import Enum

class MotorNormMode(Enum):
    RANGE_0_100 = ...
    RANGE_M100_100 = ...
    DEGREES = ...

@dataclass
class Motor:
    id: int
    model: str
    norm_mode: MotorNormMode
