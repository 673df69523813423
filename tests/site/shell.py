"""A terminal for the commands of a page: those of hexwire are run in this process, with emulated arms.

What cannot be run here is checked as far as possible: a command of hexwire that does not end by itself is parsed,
and for each program of others there is a check of what can be known of it.
"""

from __future__ import annotations

import os
import re
import shlex
import time
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import click
from click.core import ParameterSource
from click.testing import CliRunner
from tests.waits import PATIENCE

from hexwire.cli.main import cli
from hexwire.control.requests.pose_file import PoseFile
from hexwire.errors import ConfigError
from hexwire.model.arms.hex7bot.joints import HEX7BOT

ROOT = Path(__file__).resolve().parents[2]
LOOKS, SILENT = r"^hexwire bus (ping|scan)\b", "answer"
"""Commands that only look for servos, and what they say of one that is silent."""
ENDLESS = (
    r"^hexwire (sim|serve|gateway|studio|teach|follow|teleop|doctor --fix)\b",
    r"^hexwire fleet (router|watch|record)\b",
    r"^hexwire joystick (send|show)\b",
    r"--watch\b",
    r"^hexwire bus monitor\b",
)
"""They end when somebody ends them, or need somebody's hands: test_endless.py starts them."""
ELSEWHERE = {
    # Minutes of motion, here in simulated time.
    r"^hexwire bus setup\b": ("tests/cli/test_bus_arm_setup.py", "setup"),
    r"^hexwire bus calibrate\b": ("tests/cli/test_bus_calibrate.py", "calibrate"),
    r"^hexwire ports --find\b": ("tests/test_so101_page.py", "--find"),
    # Every rate with every id.
    r"--all-rates\b": ("tests/cli/test_bus.py", "--all-rates"),
    # What they read or write is made by another program.
    r"^hexwire play\b": ("tests/cli/test_motion.py", "play"),
    r"^hexwire record ros2\b": ("tests/cli/test_record_ros2.py", "ros2"),
    r"--record-ros2\b": ("tests/cli/test_record_ros2.py", "--record-ros2"),
    # It asks first.
    r"--backlash\b": ("tests/cli/test_bus_health.py", "--backlash"),
    r"^hexwire bus wave\b": ("tests/cli/test_bus_live.py", "wave"),
    # They need a compiler, or a board to write to.
    r"^hexwire firmware\b": ("tests/cli/test_firmware.py", "flash"),
    r"^hexwire loopback\b": ("tests/cli/test_loopback.py", "loopback"),
    # The certificates of the page.
    r"^hexwire fleet config\b": ("tests/test_fleet_page.py", "hexwire fleet router"),
    # The server of the page.
    r"zenoh:": ("tests/test_fleet_page.py", "zenoh:"),
    r"--port tcp://127\.0\.0\.1:15030": ("tests/cli/test_sim_puma.py", "tcp://"),
    r"--port \"?tcp://127\.0\.0\.1:15040": ("tests/cli/test_gateway.py", "tcp://"),
    r"--port \"?mq:///arms": ("tests/system/test_queue_robots.py", "mq:///"),
}
"""They are run by a test of their own -> that test, and a word of it."""
TELLS = r"^hexwire model check 90 40 40"
"""Its exit status is 1: it shows a pose that is refused."""
MEASURES = r"^hexwire bus stress\b"
"""Its exit status is 1 if a value is missing, as happens on a busy machine."""
ASKS = r"^hexwire bus center\b"
"""They ask first."""
PLAN = r"^hexwire (goto|line)\b(?! 0 220 150$)"
"""Their motions are planned and checked, but not waited for; but from the pose of one of them others begin."""


def matches(patterns: Iterable[str], line: str) -> bool:
    return any(re.search(pattern, line) for pattern in patterns)


def commands(text: str) -> list[tuple[str, list[str]]]:
    """The commands of a console block with the output that is shown below each; continued lines are one.

    Raises:
        ValueError: The block begins with a line that is not a command.
    """
    found: list[tuple[str, list[str]]] = []
    quoted = False
    for line in text.splitlines():
        if line.startswith("$ ") and not quoted:
            found.append((line[2:], []))
        elif not found:
            raise ValueError(f"{line!r} does not begin with '$ '")
        elif quoted or found[-1][0].endswith("\\"):
            found[-1] = (f"{found[-1][0].removesuffix(chr(92))} {line.strip()}", [])
        else:
            found[-1][1].append(line)
        quoted = found[-1][0].count("'") % 2 == 1 or found[-1][0].count('"') % 2 == 1
    return found


