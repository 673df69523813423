"""Rights: what stands in a certificate, and what Zenoh's access control then lets through."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import pytest
import zenoh
from tests.waits import eventually

from hexwire.errors import UsageError
from hexwire.fleet.names import ClientRole, Keys
from hexwire.fleet.node import NoAnswerError, Node
from hexwire.fleet.rights import Kind, Rights, access_control

from .lab import Lab

# -- what stands in a certificate -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "rights",
    [
        Rights(Kind.OBSERVER, ("**",)),
        Rights(Kind.OPERATOR, ("lab/*", "hall/arm1")),
        Rights(Kind.ARM, ("lab/arm1",)),
        Rights(Kind.ROUTER),
    ],
)
def test_rights_are_read_as_they_were_written(rights: Rights) -> None:
    others = ("https://example.org/x", "urn:hexwire:operator:x")
    assert Rights.from_uris((*others, *rights.uris())) == rights
    assert Rights.from_uris(others) is None


@pytest.mark.parametrize(
    "uris",
    [
        ("hexwire:operator:lab/*", "hexwire:maintainer:lab/*"),
        ("hexwire:king:lab/*",),
        ("hexwire:operator",),
        ("hexwire:operator:",),
        ("hexwire:operator:lab/$*",),
        ("hexwire:operator:lab/arm*",),
        ("hexwire:operator:@here",),
        ("hexwire:router:lab/*",),
        ("hexwire:",),
    ],
)
def test_rights_that_are_not_clear_are_none(uris: tuple[str, ...]) -> None:
    with pytest.raises(UsageError):
        Rights.from_uris(uris)


@pytest.mark.parametrize(
    ("pattern", "covered", "not_covered"),
    [
        ("lab/*", ["lab/arm1"], ["lab", "lab/a/b", "hall/arm1", "labs/arm1"]),
        ("**", ["a", "a/b/c/d"], []),
        ("lab/**", ["lab", "lab/a", "lab/a/b"], ["hall/a"]),
        ("**/left", ["left", "lab/left", "a/b/left"], ["left/a", "lab/right"]),
        ("*/a/*", ["x/a/y"], ["a/y", "x/a", "x/b/y"]),
    ],
)
def test_a_pattern_covers_what_zenoh_means_by_it(pattern: str, covered: list[str], not_covered: list[str]) -> None:
    rights = Rights(Kind.OBSERVER, (pattern,))
    for names, expected in ((covered, True), (not_covered, False)):
        for name in names:
            assert rights.covers(name) is expected
            assert zenoh.KeyExpr(pattern).includes(zenoh.KeyExpr(name)) is expected


# -- the rules --------------------------------------------------------------------------------------------


def test_one_common_name_has_one_certificate() -> None:
    for names in (("a", "a"), ("",), (" ",)):
        with pytest.raises(UsageError, match="is empty or not unique"):
            access_control([(name, Rights(Kind.OBSERVER, ("**",))) for name in names])


def test_whoever_is_not_named_gets_nothing() -> None:
    access = access_control([("anna 1", Rights(Kind.OPERATOR, ("lab/*",)))])
    assert (access["enabled"], access["default_permission"]) == (True, "deny")
    assert all(rule["permission"] == "allow" for rule in access["rules"])
    everybody = [row for row in access["subjects"] if "cert_common_names" not in row]
    assert [row["link_protocols"] for row in everybody] == [["unixsock-stream"]]
    used = [name for policy in access["policies"] for name in policy["rules"]]
    assert sorted(used) == sorted(rule["id"] for rule in access["rules"])


def test_equal_rights_share_their_rules_so_that_a_large_lab_stays_small() -> None:
    many = [(f"viewer {number}", Rights(Kind.OBSERVER, ("lab/*",))) for number in range(1000)]
    assert len(access_control(many)["rules"]) == len(access_control(many[:1])["rules"])


def test_ros_domains_are_numbers_and_no_arms() -> None:
    assert Rights.from_uris(Rights(Kind.ROS, ("0", "42")).uris()) == Rights(Kind.ROS, ("0", "42"))
    assert not Rights(Kind.ROS, ("0",)).covers("0")
    for arms in ((), ("lab/*",), ("**",), ("00",), ("-1",)):
        with pytest.raises(UsageError, match="numbers, as in --for 0"):
            Rights(Kind.ROS, arms)


# -- what gets through a router ---------------------------------------------------------------------------


class Arm:
    """Whoever acts for an arm, and what reaches it."""

    def __init__(self, node: Node, name: str) -> None:
        self.keys, self.asked, self.node = Keys(name), [""], node
        self.asked.clear()
        for key in self.keys.answered():
            node.answer(key, lambda question, key=key: (self.asked.append(key), question.reply(b"done")))  # type: ignore[misc]
        self.published: list[bytes] = []
        for key in self.keys.streamed(max(ClientRole)):
            node.take_at_once(key, self.published.append)
        node.announce(self.keys.token("1"))
        self.put = node.publisher(self.keys.state)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    lab = Lab(tmp_path_factory.mktemp("lab"))
    for name, kind, arms in (
        ("arm1", Kind.ARM, ("lab/arm1",)),
        ("arm2", Kind.ARM, ("lab/arm2",)),
        ("hall", Kind.ARM, ("hall/arm1",)),
        ("watcher", Kind.OBSERVER, ("lab/*",)),
        ("anna", Kind.OPERATOR, ("lab/*",)),
        ("ben", Kind.OPERATOR, ("hall/*", "lab/arm2")),
        ("cora", Kind.MAINTAINER, ("**",)),
    ):
        lab.issue(name, kind, *arms)
    lab.issue("stranger", Kind.MAINTAINER, "**", known=False)
    with lab.routing():
        yield lab


@pytest.fixture(scope="module")
def arms(lab: Lab) -> Iterator[dict[str, Arm]]:
    with (
        lab.session("arm1") as one,
        lab.session("arm2") as two,
        lab.session("hall") as hall,
        lab.session("cora") as node,
    ):
        arms = {
            "lab/arm1": Arm(one, "lab/arm1"),
            "lab/arm2": Arm(two, "lab/arm2"),
            "hall/arm1": Arm(hall, "hall/arm1"),
        }
        # What they offer has reached the router: each token comes after it.
        eventually(lambda: all(node.visible(arm.keys.token("1"), 5.0) for arm in arms.values()))
        yield arms


def answers(node: Node, key: str) -> bool:
    """Whether somebody answers; what is denied is denied at once, not by silence."""
    try:
        node.ask(key, b"", 5.0)
    except NoAnswerError as none:
        if not none.absent:
            raise
        return False
    return True


def allowed(node: Node, name: str) -> list[str]:
    keys = Keys(name)
    return [key.removeprefix(f"{keys.base}/") for key in keys.answered() if answers(node, key)]


READ = ["ask", "stop"]
OPERATE = [*READ, "as/operator/lease", "as/operator/order", "as/operator/off"]
MAINTAIN = [*OPERATE, "as/maintainer/lease", "as/maintainer/order", "as/maintainer/off"]


@pytest.mark.parametrize(
    ("name", "arm1", "arm2", "hall"),
    [
        ("watcher", READ, READ, []),
        ("anna", OPERATE, OPERATE, []),
        ("ben", [], OPERATE, OPERATE),
        ("cora", MAINTAIN, MAINTAIN, MAINTAIN),
        # Arms see a router's certificate, not that of whose order it relays (docs/fleet-certificates.md).
        ("router", MAINTAIN, MAINTAIN, MAINTAIN),
        ("stranger", [], [], []),
        # Those that serve do not command: neither another arm nor their own.
        ("arm2", [], [], []),
        ("hall", [], [], []),
    ],
)
def test_a_role_gets_through_what_it_allows(
    lab: Lab, arms: dict[str, Arm], name: str, arm1: list[str], arm2: list[str], hall: list[str]
) -> None:
    with lab.session(name) as node:
        for arm, expected in (("lab/arm1", arm1), ("lab/arm2", arm2), ("hall/arm1", hall)):
            arms[arm].asked.clear()
            assert allowed(node, arm) == expected
            assert len(arms[arm].asked) == len(expected)


@pytest.mark.parametrize(
    ("name", "visible"),
    [
        ("watcher", ["lab/arm1", "lab/arm2"]),
        ("ben", ["hall/arm1", "lab/arm2"]),
        ("stranger", []),
        ("arm1", ["lab/arm1"]),
    ],
)
def test_states_and_liveliness_reach_those_who_may_read_only(
    lab: Lab, arms: dict[str, Arm], name: str, visible: list[str]
) -> None:
    heard: set[str] = set()
    with lab.session(name) as node, lab.session("cora") as other:
        both: set[str] = set()
        for pattern in ("**", "*/*", "lab/*", "lab/arm1", "lab/arm2", "hall/arm1"):
            node.subscribe(Keys(pattern).state, lambda payload, key: heard.add(key))
        other.subscribe(Keys("**").state, lambda payload, key: both.add(key))

        # Seen by another program: then it has also reached this one, if it does at all.
        def all_arrived() -> bool:
            for arm in arms.values():
                arm.put(b"state")
            return len(both) == len(arms)

        eventually(all_arrived)
        for arm in arms.values():
            arm.put(b"state")
        answers(node, Keys("lab/arm1").ask)
        expected = [] if name == "arm1" else visible
        eventually(lambda: heard >= {Keys(each).state for each in expected})
        assert heard == {Keys(each).state for each in expected}
        found = {key for each in arms for key in node.visible(Keys(each).alive, 5.0)}
        assert found == {Keys(each).token("1") for each in visible}


@pytest.mark.parametrize("pattern", ["**", "*/*", "lab/*", "*/arm1"])
def test_a_pattern_reaches_no_arm_that_is_not_of_the_certificate(
    lab: Lab, arms: dict[str, Arm], pattern: str
) -> None:
    with lab.session("anna") as node:
        arms["hall/arm1"].asked.clear()
        for key in (Keys(pattern).stop, Keys(pattern).order(ClientRole.OPERATOR), f"hexwire/{pattern}/as/*/order"):
            expected = pattern == "lab/*" and "as/*" not in key
            assert answers(node, key) is expected
        assert arms["hall/arm1"].asked == []


def test_the_certificate_of_one_arm_cannot_act_for_another(lab: Lab, arms: dict[str, Arm]) -> None:
    with lab.session("hall") as impostor, lab.session("cora") as node:
        fake = Arm(impostor, "lab/arm1")
        below = Arm(impostor, "hall/arm1/hand")
        heard: list[bytes] = []
        node.subscribe(Keys("**").state, lambda payload, key: heard.append(payload))
        for other in ("lab/arm1", "lab/arm2", "hall/arm1"):
            impostor.publisher(Keys(other).order(ClientRole.OPERATOR))(b"fake")

        def real_arrives() -> bool:
            fake.put(b"fake")
            below.put(b"fake")
            arms["lab/arm1"].put(b"real")
            return b"real" in heard

        eventually(real_arrives)
        assert b"fake" not in heard
        assert allowed(node, "lab/arm1") == MAINTAIN
        assert allowed(node, "hall/arm1/hand") == []
        assert fake.asked == below.asked == []
        assert len(node.visible(Keys("lab/arm1").alive, 5.0)) == 1
        assert node.visible(Keys("hall/arm1/hand").alive, 5.0) == []


def test_nobody_else_publishes_states(lab: Lab, arms: dict[str, Arm]) -> None:
    with lab.session("cora") as node, lab.session("anna") as other:
        heard: list[bytes] = []
        node.subscribe(Keys("lab/arm1").state, lambda payload, key: heard.append(payload))
        fake = other.publisher(Keys("lab/arm1").state)

        def real_arrives() -> bool:
            fake(b"fake")
            arms["lab/arm1"].put(b"real")
            return b"real" in heard

        eventually(real_arrives)
        assert b"fake" not in heard


def test_set_points_reach_the_arm_from_those_who_may_command_it_and_nobody_else(
    lab: Lab, arms: dict[str, Arm]
) -> None:
    heard: list[bytes] = []
    names = ("anna", "ben", "watcher", "hall", "stranger")
    with ExitStack() as stack:
        nodes = {name: stack.enter_context(lab.session(name)) for name in names}
        others = [stack.enter_context(lab.session(name)) for name in ("anna", "cora", "hall")]
        for other in others:
            other.take_at_once(Keys("lab/*").order(ClientRole.OPERATOR), heard.append)
        to = {
            (name, arm): node.publisher_in_order(Keys(arm).order(ClientRole.OPERATOR))
            for name, node in nodes.items()
            for arm in arms
        }
        own = [("anna", "lab/arm1"), ("anna", "lab/arm2"), ("ben", "lab/arm2"), ("ben", "hall/arm1")]
        # Known to who publishes, too: with an access file of before, set-points are asked.
        eventually(lambda: all(to[each].is_wanted for each in own))
        for arm in arms.values():
            arm.published.clear()
        for (name, arm), publish in to.items():
            assert name == "hall" or publish.is_wanted == ((name, arm) in own), (name, arm)
            publish(name.encode())
        for arm in arms:
            expected = {name.encode() for name, other in own if other == arm}
            eventually(lambda arm=arm, expected=expected: set(arms[arm].published) >= expected)  # type: ignore[misc]
            # A question of each comes after what it published.
            for node in nodes.values():
                answers(node, Keys(arm).stop)
            assert set(arms[arm].published) == expected
        assert heard == []
