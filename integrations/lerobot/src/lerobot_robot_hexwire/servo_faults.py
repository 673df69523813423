"""Faults that servos report, in words: which servo, what it says, and what to do.

Owns which faults of a session are new. The judgement is `hexwire doctor`'s. Must not know connections, nor what is
done about a fault.
"""

from __future__ import annotations

import logging
from collections import Counter
from typing import TYPE_CHECKING

from hexwire.drivers.checkup import judge_state
from hexwire.link.diagnose import Finding, Level
from hexwire.model.state import JointFlag

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hexwire.drivers.base import JointProbe
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState

__all__ = ["ServoFaults", "told"]

logger = logging.getLogger(__name__)

_FAULTS = int(JointFlag(0xFF).faults & ~JointFlag.SILENT)
_ON, _UNKNOWN = int(JointFlag.TORQUE_ON), int(JointFlag.TORQUE_UNKNOWN)
_LIMP = "has no torque any more"
_LIMP_ADVICE = "its supply may have failed for a moment, or another program switched it off; connect again"


def told(findings: Sequence[Finding], model: ArmModel) -> str:
    """Findings in a sentence, with the ids of servos."""
    ids = {joint.name: f"{joint.name} (servo {joint.servo_id})" for joint in model.joints}
    texts = []
    for one in findings:
        about = ", ".join(ids.get(name, name) for name in one.about.split(", "))
        texts.append(f"{about}: {one.text}" + (f"; {one.advice}" if one.advice else ""))
    return "; ".join(texts)


class ServoFaults:
    """The faults of a session: each is logged when it comes first, and counted whenever it comes.

    Args:
        model: The arm.
        probes: The limits of its servos.
        whose: What comes before a line in the log.

    Attributes:
        present: What is wrong now, in words; empty if nothing is.
        counts: How often each fault came, by joint and fault, as in ``gripper overload``, ``gripper torque off``.
        holds: Whether the joints have been given torque: then one without it is a fault.
    """

    def __init__(self, model: ArmModel, probes: Sequence[JointProbe], whose: str = "") -> None:
        self._model, self._probes, self._whose = model, probes, whose
        self._before = (0,) * len(model.joints)
        self.present = ""
        self.counts: Counter[str] = Counter()
        self.holds = False

    def judge(self, state: JointState) -> list[Finding]:
        """What is wrong with the arm, and what to do."""
        return judge_state(state, self._probes)

    def see(self, state: JointState) -> None:
        """Take note of the faults in a state; every cycle does."""
        # The bit of torque stands for a joint that should have it and has not.
        limp = _ON if self.holds else 0
        faults = tuple([flags & _FAULTS | (0 if flags & _UNKNOWN else ~flags & limp) for flags in state.flags])
        if faults == self._before:
            return
        came = [
            f"{name} {'torque off' if flag is JointFlag.TORQUE_ON else flag}"
            for name, now, before in zip(state.names, faults, self._before, strict=True)
            for flag in JointFlag(now & ~before)
        ]
        self._before = faults
        found = [one for one in self.judge(state) if one.level is Level.BAD]
        if names := ", ".join(name for name, now in zip(state.names, faults, strict=True) if now & _ON):
            found.append(Finding(Level.BAD, names, _LIMP, _LIMP_ADVICE))
        self.present = told(found, self._model)
        if any(fault not in self.counts for fault in came):
            logger.warning("%s%s", self._whose, self.present)
        self.counts.update(came)
