"""What a proof does not cover: kinds of numbers that no key varies, and what its flights do not show by themselves."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.engine.fmu.uncertainty import MAX_SIGMA
from cosim.studies import Study, describe_not_flown

# Numbers in which a real vehicle differs from the model, and the prefixes of keys that vary them.
KINDS = {
    "engines": ("engine", "mismatch.engine_parameters", "mismatch.stations", "stations."),
    "delay": ("mismatch.delay_samples", "added_delay_samples"),
    "thrust": ("mismatch.thrust_factor",),
    "mass and balance": ("vehicle.mass_kg", "mismatch.mass_factor", "mismatch.centre_m", "disturbance."),
    "moments of inertia": ("vehicle.inertia", "mismatch.inertia_factor", "mismatch.stretch", "mismatch.shear"),
    "sensors": ("vehicle.sensors",),
    "servos": ("vehicle.servo",),
    "aerodynamics": ("vehicle.aero",),
    "wind and air": ("environment.",),
}
_THRUST_PARAMETERS = ("gain", "thrust")  # parameters of an engine's thrust


def kinds_not_varied(study: Study) -> list[str]:
    """Return the kinds of numbers that a study does not vary at all."""
    drawn = study.drawn
    left = [kind for kind, begins in KINDS.items() if not any(key.startswith(begins) for key in drawn)]
    last = {key.rpartition(".")[2] for key in drawn if key.startswith(KINDS["engines"])}
    told = {"delay": "delay_samples" in last, "thrust": bool(last & set(_THRUST_PARAMETERS))}
    if any(key.startswith("disturbance.") and "velocity" in key for key in drawn):
        told["wind and air"] = True
    return [kind for kind in left if not told.get(kind, False)]


def not_covered(study: Study, missing: Sequence[str], not_flown: Sequence[str]) -> list[str]:
    """Return sentences on what the result of a study does not cover.

    ``missing`` are the parts that were not done, and ``not_flown`` the reasons of the flights that could not be flown.
    """
    base = study.base()
    lines = [f"{part}" for part in missing]
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
