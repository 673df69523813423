"""Computers on a network, as far as programs can tell: network namespaces around a hub, whose cables can fail.

Owns the namespaces, their addresses and the faults of their cables. Needs root, iproute2 and nftables; where they
are missing, `Hosts` says so. Ends and removes only what it has made.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

HUB = "hub"


def run(*words: str) -> str:
    done = subprocess.run(words, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 0, f"{' '.join(words)}: {done.stderr.strip()}"
    return done.stdout


class Hosts:
    """Hosts around a hub, each with a cable to it. Use as context manager.

    Args:
        names: Short names of the hosts.
    """

    def __init__(self, *names: str) -> None:
        self.names = names

    def __enter__(self) -> Hosts:
        missing = [tool for tool in ("ip", "nft") if shutil.which(tool) is None]
        assert not missing, f"this test needs {' and '.join(missing)}: apt-get install iproute2 nftables"
        assert os.geteuid() == 0, "this test makes network namespaces, which needs root: run it as root"
        try:
            for name in (HUB, *self.names):
                run("ip", "netns", "add", self.space(name))
                run("ip", "-n", self.space(name), "link", "set", "lo", "up")
                self._nft(name, "add table inet faults")
                for chain in ("input", "output"):
                    self._nft(name, f"add chain inet faults {chain} {{ type filter hook {chain} priority 0; }}")
            for name in self.names:
                a, b = self.space(HUB), self.space(name)
                run(
                    "ip",
                    "link",
                    "add",
                    self._cable(name),
                    "netns",
                    a,
                    "type",
                    "veth",
                    "peer",
                    "name",
                    "eth0",
                    "netns",
                    b,
                )
                for space, device, address in (
                    (a, self._cable(name), self.hub(name)),
                    (b, "eth0", self.address(name)),
                ):
                    run("ip", "-n", space, "addr", "add", f"{address}/24", "dev", device)
                    run("ip", "-n", space, "link", "set", device, "up")
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for name in (HUB, *self.names):
            subprocess.run(["ip", "netns", "del", self.space(name)], capture_output=True, check=False, timeout=30)

    def space(self, name: str) -> str:
        """The namespace of a host."""
        return f"hexwire{os.getpid()}{name}"

    def at(self, name: str) -> Sequence[str]:
        """What starts a program on a host."""
        return ("ip", "netns", "exec", self.space(name))

    def hub(self, name: str) -> str:
        """Address of the hub for a host."""
        return f"10.83.{1 + self.names.index(name)}.1"

    def address(self, name: str) -> str:
        """Address of a host."""
        return f"10.83.{1 + self.names.index(name)}.2"

    @contextmanager
    def cut(self, name: str) -> Iterator[float]:
        """Cut a host off during the block; yields from when on nothing passes."""
        device = self._cable(name)
        self._nft(HUB, f"add rule inet faults input iifname {device} drop")
        self._nft(HUB, f"add rule inet faults output oifname {device} drop")
        try:
            yield time.monotonic()
        finally:
            self._nft(HUB, "flush table inet faults")

    @contextmanager
    def loss(self, *names: str, percent: int) -> Iterator[None]:
        """Lose a part of the packets of hosts, in both directions."""
        # At each receiver: a sender would notice that its own packet is dropped.
        for name in names:
            device = self._cable(name)
            self._nft(HUB, f"add rule inet faults input iifname {device} numgen random mod 100 < {percent} drop")
            self._nft(name, f"add rule inet faults input iifname eth0 numgen random mod 100 < {percent} drop")
        try:
            yield
        finally:
            for name in (HUB, *names):
                self._nft(name, "flush table inet faults")

    def _cable(self, name: str) -> str:
        return f"to-{name}"

    def _nft(self, name: str, rule: str) -> None:
        run(*self.at(name), "nft", rule)
