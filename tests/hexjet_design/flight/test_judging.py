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
from cosim.engine import library
from cosim.results.report.marks import parts_of, row
from cosim.simulation.controllers.controller_file import Requirements
from hexjet_design.measured.estimate import Bounded
from hexjet_design.measured.judgement import (
    KNOWN_PEAK,
    PEAK,
    falls_below,
    guaranteed_gain_db,
    guaranteed_phase_deg,
    judge_axis,
    judgement_line,
)

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
    answer = json.loads(measured.out)
    worst, found = answer["worst_margin"], answer["axes"]["roll"]["measured"]
    assert (worst["axis"], worst["margin"], worst["band"]) == ("roll", "peak_sensitivity", "too little")
    assert worst["value"] == found["peak_sensitivity"]["value"]
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


def an_axis(axis: str, uncertainty: float | None = None, lost: int = 0, **margins: tuple[float, float, float]) -> Any:
    """An axis with these margins, each with its bounds, a transport delay of 100 ms and steps of 4 ms."""
    found = {name: Bounded(*each) for name, each in margins.items()}
    found = {"peak_sensitivity": Bounded(1.7, 1.7, 1.7), "crossover_hz": Bounded(1.0, 1.0, 1.0)} | found
    return SimpleNamespace(
        axis=axis,
        response=SimpleNamespace(margins=found),
        transport_s=0.1,
        sine=SimpleNamespace(step=0.004),
        uncertainty=None if uncertainty is None else SimpleNamespace(delay_s=uncertainty),
        over_engine=None if uncertainty is None else SimpleNamespace(draws=200, unstable=lost),
    )


@pytest.mark.parametrize(
    ("margins", "line"),
    [
        ({"gain_db": (8.4, 8.3, 8.5), "gain_down_db": (-23.0, -23.1, -22.9), "phase_deg": (34.0, 33.9, 34.1),
          "delay_s": (0.124, 0.12, 0.13)},
         "every margin is enough; worst: roll phase, lag 34.0 deg, by its bounds 33.9 deg, "
         "limit 29.0 deg (23.1 deg with a well-known engine)"),
        ({"phase_deg": (24.0, 23.9, 24.1)},
         "fly it only with a well-known engine; worst: roll phase, lag 24.0 deg, by its bounds 23.9 deg, "
         "limit 29.0 deg (23.1 deg with a well-known engine)"),
        ({"gain_db": (6.1, 5.9, 6.3)},  # its bounds may lie below what it was found at
         "fly it only with a well-known engine; worst: roll gain up 6.1 dB, by its bounds 5.9 dB, "
         "limit 6.0 dB (4.4 dB with a well-known engine)"),
        ({"gain_down_db": (-3.0, -3.1, -2.9), "phase_deg": (23.0, 22.9, 23.1)},
         "do not fly on it; worst: roll gain down -3.0 dB, by its bounds -2.9 dB, limit -6.0 dB (-4.4 dB with a well-known engine), "
         "and 1 more too little"),
        ({"phase_deg": (34.0, -40.0, 108.0)},  # bounds that reach beyond 0 are no larger margin
         "do not fly on it; worst: roll phase, lag 34.0 deg, by its bounds 0.0 deg, "
         "limit 29.0 deg (23.1 deg with a well-known engine)"),
        ({"gain_down_db": (-9.0, -25.0, 7.0)},
         "do not fly on it; worst: roll gain down -9.0 dB, by its bounds 0.0 dB, limit -6.0 dB (-4.4 dB with a well-known engine)"),
        ({"delay_s": (0.029, 0.029, 0.029)}, "do not fly on it; worst: roll delay, more 29 ms, limit 30 ms"),
        ({"peak_sensitivity": (2.4, 2.3, 2.51)},
         "do not fly on it; worst: roll peak |S| 2.40, by its bounds 2.51, "
         "limit 2.00 (2.50 with a well-known engine)"),
        ({"uncertainty": 0.01, "delay_s": (0.029, 0.029, 0.029)},
         "do not fly on it; worst: roll delay, more 29 ms, limit 30 ms"),
        ({"uncertainty": 0.0096, "delay_s": (0.029, 0.029, 0.029), "lost": 1},
         "do not fly on it; worst: roll lost draws 1, limit 0"),
    ],
)  # fmt: skip
def test_the_last_line_judges_every_margin_and_names_the_worst(margins: dict[str, Any], line: str) -> None:
    rows = judge_axis(an_axis("roll", **margins)) + judge_axis(an_axis("yaw", peak_sensitivity=(1.1, 1.1, 1.1)))
    assert judgement_line(rows) == f"judgement: {line}: docs/judging.md"
    bands = ["enough", "narrow", "too little"]
    worst = max(bands.index(row.band or "enough") for row in rows)
    assert [falls_below(rows, band) for band in bands[:2]] == [worst > 0, worst > 1]


def test_the_limits_of_the_margins_are_those_of_the_page() -> None:
    assert tuple(judging.PEAKS)[1:3] == (PEAK, KNOWN_PEAK)
    for peak in (PEAK, KNOWN_PEAK):
        assert judging.guaranteed(peak) == pytest.approx((guaranteed_gain_db(peak), guaranteed_phase_deg(peak)))
    rows = {
        row.margin: row for row in judge_axis(an_axis("roll", gain_db=(7.0, 7.0, 7.0), phase_deg=(40.0, 40.0, 40.0)))
    }
    gain, phase = rows["gain_db"], rows["phase_deg"]
    assert gain.limit == 6.0
    stated(NAME, "on both sides; narrow is {} dB", gain.known_limit)
    stated(NAME, "Ask for the {} deg that a peak sensitivity of {} guarantees; narrow is {} deg",
           phase.limit, PEAK, phase.known_limit)  # fmt: skip


def test_what_has_no_known_delay_is_not_judged_by_one() -> None:
    axis = an_axis("pitch", delay_s=(0.001, 0.001, 0.001))
    axis.transport_s = None
    (late,) = [row for row in judge_axis(axis) if row.margin == "delay_s"]
    assert (late.limit, late.band, late.cells()[-2:]) == (None, None, ["not judged", "delay not known"])
    assert judgement_line(judge_axis(axis)).startswith("judgement: every margin is enough; worst: pitch peak |S| 1.70")


def test_a_band_without_a_crossover_tells_no_margins() -> None:
    """A low peak sensitivity is all that such a band shows, and it is no proof of the margins outside."""
    axis = an_axis("yaw")
    del axis.response.margins["crossover_hz"]
    rows = judge_axis(axis)
    assert judgement_line(rows) == ("judgement: the margins are not told; worst: yaw crossover none: docs/judging.md")
    assert [falls_below(rows, band) for band in ("enough", "narrow")] == [True, True]
    assert ["yaw", "crossover", "none", "-", "not told", "widen the band"] in [row.cells() for row in rows]
    axis.response.margins["peak_sensitivity"] = Bounded(2.6, 2.6, 2.6)
    assert judgement_line(judge_axis(axis)).startswith("judgement: do not fly on it; worst: yaw peak |S| 2.60")


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
