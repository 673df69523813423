from __future__ import annotations

import pytest

from zenoh_ros2 import graph as module
from zenoh_ros2.graph import Graph
from zenoh_ros2.keys import Role

TOKEN = "@ros2_lv/0/ab/0/{}/MS/%/%/node/%chatter/T_/H/::,10:,:,:,,"


def test_tokens_are_added_once_and_removed() -> None:
    graph = Graph()
    added = graph.add(TOKEN.format(1))
    assert added is not None
    assert graph.add(TOKEN.format(1)) is None
    assert graph.find(Role.SUBSCRIPTION, "/chatter") == [added]
    assert graph.find(Role.SUBSCRIPTION, "/other") == graph.find(Role.PUBLISHER) == []
    assert graph.remove(TOKEN.format(1)) == added
    assert graph.remove(TOKEN.format(1)) is None
    assert list(graph) == []


def test_endpoints_are_found_by_role_and_name_among_others() -> None:
    graph = Graph()
    tokens = [TOKEN.format(number) for number in range(3)]
    others = [TOKEN.format(9).replace("%chatter", "%other"), TOKEN.format(8).replace("/MS/", "/MP/")]
    for token in tokens + others:
        graph.add(token)
    assert [each.token for each in graph.find(Role.SUBSCRIPTION, "/chatter")] == tokens
    assert len(graph.find(Role.SUBSCRIPTION)) == 4
    graph.remove(tokens[1])
    graph.remove(others[1])
    assert [each.token for each in graph.find(Role.SUBSCRIPTION, "/chatter")] == [tokens[0], tokens[2]]
    assert graph.find(Role.PUBLISHER, "/chatter") == []
    assert len(list(graph)) == 3


def test_malformed_tokens_are_counted() -> None:
    graph = Graph()
    assert graph.add("@ros2_lv/x") is None
    assert (graph.malformed, list(graph)) == (1, [])


def test_there_is_room_for_so_many_tokens_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST", 2)
    graph = Graph()
    assert [graph.add(TOKEN.format(number)) is not None for number in range(4)] == [True, True, False, False]
    assert graph.left_out == 2
