"""Every error text of the source has a cause and a cure; docs/site/error_texts.py, error_pages.py, errors/."""

from __future__ import annotations

import gc
from pathlib import Path

from tests.site.pages import error_pages, error_texts

SOURCE = """
import click
from hexwire.errors import ConfigError, LeaseError, UsageError

_WHY = "the arm is away"


class OwnError(UsageError):
    pass


def one(name, several, text):
    raise UsageError(f"no joint {name!r}{'s' if several else ''}; there are {', '.join(sorted(several))}")


def two(way):
    text = "this way is closed" if way else f"that way ({way}) is closed"
    raise OwnError(text) from None


def three(error):
    raise ConfigError(_WHY, file="x")


def _refuse(why, *, more=""):
    raise UsageError(f"{why}: {more}")


def four():
    _refuse("parameter one", more=_words(4))


def _words(n):
    return f"only {n} words" if n else ""


def five(error):
    raise UsageError(str(error)) from error


def six():
    raise LeaseError("somebody else has it")


def seven():
    raise click.UsageError("give it a name", None)


def eight():
    raise KeyError("not for people")
"""


def texts(tmp_path: Path, source: str) -> set[str]:
    (tmp_path / "room.py").write_text(source)
    return set(error_texts.error_texts(tmp_path))


def test_texts_are_found_where_their_words_are(tmp_path: Path) -> None:
    (tmp_path / "errors.py").write_text(
        "class HexwireError(Exception): ...\nclass UsageError(HexwireError): ...\n"
        "class ConfigError(UsageError): ...\nclass LeaseError(HexwireError): ...\n"
    )
    assert texts(tmp_path, SOURCE) == {
        "no joint {name}{s|}; there are {several}",
        "this way is closed",
        "that way ({way}) is closed",
        "the arm is away",
        "parameter one",
        "only {n} words",
        "not done: somebody else has it",
        "give it a name",
    }
    (passing,) = error_texts.silent(tmp_path)
    assert passing.startswith("room.py:")
    assert "UsageError(str(error))" in passing


def test_the_index_is_complete() -> None:
    # The trees of all files are a million objects, none of them garbage: half of the time is spent looking for it.
    gc.disable()
    try:
        said = error_texts.error_texts(*error_pages.SOURCES)
    finally:
        gc.enable()
    assert len(said) > 1000
    wrong = error_pages.differences(said, error_pages.subjects())
    assert not wrong, (
        "each text needs an entry in docs/site/errors/, with its cause and cure "
        "(python docs/site/error_pages.py lists what is missing):\n" + "\n".join(wrong)
    )


def test_a_missing_an_old_and_a_double_text_are_told() -> None:
    said = {text: error_texts.ErrorText(text, {"UsageError"}, {"room.py"}) for text in ("a text", "new text")}
    entry = error_pages.Entry("Title", "Why.", "Do this.", ("a text", "a text", "old text"))
    assert error_pages.differences(said, [error_pages.Subject("x", "X", "Intro.", (entry,))]) == [
        "no entry: 'new text' (room.py)",
        "not in the source any more: 'old text'",
        "listed twice: 'a text'",
    ]


def test_what_only_passes_on_is_known() -> None:
    """An exception whose words were not found says what another one said, or is new: then find its words."""
    passing = error_texts.silent(*error_pages.SOURCES)
    words = ("error", "text", "why", "taken", "conflict", "found", "blocked", "words", "reason")
    assert [one for one in passing if not any(word in one.partition("(")[2] for word in words)] == []
    assert len(passing) < 40


def test_entries_are_written() -> None:
    for subject in error_pages.subjects():
        assert subject.intro.endswith(".")
        titles = [entry.title for entry in subject.entries]
        assert len(titles) == len(set(titles))
        for entry in subject.entries:
            assert entry.cause.endswith(".")
            assert entry.cure.endswith(".")
            assert entry.texts == tuple(sorted(entry.texts)), f"{subject.name}, {entry.title}: sort its texts"


def test_a_page_shows_texts_as_they_are(tmp_path: Path) -> None:
    entry = error_pages.Entry("Title", "Why.", "Do this.", ("run `x` <now>",))
    text = error_pages._page(error_pages.Subject("x", "X", "Intro.", (entry,)), {})
    assert "- `` run `x` <now> ``" in text
