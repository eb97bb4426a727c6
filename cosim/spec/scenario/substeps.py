"""From the error that a flight may have to the number of JSBSim runs in its control step.

``aircraft/substeps.toml`` has what was measured for each shipped vehicle; ``docs/accuracy.md`` says how.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any

from pydantic import Field

from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.base.storage.toml import Model, read_toml, validate
from cosim.spec.vehicle import is_aircraft_path, load_vehicle

SUBSTEPS = 4  # default: JSBSim runs per control step
# Value of ``substeps`` in place of an error such as "0.01 deg": the accuracy that campaigns need.
CAMPAIGN_ACCURACY = "campaign"
_PATTERN = re.compile(r"\s*(?P<size>[0-9]+(?:\.[0-9]+)?(?:e-?[0-9]+)?)\s*(?P<unit>deg|mm)\s*")  # "0.01 deg"
_Positive = Annotated[float, Field(gt=0.0)]  # a positive number


class StepErrors(Model):
    """Largest measured errors of one vehicle's shipped flights, by JSBSim ``runs`` per step.

    ``scenarios``: these flights by name; ``settings``: what was set over them, where they are another vehicle's.
    ``engines`` and ``controllers`` are those that flew.
    """

    flights: int
    scenarios: list[str] = []
    settings: dict[str, Any] = {}
    engines: list[str] = []
    controllers: list[str] = []
    runs: list[int]
    attitude_deg: list[_Positive]
    place_mm: list[_Positive]

    def fewest_runs(self, size: float, unit: str) -> int | None:
        """Return the fewest JSBSim runs per step with an error of at most ``size`` [deg or mm], or None."""
        kept = None
        for runs, error in reversed(list(zip(self.runs, self._list_errors_in_unit(unit), strict=True))):
            if error > size:
                break
            kept = runs
        return kept

    def for_campaigns(self, more_deg: float = 0.1, more_mm: float = 20.0) -> int:
        """Return the fewest runs, at least two, whose errors exceed those of SUBSTEPS by at most these margins.

        That is twice the noise with which shipped vehicles see attitude and height; chosen by us.
        """
        rows = {
            runs: (turned, off) for runs, turned, off in zip(self.runs, self.attitude_deg, self.place_mm, strict=True)
        }
        most_deg, most_mm = rows[SUBSTEPS][0] + more_deg, rows[SUBSTEPS][1] + more_mm
        return min(runs for runs, (turned, off) in rows.items() if runs > 1 and turned <= most_deg and off <= most_mm)

    def smallest_error(self, unit: str) -> float:
        """Return the error [deg or mm] with the largest measured number of runs."""
        return self._list_errors_in_unit(unit)[-1]

    def errors_at(self, runs: int) -> tuple[float, float] | None:
        """Return the errors [deg, mm] with ``runs`` JSBSim runs per step; None if not measured."""
        if runs not in self.runs:
            return None
        place = self.runs.index(runs)
        return self.attitude_deg[place], self.place_mm[place]

    def _list_errors_in_unit(self, unit: str) -> Sequence[float]:
        return self.attitude_deg if unit == "deg" else self.place_mm


@cache
def measured_errors(aircraft: str) -> StepErrors | None:
    path = data_folder("aircraft") / "substeps.toml"
    table = read_toml(path).get(aircraft)
    return None if table is None else validate(StepErrors, table, f"{path}: {aircraft}")


def runs_for(error: str, aircraft: str, where: str) -> int:
    """Return the fewest JSBSim runs per step, 1 to 8, with at most this measured error on a shipped vehicle.

    The error is ``"0.01 deg"`` of attitude or ``"1 mm"`` of place; ``"campaign"``: 0.1 deg and 20 mm more than with
    :data:`SUBSTEPS`.  Raises InputError, which begins with ``where``, for another form, a vehicle of which nothing was
    measured, and an error below what was.
    """
    form = _PATTERN.fullmatch(error)
    said = f"{where}: substeps = {error!r}"
    if error != CAMPAIGN_ACCURACY and (form is None or not float(form["size"]) > 0.0):
        raise InputError(
            f"{said}: a whole number, {CAMPAIGN_ACCURACY!r}, or the error to keep to, such as '0.01 deg' or '1 mm'"
        )
    measured = measured_errors(aircraft)
    if measured is None:
        if not is_aircraft_path(aircraft):
            load_vehicle(aircraft)  # an unknown name lists the known ones
        raise InputError(
            f"{said}: errors are measured for shipped aircraft, and not for {aircraft}; state a number, and compare a "
            "flight with it with one with 16"
        )
    if form is None:
        return measured.for_campaigns()
    runs = measured.fewest_runs(float(form["size"]), form["unit"])
    if runs is None:
        smallest = f"{measured.smallest_error(form['unit']):g} {form['unit']}"
        raise InputError(
            f"{said}: {aircraft} is off by {smallest} with {measured.runs[-1]}, "
            "the most that is measured; state a number"
        )
    return runs


def check_measured_step(error: str, aircraft: str, step: float, where: str) -> None:
    """Raise InputError for a stated error at a control step [s] without measurements."""
    usual = load_vehicle(aircraft)[0].control_step
    if step != usual:
        raise InputError(
            f"{where}: substeps = {error!r}: errors of {aircraft} are measured at its control step of {usual:g} s, and "
            f"not at {step:g} s; state a number, and compare a flight with it with one with 16"
        )
