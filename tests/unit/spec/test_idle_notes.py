"""What of a flight is stated and does nothing is said: turbulence by half, a small step, a tank without a flow."""

from __future__ import annotations

import pytest

from cosim import Scenario, fly
from cosim.campaign.study.options import open_study

SHORT = ["duration_s=0.1"]


def notes(scenario: str, *settings: str) -> list[str]:
    run = fly(Scenario.load(scenario, [*SHORT, *settings]).replace(command=[], disturbance=[]), report=False)
    return run.summary.notes


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["environment.turbulence_wind_m_s=6"], "turbulence is off: environment.turbulence_wind_m_s = 6 "),
        (["environment.turbulence_severity=3"], "no turbulence below 300 m: environment.turbulence_severity = 3 "),
    ],
)
def test_turbulence_by_half_is_noted(settings: list[str], said: str) -> None:
    assert any(note.startswith(said) for note in notes("hover", *settings))


def test_whole_turbulence_and_none_are_not_noted() -> None:
    assert not any("turbulence" in note for note in notes("hover"))
    whole = ["environment.turbulence_wind_m_s=6", "environment.turbulence_severity=3"]
    assert not any("turbulence" in note for note in notes("hover", *whole))


def test_a_step_below_the_noise_floor_is_noted() -> None:
    small = Scenario.load("roll-doublet", [*SHORT, "command.0.amplitude=0.17"])
    said = ["command.0: the doublet of 0.17 deg in roll_deg is below the noise floor of 0.35 deg"]
    assert [note for note in fly(small, report=False).summary.notes if "floor" in note] == said
    for other in (["command.0.amplitude=-0.5"], ["command.0.amplitude=0.17", "sensor_noise=false"]):
        flown = fly(Scenario.load("roll-doublet", [*SHORT, *other]), report=False)
        assert not any("floor" in note for note in flown.summary.notes)


def test_a_tank_without_fuel_flow_is_said_and_nothing_was_measured() -> None:
    scenario = Scenario.load("full-scale-hover", SHORT).replace(
        engine="turbojet", engine_parameters={"gain": 0.25}, controller="baseline", expect=[]
    )
    run = fly(scenario.replace(command=[], disturbance=[]), report=False)
    assert "engine turbojet reports no fuel flow: the tank stays full" in run.summary.notes
    assert run.summary.fuel_burnt_kg is None
    usual = fly(Scenario.load("full-scale-hover", SHORT), report=False)
    assert not any("fuel flow" in note for note in usual.summary.notes)
    assert usual.summary.fuel_burnt_kg is not None


def test_a_study_of_turbulence_is_told_what_varies() -> None:
    studied = open_study("gust", vary=["environment.turbulence_severity=1:7:7"])
    assert any("turbulence_severity is a switch" in note for note in studied.notes())
    still = open_study("hover", vary=["environment.turbulence_wind_m_s=0:6:3"])
    assert any(note.startswith("turbulence is off") for note in still.notes())
