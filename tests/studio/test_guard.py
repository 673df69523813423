"""The gate: nothing behind it is reached without a session, the right Host and the right Origin."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from hexwire.studio.access import Access, Limits, Right
from hexwire.studio.guard import PEER, SESSION, Guard

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


def _ask(
    kind: str = "http",
    path: str = "/",
    query: str = "",
    method: str = "GET",
    access: Access | None = None,
    peer: Right | None = None,
    body: bytes = b"",
    behind: _Behind | None = None,
    **headers: str,
) -> Any:
    access = access or Access(frozenset({_HOST}))
    session = access.admit(Right.OPERATE, 0.0)
    assert session is not None
    rows = {"host": _HOST, "cookie": f"hexwire_session_80={session.key}"} | headers
    behind, sent = behind or _Behind(), list[Any]()
    guard = Guard(behind, access, lambda: 1.0)
    scope = {
        "type": kind,
        "method": method,
        "path": path,
        "query_string": query.replace("TOKEN", access.operate_token).encode(),
        "headers": [(name.encode(), value.encode()) for name, value in rows.items() if value],
        "state": {PEER: peer},
    }

    async def receive() -> Any:
        if kind == "websocket":
            return {"type": "websocket.connect"}
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(guard(scope, receive, send))
    return behind.seen, sent


def test_a_session_comes_through_and_gets_the_headers() -> None:
    seen, sent = _ask()
    assert [session.right for session in seen] == [Right.OPERATE]
    headers = dict(sent[0]["headers"])
    policy = headers[b"content-security-policy"]
    assert b"default-src 'none'; script-src 'self'; style-src 'self';" in policy
    assert b"frame-ancestors 'none'" in policy
    assert b"unsafe" not in policy
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


@pytest.mark.parametrize(
    ("path", "url"),
    [
        ("/move", "/move"),
        ("//evil.example/x", "/evil.example/x"),
        ("/\\evil.example", "/evil.example"),
        ('/a"b', "/a%22b"),
    ],
)
def test_a_token_is_exchanged_for_a_cookie_and_leaves_the_address(path: str, url: str) -> None:
    seen, sent = _ask(query="token=TOKEN", path=path, cookie="")
    assert seen == []
    headers = dict(sent[0]["headers"])
    assert sent[0]["status"] == 200
    assert f'content="0;url={url}"' in sent[1]["body"].decode()
    assert b"HttpOnly; SameSite=Strict" in headers[b"set-cookie"]
    assert headers[b"cache-control"] == b"no-store"


def test_a_client_certificate_is_exchanged_for_a_cookie() -> None:
    access = Access(frozenset({_HOST}), secure=True)
    _, sent = _ask(cookie="", access=access, peer=Right.WATCH, origin=f"https://{_HOST}")
    cookie = dict(sent[0]["headers"])[b"set-cookie"].decode()
    assert "; Secure" in cookie
    session = access.session(cookie.partition("=")[2].partition(";")[0], 1.0)
    assert session is not None
    assert session.right is Right.WATCH


@pytest.mark.parametrize(("word", "status"), [("correct horse battery", 200), ("wrong", 403), ("", 403)])
def test_the_password_begins_a_session(word: str, status: int) -> None:
    access = Access(frozenset({_HOST}), password="correct horse battery")
    form = f"password={word.replace(' ', '+')}".encode()
    rows: dict[str, Any] = {"method": "POST", "path": "/login", "cookie": "", "origin": f"http://{_HOST}"}
    seen, sent = _ask(access=access, body=form, **rows)
    assert seen == []
    assert sent[0]["status"] == status
    assert (b"set-cookie" in dict(sent[0]["headers"])) is (status == 200)
    assert _ask(access=access, cookie="")[1][0]["status"] == 401


def test_a_body_without_a_length_is_bounded() -> None:
    class Reader(_Behind):
        async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
            self.seen.append((await receive())["type"])

    access = Access(frozenset({_HOST}), limits=Limits(body=10))
    rows: dict[str, Any] = {"method": "POST", "origin": f"http://{_HOST}", "access": access}
    assert _ask(body=b"x" * 10, behind=Reader(), **rows)[0] == ["http.request"]
    assert _ask(body=b"x" * 11, behind=Reader(), **rows)[0] == ["http.disconnect"]


def test_a_socket_ends_with_its_session() -> None:
    class Reader(_Behind):
        async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
            access.leave(scope[SESSION].key)
            self.seen.append((await receive())["type"])

    access = Access(frozenset({_HOST}))
    session = access.admit(Right.OPERATE, 0.0)
    assert session is not None
    behind = Reader()

    async def receive() -> Any:
        return {"type": "websocket.receive", "text": "{}"}

    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    rows = {"host": _HOST, "origin": f"http://{_HOST}", "cookie": f"hexwire_session_80={session.key}"}
    scope = {"type": "websocket", "path": "/live", "headers": [(k.encode(), v.encode()) for k, v in rows.items()]}
    asyncio.run(Guard(behind, access, lambda: 1.0)(scope, receive, send))
    assert behind.seen == ["websocket.disconnect"]
    assert sent[0]["type"] == "websocket.close"


@pytest.mark.parametrize("row", [{"cookie": ""}, {"origin": ""}, {"origin": "http://evil.example"}, {"host": "x"}])
def test_a_socket_that_is_wrong_is_closed(row: dict[str, str]) -> None:
    seen, sent = _ask("websocket", **({"origin": f"http://{_HOST}"} | row))
    assert seen == []
    assert sent == [{"type": "websocket.close", "code": 1008, "reason": "not allowed"}]


def test_a_socket_of_a_page_comes_through() -> None:
    seen, _ = _ask("websocket", origin=f"http://{_HOST}")
    assert len(seen) == 1


def _crowd(access: Access, asked: list[tuple[str, str, str]], began: list[str] | None = None) -> list[int | str]:
    """What each gets who asks (`kind`, `path`, `key` of the session) while all others are served.

    Also whose requests are served at the same time, in `began`.
    """
    given: list[int | str] = []
    served: list[str] = []

    async def serve() -> None:
        go = asyncio.Event()

        async def behind(scope: Any, receive: Any, send: Any) -> None:
            served.append(scope[SESSION].key)
            await go.wait()
            if scope["type"] == "http":
                await send({"type": "http.response.start", "status": 200, "headers": []})
                await send({"type": "http.response.body", "body": b""})
            else:
                await send({"type": "websocket.accept"})

        guard = Guard(behind, access, lambda: 1.0)

        async def ask(kind: str, path: str, key: str) -> int | str:
            sent: list[Any] = []

            async def receive() -> Any:
                return {"type": "websocket.connect"}

            async def send(message: Any) -> None:
                sent.append(message)

            rows = {"host": _HOST, "origin": f"http://{_HOST}", "cookie": f"hexwire_session_80={key}"}
            headers = [(name.encode(), value.encode()) for name, value in rows.items()]
            method = "POST" if path == "/wire/open" else "GET"
            scope = {"type": kind, "method": method, "path": path, "query_string": b"", "headers": headers}
            await guard(scope, receive, send)
            first = sent[0]
            return first["status"] if kind == "http" else str(first["type"])

        tasks = [asyncio.create_task(ask(*each)) for each in asked]
        for _ in range(10):
            await asyncio.sleep(0)
        if began is not None:
            began.extend(served)
        go.set()
        given.extend(await asyncio.gather(*tasks))

    asyncio.run(serve())
    return given


def _key(access: Access, right: Right) -> str:
    session = access.admit(right, 0.0)
    assert session is not None
    return session.key


def test_watchers_take_no_socket_of_an_operator_and_no_session_takes_them_all() -> None:
    access = Access(frozenset({_HOST}))
    watchers = [_key(access, Right.WATCH) for _ in range(20)]
    one, other = _key(access, Right.OPERATE), _key(access, Right.OPERATE)
    each = access.limits.session_sockets
    idle = [("websocket", "/live", key) for key in watchers for _ in range(each)]
    got = _crowd(access, [*idle, *[("websocket", "/live", one)] * (each + 1), ("websocket", "/live", other)])
    assert got[: len(idle)].count("websocket.accept") == access.limits.sockets
    assert got[len(idle) :] == ["websocket.accept"] * each + ["websocket.close", "websocket.accept"]


def test_a_session_has_a_bounded_number_of_requests_but_its_stops_are_heard() -> None:
    access = Access(frozenset({_HOST}))
    greedy, other = _key(access, Right.WATCH), _key(access, Right.WATCH)
    limits = access.limits
    asked = [("http", "/data/history", greedy)] * (limits.waiting + 2)
    stops = [("http", path, greedy) for path in ("/stop", "/fleet/stop")]
    began: list[str] = []
    got = _crowd(access, [*asked, *stops, ("http", "/data/history", other)], began)
    assert got == [200] * limits.waiting + [429, 429] + [200, 200] + [200]
    # Before any was answered: so many of the one, its stops, and that of the other.
    assert began == [greedy] * (limits.requests + 2) + [other]


def test_few_files_are_taken_at_a_time_but_stops_are_heard() -> None:
    access = Access(frozenset({_HOST}))
    watchers, operator = [_key(access, Right.WATCH) for _ in range(6)], _key(access, Right.OPERATE)
    asked = [("http", "/wire/open", key) for key in watchers]
    asked += [("http", "/stop", watchers[0]), ("http", "/wire/open", operator)]
    began: list[str] = []
    assert _crowd(access, asked, began) == [200] * len(asked)
    assert began.count(operator) == 1
    assert len(began) == access.limits.uploads + 1 + 1


def test_who_reads_an_answer_slowly_keeps_nobody_waiting() -> None:
    access = Access(frozenset({_HOST}), limits=Limits(uploads=1))
    keys = [_key(access, Right.WATCH) for _ in range(2)]

    async def serve() -> None:
        guard, hangs, reached = Guard(_Behind(), access, lambda: 1.0), asyncio.Event(), list[str]()

        async def ask(key: str, slow: bool) -> None:
            async def receive() -> Any:
                return {"type": "http.request", "body": b"", "more_body": False}

            async def send(message: Any) -> None:
                reached.append(key)
                if slow:
                    await hangs.wait()

            rows = {"host": _HOST, "origin": f"http://{_HOST}", "cookie": f"hexwire_session_80={key}"}
            headers = [(name.encode(), value.encode()) for name, value in rows.items()]
            scope: Any = {"type": "http", "method": "POST", "path": "/wire/open", "query_string": b""}
            scope["headers"] = headers
            await guard(scope, receive, send)

        first = asyncio.create_task(ask(keys[0], True))
        await asyncio.sleep(0)
        await asyncio.wait_for(ask(keys[1], False), 30)
        assert reached == [keys[0], keys[1], keys[1]]
        hangs.set()
        await first

    asyncio.run(serve())
