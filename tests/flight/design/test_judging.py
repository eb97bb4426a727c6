"""docs/judging.md: its first commands as written, the arithmetic of its text, and its tables measured and flown again."""

from __future__ import annotations

import json
import re
import shlex
from cmath import exp
from math import log10, radians
from types import SimpleNamespace
from typing import Any

import pytest
from command_tools import Hexjet
from long_cases import long_after
from places import DOCS, script
from stated_figures import stated

from cosim.base.storage.paths import data_folder
from cosim.design.measured.page import PEAK_BANDS, judgement_line
from cosim.engine import library
from cosim.results.report.marks import parts_of, row
from cosim.simulation.controllers.controller_file import Requirements

judging = script("judging")
PAGE, NAME = DOCS / "judging.md", "docs/judging.md"
TEXT = PAGE.read_text(encoding="utf-8")
MARGINS, FLIGHTS, PEAKS = parts_of(TEXT, PAGE).values()
HASTY = "vehicle.control.attitude.gain_1_s=[5.0, 5.0, 3.0]"


def cells(part: str, name: str) -> list[str]:
    (found,) = [line for line in part.splitlines() if line.startswith(f"| {name} |")]
    return [cell.strip() for cell in found.strip("|").split("|")]


def number(part: str, name: str, column: int) -> float:
    return float(re.findall(r"-?[\d.]+", cells(part, name)[column])[0])


def test_the_first_commands_print_what_the_page_says(hexjet: Hexjet) -> None:
    lines = re.findall(r"^hexjet .*$", TEXT, re.MULTILINE)
    assert [HASTY in line for line in lines] == [True, True, True]
    measured, flown, late = (hexjet(*shlex.split(line)[1:], "--json") for line in lines)
    assert (measured.status, flown.status, late.status) == (0, 1, 1)
    found = json.loads(measured.out)["axes"]["roll"]["measured"]
    values = {name: each["value"] for name, each in found.items() if each}
    assert row(judging.margins_row("hasty", values)) in MARGINS
    stated(NAME, "prints a phase margin of {} deg", values["phase_deg"])
    stated(NAME, "of {} Hz it is worth {} ms", values["crossover_hz"], 1000.0 * values["delay_s"])
    first, second = (json.loads(done.out)["metrics"]["roll"] for done in (flown, late))
    stated(NAME, "aircraft overshoots by {} % and settles, a little later", first["overshoot_percent"])
    assert first["settling_time_s"] > 2.0
    assert second["settling_time_s"] is None
    stated(NAME, "Engines that are {} ms later than their model", 10 * judging.STEP_MS)


def test_the_arithmetic_of_the_page() -> None:
    for peak, said in judging.PEAKS.items():
        (gain, phase) = judging.guaranteed(peak)
        assert f"| {peak} | {gain:.1f} dB | {phase:.1f} deg | {said} |" in PEAKS
        # the loops whose gain and phase are just these have this distance from -1
        assert abs(1.0 - 10.0 ** (-gain / 20.0)) == pytest.approx(1.0 / peak, rel=1e-12)
        assert abs(1.0 - exp(1j * radians(phase))) == pytest.approx(1.0 / peak, rel=1e-12)
    assert next(iter(judging.PEAKS)) == Requirements().max_sensitivity
    assert [end for end, _ in PEAK_BANDS][:2] == list(judging.PEAKS)[1:3]
    stated(NAME, "ask for {} % of its delay, as `hexjet design` does", 100.0 * Requirements().delay_tolerance)
    engine = library.read_engine(data_folder("engines") / "edf-as-flown")
    late = float(next(each.start for each in engine.variables if each.name == "delay_samples") or 0.0)
    stated(NAME, "engines that respond {} s late", late * judging.STEP_MS / 1000.0)
    least_ms = Requirements().delay_tolerance * late * judging.STEP_MS
    stated(
        NAME,
        "more than the {} ms that are {} % of its engine's delay",
        least_ms,
        100.0 * Requirements().delay_tolerance,
    )
    stated(NAME, "*hasty* has {} ms of delay", number(MARGINS, "hasty", 5))
    stated(NAME, "and a peak sensitivity of {}. *busy* has a peak sensitivity of {}, and {} ms",
           number(MARGINS, "hasty", 6), number(MARGINS, "busy", 6), number(MARGINS, "busy", 5))  # fmt: skip
    assert number(MARGINS, "busy", 5) < least_ms < number(MARGINS, "hasty", 5)
    stated(NAME, "Thrust that is {} % off is {} dB", 20, 20.0 * log10(1.2))
    for name in set(judging.LOOPS) - {"busy"}:  # which has several crossovers
        phase, crossover, delay = (number(MARGINS, name, column) for column in (3, 4, 5))
        assert phase / 360.0 / crossover == pytest.approx(delay / 1000.0, rel=0.03), name


