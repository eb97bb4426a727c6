"""docs/metrics.md names every metric, every limit with its default, and every verdict."""

from __future__ import annotations

import re
from math import degrees
from typing import get_args

import pytest
from places import DOCS

from cosim.base.outcomes import RunVerdict
from cosim.base.signals import AXES
from cosim.results import limits, steadiness, wording
from cosim.results.metrics import REVERSAL, SETTLING_BAND, metric_names
from cosim.spec.scenario import FlightLimits
from cosim.spec.vehicle import load_vehicle

PAGE = (DOCS / "metrics.md").read_text(encoding="utf-8")


def test_every_metric_is_defined() -> None:
    for name in metric_names():
        assert f"`{name.replace('pitch.', 'roll.').replace('yaw.', 'roll.')}`" in PAGE, name


def test_every_metric_is_shown() -> None:
    of_axes = {f"{axis}.{row.key}" for axis in AXES for row in wording.AXIS_ROWS}
    assert of_axes | {name for name, _ in wording.WHOLE_ROWS} == set(metric_names())


def test_every_limit_and_its_default_are_there() -> None:
    rows = {line.split("|")[1]: line for line in PAGE.splitlines() if line.startswith("| `")}
    for key in FlightLimits.model_fields:
        assert any(f"`{key}`" in cell for cell in rows), key
    row = {key: next(line for cell, line in rows.items() if f"`{key}`" in cell) for key in FlightLimits.model_fields}
    assert f"{limits.HEIGHT_SPANS:g} spans" in row["height_error_m"]
    assert f"{limits.POSITION_SPANS:g} spans" in row["place_error_m"]
    assert f"{limits.DRIFT_SPANS:g} spans" in row["drift_m"]
    assert f"{limits.SPEEDS:g} sqrt(g span)" in row["speed_m_s"]
    assert f"{limits.SATURATED_PERCENT:g} %" in row["saturated_percent"]


ROLL = load_vehicle("hexjet")[0].control.attitude.gain_1_s[0]
NOISE = steadiness.AxisLimitInputs(gain_1_s=ROLL, noise_rad=0.001, rate_noise_rad_s=0.005)


@pytest.mark.parametrize(
    ("sentence", "figures"),
    [
        ("by more than {} % of its range", [100.0 * REVERSAL]),
        ("comes to {} %, white noise to {} %", [100.0, 200.0 / 3.0]),
        ("{} % of the last step", [100.0 * SETTLING_BAND]),
        ("{} %, which noise does not reach", [limits.ALTERNATING_PERCENT]),
        (
            "{} time constants of the axis' attitude law, 1/K each ({} s in roll of the prototype)",
            [steadiness.TIME_CONSTANTS, steadiness.TIME_CONSTANTS / ROLL],
        ),
        ("The noise floor is {} standard deviations", [steadiness.DEVIATIONS]),
        (": {}° on the prototype. A smaller step", [degrees(steadiness.noise_floor(NOISE, 0.004))]),
        ("a wind that changes by {} sqrt(g span)", [steadiness.WIND_CHANGE]),
        ("the limit on the swing is {} deg instead", [degrees(steadiness.SWING_IN_WIND_RAD)]),
    ],
)
def test_the_figures_of_the_axes_limits(sentence: str, figures: list[float]) -> None:
    pattern = r"([\d.]+)".join(map(re.escape, sentence.split("{}")))
    found = re.search(pattern, " ".join(PAGE.replace("**", "").split()))
    assert found, sentence
    for said, figure in zip(found.groups(), figures, strict=True):
        assert float(said) == pytest.approx(figure, rel=0.02)


def test_every_verdict_is_there() -> None:
    for verdict in get_args(RunVerdict):
        assert f"| `{verdict}` |" in PAGE
