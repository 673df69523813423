from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.serve_puma import ClientSlots


def test_clients_are_admitted_until_all_seats_are_taken() -> None:
    slots: ClientSlots[int] = ClientSlots(3, per_host=3)
    assert [slots.admit(key, "a", 0.0) for key in range(3)] == [(True, None)] * 3
    assert len(slots) == 3
    slots.leave(1)
    slots.leave(1)
    assert slots.admit(3, "a", 1.0) == (True, None)


def test_clients_without_a_valid_request_are_dropped_first_oldest_first() -> None:
    slots: ClientSlots[int] = ClientSlots(4, per_host=4)
    for key in range(4):
        slots.admit(key, "a", float(key))
    slots.heard(0, 4.0)
    assert slots.admit(4, "a", 5.0) == (True, 1)
    assert slots.admit(5, "a", 6.0) == (True, 2)


def test_a_recently_active_client_is_not_displaced() -> None:
    slots: ClientSlots[int] = ClientSlots(2, per_host=2, idle=60.0)
    for key in range(2):
        slots.admit(key, "a", 0.0)
        slots.heard(key, float(key))
    assert slots.admit(2, "b", 60.0) == (False, None)
    assert slots.turned_away == 1
    assert slots.admit(2, "b", 60.5) == (True, 0), "silent for more than a minute"


def test_programs_that_have_ended_do_not_keep_their_host_out() -> None:
    """Over datagrams nobody leaves: the 33rd command of a host found no place, a stop neither."""
    slots: ClientSlots[str] = ClientSlots()
    for channel in range(4):
        slots.admit(f"channel {channel}", "a", 0.1 * channel)
        slots.heard(f"channel {channel}", 0.1 * channel)
    for number in range(200):
        now = 10.0 + 0.5 * number
        assert slots.admit(f"command {number}", "a", now)[0]
        slots.heard(f"command {number}", now)
        # The program moves the robot, and its other channels are quiet.
        slots.heard("channel 1", now, commanded=True)
    kept = [slots._guests.get(f"channel {channel}") for channel in range(4)]
    assert None not in kept
    # Those that command and end take each other's places in turn, too.
    for number in range(200):
        now = 200.0 + 0.5 * number
        assert slots.admit(f"move {number}", "a", now)[0]
        slots.heard(f"move {number}", now, commanded=True)


def test_a_host_without_a_place_waits_until_one_of_its_own_is_silent() -> None:
    slots: ClientSlots[int] = ClientSlots(10, per_host=2)
    for key in range(2):
        slots.admit(key, "a", 0.0)
        slots.heard(key, float(key))
    assert slots.admit(2, "a", 1.0) == (False, None)
    assert slots.admit(2, "a", 1.5) == (True, 0)
    slots.heard(2, 1.5)
    assert slots.admit(3, "a", 1.9) == (False, None)


def test_the_commander_and_the_channels_of_his_host_stay_however_quiet() -> None:
    slots: ClientSlots[str] = ClientSlots(4, per_host=4, idle=60.0)
    for key, host in (("io", "a"), ("commands", "a"), ("watcher", "b"), ("other", "c")):
        slots.admit(key, host, 0.0)
        slots.heard(key, 0.0, commanded=key in ("commands", "other"))
    slots.heard("commands", 1.0, commanded=True)
    assert slots.admit("x", "d", 3600.0) == (True, "watcher")
    slots.heard("x", 3600.0)
    assert slots.admit("y", "d", 3600.0) == (True, "other")
    slots.heard("y", 3600.0)
    assert slots.admit("z", "d", 3600.0) == (False, None)


def test_one_host_takes_from_its_own_only() -> None:
    slots: ClientSlots[int] = ClientSlots(10, per_host=2)
    slots.admit(100, "b", 0.0)
    for key in range(20):
        admitted, out = slots.admit(key, "a", 1.0 + key)
        assert admitted
        assert out != 100
    assert len(slots) == 3


def test_an_unknown_client_is_ignored() -> None:
    slots: ClientSlots[int] = ClientSlots()
    slots.heard(5, 1.0, commanded=True)
    assert len(slots) == 0


@given(st.lists(st.tuples(st.integers(0, 3), st.sampled_from("abc"), st.floats(0.0, 100.0)), max_size=60))
def test_the_commander_is_never_displaced(steps: list[tuple[int, str, float]]) -> None:
    slots: ClientSlots[int] = ClientSlots(5, per_host=3, idle=10.0)
    slots.admit(-1, "a", 0.0)
    slots.heard(-1, 0.0, commanded=True)
    now = 0.0
    for key, (what, host, pause) in enumerate(steps):
        now += pause
        admitted, out = slots.admit(key, host, now)
        assert out != -1
        assert len(slots) <= 5
        if admitted and what:
            slots.heard(key, now)


def test_a_server_has_64_places_32_of_them_for_one_host_and_waits_a_minute() -> None:
    slots: ClientSlots[int] = ClientSlots()
    assert (slots.most, slots.per_host, slots.idle, slots.own_idle) == (64, 32, 60.0, 1.0)
    assert (slots.turned_away, len(slots)) == (0, 0)


def test_places_are_full_at_their_number() -> None:
    slots: ClientSlots[int] = ClientSlots(3, per_host=2)
    for key, host in enumerate("aab"):
        assert slots.admit(key, host, float(key)) == (True, None)
        slots.heard(key, float(key))
    assert slots.admit(3, "a", 1.0) == (False, None)
    assert slots.admit(4, "c", 10.0) == (False, None)
    assert (slots.turned_away, len(slots)) == (2, 3)
    # The one silent longest goes: of its own host where that is full, of all where the server is.
    assert slots.admit(5, "a", 70.0) == (True, 0)
    slots.heard(5, 70.0)
    assert slots.admit(6, "c", 70.0) == (True, 1)


def test_the_longest_silent_goes_not_the_one_that_came_first() -> None:
    slots: ClientSlots[str] = ClientSlots(3, per_host=3, idle=1.0)
    for key in "xyz":
        slots.admit(key, "a", 0.0)
    for when, key in enumerate("zxy"):
        slots.heard(key, float(when))
    assert slots.admit("n", "b", 3.5) == (True, "z")


def test_only_the_last_to_command_counts_as_the_commander() -> None:
    slots: ClientSlots[str] = ClientSlots(2, per_host=2, idle=1.0)
    slots.admit("a", "host a", 0.0)
    slots.heard("a", 0.0, commanded=True)
    slots.admit("b", "host b", 0.0)
    slots.heard("b", 0.5, commanded=True)
    slots.heard("a", 0.6)
    # To have been heard is not to command: b commanded last.
    assert slots.admit("c", "host c", 10.0) == (True, "a")
    slots.heard("c", 10.0)
    slots.leave("b")
    slots.admit("d", "host d", 10.0)
    slots.heard("d", 10.0)
    assert slots.admit("e", "host e", 20.0) == (True, "c")
