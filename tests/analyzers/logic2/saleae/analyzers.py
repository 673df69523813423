"""The part of Logic 2's own module that analysers import, as it is documented: it is on no registry."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass
class AnalyzerFrame:
    type: str
    start_time: float
    end_time: float
    data: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ChoicesSetting:
    choices: tuple[str, ...]
    label: str | None = None
    default: str | None = None


class HighLevelAnalyzer:
    """Logic 2 puts the chosen values in the place of the settings before it calls __init__."""

    def __new__(cls) -> HighLevelAnalyzer:
        made = super().__new__(cls)
        for name, setting in cls._settings().items():
            setattr(made, name, setting.default or setting.choices[0])
        return made

    @classmethod
    def _settings(cls) -> dict[str, ChoicesSetting]:
        named = {name: getattr(cls, name) for name in dir(cls)}
        return {name: value for name, value in named.items() if isinstance(value, ChoicesSetting)}

    @classmethod
    def chosen(cls, **values: str) -> HighLevelAnalyzer:
        """An analyser as the user has set it up."""
        made = cls.__new__(cls)
        for name, value in values.items():
            assert value in cls._settings()[name].choices
            setattr(made, name, value)
        made.__init__()  # type: ignore[misc]  # this is the order in which Logic 2 does it
        return made
