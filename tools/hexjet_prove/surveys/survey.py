"""What the surveys share: the vehicle, the cases chosen, the flights as a campaign, and how a flight is judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import degrees, nan
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from cosim.api import Progress
from cosim.api.studies import report_tally
from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.control.predictors.registry import PREDICTORS
from cosim.engine import load_engine
from cosim.flight import new_folder
from cosim.results.log.columns import jets_in
from cosim.results.log.recorder import Log
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, aircraft_seen_from, engine_of, file_seen_from, load_vehicle
from cosim.studies import Campaign, Study, design_warnings, run_campaign

T = TypeVar("T")  # type of a case


class Subject(NamedTuple):
    """The vehicle that is surveyed, with its engine."""

    aircraft: str
    vehicle: Vehicle
    engine: str

    def settings(self, height: float, duration: float, **more: Any) -> dict[str, Any]:
        """Return the settings of a flight at its control step, from ``height`` [m] on, of ``duration`` [s]."""
        named = {"aircraft": self.aircraft, "engine": self.engine, "step_s": self.vehicle.control_step}
        return named | {"duration_s": duration, "initial": {"altitude_m": height}} | more

    def scenario(self, name: str, controller: str, height: float, duration: float, **table: Any) -> Scenario:
        """Return a flight with :meth:`settings`.  Raises InputError."""
        table = {"name": name, "controller": controller} | self.settings(height, duration, **table)
        return Scenario.from_table(table, Path(), name)

    def controllers(self) -> list[str]:
        """Return the compared controllers for which the vehicle has a model of this engine."""
        engine = load_engine(self.engine, {}, self.vehicle.control_step)
        modelled = bool(engine.models_in(self.vehicle.identified))
        return [name for name, spec in PREDICTORS.items() if spec.compared and (modelled or not spec.needs_model)]


def load_subject(aircraft: str, engine: str | None = None) -> Subject:
    """Return an aircraft with an engine, by default its own.  Raises InputError for unknown names."""
    aircraft = aircraft_seen_from(aircraft, Path())
    vehicle, _ = load_vehicle(aircraft)
    named = engine or engine_of(aircraft) or Scenario.model_fields["engine"].default
    return Subject(aircraft, vehicle, file_seen_from(named, Path()))


def select_cases(cases: Sequence[T], kinds: Sequence[str], subject: str, name_of: Callable[[T], str]) -> list[T]:
    """Return cases that begin with one of ``kinds``, or all.  Raises InputError if there are none."""
    chosen = [case for case in cases if not kinds or name_of(case).startswith(tuple(kinds))]
    if not chosen:
        names = ", ".join(dict.fromkeys(map(name_of, cases)))
        raise InputError(f"no {subject} begins with {' or '.join(map(repr, kinds))}; there are: {names}")
    return chosen


def make_study(name: str, title: str, settings: Mapping[str, Any], cases: Sequence[Any], **more: Any) -> Study:
    """Return the study of every case: a hover with ``settings``.  Raises InputError."""
    table = {"name": name, "title": title, "scenario": "hover", "settings": settings, "case": list(cases)}
    return Study.from_table(table | {"design": "grid"} | more, Path(), name)


def fly_study(study: Study, out: str | Path | None, workers: int, progress: Progress) -> Campaign:
    """Fly what ``out`` lacks of a study, by default in a new folder of ``runs/``; return its campaign.

    Raises InputError for a flight that cannot be flown, with its reason.
    """
    folder = new_folder(Path("runs"), study.name) if out is None else Path(out)
    progress.begin(folder)
    for text in design_warnings(study):
        progress.note(text)
    campaign = run_campaign(study, folder, workers, resume=True, progress=report_tally(progress))
    columns = campaign.columns
    for case, steps, reason in zip(columns["case"], columns["steps"], columns["reason"], strict=True):
        if steps is None:
            raise InputError(f"{case}: {reason}")
    return campaign


def measure_flight(log: Log, begin: int) -> tuple[float, float, int | None]:
    """Return the largest lean [deg], the height lost [m] and the row of the first detection, from row ``begin`` on."""
    roll, pitch, height = (log[name][begin:] for name in ("roll_rad", "pitch_rad", "altitude_m"))
    if not roll.size:
        return nan, nan, None
    upright = np.cos(roll) * np.cos(pitch)
    # A column is NaN if the vehicle has no such jet.
    health = np.nanmin([log[f"health_{jet}"] for jet in range(1, jets_in(log.columns) + 1)], 0)
    ill = np.flatnonzero(health < 1.0)
    lean = degrees(float(np.arccos(np.clip(upright.min(), -1.0, 1.0))))
    return lean, max(0.0, float(height[0] - height.min())), int(ill[0]) if ill.size else None


def held_formula(duration_s: float) -> str:
    """Return the requirement of a held vehicle: all axes level to 5 deg over the last second."""
    max_error_deg = 5.0  # deg, error of each axis while held
    level = " and ".join(f"abs({axis}_error_deg) <= {max_error_deg:g}" for axis in AXES)
    return f"after({duration_s - 1.0:.9g} s, always({level}))"
