from __future__ import annotations

import pytest

from zenoh_ros2.errors import UsageError
from zenoh_ros2.names import Kind, Remap, expand, logger_name, parse_remap, remap_node, resolve


@pytest.mark.parametrize(
    ("name", "namespace", "full"),
    [
        ("chatter", "/", "/chatter"),
        ("chatter", "/arm", "/arm/chatter"),
        ("/chatter", "/arm", "/chatter"),
        ("~", "/", "/driver"),
        ("~/state", "/", "/driver/state"),
        ("~/state", "/arm", "/arm/driver/state"),
        ("{node}/x", "/arm", "/arm/driver/x"),
        ("{ns}/x", "/arm", "/arm/x"),
        ("{namespace}/{node}", "/arm", "/arm/driver"),
        ("/a/{node}_x", "/arm", "/a/driver_x"),
    ],
)
def test_names_are_expanded(name: str, namespace: str, full: str) -> None:
    assert expand(name, namespace, "driver") == full


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("", "must not be empty"),
        ("chatter/", "must not end with a forward slash"),
        ("/", "must not end with a forward slash"),
        ("7foo", "must not start with a number"),
        ("foo/7bar", "must not start with a number"),
        ("foo bar", "must not contain characters other than"),
        ("föö", "must not contain characters other than"),
        ("foo/~bar", "must not have tilde '~' unless it is the first"),
        ("~foo", "tilde '~' that is not followed by a forward slash"),
        ("foo/{node", "unmatched"),
        ("foo/node}", "unmatched"),
        ("foo/{no/de}", "substitution name must not contain"),
        ("foo/{4bar}", "substitution name must not start with a number"),
        ("foo/{{node}}", "substitution name must not contain"),
        ("{other}", "unknown substitution: {other}"),
    ],
)
def test_invalid_names_are_refused_with_the_words_of_rcl(name: str, words: str) -> None:
    with pytest.raises(UsageError, match=words.replace("{", r"\{")):
        expand(name, "/", "driver")


def test_what_expansion_makes_is_checked_too() -> None:
    with pytest.raises(UsageError, match="must not contain repeated '/'"):
        resolve("a//b", "/", "driver", Kind.TOPIC)
    with pytest.raises(UsageError, match="should not exceed '247'"):
        resolve("a" * 247, "/", "driver", Kind.TOPIC)


def rules(*texts: str) -> tuple[Remap, ...]:
    return tuple(map(parse_remap, texts))


@pytest.mark.parametrize(
    ("texts", "full"),
    [
        (["chatter:=other"], "/arm/other"),
        (["/arm/chatter:=/other"], "/other"),
        (["/chatter:=/other"], "/arm/chatter"),
        (["chatter:=~/state"], "/arm/driver/state"),
        (["driver:chatter:=other"], "/arm/other"),
        (["listener:chatter:=other"], "/arm/chatter"),
        (["rostopic://chatter:=other"], "/arm/other"),
        (["rosservice://chatter:=other"], "/arm/chatter"),
        (["driver:rostopic://chatter:=other"], "/arm/other"),
        (["chatter:=first", "chatter:=second"], "/arm/first"),
        (["chatter:=other", "other:=third"], "/arm/other"),
    ],
)
def test_the_first_rule_that_applies_counts(texts: list[str], full: str) -> None:
    assert resolve("chatter", "/arm", "driver", Kind.TOPIC, rules(*texts)) == full


@pytest.mark.parametrize(
    ("texts", "found"),
    [
        ([], ("/arm", "driver")),
        (["__node:=left"], ("/arm", "left")),
        (["__name:=left"], ("/arm", "left")),
        (["__ns:=/lab"], ("/lab", "driver")),
        (["__ns:=/"], ("/", "driver")),
        (["driver:__node:=left", "left:__ns:=/lab"], ("/lab", "left")),
        (["other:__node:=left"], ("/arm", "driver")),
    ],
)
def test_node_name_and_namespace_are_remapped(texts: list[str], found: tuple[str, str]) -> None:
    assert remap_node("/arm", "driver", rules(*texts)) == found


@pytest.mark.parametrize(
    "text", ["", "a", ":=b", "a:=", "a:b", "a b:=c", "a:=b c", "__node:=a/b", "__ns:=lab", "__ns:=/lab/"]
)
def test_what_is_no_rule_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        parse_remap(text)


@pytest.mark.parametrize(
    ("name", "words"),
    [("", "empty"), ("a/b", "alphanumerics or '_'"), ("1a", "start with a number"), ("a" * 256, "255")],
)
def test_invalid_node_names_are_refused(name: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        remap_node("/", name, ())


def test_a_namespace_without_its_slash_gets_one() -> None:
    assert remap_node("arm", "driver", ()) == ("/arm", "driver")
    assert remap_node("", "driver", ()) == ("/", "driver")


@pytest.mark.parametrize(("full", "name"), [("/driver", "driver"), ("/lab/left/driver", "lab.left.driver")])
def test_a_logger_has_the_whole_name_of_its_node_with_dots(full: str, name: str) -> None:
    assert logger_name(full) == name
