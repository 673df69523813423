"""Bounded events: what gives way, and what never does."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from tests.frames import frame_bytes

from hexwire.session.events import ConnectionCounters, Event, EventQueue, Garbage, Reply, Report, TimedOut
from hexwire.wire.command_frame import Frame, parse_frame


def frame(sn: int) -> Frame:
    return parse_frame(frame_bytes(0x11, sn=sn, src=8, dst=7, type=8, cmd_ext=0x40))


def drain(queue: EventQueue) -> list[Event]:
    return list(iter(queue.pop, None))  # type: ignore[arg-type]


def test_in_order() -> None:
    queue = EventQueue(ConnectionCounters())
    events = [Garbage(1, b"x"), TimedOut(1, 2, 3, ""), Garbage(2, b"yy")]
    for event in events:
        queue.add(event)
    assert drain(queue) == events
    assert queue.pop() is None


def test_the_oldest_report_makes_room_for_the_newest() -> None:
    counters = ConnectionCounters()
    queue = EventQueue(counters)
    queue.add(Garbage(1, b"x"))
    for sn in range(1000):
        queue.add_report(Report(frame(sn)))
    found = drain(queue)
    assert found[0] == Garbage(1, b"x")
    assert [event.frame.sn for event in found[1:] if isinstance(event, Report)] == list(range(936, 1000))
    assert counters.reports_dropped == 936
    # Once taken, there is room again.
    queue.add_report(Report(frame(5)))
    assert counters.reports_dropped == 936


def test_noise_never_pushes_out_an_outcome() -> None:
    counters = ConnectionCounters()
    queue = EventQueue(counters)
    reply, timed_out = Reply(1, 2, 0, b"", None, 0.0, 1), TimedOut(2, 2, 3, "")
    queue.add(reply)
    queue.add_report(Report(frame(1)))
    queue.add(timed_out)
    for i in range(5000):
        queue.add(Garbage(i + 1, b""))
    found = drain(queue)
    assert found[:2] == [reply, timed_out]
    assert len(found) == 4096
    assert found[-1] == Garbage(5000, b"")
    assert counters.events_dropped == 5003 - 4096
    # The report that was dropped on the way does not count as waiting.
    for sn in range(64):
        queue.add_report(Report(frame(sn)))
    assert len(drain(queue)) == 64
    assert counters.reports_dropped == 0


@given(st.lists(st.tuples(st.sampled_from(("report", "noise", "outcome", "pop")), st.integers(1, 90)), max_size=12))
def test_as_a_list_that_holds_64_reports(steps: list[tuple[str, int]]) -> None:
    counters = ConnectionCounters()
    queue, model, dropped, number = EventQueue(counters), list[Event](), 0, 0
    for what, count in steps:
        for _ in range(count):
            number += 1
            if what == "pop":
                assert queue.pop() == (model.pop(0) if model else None)
                continue
            if what == "report":
                reports = [event for event in model if isinstance(event, Report)]
                if len(reports) == 64:
                    model.remove(reports[0])
                    dropped += 1
                event: Event = Report(frame(number))
                queue.add_report(event)
            else:
                event = Garbage(number, b"") if what == "noise" else TimedOut(number, 2, 3, "")
                queue.add(event)
            model.append(event)
    assert drain(queue) == model
    assert (counters.reports_dropped, counters.events_dropped) == (dropped, 0)


def test_outcomes_are_never_dropped_from_the_queue() -> None:
    counters = ConnectionCounters()
    queue = EventQueue(counters)
    outcomes: list[Event] = [TimedOut(i, 2, 3, "") for i in range(4100)]
    for event in outcomes:
        queue.add(event)
    assert drain(queue) == outcomes
    assert counters.events_dropped == 0


def test_above_4096_events_the_oldest_is_dropped_first() -> None:
    counters = ConnectionCounters()
    queue = EventQueue(counters)
    for i in range(4096):
        queue.add(Garbage(i + 1, b""))
    assert counters.events_dropped == 0
    queue.add(Garbage(9999, b""))
    assert counters.events_dropped == 1
    assert queue.pop() == Garbage(2, b"")
