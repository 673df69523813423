"""What a shared arm can do, as its server reports it.

Owns what the server adds to its robot, such as a watchdog, and what it cannot do, such as examine the port. Must
not know how the server is asked.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.drivers.base import RobotDriver

if TYPE_CHECKING:
    from hexwire.link.diagnose import Finding

    from .messages import Facts

__all__ = ["Described"]


class Described(RobotDriver):
    """The part of `RemoteRobot` that depends only on what its server reports about the arm."""

    _facts: Facts

    @property
    def command_rate(self) -> float:
        return self._facts.command_rate

    @property
    def has_watchdog(self) -> bool:
        return True

    @property
    def has_own_watchdog(self) -> bool:
        return self._facts.watchdog

    @property
    def reports_states(self) -> bool:
        return True

    @property
    def stop_kept_by(self) -> str:
        return "board" if self._facts.kept == "board" else "server"

    def examine(self) -> list[Finding]:
        from hexwire.link.diagnose import Finding, Level

        # Its line is busy with the arm, which may be moving.
        text = f"{self._facts.port} at {self._facts.host or 'its server'} is not examined through the server"
        advice = "if in doubt, end the server and run 'hexwire doctor' there"
        return [*super().examine(), Finding(Level.UNKNOWN, "port", text, advice)]
