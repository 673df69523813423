"""An open Zenoh session: questions and answers, published samples, and liveliness.

Owns questions with a time-out, and the threads that receive. The only module that imports Zenoh. Must not know
arms, messages or roles.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
import weakref
from collections.abc import Callable
from functools import partial
from typing import Any

from hexwire.closing_links import close_at_once
from hexwire.control.loop.workers import Worker
from hexwire.errors import LinkClosedError, NotSupportedError

from .names import HERE

__all__ = ["Inbox", "NoAnswerError", "Node", "OpenQuestion", "Publisher", "Question", "load_zenoh"]

_log = logging.getLogger(__name__)

_MOMENT = 0.01
_RECEIVING = 1.0
"""Most seconds for the handling of a last sample when the session is closed."""

_WAITING = 64
"""Most samples that wait in an inbox."""
_ASKED = 10_000
"""Most questions that wait in a lane; there is no answer to more of them."""


def load_zenoh() -> Any:
    """Zenoh's module.

    Raises:
        NotSupportedError: It is not installed.
    """
    try:
        import zenoh
    except ImportError:
        raise NotSupportedError(
            "sharing an arm needs Eclipse Zenoh, which is not installed: pip install 'hexwire[fleet]'"
        ) from None
    return zenoh


class NoAnswerError(Exception):
    """No answer to a question; `absent` if no visible program offers to answer it."""

    def __init__(self, *, absent: bool) -> None:
        super().__init__("no program answers this" if absent else "no answer in time")
        self.absent = absent


class Question:
    """A question that arrived.

    Args:
        key: Where it is answered. It may have been asked at a pattern, but the answer is for this key: a program
            may have no right to answer for all that the pattern names.
        query: Zenoh's.
    """

    def __init__(self, key: str, query: Any) -> None:
        self._key, self._query = key, query

    @property
    def payload(self) -> bytes:
        """What was asked."""
        payload = self._query.payload
        return bytes(payload.to_bytes()) if payload is not None else b""

    def reply(self, payload: bytes) -> None:
        """Answer it, once. The sender may have ended."""
        with contextlib.suppress(Exception):
            self._query.reply(self._key, payload)
        with contextlib.suppress(Exception):
            self._query.drop()


class OpenQuestion:
    """A question without an answer yet.

    Args:
        replies: Zenoh's channel of replies.
        closed: The exception of a channel without further replies.
    """

    def __init__(self, replies: Any, closed: type[Exception]) -> None:
        self._replies, self._closed = replies, closed

    def poll(self) -> bytes | None:
        """The answer; None while there is none. Does not wait.

        Raises:
            NoAnswerError: There will be no answer.
        """
        try:
            reply = self._replies.try_recv()
        except self._closed:
            raise NoAnswerError(absent=True) from None
        if reply is None:
            return None
        if reply.ok is None:
            raise NoAnswerError(absent=False)
        return bytes(reply.ok.payload.to_bytes())


class Inbox:
    """Samples published under a key, for one thread that waits for them.

    Args:
        subscriber: Zenoh's; it ends with this object.
        wake: Publishes an empty payload for this session only.
        closed: The exception of a channel without further samples.
    """

    def __init__(self, subscriber: Any, wake: Callable[[bytes], None], closed: type[Exception]) -> None:
        self._subscriber, self._handler = subscriber, subscriber.handler
        self._wake, self._closed = wake, closed

    def wait(self) -> bytes:
        """The next payload; empty after `wake`.

        Raises:
            LinkClosedError: The session is closed.
        """
        try:
            return bytes(self._handler.recv().payload.to_bytes())
        except self._closed:
            raise LinkClosedError("the session is closed") from None

    def poll(self) -> bytes | None:
        """The next payload; None if there is none yet. Raises as `wait`."""
        try:
            sample = self._handler.try_recv()
        except self._closed:
            raise LinkClosedError("the session is closed") from None
        return None if sample is None else bytes(sample.payload.to_bytes())

    def wake(self) -> None:
        """End a `wait` in another thread, now or as soon as it begins."""
        self._wake(b"")


class Publisher:
    """Publishes payloads under a key when it is called with them.

    Args:
        publisher: Zenoh's.
        zenoh: Its module.

    Attributes:
        is_wanted: Whether somebody subscribes.
    """

    def __init__(self, publisher: Any, zenoh: Any) -> None:
        self._publisher, self._closed = publisher, zenoh.ZError
        self.is_wanted = False
        # To ask for each payload would take as long as to publish it.
        publisher.declare_matching_listener(zenoh.handlers.Callback(self._on_change, indirect=False))
        if publisher.matching_status.matching:
            self.is_wanted = True

    def _on_change(self, status: Any) -> None:
        self.is_wanted = status.matching

    def __call__(self, payload: bytes) -> None:
        try:
            self._publisher.put(payload)
        except self._closed:
            _log.debug("the session is closed; nothing is published")


class Node:
    """An open session. Any thread may call its methods.

    Args:
        session: As Zenoh opened it.
        cert: Certificate of this program; empty for none.
        local: All its connections stay on this machine and in Unix sockets.
    """

    def __init__(self, session: Any, *, cert: str = "", local: bool = False) -> None:
        self.cert = cert
        # Zenoh's stubs leave out the types of what ends a session.
        self._session = session
        self._zenoh = load_zenoh()
        self._receivers: list[threading.Thread] = []
        self._lanes: dict[str, Worker] = {}
        if not local:
            self._receivers.append(close_at_once(session, self._zenoh.handlers.RingChannel(1)))
        # Also when a program ends without closing it.
        self._closing = weakref.finalize(self, _close, session, self._zenoh.ZError, self._receivers, self._lanes)

    @property
    def is_closed(self) -> bool:
        """Whether it was closed."""
        return bool(self._session.is_closed())

    @property
    def connections(self) -> int:
        """Number of other programs that this one is connected to: peers and routers."""
        info = self._session.info
        return len(list(info.peers_zid())) + len(list(info.routers_zid()))

    def ask_neighbours(self, timeout: float) -> None:
        """Ask the routers and servers that this program is connected to whether they know it.

        Args:
            timeout: Seconds.

        Raises:
            NoAnswerError: None answers; `absent` if none is silent, but their access control does not know this
                program.
        """
        info = self._session.info
        silent = NoAnswerError(absent=False)
        for neighbour in (*info.routers_zid(), *info.peers_zid()):
            try:
                self.ask(HERE.replace("*", str(neighbour)), b"", timeout)
            except NoAnswerError as none:
                silent = none
            else:
                return
        raise silent

    def answer_neighbours(self) -> None:
        """Answer `ask_neighbours` of those who connect to this program."""
        key = HERE.replace("*", str(self._session.info.zid()))

        self.answer(key, lambda question: question.reply(b""), lane="questions")

    @property
    def routers(self) -> int:
        """Number of routers that this one is connected to."""
        return len(list(self._session.info.routers_zid()))

    def close(self) -> None:
        """Close it; everything declared in it ends."""
        self._closing()

    def ask(self, key: str, payload: bytes, timeout: float, *, urgent: bool = False) -> bytes:
        """Ask a question and wait for the first answer.

        Args:
            key: Where.
            payload: The question.
            timeout: Seconds.
            urgent: Ahead of all other messages.

        Raises:
            NoAnswerError: There is no answer.
            LinkClosedError: The session is closed.
        """
        # Receiving in this thread takes half the time of a callback in another one.
        for reply in self._get(key, payload, timeout, urgent):
            if reply.ok is not None:
                return bytes(reply.ok.payload.to_bytes())
            raise NoAnswerError(absent=False)
        raise NoAnswerError(absent=True)

    def question(self, key: str, payload: bytes, timeout: float, *, urgent: bool = False) -> OpenQuestion:
        """Ask a question without waiting for its answer; otherwise as `ask`.

        Raises:
            LinkClosedError: The session is closed.
        """
        return OpenQuestion(self._get(key, payload, timeout, urgent), self._zenoh.ZError)

    def _get(self, key: str, payload: bytes, timeout: float, urgent: bool) -> Any:
        zenoh = self._zenoh
        extra = {"priority": zenoh.Priority.REAL_TIME, "express": True} if urgent else {"express": True}
        try:
            return self._session.get(
                key,
                payload=payload,
                timeout=timeout,
                congestion_control=zenoh.CongestionControl.BLOCK,
                consolidation=zenoh.ConsolidationMode.NONE,
                **extra,
            )
        except zenoh.ZError as error:
            raise LinkClosedError(f"the session is closed: {str(error)[:200]}") from None

    def is_offered(self, key: str, timeout: float) -> bool:
        """Whether a visible program answers questions at a key.

        Args:
            key: The key.
            timeout: Seconds.
        """
        deadline = time.monotonic() + timeout
        with contextlib.suppress(self._zenoh.ZError):
            querier = self._session.declare_querier(key)
            try:
                while not (offered := querier.matching_status.matching) and time.monotonic() < deadline:
                    time.sleep(_MOMENT)
                return bool(offered)
            finally:
                querier.undeclare()
        return False

    def answer(
        self,
        key: str,
        on_question: Callable[[Question], object],
        *,
        lane: str = "",
        at_once: Callable[[Question], bool] = lambda question: False,
    ) -> None:
        """Answer questions.

        Args:
            key: Where.
            on_question: Called with each in a thread of its lane, and may wait for the program that asks.
            lane: The keys of a lane share a thread; by default each key has its own.
            at_once: Called before, in Zenoh's thread, while nothing else arrives: it must neither wait nor answer.
                If it returns True, it has taken the question.
        """
        waiting = self._lanes.setdefault(lane or key, Worker(f"answer {lane or key}", _ASKED))

        def arrived(query: Any) -> None:
            question = Question(key, query)
            try:
                if at_once(question):
                    return
            except Exception:  # noqa: BLE001  # logged; `on_question` may find another answer
                _log.exception("a question at %s failed", key)
            waiting.put(partial(on_question, question))

        handler = self._zenoh.handlers.Callback(arrived, indirect=False)
        self._session.declare_queryable(key, handler, complete=True)

    def subscribe(self, key: str, on_sample: Callable[[bytes, str], object]) -> Callable[[], None]:
        """Receive published samples in a thread of its own; returns a function that ends it.

        Raises:
            LinkClosedError: The session is closed.
        """
        lost = self._zenoh.ZError
        try:
            subscriber = self._session.declare_subscriber(key)
        except lost:
            raise LinkClosedError("the session is closed") from None

        def receive() -> None:
            # `recv` raises when the subscriber is undeclared or the session is closed.
            with contextlib.suppress(lost):
                for sample in subscriber:
                    try:
                        on_sample(sample.payload.to_bytes(), str(sample.key_expr))
                    except Exception:  # noqa: BLE001  # logged; the next sample may be right
                        _log.exception("a sample of %s failed", sample.key_expr)

        # Zenoh's own thread for callbacks would keep a program alive that ends without closing the session.
        thread = threading.Thread(target=receive, name=f"receive {key}", daemon=True)
        self._receivers[:] = [*(other for other in self._receivers if other.is_alive()), thread]
        thread.start()

        def undeclare() -> None:
            with contextlib.suppress(lost):
                subscriber.undeclare()

        return undeclare

    def take_at_once(self, key: str, on_payload: Callable[[bytes], object]) -> None:
        """Receive published samples in Zenoh's thread, while nothing else arrives: the function must not wait."""

        def arrived(sample: Any) -> None:
            try:
                on_payload(bytes(sample.payload.to_bytes()))
            except Exception:  # noqa: BLE001  # logged; the next sample may be right
                _log.exception("a sample of %s failed", key)

        self._session.declare_subscriber(key, self._zenoh.handlers.Callback(arrived, indirect=False))

    def inbox(self, key: str) -> Inbox:
        """Receive published samples in the thread that waits for them; the oldest are dropped if none waits."""
        zenoh = self._zenoh
        subscriber = self._session.declare_subscriber(key, zenoh.handlers.RingChannel(_WAITING))
        wake = self.publisher(key, allowed_destination=zenoh.Locality.SESSION_LOCAL)
        return Inbox(subscriber, wake, zenoh.ZError)

    def publisher(self, key: str, **options: Any) -> Publisher:
        """What publishes under a key. A slow receiver never delays it; what cannot be delivered is dropped.

        Zenoh has two places of 48 KB or more for each receiver. What waits there shares them: more than 100 states.
        With `express` each would take a place of its own, and the third of a burst would be dropped where Zenoh's
        thread gets no processor for 1 ms.
        """
        zenoh = self._zenoh
        how = (zenoh.CongestionControl.DROP, zenoh.Priority.INTERACTIVE_HIGH, zenoh.Reliability.BEST_EFFORT)
        return self._publisher(key, *how, express=False, **options)

    def publisher_in_order(self, key: str) -> Publisher:
        """What publishes under a key in one order with the questions of this session, and waits as they do."""
        zenoh = self._zenoh
        # As questions: what is dropped here without a word would leave the arm short of the last set-point. Each
        # priority has a queue of its own.
        how = (zenoh.CongestionControl.BLOCK, zenoh.Priority.DATA, zenoh.Reliability.RELIABLE)
        return self._publisher(key, *how, express=True)

    def _publisher(self, key: str, congestion: Any, priority: Any, reliability: Any, **options: Any) -> Publisher:
        publisher = self._session.declare_publisher(
            key,
            **options,
            congestion_control=congestion,
            priority=priority,
            reliability=reliability,
        )
        return Publisher(publisher, self._zenoh)

    def announce(self, key: str) -> None:
        """Be visible under a key as long as this session lasts."""
        self._tokens = [*getattr(self, "_tokens", []), self._session.liveliness().declare_token(key)]

    def visible(self, key: str, timeout: float) -> list[str]:
        """Keys under which programs are visible.

        Args:
            key: A key or a pattern.
            timeout: Seconds.
        """
        with contextlib.suppress(self._zenoh.ZError):
            replies = self._session.liveliness().get(key, timeout=timeout)
            return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)
        return []

    def watch_visible(self, key: str, on_change: Callable[[str, bool], object], *, at_once: bool = False) -> None:
        """Call a function in a thread of Zenoh's for each program that is visible, becomes visible or vanishes.

        Args:
            key: A key or a pattern.
            on_change: The function; gets the key, and whether the program is visible.
            at_once: It does not wait, and needs no thread of its own: nothing else arrives meanwhile.
        """
        put = self._zenoh.SampleKind.PUT

        def arrived(sample: Any) -> None:
            try:
                on_change(str(sample.key_expr), sample.kind == put)
            except Exception:  # noqa: BLE001  # logged; the next one may be right
                _log.exception("a change of %s failed", key)

        handler = self._zenoh.handlers.Callback(arrived, indirect=not at_once)
        watch = self._session.liveliness().declare_subscriber(key, handler, history=True)
        self._watches = [*getattr(self, "_watches", []), watch]


def _close(
    session: Any,
    error: type[Exception],
    receivers: list[threading.Thread],
    lanes: dict[str, Worker],
) -> None:
    with contextlib.suppress(error):
        session.close()
    for waiting in list(lanes.values()):
        waiting.close(_RECEIVING)
    # A thread that comes back from Zenoh into an interpreter that has ended would abort the program.
    for thread in receivers:
        if thread is not threading.current_thread():
            thread.join(_RECEIVING)
