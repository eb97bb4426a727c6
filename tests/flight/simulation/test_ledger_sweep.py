"""The delay ledger against sweeps: every shipped vehicle, and two with nozzles on hinges made for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from cosim.base.storage.toml import read_toml, toml_text
from cosim.engine import load_engine
from cosim.identify.sweep import Identification, identify_axis
from cosim.identify.sweep.result import low_frequency_delay
from cosim.simulation.build import build
from cosim.simulation.delay_ledger import explain_unknown, select_axis, sum_samples
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import engine_of
from hexjet_design.measured.computed import make_plants

WITHIN = 0.5  # samples
WITH_OTHERS = 1.0  # samples, where engines give a small part of an axis beside its servos
FOLLOWS = 0.02  # misfit of a model, above which its response alone is read


def swept(found: Identification) -> float:
    """Return the delay at low frequency [samples] of a measured response.

    Of the model that ``identify`` fits, where it follows.  Where it does not, as where rotors lead, of the response:
    ``-phase - pi / 2`` is ``D w - a / w + b w^3``, with ``a`` the slow pole of what damps the motion and ``b`` what lags bend.
    """
    if found.chosen.misfit < FOLLOWS:
        return low_frequency_delay(found.chosen)
    response = found.response
    use = response.coherence > 0.9
    omega = 2.0 * np.pi * response.hertz[use] * response.step
    late = -np.unwrap(np.angle(response.value[use])) - 0.5 * np.pi
    late -= 2.0 * np.pi * np.round(late[0] / (2.0 * np.pi))
    parts = np.stack([omega, -1.0 / omega, omega**3], axis=1)
    return float(np.linalg.lstsq(parts / omega[:, None], late / omega, rcond=None)[0][0])


def agree(found: Identification, aircraft: str) -> bool:
    with build(scenario_of(aircraft)) as simulation:
        others = any(row.kind == "beside" for row in select_axis(simulation.ledger, found.channel))
    assert found.ledger_samples is not None
    return abs(swept(found) - found.ledger_samples) < (WITH_OTHERS if others else WITHIN)


def identified(axis: str, aircraft: str) -> Identification:
    return identify_axis(axis, aircraft=aircraft, settings=("sensor_noise=false",), from_hz=0.5, to_hz=4.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("aircraft", "axis"),
    [
        ("hexjet", "pitch"),
        ("hexjet", "yaw"),
        ("hexjet-100", "yaw"),
        ("hexjet-p220", "yaw"),
        ("octojet", "yaw"),
        ("quadrotor", "roll"),
        ("quadrotor", "yaw"),
        ("quadjet", "roll"),
        ("quadjet", "yaw"),
        ("trijet", "roll"),
        ("trijet", "yaw"),
        ("jetwing", "roll"),
        ("jetwing", "pitch"),
    ],
)
def test_the_ledger_is_what_a_sweep_finds(aircraft: str, axis: str) -> None:
    assert agree(identified(axis, aircraft), aircraft)


@pytest.mark.parametrize("aircraft", ["hexjet-100", "hexjet-p220", "octojet"])
def test_roll_by_turbines_is_as_late_as_their_engine_is_swept(aircraft: str) -> None:
    """To a sample of 240 and more, which lags hide from a sweep in flight that the tank lasts for."""
    scenario = scenario_of(aircraft)
    with build(scenario) as simulation:
        ledger = simulation.ledger
    vehicle, _ = scenario.resolved_vehicle()
    plants = make_plants(scenario, vehicle, load_engine(scenario.engine, {}, scenario.step_s))
    assert not isinstance(plants, str)
    engines = [row.samples for row in select_axis(ledger, "roll") if row.owner.startswith("engine")]
    dynamics = plants.channels["roll"].actuator.dynamics
    held = dynamics.delay_samples + dynamics.lag_s / dynamics.step  # from the throttle that is held, half a step before
    assert sum(value for value in engines if value is not None) + 0.5 == pytest.approx(held, abs=1.0)


def test_an_axis_that_engines_and_servos_share_has_no_sum_and_says_why() -> None:
    with build(scenario_of("trijet")) as simulation:
        ledger = simulation.ledger
    assert sum_samples(ledger, "pitch") is None
    assert explain_unknown(ledger, "pitch").startswith("no one delay: servos give 89 % of the moment")
    with build(Scenario.load("jetwing-cruise")) as simulation:
        assert all(row.samples is None and "on its wing" in row.element for row in simulation.ledger)


@pytest.mark.parametrize("aircraft", ["quadjet", "trijet", "jetwing"])
def test_no_delay_of_an_engine_is_counted_where_hinges_turn_the_vehicle(aircraft: str) -> None:
    with build(scenario_of(aircraft)) as simulation:
        rows = select_axis(simulation.ledger, "roll")
    assert any(row.kind == "lag" and row.owner.startswith("lag_s of ") for row in rows)
    assert all(row.samples == 0.0 for row in rows if "engine" in row.owner)


def scenario_of(aircraft: str) -> Scenario:
    engine = engine_of(aircraft)
    table = {"name": "x", "duration_s": 1.0, "aircraft": aircraft, "engine": engine, "controller": "baseline"}
    return Scenario.from_table(table, Path(), "x")


def gimballed(folder: Path, lag_s: float, kept: tuple[str, ...]) -> str:
    """Four fans whose nozzles turn on hinges of this lag, of the quadjet's those whose names begin so."""
    table = read_toml(ROOT / "aircraft" / "quadjet" / "vehicle.toml")
    hexjet = read_toml(ROOT / "aircraft" / "hexjet" / "vehicle.toml")
    for key in ("fuel", "airflow", "model"):
        table.pop(key, None)
    for key in ("monitor", "pilot", "position"):
        table["control"].pop(key, None)
    table |= {"name": "gimballed", "engine": "edf-as-flown", "mass_kg": 4.0 * hexjet["mass_kg"] / 6.0}
    table["inertia_kg_m2"] = [0.06, 0.06, 0.1]
    table["aero"] |= {"damping_n_m_s": [0.002, 0.002, 0.002], "drag_area_m2": [0.02, 0.02, 0.03]}
    table["hinges"] = [{**hinge, "lag_s": lag_s} for hinge in table["hinges"] if hinge["name"].startswith(kept)]
    for contact in table["contacts"]:
        contact |= {"spring_n_m": 900.0, "damping_n_s_m": 30.0}
    if "pitch" not in kept:  # by the engines, 0.1 s late
        table["control"]["rate"]["pitch"] |= {"p": 2.0, "i": 0.5}
        table["control"]["attitude"]["gain_1_s"][1] = 0.8
    folder.mkdir()
    (folder / "vehicle.toml").write_text(toml_text(table))
    return str(folder)


@pytest.mark.parametrize(
    ("axis", "kept", "lag_s", "owner"),
    [
        ("roll", ("roll", "pitch"), 0.03, "lag_s of roll_1, roll_2, roll_3, roll_4"),
        ("roll", ("roll",), 0.02, "lag_s of roll_1, roll_2, roll_3, roll_4"),
        ("pitch", ("roll",), 0.02, "engine edf-as-flown"),
    ],
)
def test_a_vehicle_of_ones_own_has_what_a_sweep_finds(
    tmp_path: Path, axis: str, kept: tuple[str, ...], lag_s: float, owner: str
) -> None:
    aircraft = gimballed(tmp_path / "own", lag_s, kept)
    with build(scenario_of(aircraft)) as simulation:
        (lag, *_) = [row for row in select_axis(simulation.ledger, axis) if row.kind == "lag"]
    assert lag.owner == owner
    assert agree(identified(axis, aircraft), aircraft)
