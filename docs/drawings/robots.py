"""The chapter's figure 9.6: classes of robots, and the session below a driver."""

from __future__ import annotations

from .canvas import Canvas

__all__ = ["ROBOTS", "hierarchy"]

ROBOTS = {
    "SessionDriver": ("Hex7BotDriver", "Puma260Driver"),
    "BusArm": (),
    "RemoteRobot": (),
}
"""The classes below `RobotDriver`, and what is below or behind each."""


def hierarchy() -> Canvas:
    """Who is below whom, and what a session has."""
    c = Canvas(
        430,
        "Classes: RobotDriver above SessionDriver, BusArm, RemoteRobot, yours; a session has a channel and a link",
    )
    c.labelled(220, 16, 200, 62, "RobotDriver", sub="the chapter's verbs")
    c.line((320, 78), (320, 104))
    c.line((100, 104), (565, 104))
    places = {"SessionDriver": (24, 152), "BusArm": (196, 112), "RemoteRobot": (328, 128)}
    for name, (x, w) in places.items():
        c.line((x + w / 2, 104), (x + w / 2, 124))
        c.labelled(x, 124, w, 44, name)
    c.line((565, 104), (565, 124), dash="4 4")
    c.labelled(500, 124, 130, 44, "yours")
    c.line((100, 168), (100, 194))
    c.line((74, 194), (232, 194))
    for x, name in ((10, "Hex7BotDriver"), (168, "Puma260Driver")):
        c.line((x + 64, 194), (x + 64, 208))
        c.labelled(x, 208, 128, 40, name)
    c.text(252, 184, "SO-100,\nSO-101", anchor="middle", size=13, color="soft")
    c.text(392, 184, "an arm that another\nprogram shares", anchor="middle", size=13, color="soft")
    c.text(565, 184, "a package\nof its own", anchor="middle", size=13, color="soft")
    # Below the drivers: what each of them has.
    c.line((74, 248), (74, 290), color="blue", end=True, width=2.4)
    c.line((232, 248), (140, 290), color="blue", end=True, width=2.4)
    c.text(196, 276, "has one, or one for each of its channels", size=13, color="blue")
    c.labelled(16, 290, 150, 58, "Session", sub="request, reply, report")
    c.line((166, 319), (216, 319), color="blue", end=True, width=2.4)
    c.labelled(216, 290, 150, 58, "IpcHandle", sub="two modules")
    c.line((366, 319), (416, 319), color="blue", end=True, width=2.4)
    c.labelled(416, 290, 208, 58, "Link", sub="serial, TCP, UDP, queue")
    c.line((300, 168), (300, 224), (520, 224), (520, 290), color="blue", end=True, width=2.4)
    c.text(528, 262, "ServoBus", size=13, color="blue")
    c.text(320, 380, "black: is a kind of what is above; blue: has", anchor="middle", size=13, color="soft")
    c.text(320, 404, "in the chapter: robot_driver, Session, Ipchandle", anchor="middle", size=13, color="soft")
    return c
