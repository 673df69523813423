from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import UsageError
from hexwire.link.url import LinkUrl, is_loopback, parse_url, split_host_port


def test_parts() -> None:
    url = parse_url("tcp://192.168.1.10:15030?timeout=2.5&x=a%26b")
    assert url == LinkUrl(
        "tcp://192.168.1.10:15030?timeout=2.5&x=a%26b",
        "tcp",
        "192.168.1.10:15030",
        "",
        {"timeout": "2.5", "x": "a&b"},
    )
    assert url.host_port() == ("192.168.1.10", 15030)
    assert parse_url("MQ:///arm%20one").path == "/arm one"
    assert parse_url("MQ:///arm").scheme == "mq"
    assert parse_url("board?baud=9600") == LinkUrl("board?baud=9600", "serial", "", "board", {"baud": "9600"})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty or contains blanks"),
        (" tcp://a:1", "empty or contains blanks"),
        ("tcp://a b:1", "empty or contains blanks"),
        ("tcp:192.168.1.10:5", "write '//' after the first colon"),
        ("9p://x", "'9p' is not a scheme"),
        ("://x", "'' is not a scheme"),
        ("tcp://a:1#top", "'#' is not allowed"),
        ("tcp://a:1?", "nothing follows the '?'"),
        ("tcp://a:1?x", "'x' is not an option of the form key=value"),
        ("tcp://a:1?=1", "'=1' is not an option"),
        ("tcp://a:1?x=", "'x=' is not an option"),
        ("tcp://a:1?x=1&&y=2", "'' is not an option"),
        ("tcp://a:1?x=1&x=2", "option 'x' is given twice"),
    ],
)
def test_syntax_errors_name_the_part(text: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_url(text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("netloc", "result"),
    [
        ("localhost:0", ("localhost", 0)),
        ("10.0.0.1:65535", ("10.0.0.1", 65535)),
        ("[::1]:15030", ("::1", 15030)),
    ],
)
def test_host_and_port(netloc: str, result: tuple[str, int]) -> None:
    assert split_host_port(netloc, "tcp://" + netloc) == result


@pytest.mark.parametrize(
    ("netloc", "words"),
    [
        ("", "the host is missing"),
        (":15030", "the host is missing"),
        ("host", "the port is missing, as in host:15030"),
        ("host:", "the port is missing"),
        ("host:65536", "a number from 0 to 65535, not '65536'"),
        ("host:-1", "not '-1'"),
        ("host:1e3", "not '1e3'"),
        ("host:٣", "not '٣'"),
        ("::1:15030", "in brackets"),
        ("fe80::1:15030", "in brackets"),
        ("[::1", "in brackets"),
        ("[::1]15030", "in brackets"),
        ("me:secret@host:1", "no user name or password"),
    ],
)
def test_wrong_host_or_port(netloc: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        split_host_port(netloc, "tcp://x")
    assert words in str(caught.value)


def test_a_port_may_be_left_out_where_that_makes_sense() -> None:
    assert split_host_port("host", "x", port_needed=False) == ("host", 0)
    assert split_host_port("[::1]", "x", port_needed=False) == ("::1", 0)


def test_options() -> None:
    url = parse_url("x://y?n=5&t=0.25&on=Yes&off=0&word=red")
    assert url.integer("n", 1, 0, 10) == 5
    assert url.integer("none", 1, 0, 10) == 1
    assert url.seconds("t", 1.0) == 0.25
    assert url.seconds("none", 1.0) == 1.0
    assert url.yes_no("on", False) is True
    assert url.yes_no("off", True) is False
    assert url.yes_no("none", True) is True
    assert url.choice("word", "blue", ("red", "blue")) == "red"
    assert url.choice("none", "blue", ("red", "blue")) == "blue"
    url.check_keys(("n", "t", "on", "off", "word"))
    with pytest.raises(UsageError, match="unknown option 'n'; options of x://: m, t"):
        url.check_keys(("m", "t"))
    with pytest.raises(UsageError, match="unknown option 'n'; options of x://: none"):
        url.check_keys(())


@pytest.mark.parametrize("text", ["-1", "11", "1.0", "x", "+5", "99999999999999"])
def test_wrong_integers(text: str) -> None:
    with pytest.raises(UsageError, match="n must be an integer from 0 to 10"):
        LinkUrl("u", "x", "", "", {"n": text}).integer("n", 1, 0, 10)


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "soon"])
def test_wrong_times(text: str) -> None:
    with pytest.raises(UsageError, match="t must be a time in seconds above 0"):
        LinkUrl("u", "x", "", "", {"t": text}).seconds("t", 1.0)


