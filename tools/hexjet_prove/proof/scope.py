"""What a proof does not cover: numbers that no key varies, and what its flights do not show by themselves."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from cosim.base.signals import AXES
from cosim.engine.fmu.uncertainty import MAX_SIGMA
from cosim.studies import ENGINE, Study, all_keys, describe_not_flown
from hexjet_prove.proof.credibility import join_names

# Numbers in which a real vehicle differs from the model, and how keys that vary them begin.
KINDS = {
    "engines": r"(mismatch\.)?(engine_parameters|stations|delay_samples|thrust_factor)|added_delay_samples",
    "mass and balance": r"vehicle\.mass|mismatch\.(mass|centre)|disturbance\.\d+\.(mass|offset)",
    "moments of inertia": r"vehicle\.inertia|mismatch\.(inertia|stretch)",
    "sensors": r"vehicle\.sensors\.",
    "servos": r"vehicle\.servo\.",
    "aerodynamics": r"vehicle\.aero\.",
    "wind and air": r"environment\.(wind|turbulence|ground)|disturbance\.\d+\.velocity",
}
# Names of parts, by the last name of a key without its unit, where it is not that itself.
_PARTS = {
    "added delay": "delay", "pole": "lag", "newton per unit": "gain", "thrust": "gain",
    "turbulence severity": "turbulence", "turbulence wind": "turbulence",
}  # fmt: skip
_ENDING = r"(_(\d+|deg|factor|kg|m|m2|n|ned|rad|s|s2|samples))+$"  # units and more at the end of a key


def kinds_not_varied(study: Study) -> list[str]:
    """Return the kinds of numbers that a study does not vary, each with the parts of it that it does."""
    left, keys = [], [key.path for key in all_keys(study.base())]
    for kind, begins in KINDS.items():
        varied = {part for key in study.drawn if re.match(begins, key) for part in _parts(kind, key)}
        whole = {part for key in keys if re.match(begins, key) for part in _parts(kind, key) if " of " not in part}
        if not whole <= varied and not (kind == "engines" and ENGINE in study.drawn):
            some = f"their {join_names(sorted(varied))}" if len(varied) <= 3 else f"{len(varied)} of their numbers"
            left.append(f"{kind} but for {some}" if varied else kind)
    return left


def _parts(kind: str, key: str) -> Iterable[str]:
    """Return the parts of a kind that a key varies; a place's or a disturbance's own is another part than that of all.

    A stretch along one axis changes the moments about the others.
    """
    names = [name for name in key.split(".") if not name.isdecimal()]
    index = key.rpartition(".")[2]
    if kind == "moments of inertia":
        is_stretch = "stretch" in names
        return [axis for at, axis in enumerate(AXES) if "factor" in index or (str(at) == index) is not is_stretch]
    part = re.sub(_ENDING, "", names[-1]).replace("_", " ")
    one = re.match(r"(?:mismatch\.)?(?:(station|disturbance)s?\.|thrust_factor_)(\d+)", key)
    sensor = f"{names[2]} " if kind == "sensors" else ""
    return [f"{sensor}{_PARTS.get(part, part)}" + (f" of {one[1] or 'station'} {one[2]}" if one else "")]


def not_covered(study: Study, missing: Sequence[str], not_flown: Sequence[str]) -> list[str]:
    """Return sentences on what the result of a study does not cover.

    ``missing`` are the parts that were not done, and ``not_flown`` the reasons of the flights that could not be flown.
    """
    base = study.base()
    lines = list(missing)
    if not_flown:
        lines.append(describe_not_flown(len(not_flown), not_flown[0]))
    lines.append(
        f"the manoeuvre is that of the scenario {base.name}, {base.duration_s:g} s long: nothing is said of another one"
    )
    if any(vary.uncertainty for vary in study.vary):
        lines.append(f"an engine's parameters are drawn up to {MAX_SIGMA:g} standard deviations, and no further")
    if not base.fault:
        lines.append("nothing fails in these flights; hexjet faults says what then")
    lines.append("the probability is that of the model; how far that is the vehicle's, the evidence on record says")
    return lines
