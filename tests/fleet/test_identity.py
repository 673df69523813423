"""Who this program is, in words."""

from __future__ import annotations

import getpass
import os
import socket
import sys

import pytest

from hexwire.fleet.remote import whoami


def test_it_names_user_computer_program_and_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(getpass, "getuser", lambda: "ann")
    monkeypatch.setattr(sys, "argv", ["/usr/bin/hexwire", "move"])
    assert whoami() == f"ann@{socket.gethostname()} (hexwire, process {os.getpid()})"


def test_a_user_without_a_name_and_a_program_whose_name_is_no_text(monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody() -> str:
        raise KeyError("no such user")

    monkeypatch.setattr(getpass, "getuser", nobody)
    monkeypatch.setattr(sys, "argv", ["/tmp/odd\udcff"])
    assert whoami().startswith(f"user {os.getuid()}@")
    assert "(odd?, process" in whoami()
