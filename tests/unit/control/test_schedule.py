"""Gains that follow the thrust level: the block, what a vehicle may state, and flights with part of the fuel."""

from __future__ import annotations

from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from command_tools import Hexjet
from lead_tools import answered, axis
from places import DESIGNS

from cosim import Scenario, fly
from cosim.base.errors import InputError
from cosim.base.signals import Command, Measured, Unallocated
from cosim.base.storage.toml import read_toml
from cosim.control.altitude import AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.lead import Lead
from cosim.control.schedule import GainSchedule
from cosim.simulation.build import build
from cosim.simulation.controllers.controller_file import read_controller
from cosim.spec.vehicle import EngineLead, Leads, Schedule, load_vehicle

STEP = 0.004
FULL = EngineLead(natural_rad_s=1.3, damping=0.66, pole_rad_s=8.0)
LEADS = Leads(roll=FULL)
STATED = Schedule.model_validate(
    {
        "filter_s": 2.0,
        "level": [
            {"share": 0.2, "roll": {"angle": 0.5, "p": 0.8, "natural_rad_s": 1.1, "damping": 0.5, "pole_rad_s": 5.0}},
            {"share": 0.3, "roll": {"natural_rad_s": 1.2, "damping": 0.6, "pole_rad_s": 6.0}},
            {"share": 0.4, "roll": {"d": 2.0, "natural_rad_s": 1.3, "damping": 0.66, "pole_rad_s": 8.0}},
        ],
    }
)


def test_between_two_levels_every_number_is_linear_and_beyond_them_held() -> None:
    block = GainSchedule(STATED, LEADS, STEP)
    low, middle, high = (block.at(share).roll for share in (0.2, 0.3, 0.4))
    assert (low.angle, low.p, low.i, low.d) == (0.5, 0.8, 1.0, 1.0)
    assert (middle.angle, middle.p, middle.d) == (1.0, 1.0, 1.0)
    assert high.d == 2.0
    assert block.at(0.1).roll == low
    assert block.at(0.9).roll == high
    quarter = block.at(0.225).roll
    assert quarter.angle == pytest.approx(0.625)
    assert quarter.lead.natural_rad_s == pytest.approx(1.125)
    assert quarter.lead.damping == pytest.approx(0.525)
    assert quarter.lead.pole_rad_s == pytest.approx(5.25)
    assert block.at(0.225).altitude == (1.0, 1.0, 1.0, 1.0, None)


def test_without_a_lead_what_the_levels_say_of_it_is_not_read() -> None:
    assert GainSchedule(STATED, None, STEP).at(0.25).roll.lead is None


def test_the_level_is_a_first_order_lag_of_the_collective() -> None:
    """``1 - e^(-t / filter)`` of a step, told in steps of a thousandth of the range."""
    block = GainSchedule(STATED, LEADS, STEP)
    block.reset(0.2)
    told = [(k, found.thrust_fraction) for k in range(2000) if (found := block.update(0.4)) is not None]
    for k, share in told:
        assert share == pytest.approx(0.4 - 0.2 * exp(-(k + 1) * STEP / 2.0), rel=1e-9)
    shares = [0.2, *[share for _, share in told]]
    assert np.diff(shares).max() < 2e-3 * 0.2 + 0.2 * STEP / 2.0
    assert shares[-1] == pytest.approx(0.4, abs=0.005)
    # bounded: a collective far beyond the last level is followed no faster than the last level itself
    block.reset(0.2)
    far = [found.thrust_fraction for _ in range(2000) if (found := block.update(1.0)) is not None]
    assert far == shares[1:]


def test_a_lead_that_changes_makes_no_bump_at_rest() -> None:
    """What has been wanted for long is given as it is, whatever the lead becomes."""
    block = Lead(FULL, STEP)
    block.settle(0.3)
    for pole in (7.0, 5.0, 9.0):
        block.set_poles(EngineLead(natural_rad_s=1.1, damping=0.55, pole_rad_s=pole))
        assert block.update(0.3, 0.0) == pytest.approx(0.3, abs=1e-9)
    # and from then on it is the new one: the same answers as of a lead that was the new one from the start
    new = EngineLead(natural_rad_s=1.1, damping=0.55, pole_rad_s=9.0)
    rest = answered(new, np.concatenate([np.zeros(3), [0.1], np.zeros(50)]))[3:]
    found = [block.update(0.3 + v, 0.0) - 0.3 for v in [0.1, *np.zeros(50)]]
    np.testing.assert_allclose(found, rest, atol=1e-7)


def test_the_axis_follows_gains_and_keeps_its_integral() -> None:
    one, other = axis(None, p=0.3, i=0.2, d=0.01), axis(None, p=0.15, i=0.1, d=0.03)
    rng = np.random.default_rng(2)
    for setpoint, rate in rng.standard_normal((40, 2)):
        one.update(setpoint, rate, 0.0)
        other.update(setpoint, rate, 0.0)
    kept = one._integral
    one.scale_gains(0.5, 0.5, 3.0, None)
    assert one._integral == kept
    other._integral = kept
    for setpoint, rate in rng.standard_normal((40, 2)):
        assert one.update(setpoint, rate, 0.0) == pytest.approx(other.update(setpoint, rate, 0.0), rel=1e-12)


