"""Who else offers a name, seen by way of a router."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.link.far_ends import free_port
from tests.waits import eventually

from hexwire.fleet.names import Keys
from hexwire.fleet.network import Network
from hexwire.fleet.rights import Kind
from hexwire.fleet.server import NameGuard

from .lab import Lab

KEYS = Keys("lab/arm1")


def test_it_sees_the_own_name_with_the_certificate_of_an_arm_and_no_other(tmp_path: Path, runtime: Path) -> None:
    lab = Lab(tmp_path)
    lab.issue("arm1", Kind.ARM, "lab/arm1")
    lab.issue("arm2", Kind.ARM, "lab/arm2")
    with lab.routing(), lab.session("arm1", wait=False) as one, lab.session("arm2", wait=False) as two:
        one.announce(KEYS.token("1"))
        two.announce(Keys("lab/arm2").token("1"))
        own = NameGuard(lab.network("arm1"), KEYS.alive)
        all_names = NameGuard(lab.network("arm1"), Keys("**").alive)
        for guard in (own, all_names):
            guard.open()
        try:
            eventually(own.visible)
            assert own.visible() == [KEYS.token("1")]
            assert all_names.visible() == []
        finally:
            own.close()
            all_names.close()


@pytest.mark.slow
def test_it_tells_once_the_router_is_there_and_again_after_it_returns() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    network = Network(connect=(endpoint,))
    told: list[tuple[str, bool]] = []
    guard = NameGuard(network, KEYS.alive)
    guard.open()
    assert guard.visible() == []
    guard.watch(lambda key, visible: told.append((key, visible)))
    server = network.open(wait=False)
    server.announce(KEYS.token("1"))
    try:
        for _ in range(2):
            router = Network(listen=(endpoint,), router=True).open()
            eventually(lambda: told == [(KEYS.token("1"), True)])
            told.clear()
            router.close()
            eventually(lambda: told == [(KEYS.token("1"), False)])
            told.clear()
    finally:
        guard.close()
        server.close()


@pytest.mark.parametrize("watches", [False, True])
def test_it_ends_without_a_router(watches: bool) -> None:
    guard = NameGuard(Network(connect=(f"tcp/127.0.0.1:{free_port()}",)), KEYS.alive)
    guard.open()
    if watches:
        guard.watch(lambda key, visible: None)
    guard.close()
    assert guard.visible() == []
