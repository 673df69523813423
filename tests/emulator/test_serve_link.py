from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from hexwire.emulator.serve_pty import TerminalName
from hexwire.errors import UsageError
from hexwire.testing.link import descriptors

GONE = "/dev/pts/1048576"


@pytest.fixture
def terminal() -> Iterator[str]:
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(slave)
    os.close(master)


def test_a_name_is_made_and_taken_away(tmp_path: Path, terminal: str) -> None:
    link = tmp_path / "arm"
    name = TerminalName(link, terminal)
    assert str(link.readlink()) == terminal
    name.remove()
    name.remove()
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_is_served_is_not_taken_by_any_path(tmp_path: Path, terminal: str) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "alias").symlink_to(folder)
    link = folder / "arm"
    name = TerminalName(link, terminal)
    # Its access rights are changed: the terminal looks younger than the link.
    Path(terminal).chmod(0o666)
    for path in (link, tmp_path / "alias" / "arm"):
        with pytest.raises(UsageError, match="is in use by another emulator; stop that one"):
            TerminalName(path, "/dev/pts/4321")
    assert str(link.readlink()) == terminal
    name.remove()
    second = TerminalName(link, terminal)
    second.remove()


def test_a_name_that_was_left_behind_is_taken(tmp_path: Path, terminal: str) -> None:
    link = tmp_path / "arm"
    link.symlink_to(GONE)
    name = TerminalName(link, terminal)
    assert str(link.readlink()) == terminal
    name.remove()


def test_a_name_whose_terminal_has_its_number_again_is_taken(tmp_path: Path, terminal: str) -> None:
    link = tmp_path / "arm"
    master, slave = os.openpty()
    link.symlink_to(os.ttyname(slave))
    os.utime(link, (1.0, 1.0), follow_symlinks=False)
    name = TerminalName(link, terminal)
    assert str(link.readlink()) == terminal
    name.remove()
    os.close(slave)
    os.close(master)


def test_a_living_terminal_of_another_program_keeps_its_name(tmp_path: Path, terminal: str) -> None:
    link = tmp_path / "arm"
    link.symlink_to(terminal)
    with pytest.raises(UsageError, match=f"leads to {terminal}, which another program of yours has open"):
        TerminalName(link, GONE)
    assert str(link.readlink()) == terminal


def test_names_that_must_not_be_replaced(tmp_path: Path, terminal: str, monkeypatch: pytest.MonkeyPatch) -> None:
    file, other = tmp_path / "file", tmp_path / "other"
    file.write_text("precious")
    other.symlink_to(file)
    (tmp_path / "dangling").symlink_to(tmp_path / "nothing")
    (tmp_path / "tty").symlink_to("/dev/pts/../null")
    before = descriptors()
    for link, words in (
        (file, "exists and is not a symbolic link"),
        (tmp_path, "exists and is not a symbolic link"),
        (other, f"links to {file}, not to a pseudo-terminal"),
        (tmp_path / "dangling", "not to a pseudo-terminal"),
        (tmp_path / "tty", "not to a pseudo-terminal"),
        (tmp_path / "no" / "arm", "there is no such folder"),
        (file / "arm", "Not a directory"),
    ):
        with pytest.raises(UsageError, match=words) as caught:
            TerminalName(link, terminal)
        assert "--link" in str(caught.value)
    link = tmp_path / "arm"
    link.symlink_to(GONE)
    uid = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: uid + 1)
    with pytest.raises(UsageError, match="is a link that belongs to"):
        TerminalName(link, terminal)
    assert str(link.readlink()) == GONE
    assert file.read_text() == "precious"
    assert descriptors() <= before


def test_only_ones_own_link_is_taken_away(tmp_path: Path, terminal: str) -> None:
    for theirs in (GONE, None):
        link = tmp_path / "arm"
        name = TerminalName(link, terminal)
        link.unlink()
        if theirs is None:
            link.write_text("a file")
        else:
            link.symlink_to(theirs)
        name.remove()
        assert os.path.lexists(link)
        link.unlink()


def test_without_such_sockets_a_link_can_still_be_made(
    tmp_path: Path, terminal: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class NoBind(socket.socket):
        def bind(self, address: object) -> None:
            raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(socket, "socket", NoBind)
    link = tmp_path / "arm"
    name = TerminalName(link, terminal)
    assert link.is_symlink()
    name.remove()
    assert not link.is_symlink()
