"""The tables of docs/identification.md: every aircraft's axes swept, beside delay ledger and margins.

python docs/agreement.py --rows FILE.json                 all axes swept and measured; what is done is kept in the file
python docs/agreement.py --rows FILE.json --only octojet  of these aircraft alone (more than one: --only again)
python docs/agreement.py --rows FILE.json --what margins  identify, why (of rows that do not agree) or margins
python docs/agreement.py --rows FILE.json --write         what is kept, written into the page, the rest "not measured"
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from cosim.base.runtime.threads import one_thread

one_thread()

import click  # noqa: E402
import numpy as np  # noqa: E402

from cosim.base.errors import InputError  # noqa: E402
from cosim.base.signals import AXES  # noqa: E402
from cosim.control.predictors.registry import BASELINE  # noqa: E402
from cosim.identify.sweep import identify_axis  # noqa: E402
from cosim.identify.sweep.fit import fit  # noqa: E402
from cosim.identify.sweep.response import FrequencyResponse  # noqa: E402
from cosim.identify.sweep.result import (  # noqa: E402  # noqa: E402
    LEDGER_SAMPLES,
    MISFIT,
    agrees_with_ledger,
    all_delay_is_determined,
    fit_rows,
    low_frequency_delay,
    why_refused,
)
from cosim.results.report.marks import table, write_marks  # noqa: E402
from cosim.simulation.build import build  # noqa: E402
from cosim.simulation.delay_ledger import select_axis  # noqa: E402
from cosim.spec.scenario import Scenario  # noqa: E402
from cosim.spec.vehicle import aircraft_names, engine_of, load_vehicle  # noqa: E402
from hexjet_design.measured.computed import make_plants  # noqa: E402
from hexjet_design.measured.margins import measure_margins  # noqa: E402

PAGE = Path(__file__).parent / "identification.md"
OFF = {"phase_deg": 0.1, "gain_db": 0.15}  # what measured margins may be off the computed, as a share; of gains factors
NOISY = 0.9  # coherence below which noise shows in a misfit
POINTS = 35  # of a computed response, in a band
COLUMNS = {
    "identify": (
        "aircraft", "axis", "band, Hz", "gain", "lag, ms", "delay, samples", "misfit, %", "all delay, samples",
        "ledger, samples", "agree", "why not",
    ),
    "margins": (
        "aircraft", "axis", "phase margin, deg", "computed", "gain margin, dB", "computed gain margin, dB", "agree",
        "why not",
    ),
}  # fmt: skip
Cells = list[str]


def swept(aircraft: str, axis: str) -> Cells:
    """What ``hexjet identify`` finds, beside the ledger; the reason where one of them is absent."""
    try:
        found = identify_axis(axis, aircraft)
    except InputError as error:
        return ["", f"refused: {error}", *[""] * 6]
    band = f"{found.sweep.from_hz:g} to {found.sweep.to_hz:g}"
    if found.refused:
        why = [reason.partition(":")[0] for reason in found.refused]
        least = float(found.response.coherence.min())
        why += [f"coherence at least {least:.2f} alone: the axis is not still beside the sweep"] * (least < NOISY)
        return [band, "refused: " + "; ".join(why), *[""] * 6]
    cells = {row[0].partition(",")[0]: row[1] for row in fit_rows(found)}
    ledger = found.ledger_samples
    numbers = [cells[name] for name in ("gain", "lag", "delay", "misfit", "all delay")]
    if ledger is None:
        return [band, *numbers, f"none: {found.no_ledger}", ""]
    return [band, *numbers, f"{ledger:.2f}", _agree(agrees_with_ledger(found.chosen, ledger))]


def why_not(aircraft: str, axis: str, cells: Cells) -> Cells:
    """Why a sweep does not give the ledger's sum: whether the axis as it is computed, linear and without noise, has the
    form that is fitted, in the same band; what of the ledger no lag is; and where noise is what moves it, whether it is
    found without.
    """
    lowest, _, highest = cells[0].partition(" to ")
    if not highest:
        return [""]
    scenario = _hovering(aircraft)
    reasons = []
    if "coherence" in cells[1]:
        still = identify_axis(axis, aircraft, settings=("sensor_noise=false",))
        found = "also refused" if still.refused else f"found, with {low_frequency_delay(still.chosen):.2f} samples"
        reasons.append(f"without the sensors' noise it is {found}")
    if cells[-1]:  # a sum was found
        worth = 0.01 * float(cells[4]) / (2.0 * np.pi * float(lowest) * scenario.step_s)
        reasons.append(f"the misfit is worth {worth:.1f} samples at {lowest} Hz")
    with build(scenario) as simulation:
        vehicle, engine, ledger = simulation.vehicle, simulation.engine, select_axis(simulation.ledger, axis)
    leads = [row.samples for row in ledger if row.kind == "lead" and row.samples and -row.samples > LEDGER_SAMPLES]
    reasons += [f"the rotors' momentum leads by {-lead:.1f} samples: a zero, which the form lacks" for lead in leads]
    plants = make_plants(scenario, vehicle, engine)
    if isinstance(plants, str):
        return ["; ".join([*reasons, plants])]
    hertz = np.geomspace(float(lowest), float(highest), POINTS)
    value = plants.channels[axis].responses(np.exp(2j * np.pi * hertz * scenario.step_s))[0]
    ones = np.ones(POINTS)
    chain = fit(FrequencyResponse(hertz, value, ones, 1e-3 * ones, scenario.step_s), 1, "computed")
    if chain.misfit > MISFIT:
        reasons.append(f"the axis as computed has not this form either: {100.0 * chain.misfit:.0f} % off in this band")
    elif not all_delay_is_determined(chain) or why_refused(chain, engine=False):
        reasons.append("a band this high does not tell the sum of the axis as computed either")
    else:
        reasons.append(f"the axis as computed gives {low_frequency_delay(chain):.2f} samples in this band")
    return ["; ".join(reasons)]


def _hovering(aircraft: str) -> Scenario:
    """Hover with the Smith predictor where the aircraft has models for its engine, as ``hexjet identify`` flies it."""
    stated = {"name": "hover", "duration_s": 1.0, "aircraft": aircraft, "engine": engine_of(aircraft)}
    scenario = Scenario.from_table(stated, Path(), "agreement")
    modelled = Path(scenario.engine).name in load_vehicle(aircraft, {}, "agreement")[0].identified
    return scenario if modelled else scenario.replace(controller=BASELINE.name)


def measured(aircraft: str, axis: str) -> Cells:
    """What ``hexjet margins`` measures in hover beside what is computed; where they do not agree also without noise, up
    to half the control rate.
    """
    scenario = _hovering(aircraft)
    try:
        cells, agrees = _compared(scenario, axis)
        if agrees is not False:
            return [*cells, "" if agrees is None else _agree(agrees), ""]
        (phase, _, gain, _), still = _compared(scenario.replace(sensor_noise=False), axis, 0.5 / scenario.step_s)
    except InputError as error:
        return [f"none: {error}", *[""] * 5]
    verdict = "which agrees: it is the noise" if still else "which does not agree either"
    return [*cells, _agree(False), f"without the sensors' noise {phase} deg and {gain} dB are measured, {verdict}"]


def _compared(scenario: Scenario, axis: str, to_hz: float | None = None) -> tuple[Cells, bool | None]:
    """Phase and gain margin, each measured and computed, and whether they agree; None where nothing can be said."""
    got = measure_margins(scenario, (axis,), to_hz=to_hz).axes[axis]
    cells, verdicts = [], []
    for name, allowed in OFF.items():
        ours = got.response.margins.get(name)
        theirs = None if got.computed is None else getattr(got.computed.margins, name)
        cells += [f"{value:.1f}" if value is not None else "none" for value in (ours and ours.value, theirs)]
        off = got.off(name)
        verdicts += [] if off is None else [abs(off) <= allowed]
    return cells, all(verdicts) if verdicts else None


def _agree(holds: bool) -> str:
    return "yes" if holds else "no"


MAKERS: Mapping[str, Callable[[str, str], Cells]] = {"identify": swept, "margins": measured}


WHAT = ("identify", "why", "margins")


def made_of(kind: str, aircraft: str, axis: str, done: Mapping[str, Cells]) -> Cells | None:
    """The cells of a kind; none where there is nothing to explain."""
    if kind != "why":
        return MAKERS[kind](aircraft, axis)
    cells = done.get(f"identify {aircraft} {axis}")
    return why_not(aircraft, axis, cells) if cells and cells[-1] != "yes" else None


def read(kept: Path) -> dict[str, Any]:
    """The rows that are done."""
    return dict(json.loads(kept.read_text(encoding="utf-8"))) if kept.exists() else {}


@click.command()
@click.option("--rows", "kept", type=click.Path(dir_okay=False, path_type=Path), required=True)
@click.option("--only", multiple=True, type=click.Choice(aircraft_names()))
@click.option("--what", multiple=True, type=click.Choice(WHAT))
@click.option("--write", is_flag=True)
def main(kept: Path, only: tuple[str, ...], what: tuple[str, ...], write: bool) -> None:
    """Measure what is not kept yet, or write the tables."""
    if not write:
        for kind in what or WHAT:
            for key in (f"{kind} {aircraft} {axis}" for aircraft in only or aircraft_names() for axis in AXES):
                cells = None if key in read(kept) else made_of(kind, *key.split()[1:], read(kept))
                if cells is not None:
                    kept.write_text(json.dumps(read(kept) | {key: cells}, indent=1) + "\n", encoding="utf-8")
                    click.echo(f"{key}: {' | '.join(cells)}", err=True)
    done = read(kept)
    made = {}
    for kind, columns in COLUMNS.items():
        keys = [(aircraft, axis) for aircraft in aircraft_names() for axis in AXES]
        absent = ["not measured", *[""] * (len(columns) - 3)]
        rows = [(*key, *done.get(f"{kind} {' '.join(key)}", absent)) for key in keys]
        if kind == "identify":
            whys = [done.get(f"why {' '.join(key)}", [""]) for key in keys]
            rows = [(*row[: len(columns) - 1], *why) for row, why in zip(rows, whys, strict=True)]
        if any(f"{kind} {' '.join(key)}" in done for key in keys):
            made[f"agreement-{kind}"] = table(columns, rows)
    if write:
        write_marks(PAGE, made)
    sys.stdout.write("\n".join(made.values()))


if __name__ == "__main__":
    main()
