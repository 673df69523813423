"""A layout for Foxglove: the arm in 3D, its positions over time, what is wrong with it, and its log.

Owns the file's form.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

from hexwire.model.urdf import ROOT_LINK

__all__ = ["foxglove_layout"]

_SCENE, _PLOT, _HEALTH, _LOG = "3D!arm", "Plot!positions", "DiagnosticSummary!arm", "RosOut!log"


def foxglove_layout(joints: Sequence[str]) -> str:
    """The text of a layout file.

    Args:
        joints: The driver's joints, in the order of the joint states.
    """
    paths = [
        {
            "value": f"/joint_states.position[{i}]",
            "label": name,
            "enabled": True,
            "timestampMethod": "headerStamp",
        }
        for i, name in enumerate(joints)
    ]
    layers = {
        "grid": {"layerId": "foxglove.Grid", "instanceId": "grid", "label": "Grid", "visible": True, "order": 1},
        "urdf": {
            "layerId": "foxglove.Urdf",
            "instanceId": "urdf",
            "label": "Arm",
            "visible": True,
            "order": 2,
            "sourceType": "topic",
            "topic": "/robot_description",
        },
    }
    layout = {
        "configById": {
            _SCENE: {"layers": layers, "followTf": ROOT_LINK, "followMode": "follow-pose", "topics": {}},
            _PLOT: {
                "foxglovePanelTitle": "Joints, rad",
                "paths": paths,
                "xAxisVal": "timestamp",
                "followingViewWidth": 20,
            },
            _HEALTH: {"topicToRender": "/diagnostics", "minLevel": 0, "pinnedIds": [], "sortByLevel": True},
            _LOG: {"topicToRender": "/rosout", "minLogLevel": 1, "nameFilter": {}, "searchTerms": []},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "splitPercentage": 55,
            "first": _SCENE,
            "second": {
                "direction": "column",
                "splitPercentage": 60,
                "first": _PLOT,
                "second": {"direction": "row", "splitPercentage": 45, "first": _HEALTH, "second": _LOG},
            },
        },
    }
    return json.dumps(layout, indent=2) + "\n"