def split(command: str) -> list[list[str]]:
    """The simple commands of a line, as lists of words; comments are left out."""
    lexer = shlex.shlex(command, posix=True, punctuation_chars="|&;()")
    lexer.whitespace_split = True
    lexer.commenters = "#"
    parts: list[list[str]] = [[]]
    for word in lexer:
        if set(word) <= set("|&;()"):
            parts.append([])
        else:
            parts[-1].append(word)
    return [part for part in parts if part]


def parse(words: list[str]) -> bool:
    """Parse a command line of hexwire as the program does, without running it.

    Returns:
        Whether it names a command, not only a group of them.

    Raises:
        click.UsageError: It is wrong.
    """
    context, command, rest = _command(words)
    if isinstance(command, click.Group):
        return False
    try:
        with command.make_context(context.info_name, rest, parent=context.parent):
            return True
    except (click.BadParameter, ConfigError) as error:
        # What another command makes is not there.
        if "No such file" not in str(error) and "does not exist" not in str(error):
            raise
        return True


def parse_mentioned(words: list[str]) -> bool:
    """Parse a command that stands in a sentence, where its arguments may be left out, but not some of them.

    Returns:
        Whether it is complete.

    Raises:
        click.UsageError: It is wrong.
    """
    try:
        return parse(words)
    except click.exceptions.Exit:
        return True  # such as --version
    except click.MissingParameter:
        context, command, rest = _command(words)
        with command.make_context(context.info_name, rest, parent=context.parent, resilient_parsing=True) as made:
            arguments = [one.name or "" for one in command.params if isinstance(one, click.Argument)]
            if any(made.get_parameter_source(name) is ParameterSource.COMMANDLINE for name in arguments):
                raise
        return False
    except click.BadOptionUsage as error:
        if error.option_name != words[-1]:
            raise
        return False


def _command(words: list[str]) -> tuple[click.Context, click.Command, list[str]]:
    """The command that a line names, with a context, and what is left for it."""
    command: click.Command = cli
    context = cli.make_context("hexwire", words[1:])
    rest = [*context._protected_args, *context.args]
    while isinstance(command, click.Group) and rest:
        name, found, rest = command.resolve_command(context, rest)
        assert found is not None
        command, context = found, click.Context(found, info_name=name, parent=context)
    return context, command, rest


class Shell:
    """A terminal at a page.

    Args:
        folder: Where commands run.
        arm: The port of an emulated arm, which stands for every other port of the page.
    """

    def __init__(self, folder: Path, arm: str) -> None:
        self.folder, self.arm = folder, arm
        self.only_parse = False
        # Pages go to a pose that the reader has saved.
        rest = {joint.name: joint.offset for joint in HEX7BOT.joints}
        PoseFile(HEX7BOT, folder / "hexwire" / "poses").save("home", rest)
        self.env: dict[str, str | None] = {"HEXWIRE_PORT": arm, "COLUMNS": "200", "XDG_CONFIG_HOME": str(folder)}

    def run(self, command: str, *, whole: bool = False) -> str | None:
        """Run a line; returns what it printed, or None if it was only checked.

        Args:
            command: The line.
            whole: Motions are waited for.

        Raises:
            AssertionError: A command failed, or is wrong.
        """
        said = ""
        checked = False
        refused = "||" in command
        for words in split(re.sub(r"/dev/tty\w+|/tmp/\w+|\$\w+", lambda _: self.arm, command)):
            program = words[0].removeprefix(".venv/bin/")
            if program == "sudo":
                words, program = words[1:], words[1].removeprefix(".venv/bin/")
            words = [program, *words[1:]]
            if program == "echo" and refused:
                said += f"{' '.join(words[1:])}\n"
            elif program != "hexwire":
                if not re.match(r"\w+=", program):
                    OTHERS[program](words)
                checked = True
            else:
                output = self._hexwire(words, refused, whole, said if "|" in command else "")
                checked = checked or output is None
                said = output or "" if "|" in command and not refused else said + (output or "")
        return None if checked else said

    def _hexwire(self, words: list[str], refused: bool, whole: bool, given: str) -> str | None:
        line = " ".join(words)
        if self.only_parse or matches((*ENDLESS, *ELSEWHERE), line):
            parse(words)
            return None
        if re.search("^hexwire goto .*--robot so10[01]", line) and "--port" not in words:
            words = [*words, "--port", "sim://so101"]
        if re.search(ASKS, line):
            words = [*words, "--yes"]
        if re.search(PLAN, line) and "--dry-run" not in words and not whole:
            words = [*words, "--dry-run"]
        before = Path.cwd()
        os.chdir(self.folder)
        try:
            done = CliRunner().invoke(cli, words[1:], env=self.env, input=given)
            end = time.monotonic() + PATIENCE
            # The emulated servos got no processor: a person would look again.
            while done.exit_code and re.search(LOOKS, line) and SILENT in done.output and time.monotonic() < end:
                done = CliRunner().invoke(cli, words[1:], env=self.env, input=given)
        finally:
            os.chdir(before)
        if re.search(MEASURES, line):
            assert done.exit_code in (0, 1), f"{line}: {done.output}"
            return done.output
        assert (done.exit_code != 0) == (refused or bool(re.search(TELLS, line))), f"{line}: {done.output}"
        return "" if refused else done.output


