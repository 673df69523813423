"""What asyncio-for-robotics hears and ros2-pyterfaces understands, as JSON; in the environment of the witnesses.

    python afor_pyterfaces.py NODE      (the session as ZENOH_SESSION_CONFIG_URI says)

Neither discovers: the tokens come from Zenoh, the types, hashes and bytes from ros2-pyterfaces.
"""

from __future__ import annotations

import asyncio
import importlib
import json
import struct
import sys
import time
from typing import Any

import asyncio_for_robotics as afor
import asyncio_for_robotics.zenoh as afor_zenoh
import zenoh


def known(dds_type: str) -> Any:
    """The class of `std_srvs::srv::dds_::Trigger_`, or None."""
    package, kind, _, name = dds_type.split("::")
    try:
        module = importlib.import_module(f"ros2_pyterfaces.cyclone.{package}.{kind}")
    except ImportError:
        return None
    return getattr(module, name.removesuffix("_"), None)


NEEDED = (
    *("%joint_states", "%diagnostics", "%rosout"),
    *("%reset", "%list_parameters", "%get_parameters", "%get_state"),
)


def tokens(session: zenoh.Session) -> list[list[str]]:
    deadline = time.monotonic() + 30
    while True:
        replies = session.liveliness().get("@ros2_lv/0/**", timeout=30.0)
        found = [str(reply.ok.key_expr).split("/") for reply in replies if reply.ok is not None]
        if all(any(part.endswith(name) for token in found for part in token) for name in NEEDED):
            return found
        if time.monotonic() > deadline:
            return found


async def main(node: str) -> dict[str, Any]:
    seen: dict[str, Any] = {"hashes": {}, "understood": {}}
    with afor_zenoh.auto_context() as session:
        ends = {
            (token[5], token[9].replace("%", "/")): (token[10], token[11])
            for token in await asyncio.to_thread(tokens, session)
            if len(token) == 13
        }
        for dds_type, told in ends.values():
            if (found := known(dds_type)) is not None:
                seen["hashes"][dds_type] = [told, found.hash_rihs01()]
        for topic, count in (("/joint_states", 20), ("/diagnostics", 2), ("/rosout", 0)):
            dds_type, told = ends["MP", topic]
            message_type = known(dds_type)
            async with afor.Scope():
                sub = afor_zenoh.Sub(f"0{topic}/{dds_type}/{told}")
                raw = []
                while len(raw) < count:
                    raw.append((await asyncio.wait_for(sub.wait_for_next(), 30)).payload.to_bytes())
            parsed = [message_type.deserialize(each) for each in raw]
            # Written again it is the same, so nothing was lost.
            seen["understood"][topic] = [
                one.serialize()[: len(each)] == each for one, each in zip(parsed, raw, strict=True)
            ]
            if topic == "/joint_states":
                seen["joints"] = list(parsed[0].name)

        async def call(service: str, **fields: Any) -> Any:
            dds_type, told = ends["SS", service]
            service_type = known(dds_type)
            payload = service_type.Request(**fields).serialize()
            attachment = struct.pack("<qq", 1, time.time_ns()) + b"\x10" + bytes(range(16))
            replies = await asyncio.to_thread(
                lambda: list(
                    session.get(
                        f"0{service}/{dds_type}/{told}",
                        payload=payload,
                        attachment=attachment,
                        target=zenoh.QueryTarget.ALL_COMPLETE,
                        consolidation=zenoh.ConsolidationMode.NONE,
                        timeout=30.0,
                    )
                )
            )
            (reply,) = replies
            return service_type.Response.deserialize(reply.ok.payload.to_bytes())

        reset = await call(f"{node}/reset")
        seen["reset"] = [reset.success, reset.message]
        listed = await call(f"{node}/list_parameters", prefixes=[], depth=0)
        seen["parameters"] = list(listed.result.names)
        values = await call(f"{node}/get_parameters", names=["port", "publish_rate"])
        seen["values"] = [values.values[0].string_value, values.values[1].double_value]
        state = await call(f"{node}/get_state")
        seen["state"] = [state.current_state.id, state.current_state.label]
    return seen


if __name__ == "__main__":
    json.dump(asyncio.run(main(sys.argv[1])), sys.stdout)
