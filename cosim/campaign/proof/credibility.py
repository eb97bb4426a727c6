"""The credibility table of a proof: the factors of NASA-STD-7009B, each with a level from 0 to 4 by what exists.

The factors are those of the standard's two assessments (Standard for Models and Simulations, NASA-STD-7009B, 2024,
Appendix E), the words are ours.  0 says that there is not enough evidence, which is a result like another.  No level
above 3 is given and few above 2: what those ask for, a person has to judge.  There is no overall level: the factors do
not add up, and the standard warns of adding them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from cosim.base.errors import InputError
from cosim.base.storage.files import read_text
from cosim.base.storage.toml import read_toml

RECORD = Path(__file__).with_name("evidence.toml")
CHOSEN = "chosen"  # with which an engine's source begins that was not measured
CAPABILITY, RESULTS = "capability", "results"  # the standard's two assessments


class Factor(NamedTuple):
    """One factor: its level, what the level rests on, and what would raise it."""

    assessment: str
    name: str
    level: int
    evidence: str
    raised_by: str


@dataclass(frozen=True)
class Evidence:
    """What a proof knows of its model and of itself, beside the flights' outcomes."""

    aircraft: str
    engine: str
    is_shipped: bool  # aircraft and engine are those of the package
    version: str  # of the package that flew
    own_code: Sequence[str]  # files of the user's that flew: controllers, engines, blocks
    uncertainty_source: str | None  # of the engine's table; "" where it states none, None where there is no table
    is_engine_drawn: bool
    varied: int  # keys that were drawn
    not_varied: Sequence[str]  # kinds of numbers of which none was
    ranked: int  # of the drawn keys, those whose effect on a result could be told from chance or not
    searched: bool  # for the worst case, over all keys together
    warnings: Sequence[str]  # of the use: a model that is far from its vehicle, a design without its proof
    replayed: int  # flights of the proof flown again
    replayed_same: int
    comparisons: Sequence[Mapping[str, Any]] = ()  # replay.json of recorded flights


def read_comparison(path: Path) -> dict[str, Any]:
    """Return what ``hexjet replay`` left in a replay.json, or in its folder.  Raises InputError."""
    file = path / "replay.json" if path.is_dir() else path
    try:
        data = json.loads(read_text(file))
        return {key: data[key] for key in ("log", "aircraft", "engine", "verdict", "seconds")}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file}: is no replay.json of hexjet replay") from error


def assess_credibility(evidence: Evidence) -> list[Factor]:
    """Return the level of each factor, in the standard's order."""
    record = read_toml(RECORD)
    return [Factor(assessment, name, *judge(evidence, record)) for assessment, name, judge in _FACTORS]


Judgement = tuple[int, str, str]  # a factor's level, evidence and what would raise it


def _data_pedigree(evidence: Evidence, record: Mapping[str, Any]) -> Judgement:
    where = f"the numbers of {evidence.aircraft} and {evidence.engine}"
    if not evidence.is_shipped:
        level, text = 0, f"{where} are of files outside the package, and nothing says where they are from"
    elif not _is_measured(evidence):
        level, text = 1, f"{where} stand in their README.md, each with its parent; many are published or chosen"
    else:
        level, text = 2, f"{where} stand in their README.md; the engine's are identified: {evidence.uncertainty_source}"
    raised = (
        "measure mass, inertia and engine of the vehicle that is to fly: hexjet identify bench leaves an engine with "
        "its uncertainty"
    )
    return level, text, raised if level < 2 else "measure every number of this very vehicle, with its uncertainty"


def _verification(evidence: Evidence, record: Mapping[str, Any]) -> Judgement:
    made = record["verification"]
    stated = (
        f"{made['inside']} of {made['compared']} quantities of NASA's check cases are within what its own simulators "
        "span (docs/accuracy.md), and the blocks have tests against closed forms and other codes"
    )
    raised = "independent verification from end to end, with all errors bounded"
    if made["version"] != evidence.version:
        level, text = 1, f"{stated}, of version {made['version']}; {evidence.version or 'another'} flew"
        raised = "fly the version that the record is of"
    elif made["inside"] < made["compared"]:
        level, text, raised = 1, stated, "the check cases that are not inside"
    elif evidence.own_code:
        files = ", ".join(evidence.own_code[:3]) + (", ..." if len(evidence.own_code) > 3 else "")
        level, text = 1, f"{stated}; code of the user's flew that none of them sees: {files}"
        raised = "tests of that code; hexjet fmu check for an engine"
    else:
        level, text = 2, f"{stated}, of this version {made['version']}"
    return level, text, raised


def _validation(evidence: Evidence, record: Mapping[str, Any]) -> Judgement:
    raised = "log a flight of the vehicle, and give what hexjet replay says of it: --replay replay.json"
    same = [one for one in evidence.comparisons if one["aircraft"] == evidence.aircraft]
    other = [one for one in evidence.comparisons if one["aircraft"] != evidence.aircraft]
    texts = [f"a recorded flight of {one['seconds']:.0f} s ({Path(one['log']).name}): {one['verdict']}" for one in same]
    texts += [f"{Path(one['log']).name} is of {one['aircraft']} and does not count" for one in other]
    known = [
        one
        for one in record["comparison"]
        if evidence.is_shipped and (one.get("aircraft") == evidence.aircraft or one.get("engine") == evidence.engine)
    ]
    texts += [f"compared with {one['with']}: {one['says']} ({one['page']})" for one in known]
    if any(one["verdict"] != "explained" for one in same):
        level, raised = 0, "mend the model until every recorded flight is explained"
    elif same:
        level, raised = 2, "flights over all that is claimed here, and in the weather that is flown in"
    else:
        of_aircraft = [one["agrees"] for one in known if one.get("aircraft")]  # of its engine alone it is none of it
        level = int(bool(of_aircraft) and all(of_aircraft))
    return level, "; ".join(texts) or "compared with no measurement of the real vehicle", raised


