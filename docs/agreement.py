"""The tables of docs/identification.md: every aircraft's axes swept, beside delay ledger and margins.

python docs/agreement.py --rows FILE.json                 all axes swept and measured; what is done is kept in the file
python docs/agreement.py --rows FILE.json --only octojet  of these aircraft alone (more than one: --only again)
python docs/agreement.py --rows FILE.json --what margins  identify or margins alone
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

from cosim.base.errors import InputError  # noqa: E402
from cosim.base.signals import AXES  # noqa: E402
from cosim.design.identify import identify_axis  # noqa: E402
from cosim.design.identify.result import fit_rows, low_frequency_delay  # noqa: E402
from cosim.design.measured import measure_margins  # noqa: E402
from cosim.results.report.marks import table, write_marks  # noqa: E402
from cosim.spec.scenario import Scenario  # noqa: E402
from cosim.spec.vehicle import aircraft_names, engine_of  # noqa: E402

PAGE = Path(__file__).parent / "identification.md"
ALLOWED, LEAST_SAMPLES = 0.1, 1.0  # what a sum of delays may be off the ledger: this share, or so many samples
OFF = {"phase_deg": 0.1, "gain_db": 0.15}  # what measured margins may be off the computed, as a share; of gains factors
COLUMNS = {
    "identify": (
        "aircraft", "axis", "band, Hz", "gain", "lag, ms", "delay, samples", "misfit, %", "all delay, samples",
        "ledger, samples", "agree",
    ),
    "margins": (
        "aircraft", "axis", "phase margin, deg", "computed", "gain margin, dB", "computed gain margin, dB", "agree",
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
        return [band, "refused: " + "; ".join(reason.partition(":")[0] for reason in found.refused), *[""] * 6]
    cells = {row[0].partition(",")[0]: row[1] for row in fit_rows(found)}
    total, ledger = low_frequency_delay(found.chosen), found.ledger_samples
    numbers = [cells[name] for name in ("gain", "lag", "delay", "misfit", "all delay")]
    if ledger is None:
        return [band, *numbers, f"none: {found.no_ledger}", ""]
    return [band, *numbers, f"{ledger:.2f}", _agree(abs(total - ledger) <= max(ALLOWED * ledger, LEAST_SAMPLES))]


def measured(aircraft: str, axis: str) -> Cells:
    """What ``hexjet margins`` measures in hover, beside what is computed."""
    stated = {"name": "hover", "duration_s": 1.0, "aircraft": aircraft, "engine": engine_of(aircraft)}
    try:
        made = measure_margins(Scenario.from_table(stated, Path(), "agreement"), (axis,))
    except InputError as error:
        return [f"none: {error}", *[""] * 4]
    got = made.axes[axis]
    cells, verdicts = [], []
    for name, allowed in OFF.items():
        ours = got.response.margins.get(name)
        theirs = None if got.computed is None else getattr(got.computed.margins, name)
        cells += [f"{value:.1f}" if value is not None else "none" for value in (ours and ours.value, theirs)]
        off = got.off(name)
        verdicts += [] if off is None else [abs(off) <= allowed]
    return [*cells, _agree(all(verdicts)) if verdicts else ""]


def _agree(holds: bool) -> str:
    return "yes" if holds else "no"


MAKERS: Mapping[str, Callable[[str, str], Cells]] = {"identify": swept, "margins": measured}


def read(kept: Path) -> dict[str, Any]:
    """The rows that are done."""
    return dict(json.loads(kept.read_text(encoding="utf-8"))) if kept.exists() else {}


@click.command()
@click.option("--rows", "kept", type=click.Path(dir_okay=False, path_type=Path), required=True)
@click.option("--only", multiple=True, type=click.Choice(aircraft_names()))
@click.option("--what", multiple=True, type=click.Choice([*MAKERS]))
@click.option("--write", is_flag=True)
def main(kept: Path, only: tuple[str, ...], what: tuple[str, ...], write: bool) -> None:
    """Measure what is not kept yet, or write the tables."""
    if not write:
        for kind in what or MAKERS:
            for key in (f"{kind} {aircraft} {axis}" for aircraft in only or aircraft_names() for axis in AXES):
                if key not in read(kept):
                    cells = MAKERS[kind](*key.split()[1:])
                    kept.write_text(json.dumps(read(kept) | {key: cells}, indent=1) + "\n", encoding="utf-8")
                    click.echo(f"{key}: {' | '.join(cells)}", err=True)
    done = read(kept)
    made = {}
    for kind, columns in COLUMNS.items():
        keys = [(aircraft, axis) for aircraft in aircraft_names() for axis in AXES]
        absent = ["not measured", *[""] * (len(columns) - 3)]
        rows = [(*key, *done.get(f"{kind} {' '.join(key)}", absent)) for key in keys]
        if any(f"{kind} {' '.join(key)}" in done for key in keys):
            made[f"agreement-{kind}"] = table(columns, rows)
    if write:
        write_marks(PAGE, made)
    sys.stdout.write("\n".join(made.values()))


if __name__ == "__main__":
    main()
