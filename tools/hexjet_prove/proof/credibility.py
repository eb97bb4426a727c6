"""What is on record for the factors of NASA-STD-7009B, as a form whose levels a person fills in.

The factors are those of the standard's two assessments (Standard for Models and Simulations, NASA-STD-7009B, 2024,
Appendix E), the words are ours.  No level is given here: what the evidence is worth, a person has to judge.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from cosim.base.errors import InputError
from cosim.base.storage.files import read_json
from cosim.base.storage.toml import read_toml

RECORD = Path(__file__).with_name("evidence.toml")  # file of the evidence
# An uncertainty whose source begins with this word was chosen, not measured.
CHOSEN = "chosen"
VALIDATION = "Validation"  # group of factors
CAPABILITY, RESULTS = "capability", "results"  # the standard's two assessments


class Factor(NamedTuple):
    """One factor of credibility: the record, and a person's statement."""

    assessment: str
    name: str
    evidence: str
    level: None = None  # 0 to 4, filled in by a person
    reason: str = ""
    judged_by: str = ""


@dataclass(frozen=True)
class Evidence:
    """Evidence on a proof's model and method, besides the flights' results."""

    aircraft: str
    engine: str
    is_shipped: bool  # aircraft and engine are shipped ones
    version: str  # version of the package that flew
    own_code: Sequence[str]  # files of the user that flew
    uncertainty_source: str | None  # None: no table; empty: no source stated
    is_engine_drawn: bool
    varied: int  # number of drawn keys
    not_varied: Sequence[str]  # kinds of numbers that no key varied
    ranked: int  # drawn keys whose effect was estimated
    searched: bool  # True: the worst case was searched for
    warnings: Sequence[str]  # use outside the design, or no proof
    replayed: int  # flights of the proof that were repeated
    replayed_same: int
    comparisons: Sequence[Mapping[str, Any]] = ()  # contents of replay.json files


def read_comparison(path: Path) -> dict[str, Any]:
    """Read the replay.json of ``hexjet replay``, or of its folder.

    Raises InputError where the hash of its log is missing, too, as in those of version 0.2.0.
    """
    file = path / "replay.json" if path.is_dir() else path
    try:
        data = read_json(file)
        keys = ("log", "log_sha256", "simulated", "aircraft", "engine", "verdict", "seconds")
        return {key: data[key] for key in keys}
    except KeyError as error:
        raise InputError(f"{file}: lacks {error}; hexjet replay of this version writes it") from error
    except (ValueError, TypeError) as error:
        raise InputError(f"{file}: is no replay.json of hexjet replay") from error


def list_evidence(evidence: Evidence) -> list[Factor]:
    """Return the evidence on each factor of credibility, in the standard's order."""
    record = read_toml(RECORD)
    return [Factor(assessment, name, describe(evidence, record)) for assessment, name, describe in _FACTORS]


def _describe_data_pedigree(evidence: Evidence, record: Mapping[str, Any]) -> str:
    where = f"the numbers of {evidence.aircraft} and {evidence.engine}"
    if not evidence.is_shipped:
        return f"{where} are of files outside the package, and nothing says where they are from"
    if not _is_measured(evidence):
        return f"{where} stand in their README.md, each with its parent; many are published or chosen"
    return f"{where} stand in their README.md; the engine's are identified: {evidence.uncertainty_source}"


def _describe_verification(evidence: Evidence, record: Mapping[str, Any]) -> str:
    made = record["verification"]
    stated = (
        f"{made['inside']} of {made['compared']} quantities of NASA's check cases are within what its own simulators "
        "span (docs/accuracy.md), and the blocks have tests against closed forms and other codes, of version "
        f"{made['version']}; {evidence.version or 'another'} flew"
    )
    if evidence.own_code:
        files = ", ".join(evidence.own_code[:3]) + (", ..." if len(evidence.own_code) > 3 else "")
        stated += f"; code of the user's flew that none of them sees: {files}"
    return stated


def _describe_validation(evidence: Evidence, record: Mapping[str, Any]) -> str:
    texts = [_describe_comparison(one, evidence) for one in evidence.comparisons]
    known = [
        one
        for one in record["comparison"]
        if evidence.is_shipped and (one.get("aircraft") == evidence.aircraft or one.get("engine") == evidence.engine)
    ]
    texts += [f"compared with {one['with']}: {one['says']} ({one['page']})" for one in known]
    return "; ".join(texts) or "compared with no measurement of the real vehicle"


