"""Writes how near flights on arrays are to JSBSim's into docs/tables/batch.md, in ten minutes: python docs/batch.py."""

from contextlib import suppress
from pathlib import Path

from cosim import InputError, Scenario
from cosim.pages import table, write_marks
from hexjet_batch.check import check

ROOT, ROWS = Path(__file__).parent.parent, []
for scenario in map(Scenario.load, sorted(path.stem for path in (ROOT / "scenarios").glob("*.toml"))):
    for noise in (False, True):
        with suppress(InputError):  # scenarios that are not covered
            found = check(scenario.replace(sensor_noise=noise, duration_s=min(scenario.duration_s, 12.0)))
            worst = [f"{max(one.apart for one in found.samples[i : i + 3]):.1e}" for i in (0, 3, 6)]
            ROWS.append((scenario.name, "on" if noise else "off", *worst, "yes" if found.is_same else found.lines()[0]))
write_marks(ROOT / "docs/tables/batch.md", {"check": table(("", "noise", "deg", "deg/s", "m", "same"), ROWS, 2)})
