"""The designs in tests/designs: what today's command makes, and an independent linear simulation of every axis."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import exp, inf
from typing import Any

import control
import numpy as np
import pytest
from long_cases import long_after
from places import DESIGNS
from state_space import Body, Loop, first_order
from stored_designs import LINEAR, small_step, stored

from cosim.base.storage.toml import read_toml
from cosim.control.predictors.registry import BASELINE
from cosim.engine import load_engine
from cosim.simulation.controllers.controller_file import Requirements, read_controller
from cosim.spec.vehicle import RateModel, load_vehicle
from hexjet_design.assessment import assess, predictor_model, shipped_tuning
from hexjet_design.candidates import WITH_LEAD, find_simplest
from hexjet_design.design import (
    AXES,
    _make_levels,
    _read_start,
    _scenario,
    adapt_lead,
    axis_requirements,
    design,
    identify_hover,
    make_dynamics,
)
from hexjet_design.levels import THRUST_AXES, meets_requirements, tunings_at
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import Channel, channels, engine_lead
from hexjet_design.loop.tuning import Tuning
from hexjet_design.tune import tune, tune_digits

NAMES = sorted(path.stem for path in DESIGNS.glob("*.toml"))
BURNING = [name for name in NAMES if stored(name)["design"].get("levels")]
GRAVITY = 9.80665
# Those that a second command made, which began at the file of the first.
IN_TWO_STEPS = ("turbine-100", "turbine-220")


@lru_cache
def today(name: str) -> tuple[Any, ...]:
    """Scenario, vehicle, engine, actuator, channels and tunings of a stored design, identified and composed anew."""
    path = DESIGNS / f"{name}.toml"
    made = read_controller(path).design
    scenario, vehicle = _scenario(made.engine, made.aircraft, ())
    spec = load_engine(scenario.engine, scenario.engine_parameters, scenario.step_s)
    found = identify_hover(scenario, vehicle, spec, None)
    actuator = Actuator.of(spec.name, make_dynamics(found))
    wanted = channels(scenario, vehicle, spec, actuator)
    return (
        made,
        scenario,
        vehicle,
        spec,
        actuator,
        wanted,
        _read_start(path, wanted, scenario.aircraft, vehicle, spec),
        found.source,
    )


def from_nothing(name: str, channel: Channel, fixed: Tuning, model: RateModel, asked: Requirements) -> Tuning | None:
    """What the command finds on roll with the candidate that the file has; nothing of the file's gains goes into it."""
    file = stored(name)
    controller, tried = (file["design"]["axes"]["roll"][key] for key in ("controller", "candidates"))
    lead = engine_lead(channel) if file["vehicle"]["control"].get("lead", {}).get("roll") else None
    found = tune(channel, controller, model, fixed, asked, lead=lead)
    # the objective is the file's, and of those of all candidates it is the choice
    key = controller + (WITH_LEAD if lead else "")
    assert tried[key] == pytest.approx(found.objective, abs=1e-6)
    assert find_simplest({BASELINE.name: inf} | tried) == key  # a candidate that kept no requirements is not there
    return tune_digits(channel, found.tuning, asked)


@pytest.mark.parametrize("name", long_after(2, NAMES))
def test_a_stored_design_is_what_todays_command_makes(name: str) -> None:
    """Engine, airframe and requirements of today; roll's search from nothing ends at the file's gains, other axes stop there.

    Of roll the candidate that was chosen is searched; where the command has two lines, and of the other axes, the last
    stage is begun at the file and stops there.  The whole search again takes minutes.
    """
    made, _, vehicle, spec, _, wanted, begin, source = today(name)
    assert made.engine_sha256 == spec.identity
    need = made.requirements
    for axis in AXES:
        channel, asked = wanted[axis], axis_requirements(axis, need)
        start = begin[axis][1.0]
        lead = adapt_lead(start.lead, channel)
        if lead is not None and start.lead is not None:
            # the engine's own poles, identified again
            assert start.lead.natural_rad_s == pytest.approx(lead.natural_rad_s, rel=1e-5)
        free = axis == "roll" or vehicle.servo is not None or axis == "altitude"
        model = predictor_model(channel, source)
        again = (
            from_nothing(name, channel, shipped_tuning(channel, vehicle, spec), model, asked)
            if axis == "roll" and name not in IN_TWO_STEPS
            else tune_digits(channel, replace(start, model=model), asked, free)
        )
        assert again is not None, axis
        assert again.angle_gain == pytest.approx(start.angle_gain, rel=1e-9), axis
        assert again.gains.model_dump() == pytest.approx(start.gains.model_dump(), rel=1e-9), axis
        assert again.predictor.model_dump() == pytest.approx(start.predictor.model_dump(), rel=1e-9), axis
        if again.lead is not None and start.lead is not None:
            assert again.lead.pole_rad_s == pytest.approx(start.lead.pole_rad_s, rel=1e-9), axis
        told, record = assess(channel, again, asked), made.axes[axis]
        assert told.margins is not None
        for value, stated in (
            (told.peak_sensitivity, record.peak_sensitivity),
            (told.margins.gain_db, record.gain_margin_db),
            (told.margins.gain_down_db, record.gain_margin_down_db),
            (told.margins.phase_deg, record.phase_margin_deg),
            (told.margins.delay_s, record.delay_margin_s),
            (told.bandwidth_hz, record.bandwidth_hz),
            (told.overshoot, record.overshoot),
            (told.settling_s, record.settling_s),
            (told.tolerated, record.tolerated),
        ):
            assert stated == pytest.approx(value, rel=1e-4, abs=1e-4), axis
    if wanted["roll"].identified is None and made.axes["roll"].controller != "baseline":
        model = stored(name)["vehicle"]["identified"][made.family]["roll"]
        fresh = wanted["roll"].model("x")
        assert model["poles"] == pytest.approx(fresh.poles, rel=1e-6, abs=1e-9)
        assert model["gain"] == pytest.approx(fresh.gain, rel=1e-5)


