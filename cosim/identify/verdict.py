"""The words of every verdict on a model, and what the JSON of every result about one begins with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

EXPLAINED: Final = "explained"  # the model explains the data
NOT_EXPLAINED: Final = "not explained"  # the model does not explain the data
NOT_TOLD: Final = "not told"  # the data do not determine it


class Judgement(NamedTuple):
    """Verdict whether a model explains the data, and the evidence, one line each."""

    verdict: str
    evidence: tuple[str, ...]


def judge_model(is_explained: bool, *evidence: str) -> Judgement:
    """Return the judgement of a model that the data determine."""
    return Judgement(EXPLAINED if is_explained else NOT_EXPLAINED, evidence)


def shared_record(
    subject: str,
    channels: tuple[str, str],
    units: tuple[str, str],
    judgement: Judgement,
    refused: Sequence[str],
    notes: Sequence[str],
) -> dict[str, Any]:
    """Return the JSON keys common to all identifications, validations and replays, without ``estimates``.

    ``channels`` and ``units`` are those of command and output; ``refused``: why the model may not be used, a line a
    reason.
    """
    return {
        "subject": subject,
        "command": channels[0],
        "output": channels[1],
        "command_unit": units[0],
        "output_unit": units[1],
        "verdict": judgement.verdict,
        "evidence": list(judgement.evidence),
        "found": not refused,
        "refused": list(refused),
        "notes": list(notes),
    }
