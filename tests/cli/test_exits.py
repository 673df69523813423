from __future__ import annotations

import errno
import logging
import signal
import subprocess
import sys
from types import SimpleNamespace

import click
import pytest

from hexwire.cli import __main__ as start
from hexwire.cli import exits
from hexwire.errors import ConfigError, DeviceError, LimitError, LinkNotFoundError, ReplyTimeoutError


def raising(error: BaseException) -> object:
    def call() -> None:
        raise error

    return exits.run(call)


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (LimitError("too far"), 2),
        (ConfigError("odd", file="x.conf", line=3), 2),
        (DeviceError("broken"), 1),
        (LinkNotFoundError("no port"), 1),
        (ReplyTimeoutError("IDENTIFY"), 1),
        (click.UsageError("odd"), 2),
        (click.BadParameter("odd"), 2),
    ],
)
def test_an_error_is_one_line(error: Exception, status: int, capsys: pytest.CaptureFixture[str]) -> None:
    assert raising(error) == status
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1


def test_an_error_of_several_lines_is_still_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert raising(DeviceError("a\n  b\tc\n")) == 1
    assert capsys.readouterr().err == "error: a b c\n"


def test_an_error_of_the_system_names_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert raising(PermissionError(errno.EACCES, "Permission denied", "/x/y")) == 1
    assert capsys.readouterr().err == "error: /x/y: Permission denied\n"


@pytest.mark.parametrize("error", [KeyboardInterrupt(), click.Abort()])
def test_an_interruption_is_130_and_silent(error: BaseException, capsys: pytest.CaptureFixture[str]) -> None:
    assert raising(error) == 130
    assert capsys.readouterr() == ("", "")


def test_a_bug_keeps_its_traceback() -> None:
    with pytest.raises(ZeroDivisionError):
        exits.run(lambda: 1 / 0)


@pytest.mark.parametrize(("result", "status"), [(None, 0), (0, 0), (3, 3), ("text", 0)])
def test_what_a_command_returns(result: object, status: int) -> None:
    assert exits.run(lambda: result) == status


def test_warnings_of_the_library_are_one_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("hexwire.some.module")
    with exits.warnings_shown():
        log.warning("the port\nis back")
        log.info("not shown")
        exits.show_more(1)
        log.info("shown")
        log.debug("not shown")
        exits.show_more(9)
        log.debug("shown, too")
    log.warning("after it")
    assert capsys.readouterr().err == "warning: the port is back\ninfo: shown\ndebug: shown, too\n"


def test_a_shielded_section_is_not_interrupted() -> None:
    before = signal.getsignal(signal.SIGINT)
    with exits.shielded():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_sigterm_and_sighup_end_like_ctrl_c(number: signal.Signals) -> None:
    # The tests themselves may have been started by `nohup`.
    before = signal.signal(number, signal.SIG_DFL)
    try:
        exits.ends_like_ctrl_c()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
    finally:
        signal.signal(number, before)


def test_a_node_ends_like_ctrl_c_and_a_second_signal_ends_what_is_left_of_it() -> None:
    code = "import signal; from hexwire.cli.exits import run_node; raise_ = signal.raise_signal; "
    code += "print(run_node(lambda: raise_(signal.SIGTERM)), flush=True); raise_(signal.SIGINT); print('goes on')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "130\n", "")


def test_a_signal_that_nohup_ignores_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        exits.ends_like_ctrl_c()
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def shell(code: str, tail: str) -> subprocess.CompletedProcess[str]:
    script = f'set -o pipefail; "$0" -c "$1" {tail}'
    return subprocess.run(
        ["bash", "-c", script, sys.executable, code], capture_output=True, text=True, check=False, timeout=60
    )


PRINTS = "import sys; from hexwire.cli import exits; sys.exit(exits.run(lambda: {}))"


def test_a_reader_that_has_enough_is_no_error() -> None:
    endless = PRINTS.format("[print('line', i) for i in range(10**6)]")
    done = shell(endless, "| head -n 1")
    assert done.stdout == "line 0\n"
    assert done.stderr == ""
    assert done.returncode == 1


def test_a_reader_that_never_read_is_no_error_either() -> None:
    # The one short line is still in our buffer when the reader is gone.
    late = PRINTS.format("(print('line'), __import__('time').sleep(1.0))[0]")
    done = shell(late, "| true")
    assert (done.stdout, done.stderr) == ("", "")


def test_a_full_disk_is_an_error() -> None:
    done = shell(PRINTS.format("print('line')"), "> /dev/full")
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_work_that_must_not_be_interrupted_is_asked_to_end(number: signal.Signals) -> None:
    # The tests themselves may have been started by `nohup`.
    signal.signal(number, signal.SIG_DFL)
    before = signal.getsignal(number)
    with exits.ends_when_asked() as ended:
        assert not ended()
        signal.raise_signal(number)
        assert ended()
    assert signal.getsignal(number) is before


def test_only_a_program_that_has_loaded_zenoh_ends_without_the_interpreters_shutdown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(start.importlib, "import_module", lambda name: SimpleNamespace(main=lambda: sys.exit(3)))
    at_once: list[object] = []
    monkeypatch.setattr(start, "_end_at_once", at_once.append)
    for loaded in (False, True):
        with monkeypatch.context() as patch:
            patch.delitem(sys.modules, "zenoh", raising=False)
            if loaded:
                patch.setitem(sys.modules, "zenoh", SimpleNamespace())  # type: ignore[arg-type]
            with pytest.raises(SystemExit) as end:
                start._start("main")
        assert end.value.code == 3
        assert at_once == [3] * loaded