@pytest.mark.parametrize("name", long_after(2, BURNING))
def test_a_stored_schedule_is_what_todays_command_makes(name: str) -> None:
    """With less fuel, too: each level stays where it is, and every level keeps what the file says of it."""
    made, scenario, vehicle, spec, actuator, _, begin, _ = today(name)
    found = _make_levels(scenario, vehicle, spec, actuator, None, (), lambda text: None)
    plan = load_vehicle(made.aircraft, read_controller(DESIGNS / f"{name}.toml").vehicle)[0].control.schedule
    assert plan
    full = {axis: begin[axis][1.0] for axis in THRUST_AXES}
    for level, record in zip(found, made.levels, strict=True):
        assert level.thrust_fraction == pytest.approx(record.share, rel=1e-4)
        for axis in THRUST_AXES:
            asked = axis_requirements(axis, made.requirements)
            held = assess(level.channels[axis], begin[axis][1.0], asked)
            assert record.held.get(axis) == pytest.approx(held.peak_sensitivity, rel=1e-3)
            if record.designed:
                here = begin[axis][level.fuel]
                again = tune_digits(level.channels[axis], here, asked, level=True)
                assert again is not None
                assert again.angle_gain == pytest.approx(here.angle_gain, rel=1e-5)
                assert again.gains.model_dump() == pytest.approx(here.gains.model_dump(), rel=1e-5)
                told = assess(level.channels[axis], here, asked)
                assert record.axes[axis].peak_sensitivity == pytest.approx(told.peak_sensitivity, rel=1e-3)
            assert record.axes[axis].peak_sensitivity <= made.requirements.max_sensitivity
            # what acts in flight, between the levels too, keeps every requirement: noise, saturation and tolerance as well
            assert meets_requirements(
                level.channels[axis], tunings_at(plan, full, level.thrust_fraction, scenario.step_s)[axis], asked
            )


@pytest.mark.long
def test_a_level_is_designed_where_a_straight_line_misses_a_requirement() -> None:
    """The shipped P220's schedule, begun at its own gains, stands at 75 % and 25 % of the fuel with levels of their own."""
    found = design("p220", "hexjet-p220", start=DESIGNS / "p220.toml")
    assert found.ok
    assert [(each.level.fuel, each.designed) for each in found.levels] == [
        (1.0, True), (0.75, True), (0.5, True), (0.25, True), (0.0, True),
    ]  # fmt: skip
    assert all(kept for each in found.levels for kept in each.is_kept.values())
    assert found.schedule is not None
    shares = [level.share for level in found.schedule.level]
    assert shares == pytest.approx(
        [each.level.thrust_fraction for each in reversed(found.levels) if each.designed], rel=1e-5
    )
    # and the full tank's gains are those of the file
    first, _ = load_vehicle("hexjet-p220", stored("p220")["vehicle"])
    tuned = found.axes["roll"].after
    assert tuned is not None
    assert tuned.tuning.gains == first.control.rate.roll


