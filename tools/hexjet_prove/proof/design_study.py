"""The study that proves a design: the largest doublet of its own proof, over the tolerances that it was made for.

An engine that states its uncertainty is drawn by it.  Any other one has the box that ``hexjet design`` proves at the
corners of: the gain of the axes by their moments of inertia, all alike, as much less as more, and a later answer up to
the tolerance of the delay, both evenly.  What a flight may do is what it may do at a corner
(:mod:`hexjet_design.proof.flights`).
"""

from __future__ import annotations

from collections.abc import Sequence
from json import dumps
from math import floor, radians
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.base.storage.toml import parse_setting, read_toml, set_path
from cosim.engine import list_engine_names
from cosim.engine.library import FMI2_SUFFIX
from cosim.simulation.build import build
from cosim.simulation.controllers.controller_file import Purpose, apply_controller, read_purpose
from cosim.simulation.delay_ledger import sum_transport_samples
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import aircraft_name
from cosim.studies import Study, default_draw, flatten_settings, open_study
from hexjet_design.loop.criteria import CORNER_FACTOR, OVERSHOOT_ROOM
from hexjet_design.proof.flights import BOUNDS, lean_of, side_s

CONTROLLER = "controller.toml"  # file that hexjet design writes
SCENARIO = "roll-doublet"  # default scenario
# Limits of a flight that a design does not promise, or that are in [success].
NOT_PROMISED = ("drift_m", "speed_m_s", "settling_s", "oscillation_rad", "saturated_percent", "alternating_percent")


def find_design(path: Path) -> Path | None:
    """Return the controller file at ``path`` or in the folder ``path``, or None."""
    file = path / CONTROLLER if path.is_dir() else path
    if file.suffix != ".toml" or not file.is_file():
        return None
    return file if {"controller", "design"} <= read_toml(file).keys() else None


def design_study(file: Path, claim: str, runs: int, **options: Any) -> Study:
    """Return the study that tests a claim on the design in a controller file by at most ``runs`` draws.

    ``options``: ``settings``, ``success``, ``seed``, ``nominal_engine`` and ``batch``, as of a study; ``success``
    stands beside what the design promises.  Raises InputError, for any other too.
    """
    known = ("settings", "success", "seed", "nominal_engine", "batch")
    refused = next((k for k, v in options.items() if v and k not in known), None)
    if refused is not None:
        raise InputError(
            f"{file}: a design brings its own {refused}; leave it out, or prove a study that names the file"
        )
    made, nominal = read_purpose(file), bool(options.get("nominal_engine"))
    settings = _make_settings(file, made, options.get("settings") or ())
    _require_engine(file, made, str(settings["engine"]))
    aircraft = str(settings.pop("aircraft"))
    texts = [f"{key}={dumps(value)}" for key, value in flatten_settings(settings)]
    designed = apply_controller(SCENARIO, file, texts, aircraft)
    texts += [f"aircraft={dumps(aircraft)}", f"command.0.amplitude={lean_of(designed.resolved_vehicle()[0])}"]
    is_drawn = default_draw(designed, nominal)[0] is not None
    roll = made.axes["roll"]
    overshoot = 100.0 * CORNER_FACTOR * ((roll.overshoot or 0.0) + OVERSHOOT_ROOM)
    study = open_study(
        SCENARIO,
        vary=[] if is_drawn else tolerance_box(made, designed),
        settings=texts,
        controllers=[str(file)],
        success=[
            f"roll.overshoot_percent<={overshoot:.6g}",
            f"roll.oscillation_rad<={radians(CORNER_FACTOR * BOUNDS.still_deg):.6g}",
            *options.get("success", ()),
        ],
        design="random",
        runs=runs,
        until=claim,
        seed=options.get("seed"),
        nominal_engine=nominal,
        batch=bool(options.get("batch")),
    )
    named = f"{aircraft_name(aircraft)}-{made.engine}-designed"
    return study.changed(name=named, title=f"{file.name}: the design for {made.aircraft} with engine {made.engine}")


def _require_engine(file: Path, made: Purpose, flown: str) -> None:
    """Raise InputError if the design's engine file is missing."""
    designed_for = made.find_engine(file)
    if flown != designed_for or Path(flown).is_file() or flown.removesuffix(FMI2_SUFFIX) in list_engine_names():
        return
    where = "is not shipped" if made.engine_path is None else f"is not at {designed_for}"
    raise InputError(f"{file}: designed for engine {made.engine!r}, which {where}; give its file as engine")


def tolerance_box(made: Purpose, scenario: Scenario) -> list[str]:
    """Return distributions, as command-line texts, that are uniform over the tolerances of a design."""
    need = made.requirements
    with build(scenario) as simulation:
        late = sum_transport_samples(simulation.ledger, "roll") or 0
    low, high = 1.0 / (1.0 + need.gain_tolerance), 1.0 / (1.0 - need.gain_tolerance)
    box = [f"mismatch.inertia_factor=log({low:.6g}:{high:.6g})"] if low < high else []
    later = floor(need.delay_samples(late))
    return box + ([f"mismatch.delay_samples=0:{later}"] if later else [])


def _make_settings(file: Path, made: Purpose, given: Sequence[str]) -> dict[str, Any]:
    """Return the scenario's settings: those of the design, the doublet of its proof, and ``given``."""
    roll = made.axes["roll"]
    width = side_s(roll.bandwidth_hz)
    settings: dict[str, Any] = {
        "engine": made.find_engine(file),
        "engine_parameters": dict(made.engine_parameters),
        "vehicle": dict(made.vehicle_changes),
        "step_s": made.step_s,
        "substeps": made.substeps,
        "added_delay_samples": made.added_delay_samples,
        "duration_s": 1.0 + 4.0 * width,
        "command": {"0": {"width_s": width}},
        "limits": {**dict.fromkeys(NOT_PROMISED, False), "height_error_m": CORNER_FACTOR * BOUNDS.height_m},
    }
    for text in given:
        keys, value = parse_setting(text)
        set_path(settings, keys, value, "settings")
    settings["aircraft"] = settings.get("aircraft") or made.find_aircraft(file)
    return {key: value for key, value in settings.items() if value != {}}
