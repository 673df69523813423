"""The arms that `hexwire serve` shares, out of a file: closed, and every fault with its place in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.fleet.service_file import read_arms, read_service_file


@pytest.fixture(autouse=True)
def no_port_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HEXWIRE_PORT", raising=False)


def written(folder: Path, text: str) -> str:
    path = folder / "lab.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_file_names_arms_their_settings_and_the_network(tmp_path: Path) -> None:
    file = written(
        tmp_path,
        """
        lease = 0.8
        [arms."lab/arm1"]
        robot = "so101"
        port = "/dev/ttyACM0"
        lease = 2.0
        [arms."lab/arm2"]
        robot = "sim"
        table_height = -0.1
        [network]
        router = ["tls/lab-pc:7447"]
        listen = ["tcp/localhost:7447"]
        ca = "ca.pem"
        """,
    )
    (one, two), network = read_service_file(file)
    assert (one.name, one.driver.model.name, one.lease) == ("lab/arm1", "so101", 2.0)
    assert (two.name, two.driver.url, two.lease, two.settings.table) == ("lab/arm2", "sim://hex7bot", 0.8, -0.1)
    assert not one.driver.is_attached
    assert network == {
        "connect": ("tls/lab-pc:7447",),
        "listen": ("tcp/localhost:7447",),
        "ca": str(tmp_path / "ca.pem"),
    }


SIM = '[arms."lab/arm1"]\nrobot = "sim"\n'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", ["arms", "is missing"]),
        ("arms = 3", ["arms", "a table"]),
        ("[arms]", ['write [arms."lab/arm1"]']),
        (SIM + "[netwrok]", ["netwrok", "unknown key", "network"]),
        (SIM + "[network]\nport = 3", ["network.port", "unknown key", "listen"]),
        (SIM + "[network]\nlisten = 'tcp/localhost:1'", ["network.listen", "a list"]),
        (SIM + "[network]\nca = 3", ["network.ca", "text"]),
        ("lease = 0.01\n" + SIM, ["lease", "0.01", "0.1 to 60"]),
        (SIM + "lease = 'x'", ["arms.lab/arm1.lease", "number"]),
        (SIM + SIM, ["lab.toml:3:", "not TOML", "twice"]),
        ("[arms.'lab arm']\nrobot='sim'", ["arms.'lab arm' is not the name of an arm"]),
        ("[arms.lab.arm1]\nrobot = 'sim'", ["arms.lab contains an arm", '[arms."lab/arm1"]']),
        ("[arms]\na = 3", ["arms.a", "a table"]),
        ("[arms.a]\nrobot = 'sim'\nwacthdog = 1.0", [": 3:12: arms.a.wacthdog: unknown, did you mean watchdog?"]),
        (
            "[arms.a]\nrobot = 'sim'\nwatchdog = 'x'",
            [": 3:12: arms.a.watchdog: must be a number, not the text 'x'"],
        ),
        ("[arms.a]\nrobot = 'r2d2'\nport = '/dev/null'", ["arms.a.robot", "r2d2", "hex7bot"]),
        ("[arms.a]\nrobot = 'sim'\nport = '/dev/null'", ["arms.a.port", "leave it out"]),
        ("[arms.a]\nport = 'zenoh:b'", ["arms.a.port", "shared already"]),
        (
            "[arms.a]\nport = 'nix://b'\n[arms.b]\nrobot = 'sim'\ntable_height = 9.0",
            ["2 settings", "2:8: arms.a.port", "nix", "5:16: arms.b.table_height"],
        ),
        ("[arms.a]\nport = '/dev/null'\n[arms.b]\nport = '/dev/null'", ["arms.b.port", "/dev/null", "port of a"]),
        ("[arms.a]\n[arms.b]\nrobot = 'sim'", ["1:1: arms.a.port", "missing"]),
        ("[arms.a]\nrobot = 'r2d2'\n[arms.b]\n[arms.c]", ["arms.a.robot", "arms.b.port", "arms.c.port"]),
    ],
)
def test_each_fault_is_one_line_with_its_place(tmp_path: Path, text: str, says: list[str]) -> None:
    file = written(tmp_path, text)
    with pytest.raises(UsageError) as caught:
        read_service_file(file, find_port=lambda: pytest.fail("a port was looked for"))
    assert "\n" not in str(caught.value)
    for words in (file, *says):
        assert words in str(caught.value)


def test_a_file_with_more_arms_than_a_program_can_own_is_refused_before_any_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexwire.fleet.service_file.read_settings", lambda *_, **__: pytest.fail("an arm was read"))
    file = written(tmp_path, "".join(f"[arms.a{i}]\nrobot = 'sim'\n" for i in range(2000)))
    with pytest.raises(UsageError, match="arms names 2000 arms; one program shares at most 128: use several files"):
        read_service_file(file)


def test_a_single_arm_is_named_after_its_model_and_finds_its_port() -> None:
    def nothing() -> str:
        raise LinkNotFoundError("no board is plugged in")

    (arm,) = read_arms({"": {"robot": "sim"}})
    assert arm.name == "hex7bot"
    (arm,) = read_arms({"": {}}, find_port=lambda: "/dev/ttyUSB7")
    assert "/dev/ttyUSB7" in arm.driver.url
    with pytest.raises(LinkNotFoundError, match="no board"):
        read_arms({"": {}}, find_port=nothing)


def test_two_emulated_arms_are_two_arms() -> None:
    one, two = read_arms({"a": {"robot": "sim"}, "b": {"robot": "sim"}})
    assert one.driver is not two.driver


def test_the_port_variable_may_name_a_shared_arm_which_is_not_shared_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HEXWIRE_PORT", "zenoh:lab/arm1")
    with pytest.raises(UsageError, match="shared already"):
        read_arms({"": {}})


def test_of_thousands_of_faults_the_first_are_told(tmp_path: Path) -> None:
    rows = "".join(f"wrong{i} = 1\n" for i in range(200))
    file = written(tmp_path, "".join(f"[arms.a{i}]\nrobot = 'sim'\n{rows}" for i in range(20)))
    with pytest.raises(UsageError, match=r"4000 settings are wrong: 3:10: arms\.a0\.wrong0: .*; and 3990 more$"):
        read_service_file(file)