def loop(name: str, axis: str) -> Loop:
    """The second realisation of one axis of a stored design; nothing of :mod:`hexjet_design`."""
    file = stored(name)
    made, gains = file["design"], file["vehicle"]["control"]
    vehicle, _ = load_vehicle(made["aircraft"])
    T, sensors = made["step_s"], vehicle.sensors
    if name in LINEAR:
        pole, delay, span = LINEAR[name]
        engine = first_order(pole, delay)
    else:
        engine, span = small_step(name, made["aircraft"])
    lead = gains.get("lead", {}).get(axis) or None
    if axis == "altitude":
        own = gains["altitude"]
        rate = {"p": own["velocity_1_s"], "i": own["integral_1_s2"], "d": 0.0, "d_filter_s": 1.0}
        body = Body(
            1.0, 0.0, T, made["substeps"], 0.0, sensors.gnss.latency_samples, sensors.gnss.period_samples,
            sensors.barometer.latency_samples,
        )  # fmt: skip
        return Loop(engine, body, "baseline", None, rate, own["position_1_s"], gains["predictor"], lead)
    k = ("roll", "pitch", "yaw").index(axis)
    inertia = vehicle.inertia_kg_m2[k]
    places = [jet.position_m for jet in vehicle.jets]
    if vehicle.servo is None:
        arms = [abs((y, x, jet.reaction_m)[k]) for (x, y, _), jet in zip(places, vehicle.jets, strict=True)]
        moment = sum(arms) * span
    elif axis == "roll":
        moment = sum(abs(y) for _, y, _ in places) * span
    else:
        arm = sum(z if axis == "pitch" else abs(y) for _, y, z in places)
        moment = abs(arm) * vehicle.mass_kg * GRAVITY / len(places)
        engine = first_order(exp(-T / vehicle.servo.lag_s), 0)
    banks = 0.0
    if axis == "pitch" and vehicle.servo is not None:  # both turn the same way; the jets stand below the centre
        assert all(z > 0.0 for _, _, z in places) or not vehicle.servo.bank_inertia_kg_m2
        banks = 2.0 * vehicle.servo.bank_inertia_kg_m2 / inertia
    body = Body(
        moment / inertia, vehicle.aero.damping_n_m_s[k] / inertia, T, made["substeps"], sensors.gyro.filter_s,
        sensors.gyro.latency_samples, 1, sensors.attitude.latency_samples, banks,
    )  # fmt: skip
    controller = made["axes"][axis]["controller"]
    model = file["vehicle"].get("identified", {}).get(name, {}).get(axis)
    return Loop(engine, body, controller, model, gains["rate"][axis], gains["attitude"]["gain_1_s"][k],
                gains["predictor"], lead)  # fmt: skip


@pytest.mark.parametrize(
    ("name", "axis"), long_after(2, [(name, axis) for name in NAMES for axis in ("roll", "pitch", "yaw", "altitude")])
)
def test_an_independent_simulation_gives_what_is_stated(name: str, axis: str) -> None:
    """Gain up and down and the phase by eigenvalues a per cent inside and outside; delay, overshoot, settling to 1 %.

    The loop of an engine that is fitted is realised from its own answer to a small step, not from the fit.
    """
    record = stored(name)["design"]["axes"][axis]
    second = loop(name, axis)
    near = 0.01
    for key in ("gain_margin_db", "gain_margin_down_db"):
        factor = 10.0 ** (record[key] / 20.0)
        within, beyond = (1.0 - near, 1.0 + near) if factor > 1.0 else (1.0 + near, 1.0 - near)
        assert second.stable_with(factor * within), key
        assert not second.stable_with(factor * beyond), key
    phase = np.radians(abs(record["phase_margin_deg"])) * np.sign(record["phase_margin_deg"])
    assert second.stable_with(np.exp(-1j * phase * (1.0 - near)))
    assert not second.stable_with(np.exp(-1j * phase * (1.0 + near)))
    step = stored(name)["design"]["step_s"]
    assert second.delay_margin() * step == pytest.approx(record["delay_margin_s"], rel=near)
    time = np.arange(round(max(20.0 * record["settling_s"], 1.0) / step)) * step
    answer = control.forced_response(second.closed(step), time, np.ones(len(time))).outputs
    told = control.step_info(answer, time, yfinal=1.0, SettlingTimeThreshold=0.05)
    # one per cent of the step
    assert told["Overshoot"] / 100.0 == pytest.approx(record["overshoot"], abs=near)
    edge = 1.0 - answer[np.arange(len(time)) == round(record["settling_s"] / step)]
    assert told["SettlingTime"] == pytest.approx(record["settling_s"], rel=near, abs=2.0 * step) or (
        abs(abs(edge[0]) - 0.05) < 0.05 * near
    )


def test_the_aircraft_ship_what_the_command_wrote() -> None:
    for aircraft, name in (("hexjet-p220", "p220"), ("hexjet-100", "turbine-100")):
        vehicle, _ = load_vehicle(aircraft)
        written, _ = load_vehicle(aircraft, read_toml(DESIGNS / f"{name}.toml")["vehicle"])
        assert vehicle.control.schedule == written.control.schedule
        assert vehicle.control.schedule