def _describe_comparison(one: Mapping[str, Any], evidence: Evidence) -> str:
    """Describe a replay.json: its result, its log, and whether the log is a flight of this vehicle."""
    of = [("aircraft", evidence.aircraft), ("engine", evidence.engine)]
    others = [f"another {kind}" for kind, flown in of if one[kind] != flown]
    what = f"{Path(one['log']).name} (sha256 {one['log_sha256'][:16]}, {one['aircraft']} with {one['engine']})"
    said = f"{one['seconds']:.3g} s of {what}: {one['verdict']}"
    if one["simulated"]:
        said += "; a run of this program, no recorded flight"
    return f"{said}; of {' and '.join(others)} than flew here" if others else said


def _describe_development(evidence: Evidence, record: Mapping[str, Any]) -> str:
    if evidence.is_shipped:
        return (
            "model files of the package, kept under versions; its rules are written down (CONTRIBUTING.md) and every "
            "change passes its tests"
        )
    return "model files outside the package, known by their hashes alone"


def _describe_earlier_use(evidence: Evidence, record: Mapping[str, Any]) -> str:
    return "; ".join([*evidence.warnings, "no earlier use is on record"])


def _describe_input_pedigree(evidence: Evidence, record: Mapping[str, Any]) -> str:
    if not evidence.varied:
        return "nothing was varied"
    source = evidence.uncertainty_source
    if evidence.is_engine_drawn and source:
        measured = "with a source" if _is_measured(evidence) else "that was not measured"
        return f"the engine is drawn by an uncertainty {measured}: {source}; other ranges are those the study states"
    return "the ranges are those that the study states; no measurement of them is on record"


def _describe_uncertainty(evidence: Evidence, record: Mapping[str, Any]) -> str:
    if not evidence.varied:
        return "nothing was varied"
    text = f"{evidence.varied} numbers, noise and turbulence are drawn and flown through the whole model"
    if evidence.uncertainty_source is not None and not evidence.is_engine_drawn:
        text += "; the engine states an uncertainty that was not drawn"
    return text + (f"; nothing of {join_names(evidence.not_varied)}" if evidence.not_varied else "")


def _describe_robustness(evidence: Evidence, record: Mapping[str, Any]) -> str:
    text = "no sensitivity is known"
    if evidence.ranked:
        text = f"the effect of {evidence.ranked} of {evidence.varied} drawn numbers is known, one at a time"
    return text + ("; a search for the worst case over all keys together" if evidence.searched else "")


def _describe_use(evidence: Evidence, record: Mapping[str, Any]) -> str:
    kept = "every flight has the hashes of its log and of what it was made from"
    if not evidence.replayed:
        return f"{kept}; none was flown again"
    flown = f"{evidence.replayed_same} of {evidence.replayed}"
    return f"{kept}; {flown} flights came out the same when they were flown again"


def _make_review_gap(of: str) -> Callable[[Evidence, Mapping[str, Any]], str]:
    return lambda evidence, record: f"no review of {of} by others is on record"


_FACTORS: tuple[tuple[str, str, Callable[[Evidence, Mapping[str, Any]], str]], ...] = (  # group, factor, function
    (CAPABILITY, "Data pedigree", _describe_data_pedigree),
    (CAPABILITY, "Verification", _describe_verification),
    (CAPABILITY, VALIDATION, _describe_validation),
    (CAPABILITY, "Development technical review", _make_review_gap("the model")),
    (CAPABILITY, "Development process and product management", _describe_development),
    (RESULTS, "Use assessment", _describe_earlier_use),
    (RESULTS, "Input pedigree", _describe_input_pedigree),
    (RESULTS, "Uncertainty characterization", _describe_uncertainty),
    (RESULTS, "Results robustness", _describe_robustness),
    (RESULTS, "Use and analysis technical review", _make_review_gap("this proof")),
    (RESULTS, "Use process and product management", _describe_use),
)


def _is_measured(evidence: Evidence) -> bool:
    source = evidence.uncertainty_source
    return bool(source) and not str(source).startswith(CHOSEN)


def join_names(names: Sequence[str]) -> str:
    """Join names by commas and a word."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else "nothing"
