from __future__ import annotations

import math
from typing import Any

import pytest
from tests.model.poses import hex7bot_edges, puma260_edges, random_angles, turn_error

from hexwire.model import batch
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.hex7bot.links import LINK_SETS
from hexwire.model.arms.puma260.kinematics import Puma260Model
from hexwire.model.kinematics import KinematicModel

MODELS = {"hex7bot": Hex7BotModel(), "puma260": Puma260Model()}
EDGES = {"hex7bot": hex7bot_edges(LINK_SETS["A"], 30), "puma260": puma260_edges(30)}
EACH = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


def ways(rows: Any) -> list[tuple[float, ...]]:
    return [tuple(float(v) for v in row) for row in rows if not math.isnan(row[0])]


@EACH
def test_arrays_agree_with_single_poses(model: KinematicModel) -> None:
    angles = [*random_angles(8, 200), (math.pi / 2,) * 6]
    positions, rotations = model.forward_many(angles)
    assert positions.shape == (201, 3)
    table = model.inverse_many(positions, rotations)
    assert table.shape == (201, 8, 6)
    for row, place, turn, q in zip(table, positions, rotations, angles, strict=True):
        pose = model.forward(q)
        assert place == pytest.approx(pose.position, abs=1e-14)
        assert turn.ravel().tolist() == pytest.approx([v for r in pose.rotation for v in r], abs=1e-14)
        found, expected = ways(row), model.inverse(pose)
        assert len(found) == len(expected)
        assert all(min(turn_error(s.angles, way) for way in found) < 1e-9 for s in expected)


@EACH
def test_arrays_find_the_same_poses_at_the_edge_of_reach(model: KinematicModel) -> None:
    angles = EDGES[model.name]
    for row, q in zip(model.inverse_many(*model.forward_many(angles)), angles, strict=True):
        found, expected = ways(row), model.inverse(model.forward(q))
        # Near the edge a little rounding is much in angles.
        assert len(found) == len(expected) > 0
        assert all(min(turn_error(s.angles, way) for way in found) < 1e-5 for s in expected)


@EACH
def test_without_numpy_the_same(model: KinematicModel, monkeypatch: pytest.MonkeyPatch) -> None:
    angles = random_angles(9, 50)
    fast = model.forward_many(angles)
    fast_ways = model.inverse_many(*fast)
    monkeypatch.setattr(batch, "numpy_or_none", lambda: None)
    positions, rotations = model.forward_many(angles)
    assert isinstance(positions, list)
    for a, b in zip(positions, fast[0], strict=True):
        assert a == pytest.approx(list(b), abs=1e-14)
    table = model.inverse_many(positions, rotations)
    assert [len(rows) for rows in table] == [8] * 50
    for slow, quick in zip(table, fast_ways, strict=True):
        assert len(ways(slow)) == len(ways(quick))
        assert all(min(turn_error(a, b) for b in ways(quick)) < 1e-9 for a in ways(slow))


@EACH
def test_out_of_reach_is_nan(model: KinematicModel) -> None:
    table = model.inverse_many([[9.0, 0.0, 0.0]], [[[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]])
    assert ways(table[0]) == []


def test_one_pose_is_many_of_one() -> None:
    positions, rotations = MODELS["hex7bot"].forward_many([[1.0] * 6])
    assert positions.shape == (1, 3)
    assert rotations.shape == (1, 3, 3)