@pytest.mark.parametrize(
    ("peaks", "band"),
    [
        ({"roll": 1.7, "yaw": 2.0}, "yaw: peak |S| 2.00: up to 2.0, good or usual"),
        ({"roll": 2.43, "yaw": 2.0}, "roll: peak |S| 2.43: from 2.0 to 2.5, only with a well-known engine"),
        ({"roll": 1.7, "yaw": 4.12}, "yaw: peak |S| 4.12: above 2.5, do not fly on it alone"),
    ],
)
def test_the_last_line_judges_the_worst_axis(peaks: dict[str, float], band: str) -> None:
    axes = {
        axis: SimpleNamespace(response=SimpleNamespace(margins={"peak_sensitivity": SimpleNamespace(value=peak)}))
        for axis, peak in peaks.items()
    }
    margins: Any = SimpleNamespace(axes=axes)
    assert judgement_line(margins) == f"judgement: {band}; the margins must be enough too: docs/judging.md"


def test_what_the_text_says_of_the_tables() -> None:
    stated(NAME, "*shipped* overshoots by {} % with {} of its {} ms used.", number(FLIGHTS, "shipped", 2), 40,
           number(MARGINS, "shipped", 5))  # fmt: skip
    alike = [number(FLIGHTS, name, 1) for name in ("shipped", "filtered")]
    settled = [float(cells(FLIGHTS, name)[1].split(", ")[1].removesuffix(" s")) for name in ("shipped", "filtered")]
    assert alike[0] == alike[1]
    stated(NAME, "overshoot by {} % and settle within {} s", alike[0], settled[0] - settled[1])
    stated(NAME, "*filtered* has a gain margin of {} dB and a peak sensitivity of {}.",
           number(MARGINS, "filtered", 1), number(MARGINS, "filtered", 6))  # fmt: skip
    assert cells(FLIGHTS, "filtered")[3] == "lost"
    stated(NAME, "With engines {} ms late it is lost", 20 * judging.STEP_MS)
    assert max(judging.LOOPS, key=lambda name: number(MARGINS, name, 3)) == "busy"
    assert min(judging.LOOPS, key=lambda name: number(MARGINS, name, 6)) == "busy"
    stated(NAME, "phase margin of the five, {} deg, and", number(MARGINS, "busy", 3))
    stated(NAME, "the gain near 1 up to {} Hz, and there {} ms of delay are enough",
           number(MARGINS, "busy", 4), number(MARGINS, "busy", 5))  # fmt: skip
    assert cells(FLIGHTS, "busy")[1].startswith("swings")
    stated(
        NAME, "With engines {} ms late and {} % more thrust it swings by {} deg", 40, 20, number(FLIGHTS, "hasty", 5)
    )
    assert all("%" in cell for cell in cells(FLIGHTS, "calm")[1:6])
    stated(NAME, "Its peak sensitivity is {}, its gain margin {} dB and its delay margin {} ms",
           *(number(MARGINS, "calm", column) for column in (6, 1, 5)))  # fmt: skip


@pytest.mark.parametrize("name", long_after(1, judging.LOOPS))
def test_the_flights_are_what_the_table_says(name: str) -> None:
    runs = [judging.flown(judging.LOOPS[name], off) for off in judging.OFF.values()]
    assert row(judging.flights_row(name, runs)) in FLIGHTS
    if name == "busy":
        calm, busy = (
            judging.flown(judging.LOOPS[each], ()).summary.flat_metrics["effort.throttle_1_s"]
            for each in ("calm", "busy")
        )
        stated(NAME, "throttles {} % more than *calm*", 100.0 * (busy / calm - 1.0))


@pytest.mark.long
@pytest.mark.parametrize("name", judging.LOOPS)
def test_the_margins_are_what_the_table_says(name: str) -> None:
    assert row(judging.margins_row(name, judging.measured(judging.LOOPS[name]))) in MARGINS
