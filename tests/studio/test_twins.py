"""Which emulated arm can play a recording."""

from __future__ import annotations

from hexwire.studio.twins import twin_for


def test_a_twin_is_found_by_name_or_by_joints() -> None:
    assert twin_for("so101", ()) == "so101"
    assert twin_for("", ("J1", "J7")) == "hex7bot"
    assert twin_for("mine", ("shoulder_pan", "gripper")) == "so101"
    assert twin_for("", ()) == twin_for("", ("K9",)) == ""
