"""hexjet margins: how much gain, phase and delay a controller's loops have left, measured in flight."""

from __future__ import annotations

from cosim.commands import Command, one_thread

margins = Command(
    "margins",
    "hexjet_design.measured.api:margins",
    "--controller mine.py:Mine --axis roll",
    options={"axes": "--axis", "from_hz": "--from-hz", "to_hz": "--to-hz"},
    metavars={"engine": "[N=]NAME|FILE", "amplitude": "A"},
    folder=lambda arguments: "margins",
    before=lambda arguments: one_thread(),
    succeeded=lambda result: result.kept is not False,
    notes="warning",
    ends="Status 0: measured, whatever the margins; 1: a margin is worse than --at-least asks for, or the vehicle does "
    "not stay in the air.",
)