def test_a_change_of_the_stated_gains_counts_at_every_level() -> None:
    vehicle, _ = load_vehicle("hexjet")
    gains = vehicle.control.attitude
    attitude = AttitudeController(gains)
    attitude.scale_gains(0.5)
    hover = Measured((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -5.0), (0.0, 0.0, 0.0), 5.0)
    command = Command((0.01, 0.0, 0.0), 5.0)
    before = attitude.update(command, hover)[0]
    assert before == pytest.approx(0.5 * gains.gain_1_s[0] * 0.01, rel=1e-4)
    attitude.retune(gains.model_copy(update={"gain_1_s": tuple(2.0 * k for k in gains.gain_1_s)}), STEP)
    for _ in range(5000):
        after = attitude.update(command, hover)[0]
    assert after == pytest.approx(2.0 * before, rel=1e-6)
    height = AltitudeController(vehicle.control.altitude, 5.0, lambda thrust: thrust / 120.0, STEP)
    plain = height.update(Command((0.0, 0.0, 0.0), 5.1), hover, Unallocated())
    height.reset()
    height.scale_gains(0.5, 1.0, 1.0, None)
    halved = height.update(Command((0.0, 0.0, 0.0), 5.1), hover, Unallocated())
    rest = 5.0 * 9.80665 / 120.0
    assert halved - rest == pytest.approx(0.5 * (plain - rest), rel=1e-9)


@pytest.mark.parametrize(
    ("schedule", "said"),
    [
        ({"filter_s": 1.0}, r"control\.schedule\.level is missing$"),
        ({"filter_s": 0.0, "level": []}, r"control\.schedule\.filter_s = 0\.0: should be greater than 0; wrong too: control\.schedule\.level$"),
        ({"filter_s": 1.0, "level": [{"share": 0.3}]}, r"control\.schedule\.level: needs at least 2$"),
        ({"filter_s": 1.0, "level": [{"share": 0.3}, {"share": 0.3}]}, "every share must be above"),
        ({"filter_s": 1.0, "level": [{"share": 0.3}, {"share": 0.4}]}, "needs natural_rad_s and pole_rad_s"),
    ],
)  # fmt: skip
def test_a_wrong_schedule_is_refused(schedule: Any, said: str) -> None:
    control = {"lead": {"roll": FULL.model_dump(), "altitude": False}, "schedule": schedule}
    with pytest.raises(InputError, match=said):
        load_vehicle("hexjet", {"control": control})


def test_a_flight_begins_with_part_of_the_fuel() -> None:
    """Lighter by what is missing, hovering at the thrust that the rest needs, and never above full."""
    scenario = Scenario.load("full-scale-hover").replace(initial={"fuel": 0.5}, expect=[])
    with build(scenario) as simulation:
        assert simulation.propulsion.tank.remaining == pytest.approx(9.0)
        first = simulation.step()
        mass, _, _ = simulation.airframe.mass_properties()
        assert mass == pytest.approx(61.97 - 9.0, abs=0.01)
        assert sum(first.engines.thrust) == pytest.approx((61.97 - 9.0) * 9.80665, rel=0.02)
        assert first.fuel == pytest.approx(9.0)
    for wrong in (0.0, 1.1):
        with pytest.raises(InputError, match=r"initial\.fuel"):
            Scenario.load("full-scale-hover").replace(initial={"fuel": wrong})


def test_part_of_a_tank_that_is_not_there_is_refused(hexjet: Hexjet) -> None:
    """A whole one, as every stored scenario states it, flies."""
    done = hexjet("fly", "hover", "--set", "initial.fuel=0.5")
    said = "scenario hover: initial.fuel = 0.5: hexjet has no tank; leave it out, or state vehicle.fuel"
    assert done == (2, "", f"hexjet: {said}\n")
    build(Scenario.load("hover").replace(initial={"fuel": 1.0})).close()


def test_half_a_tank_stands_where_it_began() -> None:
    run = fly(Scenario.load("full-scale-hover").replace(initial={"fuel": 0.5}, expect=[]))
    assert run.outcome == "completed"
    height = run.log["altitude_m"]
    assert np.abs(height - height[0]).max() < 0.3


def test_the_law_knows_a_schedule() -> None:
    """A scaled copy of a vehicle with a schedule: rates by the law of rates, factors and shares as they are."""
    from cosim.spec.scaling import scale_vehicle

    vehicle, _ = load_vehicle("hexjet")
    stated = vehicle.model_dump(mode="json", exclude_none=True)
    stated["control"]["schedule"] = STATED.model_dump(mode="json", exclude_none=True)
    twice = scale_vehicle(stated, stated["mass_kg"] * 64.0)["control"]["schedule"]  # L = 4, times twice as long
    assert twice["filter_s"] == pytest.approx(4.0)
    for new, old in zip(twice["level"], stated["control"]["schedule"]["level"], strict=True):
        assert new["share"] == old["share"]
        assert new["roll"]["angle"] == old["roll"]["angle"]
        assert new["roll"]["pole_rad_s"] == pytest.approx(0.5 * old["roll"]["pole_rad_s"])


def test_a_controller_file_from_before_schedules_flies_without_one(tmp_path: Path) -> None:
    """Its gains are for every thrust; the factors that an aircraft states are not for them."""
    vehicle, _ = load_vehicle("hexjet-p220")
    assert vehicle.control.schedule
    table = read_toml(DESIGNS / "turbine-220.toml")
    table["vehicle"]["control"].pop("schedule", None)
    table["design"].pop("levels", None)
    old = tmp_path / "old.toml"
    old.write_text(tomli_w.dumps(table), encoding="utf-8")
    assert read_controller(old).vehicle["control"]["schedule"] is False
