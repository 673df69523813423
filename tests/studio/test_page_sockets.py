"""NiceGUI's socket: a browser speaks for its own pages only."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from tests.studio.running import Visitor

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio


def test_a_watcher_who_knows_the_id_of_another_page_cannot_press_its_buttons(
    studio: RunningStudio, page: Page
) -> None:
    from nicegui import Client

    client_id = page.evaluate("window.clientId")
    client = Client.instances[client_id]
    button = next(e for e in client.elements.values() if "hw-take" in str(e.props.get("id", "")))
    event = {
        "id": button.id,
        "client_id": client_id,
        "listener_id": next(iter(button._event_listeners)),
        "args": [],
    }
    arm = studio.studio.source.arm
    assert arm is not None
    for how in ("implicit", "explicit", "none"):
        with Visitor(studio, studio.studio.access.watch_token) as watcher:
            _press(watcher, how, client_id, event)
        assert arm.shared.holder is None, how
    # The same event of the page itself is obeyed.
    page.get_by_role("button", name="Take control").click()
    studio.until(lambda: arm.shared.holder is not None, "control")


def _press(watcher: Visitor, how: str, client_id: str, event: dict[str, Any]) -> None:
    """Send an event of another's page, after a handshake of this kind."""
    query = f"EIO=4&transport=websocket&client_id={client_id}" if how == "implicit" else "EIO=4&transport=websocket"
    if how == "implicit":
        query += "&implicit_handshake=true&tab_id=x&document_id=x&next_message_id=0"
    with watcher.socket(f"/_nicegui_ws/socket.io/?{query}") as line:
        assert str(line.recv(timeout=30)).startswith("0{"), how
        line.send("40")
        if how == "implicit":
            assert str(line.recv(timeout=30)).startswith("44"), "the connection is refused"
            return
        assert str(line.recv(timeout=30)).startswith("40{"), how
        if how == "explicit":
            hello: dict[str, Any] = {"client_id": client_id, "tab_id": "x", "document_id": "x"}
            line.send("421" + json.dumps(["handshake", hello]))
            assert line.recv(timeout=30) == "431[false]"
        line.send("42" + json.dumps(["event", event]))
        line.send("422" + json.dumps(["handshake", {"client_id": "none"}]))
        assert line.recv(timeout=30) == "432[false]", how


def test_a_page_that_the_server_has_forgotten_is_told_to_load_itself_again(studio: RunningStudio) -> None:
    with Visitor(studio, studio.studio.access.operate_token) as owner:
        query = "EIO=4&transport=websocket&client_id=gone&implicit_handshake=true&tab_id=x&document_id=x"
        with owner.socket(f"/_nicegui_ws/socket.io/?{query}&next_message_id=0") as line:
            assert str(line.recv(timeout=30)).startswith("0{")
            line.send("40")
            answer = str(line.recv(timeout=30))
            assert answer.startswith("44")
            assert "Implicit handshake failed" in answer
