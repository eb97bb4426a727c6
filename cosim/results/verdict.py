"""The verdict of a flight: what its outcome, its limits and its scenario's expectations come to, in words.

A flight that completed within its limits is ``as planned`` only if something was expected of it and came true.  Where
nothing was expected, because no ``[[expect]]`` of the scenario applies and it has no ``[[require]]``, it is
``completed, nothing checked``: its default limits held, and nobody said what the flight was to come to.
"""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.outcomes import Outcome, RunVerdict, Verdict

# CSS class of each verdict's badge.
BADGES: dict[RunVerdict, str] = {
    Verdict.AS_PLANNED: "met",
    Verdict.NOTHING_CHECKED: "none",
    Verdict.UNMET: "unmet",
    Verdict.BROKEN: "unmet",
    Verdict.BEYOND_LIMITS: "unmet",
}


def judge(
    outcome: Outcome, beyond: Sequence[str], expectations_met: bool | None, requirements_kept: bool | None = None
) -> RunVerdict:
    """Return the verdict of a flight; None: nothing was expected, or required."""
    if outcome != "completed":
        return Verdict.NOT_COMPLETED
    if beyond:
        return Verdict.BEYOND_LIMITS
    if expectations_met is False:
        return Verdict.UNMET
    if requirements_kept is False:
        return Verdict.BROKEN
    return Verdict.NOTHING_CHECKED if expectations_met is requirements_kept is None else Verdict.AS_PLANNED


def describe_end(outcome: Outcome, reason: str, verdict: RunVerdict | None) -> str:
    """Return how a flight ended and what that is worth, such as ``completed, flew 3000 steps; as planned``."""
    if verdict == Verdict.NOTHING_CHECKED:
        return f"{verdict}; {reason}"
    text = f"{outcome}, {reason}"
    return text if verdict in (None, Verdict.NOT_COMPLETED) else f"{text}; {verdict}"
