"""Several trajectories of different joints as one, each with what it replaces.

Owns which of them counts at a time. Pure. Must not know robots or clocks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .trajectory import Sample, Trajectory

__all__ = ["Together"]


class Together(Trajectory):
    """Trajectories that start at times of their own.

    Args:
        names: Joint names: those of all trajectories.
        parts: Joints -> trajectories of them, each with the time at which it starts, in the order of these times.
            Each counts until the next one starts; the first also before its start, the last also after its end.
    """

    def __init__(
        self, names: Sequence[str], parts: Mapping[tuple[str, ...], Sequence[tuple[Trajectory, float]]]
    ) -> None:
        self.names = tuple(names)
        self._parts = tuple((tuple(map(self.names.index, joints)), rows) for joints, rows in parts.items())
        self.duration = max((rows[-1][0].duration + rows[-1][1] for _, rows in self._parts), default=0.0)

    def at(self, t: float) -> Sample:
        columns: tuple[list[float], ...] = tuple([0.0] * len(self.names) for _ in range(3))
        for places, rows in self._parts:
            path, began = next((row for row in reversed(rows) if row[1] <= t), rows[0])
            for column, values in zip(columns, path.sample(t - began), strict=True):
                for place, value in zip(places, values, strict=True):
                    column[place] = value
        return Sample(*map(tuple, columns))
