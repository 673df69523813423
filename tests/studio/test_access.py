"""Access: who gets a session, when it ends, and which hosts and origins count."""

from __future__ import annotations

import pytest

from hexwire.studio.access import Access, Limits, Right


def _access(**limits: float) -> Access:
    return Access(frozenset({"127.0.0.1:80"}), limits=Limits(**limits))  # type: ignore[arg-type]  # a test's own


def test_each_token_gives_its_right_and_others_none() -> None:
    access = _access()
    operate, watch = access.enter(access.operate_token, 0.0), access.enter(access.watch_token, 0.0)
    assert operate is not None
    assert watch is not None
    assert (operate.right, watch.right) == (Right.OPERATE, Right.WATCH)
    assert operate.key != watch.key
    assert access.enter("", 0.0) is None
    assert access.enter(access.operate_token[:-1], 0.0) is None
    assert access.enter("é", 0.0) is None


def test_a_session_ends_when_it_is_not_used() -> None:
    access = _access(session_age=100.0)
    session = access.enter(access.operate_token, 0.0)
    assert session is not None
    assert access.session(session.key, 90.0) is session
    assert access.session(session.key, 180.0) is session
    assert access.session(session.key, 281.0) is None


def test_a_session_that_was_left_does_not_come_back() -> None:
    access = _access()
    session = access.enter(access.operate_token, 0.0)
    assert session is not None
    access.leave(session.key)
    assert access.session(session.key, 1.0) is None
    assert access.session(None, 1.0) is None


def test_too_many_sessions_end_the_oldest() -> None:
    access = _access(sessions=2)
    first, second, third = (access.admit(Right.WATCH, float(t)) for t in range(3))
    assert first is not None
    assert second is not None
    assert third is not None
    assert access.session(first.key, 3.0) is None
    assert access.session(second.key, 3.0) is second
    assert access.session(third.key, 3.0) is third


@pytest.mark.parametrize("host", ["evil.example:80", "127.0.0.1", "127.0.0.1:81", ""])
def test_another_host_is_refused(host: str) -> None:
    assert not _access().allows_host(host)
    assert _access().allows_host("127.0.0.1:80")


@pytest.mark.parametrize("origin", ["http://evil.example", "https://127.0.0.1:80", "null", ""])
def test_another_origin_is_refused(origin: str) -> None:
    access = _access()
    assert not access.allows_origin(origin, "127.0.0.1:80", needed=False)
    assert access.allows_origin("http://127.0.0.1:80", "127.0.0.1:80", needed=True)
    assert not access.allows_origin(None, "127.0.0.1:80", needed=True)
    assert access.allows_origin(None, "127.0.0.1:80", needed=False)


def test_a_watcher_does_not_push_out_an_operator() -> None:
    access = _access(sessions=2)
    operators = [access.admit(Right.OPERATE, 0.0), access.admit(Right.OPERATE, 1.0)]
    assert access.admit(Right.WATCH, 2.0) is None
    assert access.enter(access.watch_token, 2.0) is None
    assert all(session is not None and access.session(session.key, 3.0) is session for session in operators)
    assert access.admit(Right.OPERATE, 4.0) is not None


def test_a_password_cannot_be_tried_often() -> None:
    access = Access(frozenset({"127.0.0.1:80"}), password="correct horse battery")
    for _ in range(5):
        assert access.log_in("guess", 10.0) is None
    assert access.log_in("correct horse battery", 10.0) is None
    assert access.log_in("correct horse battery", 12.0) is not None


def test_without_a_password_nobody_logs_in() -> None:
    assert _access().log_in("", 10.0) is None


def test_what_is_secret_is_not_shown() -> None:
    access = Access(frozenset({"127.0.0.1:80"}), password="correct horse battery")
    access.admit(Right.OPERATE, 0.0)
    shown = repr(access)
    assert access.operate_token not in shown
    assert "horse" not in shown