def test_wrong_words_and_paths() -> None:
    url = LinkUrl("u", "x", "", "/path", {"w": "green"})
    with pytest.raises(UsageError, match="w must be one of red, blue, not 'green'"):
        url.choice("w", "red", ("red", "blue"))
    with pytest.raises(UsageError, match="'/path' is not allowed"):
        url.check_no_path()
    LinkUrl("u", "x", "", "/").check_no_path()


@given(st.text(max_size=60))
def test_any_text_is_an_address_or_a_usage_error(text: str) -> None:
    for prefix in ("", "tcp://", "udp://[", "serial:///", "mq:///?"):
        try:
            url = parse_url(prefix + text)
            url.host_port()
        except UsageError:
            continue
        assert url.scheme


def test_loopback() -> None:
    assert [is_loopback(host) for host in ("localhost", "127.0.0.1", "127.9.9.9", "::1")] == [True] * 4
    assert [is_loopback(host) for host in ("0.0.0.0", "10.0.0.1", "arm", "::")] == [False] * 4


def test_where_each_part_ends() -> None:
    assert parse_url("serial:///dev/x?y=1") == LinkUrl("serial:///dev/x?y=1", "serial", "", "/dev/x", {"y": "1"})
    assert parse_url("tcp://h:1/p/q") == LinkUrl("tcp://h:1/p/q", "tcp", "h:1", "/p/q")
    assert parse_url("/dev/ttyUSB0") == LinkUrl("/dev/ttyUSB0", "serial", "", "/dev/ttyUSB0")
    assert parse_url("x://a!b?k=a=b%3F").query == {"k": "a=b?"}
    assert parse_url("tcp://a:1?x=1&y=2&z=3").query == {"x": "1", "y": "2", "z": "3"}


@pytest.mark.parametrize(
    "scheme", ["serial", "tcp", "tcps", "udp", "mq", "tcp-listen", "tcps-listen", "udp-listen"]
)
def test_a_scheme_without_slashes_is_no_device(scheme: str) -> None:
    with pytest.raises(UsageError, match="write '//' after the first colon"):
        parse_url(f"{scheme}:x")
    assert parse_url(f"x{scheme}:x").path == f"x{scheme}:x"


@pytest.mark.parametrize("char", ["\x00", "\x1f", " ", "\t"])
def test_no_blank_is_taken_anywhere(char: str) -> None:
    for text in (f"tcp://a{char}b:1", f"{char}tcp://a:1", f"tcp://a:1{char}"):
        with pytest.raises(UsageError, match="empty or contains blanks"):
            parse_url(text)


def test_options_at_their_bounds() -> None:
    def url(text: str) -> LinkUrl:
        return LinkUrl("u", "x", "", "", {"n": text})

    assert [url(text).integer("n", 1, 3, 10) for text in ("3", "10", "000000000005")] == [3, 10, 5]
    for text in ("2", "11", "0000000000005", ""):
        with pytest.raises(UsageError, match="n must be an integer from 3 to 10"):
            url(text).integer("n", 1, 3, 10)
    assert url("1e-9").seconds("n", 1.0) == 1e-9
    assert [url(text).yes_no("n", False) for text in ("1", "yes", "TRUE", "On")] == [True] * 4
    assert [url(text).yes_no("n", True) for text in ("0", "NO", "false", "Off")] == [False] * 4
    with pytest.raises(UsageError, match="n must be 1 or 0, not '2'"):
        url("2").yes_no("n", True)
    with pytest.raises(UsageError, match="n must be one of a, b"):
        LinkUrl("u", "x", "", "").choice("n", "c", ("a", "b"))


def test_a_port_that_may_be_left_out_is_still_read() -> None:
    assert split_host_port("host:7", "x", port_needed=False) == ("host", 7)
    assert split_host_port("[::1]:7", "x", port_needed=False) == ("::1", 7)
    assert split_host_port("host:", "x", port_needed=False) == ("host", 0)
    assert split_host_port("host:00000", "x") == ("host", 0)
    for netloc in ("host:000000", "[]:5", "[::1]:", "[::1]", "[::1]x"):
        with pytest.raises(UsageError):
            split_host_port(netloc, "x")


@pytest.mark.parametrize(
    ("text", "rest"),
    [
        ("tcp://pi:15040?to=9", "tcp://pi:15040"),
        ("tcp://pi:15040?to=9&timeout=2", "tcp://pi:15040?timeout=2"),
        ("/dev/ttyUSB0?baud=9600&to=9", "/dev/ttyUSB0?baud=9600"),
        ("tcp://pi:15040?timeout=2", "tcp://pi:15040?timeout=2"),
    ],
)
def test_a_key_that_is_not_the_links_is_taken_out(text: str, rest: str) -> None:
    assert parse_url(text).without("to") == rest
