"""The gate: nothing behind it is reached without a session, the right Host and the right Origin."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from hexwire.studio.access import Access, Right
from hexwire.studio.guard import SESSION, Guard

_HOST = "127.0.0.1:80"


class _Behind:
    """What is behind the gate: notes who came through."""

    def __init__(self) -> None:
        self.seen: list[Any] = []

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        self.seen.append(scope[SESSION])
        if scope["type"] == "http":
            await send({"type": "http.response.start", "status": 200, "headers": []})
            await send({"type": "http.response.body", "body": b"secret"})


def _ask(kind: str = "http", path: str = "/", query: str = "", method: str = "GET", **headers: str) -> Any:
    access = Access(frozenset({_HOST}))
    session = access.admit(Right.OPERATE, 0.0)
    rows = {"host": _HOST, "cookie": f"hexwire_session_80={session.key}"} | headers
    behind, sent = _Behind(), list[Any]()
    guard = Guard(behind, access, lambda: 1.0)
    scope = {
        "type": kind,
        "method": method,
        "path": path,
        "query_string": query.replace("TOKEN", access.operate_token).encode(),
        "headers": [(name.encode(), value.encode()) for name, value in rows.items() if value],
    }

    async def receive() -> Any:
        return {"type": "websocket.connect"}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(guard(scope, receive, send))
    return behind.seen, sent


def test_a_session_comes_through_and_gets_the_headers() -> None:
    seen, sent = _ask()
    assert [session.right for session in seen] == [Right.OPERATE]
    headers = dict(sent[0]["headers"])
    assert b"frame-ancestors 'none'" in headers[b"content-security-policy"]
    assert headers[b"referrer-policy"] == b"no-referrer"


@pytest.mark.parametrize(
    ("status", "row"),
    [
        (401, {"cookie": ""}),
        (401, {"cookie": "hexwire_session_80=guess"}),
        (421, {"host": "evil.example"}),
        (421, {"host": ""}),
        (403, {"origin": "http://evil.example"}),
        (403, {"method": "POST"}),
        (403, {"query": "token=guess"}),
        (413, {"content-length": "99999999999"}),
    ],
)
def test_what_is_wrong_is_refused_before_anything_sees_it(status: int, row: dict[str, str]) -> None:
    seen, sent = _ask(**row)
    assert seen == []
    assert sent[0]["status"] == status


def test_a_token_is_exchanged_for_a_cookie_and_leaves_the_address() -> None:
    seen, sent = _ask(query="token=TOKEN", path="/arm", cookie="")
    assert seen == []
    headers = dict(sent[0]["headers"])
    assert sent[0]["status"] == 303
    assert headers[b"location"] == b"/arm"
    assert b"HttpOnly; SameSite=Strict" in headers[b"set-cookie"]


@pytest.mark.parametrize("row", [{"cookie": ""}, {"origin": ""}, {"origin": "http://evil.example"}, {"host": "x"}])
def test_a_socket_that_is_wrong_is_closed(row: dict[str, str]) -> None:
    seen, sent = _ask("websocket", **({"origin": f"http://{_HOST}"} | row))
    assert seen == []
    assert sent == [{"type": "websocket.close", "code": 1008, "reason": "not allowed"}]


def test_a_socket_of_a_page_comes_through() -> None:
    seen, _ = _ask("websocket", origin=f"http://{_HOST}")
    assert len(seen) == 1
