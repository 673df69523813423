"""What pyzeros hears of a node whose time it makes, as JSON; in the environment of the witnesses.

    python pyzeros_clock.py NODE      (the session as ZENOH_SESSION_CONFIG_URI says)

It publishes `/clock` at half speed, which starts at 1000 s, and drives the node's life cycle.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from typing import Any

import asyncio_for_robotics as afor
import pyzeros
import zenoh
from ros2_pyterfaces.cyclone.all_msgs import Clock, JointState, Time, Transition
from ros2_pyterfaces.cyclone.all_srvs import ChangeState, GetState

START, STEP = 1000.0, 0.02
ACTIVATE, DEACTIVATE = 3, 4
PATIENCE = 30.0


@afor.scoped
async def main(node: str) -> dict[str, Any]:
    clock, states = pyzeros.Pub(Clock, "/clock"), pyzeros.Sub(JointState, "/joint_states")
    time = START

    async def run() -> None:
        nonlocal time
        while True:
            time += STEP / 2
            clock.publish(Clock(clock=Time(sec=int(time), nanosec=int(time % 1 * 1e9))))
            await asyncio.sleep(STEP)

    async def call(kind: Any, name: str, **fields: Any) -> Any:
        client = pyzeros.Client(kind, f"{node}/{name}")
        await asyncio.wait_for(client.wait_for_service(), PATIENCE)
        return await asyncio.wait_for(client.call_async(kind.Request(**fields)), PATIENCE)

    async def stamps() -> list[list[float]]:
        """Stamps and what was simulated when they came, once the node has the clock."""
        rows = []
        async for state in states.listen_reliable():
            stamp = state.header.stamp.sec + state.header.stamp.nanosec * 1e-9
            if stamp or rows:
                rows.append([stamp, time])
            if len(rows) == 50:
                return rows
        return rows

    async def change(transition: int) -> list[Any]:
        asked = Transition(id=transition, label="")
        changed = await call(ChangeState, "change_state", transition=asked)
        return [changed.success, (await call(GetState, "get_state")).current_state.label]

    running = asyncio.create_task(run())
    seen: dict[str, Any] = {"stamps": await asyncio.wait_for(stamps(), PATIENCE)}
    seen["changes"] = [await change(each) for each in (DEACTIVATE, ACTIVATE, DEACTIVATE)]
    running.cancel()
    return seen


if __name__ == "__main__":
    config = zenoh.Config.from_file(os.environ["ZENOH_SESSION_CONFIG_URI"])
    # Two peers that have just opened sometimes find each other only after a while.
    config.insert_json5("mode", json.dumps("client"))
    session = zenoh.open(config)
    with pyzeros.auto_context(node="simulation", zenoh_session=session):
        json.dump(asyncio.run(main(sys.argv[1])), sys.stdout)
    session.close()
