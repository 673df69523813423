"""Suites that check a link or a robot of your own against its contract; pytest runs them.

Owns the suites that hexwire's own links and robots pass, too. Must not know any particular link or robot. Needs
pytest: ``pip install 'hexwire[testing]'``. See docs/adding-a-robot.md.
"""

from __future__ import annotations

try:
    import pytest
except ImportError as error:
    raise ImportError("hexwire.testing needs pytest: pip install 'hexwire[testing]'") from error

# Failed comparisons are then explained as in any test file; only before a module is first imported.
pytest.register_assert_rewrite("hexwire.testing.link", "hexwire.testing.robot")

from .link import LinkConformance  # noqa: E402
from .robot import RobotConformance  # noqa: E402

__all__ = ["LinkConformance", "RobotConformance"]