def _development_management(evidence: Evidence, record: Mapping[str, Any]) -> Judgement:
    if evidence.is_shipped and record["verification"]["version"] == evidence.version:
        text = "kept under versions, its rules are written down (CONTRIBUTING.md) and every change passes its tests"
        return 2, text, "an audit that measures this"
    text = "model files outside the package, known by their hashes alone"
    if evidence.is_shipped:
        text = f"another version than that of the record, {record['verification']['version']}"
    return 1, text, "keep these files under version and review"


def _use(evidence: Evidence, record: Mapping[str, Any]) -> Judgement:
    if evidence.warnings:
        return 0, "; ".join(evidence.warnings), "what is warned of"
    text = "vehicle, engine and controller are used as they were made to be; no earlier use is on record"
    return 1, text, "a decision that rested on this model and came true"


def _input_pedigree(evidence: Evidence, record: Mapping[str, Any]) -> Judgement:
    if not evidence.varied:
        return 0, "nothing was varied", "vary what is not known"
    source, raised = evidence.uncertainty_source, "an [uncertainty] of the engine from a bench: hexjet identify bench"
    if evidence.is_engine_drawn and _is_measured(evidence):
        text = f"the engine is drawn by an uncertainty with a source: {source}"
        return 2, text, "a source for every other range, of this very vehicle"
    if evidence.is_engine_drawn and source:
        text = f"the engine is drawn by an uncertainty that was not measured: {source}"
    else:
        text = "the ranges are those that the study states; no measurement of them is on record"
    return 1, text, raised


def _uncertainty(evidence: Evidence, record: Mapping[str, Any]) -> Judgement:
    if not evidence.varied:
        return 0, "nothing was varied", "vary what is not known"
    text = f"{evidence.varied} numbers, noise and turbulence are drawn and flown through the whole model"
    if evidence.uncertainty_source is not None and not evidence.is_engine_drawn:
        text += "; the engine states an uncertainty that was not drawn"
        return 1, text, "draw the engine: leave --nominal-engine out"
    left = f"; nothing of {_listed(evidence.not_varied)}" if evidence.not_varied else ""
    raised = f"vary {_listed(evidence.not_varied)}, or show that they do not matter" if left else "errors of the model"
    return 2, text + left, raised


def _robustness(evidence: Evidence, record: Mapping[str, Any]) -> Judgement:
    search = "a search for the worst case over all keys together: --search"
    if not evidence.ranked:
        level = 1 if evidence.searched else 0
        text = "a search over all keys together" if level else "no sensitivity is known"
        return level, text, "more flights, for the keys' effects to be told from chance"
    text = f"the effect of {evidence.ranked} of {evidence.varied} drawn numbers is known, one at a time"
    if not evidence.searched or evidence.ranked < evidence.varied:
        return 2, text, "more flights" if evidence.searched else search
    text += ", and all together by a search for the worst case"
    if evidence.not_varied:
        return 2, text, f"the same for {_listed(evidence.not_varied)}"
    return 3, text, "what the numbers do together"


def _use_management(evidence: Evidence, record: Mapping[str, Any]) -> Judgement:
    flown = f"{evidence.replayed_same} of {evidence.replayed}"
    kept = "every flight has the hashes of its log and of what it was made from"
    if not evidence.replayed:
        return 1, f"{kept}; none was flown again", "fly some again"
    if evidence.replayed_same < evidence.replayed:
        text = f"{flown} flights came out the same when they were flown again"
        return 0, text, "find out why the others did not"
    text = f"{kept}; {flown} flights came out the same, bit for bit, when they were flown again"
    return 2, text, "another person repeats it on another machine, by the command on this page"


def _review(of: str, raised: str) -> Callable[[Evidence, Mapping[str, Any]], Judgement]:
    return lambda evidence, record: (0, f"no review of {of} by others is on record", raised)


_FACTORS: tuple[tuple[str, str, Callable[[Evidence, Mapping[str, Any]], Judgement]], ...] = (
    (CAPABILITY, "Data pedigree", _data_pedigree),
    (CAPABILITY, "Verification", _verification),
    (CAPABILITY, "Validation", _validation),
    (CAPABILITY, "Development technical review", _review("the model", "a review by peers who did not write it")),
    (CAPABILITY, "Development process and product management", _development_management),
    (RESULTS, "Use assessment", _use),
    (RESULTS, "Input pedigree", _input_pedigree),
    (RESULTS, "Uncertainty characterization", _uncertainty),
    (RESULTS, "Results robustness", _robustness),
    (RESULTS, "Use and analysis technical review", _review("this proof", "the review that this page is for")),
    (RESULTS, "Use process and product management", _use_management),
)


def _is_measured(evidence: Evidence) -> bool:
    source = evidence.uncertainty_source
    return bool(source) and not str(source).startswith(CHOSEN)


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else "nothing"
