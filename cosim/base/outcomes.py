"""How a flight ends, and what that comes to: the words that scenarios, runs, surveys and their files share."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal

Outcome = Literal["completed", "crashed", "diverged", "failed"]


class Verdict(StrEnum):
    """Verdict on a flight; the value is the word in files and on pages."""

    # Verdicts on a run, by its limits and by what its scenario expects and requires.
    AS_PLANNED = "as planned"
    NOTHING_CHECKED = "completed, nothing checked"
    UNMET = "not as expected"
    BROKEN = "requirement broken"
    BEYOND_LIMITS = "beyond limits"
    NOT_COMPLETED = "not completed"
    # Results with a fault: held is level to a few degrees, airborne neither crashed nor diverged and no more.
    HELD = "held"
    AIRBORNE = "airborne"
    # Results of a flight with a failsafe: on the ground, in the air, or refused before the start.
    LANDED = "landed"
    SLID = "slid"
    STANDS_ARMED = "stands armed"
    HOLDS = "holds"
    FLIES_ON = "flies on"
    REFUSED = "refused"
    # Results that both kinds of flight share.
    CRASHED = "crashed"
    LOST = "lost"

    def __repr__(self) -> str:
        """Return the word in quotes, as errors about files show it."""
        return repr(self.value)


RunVerdict = Literal[
    Verdict.AS_PLANNED,
    Verdict.NOTHING_CHECKED,
    Verdict.UNMET,
    Verdict.BROKEN,
    Verdict.BEYOND_LIMITS,
    Verdict.NOT_COMPLETED,
]