# --- programs of others ------------------------------------------------------------------------------------------


def _pip(words: list[str]) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert words[1] == "install"
    for word in words[2:]:
        name, _, extra = word.partition("[")
        assert name in ("hexwire", "zenoh-ros2-sdk") or (ROOT / name / "pyproject.toml").is_file(), word
        assert set(filter(None, extra.removesuffix("]").split(","))) <= set(extras), word


def _make(words: list[str]) -> None:
    assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), re.MULTILINE), words


def _launch(words: list[str]) -> None:
    folder = ROOT / "src/hexwire/ros1/share/hexwire/launch"
    if words[1] != "hexwire":
        return  # another package's
    text = (folder / words[2]).read_text()
    for argument in (word.partition(":=")[0] for word in words[3:] if ":=" in word):
        assert f'<arg name="{argument}"' in text, words


def _in_page(page: str) -> Callable[[list[str]], None]:
    """Every such command stands in a page whose own test runs it."""

    def check(words: list[str]) -> None:
        text = (ROOT / page).read_text()
        known = [
            split(line) for block in re.findall(r"```console\n(.*?)```", text, re.S) for line, _ in commands(block)
        ]
        assert words in [part for parts in known for part in parts], f"{words} is not in {page}"

    return check


def _lerobot(words: list[str]) -> None:
    source = "".join(path.read_text() for path in (ROOT / "integrations/lerobot/src").rglob("*.py"))
    for name in re.findall(r"\.type=(hexwire\w+)", " ".join(words)):
        assert f'"{name}"' in source, name


def _analyser(words: list[str]) -> None:
    from tests.analyzers.lines import assembled

    for path in re.findall(r"build/analyzers/(\S+)", " ".join(words)):
        assert (assembled() / path).is_file(), path


def _node(words: list[str]) -> None:
    for argument in words[1:]:
        option = argument.startswith(("_", "-")) or "=" in argument
        assert option or argument.endswith(".yaml") or argument.isupper(), argument


def _apt(words: list[str]) -> None:
    packages = {word for word in words[1:] if word not in ("install", "-y")}
    makefile = (ROOT / "Makefile").read_text().replace("\\\n", " ")
    known = " ".join(re.findall(r"^APT_\w+ := (.*)$", makefile, re.MULTILINE))
    pages = (ROOT / "docs/ros.md").read_text() + (ROOT / "docs/ros2.md").read_text()
    assert all(name in known.split() or name in pages for name in packages), packages


def _firmware(words: list[str]) -> None:
    assert re.search(rf"\b{Path(words[0]).name}\b", (ROOT / "firmware/Makefile").read_text()), words


def _word(words: list[str]) -> None:
    """A word of the shell or a program of every system."""
    assert words


LEROBOT = ("calibrate", "find-port", "record", "replay", "rollout", "teleoperate", "train")
WORDS = (
    *("export", "source", ".", "eval", "mkdir", "cp", "cd", "umask", "openssl", "udevadm", "python", "python3"),
    *("colcon", "rosdep"),  # on a machine with ROS 2, which none of the tests is
)
OTHERS: Mapping[str, Callable[[list[str]], None]] = {
    "pip": _pip,
    "make": _make,
    "roslaunch": _launch,
    "ros2": _in_page("docs/ros2.md"),
    "zenoh-ros2": _in_page("docs/ros2.md"),
    "rosservice": _in_page("docs/ros.md"),
    "rostopic": _in_page("docs/ros.md"),
    "hexwire-ros1": _node,
    "hexwire-ros2": _node,
    "tshark": _analyser,
    "wireshark": _analyser,
    "sigrok-cli": _analyser,
    "firmware/build/host/fuzz_board": _firmware,
    "apt-get": _apt,
    "apt": _apt,
    **{f"lerobot-{name}": _lerobot for name in LEROBOT},
    **dict.fromkeys(WORDS, _word),
}
"""Programs that pages use -> what is checked of their words."""
