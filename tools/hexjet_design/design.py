"""The design: identify the engine, form the channels, tune every candidate, choose, and say what limits it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.base.storage.toml import merge, parse_setting, set_path
from cosim.control.predictors.registry import BASELINE, PREDICTORS
from cosim.engine import EngineSpec, load_engine
from cosim.identify.sweep import Identification, identify_engine
from cosim.simulation.controllers.controller_file import LAW, Requirements, read_controller
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Schedule, Vehicle, aircraft_seen_from, file_seen_from, load_vehicle, read_models
from hexjet_design.assessment import Assessment, AxisDesign, assess, predictor_model, shipped_tuning
from hexjet_design.candidates import WITH_LEAD, candidate_names, design_axis_at_limit, find_simplest, servo_candidates
from hexjet_design.levels import (
    DESIGN_FUELS,
    THRUST_AXES,
    Level,
    adapt_lead,
    make_levels,
    make_schedule,
    meets_requirements,
    tune_levels,
    tunings_at,
)
from hexjet_design.limits import (
    Say,
    bandwidths_without_limits,
    describe_nearest,
    explain_failure,
    find_allowances,
    tolerance_checks,
)
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import Channel, channels, engine_lead, hover_fraction
from hexjet_design.loop.criteria import fine_loop, objective
from hexjet_design.loop.dynamics import Dynamics, fit_dynamics, make_lag_dynamics, with_misfit
from hexjet_design.loop.engine_uncertainty import engine_tolerances
from hexjet_design.loop.firmware import Firmware
from hexjet_design.loop.limit import AxisLimit, axis_limit
from hexjet_design.loop.programme import need_solver
from hexjet_design.loop.tuning import Tuning
from hexjet_design.proof.result import Proof
from hexjet_design.tune import TuningResult, tune, tune_digits, tune_near

CHANNELS = (*AXES, "altitude")  # channels that a design has gains for


@dataclass(frozen=True)
class LevelDesign:
    """One fuel level: the channels driven by engines, with full-tank gains and with scheduled ones."""

    level: Level
    designed: bool  # False: between two designed levels
    unscheduled: Mapping[str, Assessment]
    after: Mapping[str, Assessment]  # as ``unscheduled`` if not scheduled
    is_kept: Mapping[str, bool]  # whether ``after`` meets the requirements


@dataclass(frozen=True)
class Design:
    """All channels of a vehicle with an engine."""

    engine: EngineSpec
    vehicle: Vehicle
    scenario: Scenario
    need: Requirements
    identification: Identification | None  # of the engine; None: a model was given
    model_source: str
    axes: Mapping[str, AxisDesign]
    levels: Sequence[LevelDesign]  # full tank first; empty: no tank
    schedule: Schedule | None  # gain schedule; None: full tank's gains
    reason: str  # why not acceptable; empty: acceptable
    allowing: Mapping[str, float]  # delay_s, lag_factor that would suffice
    proof: Proof | None = None  # None: not requested
    firmware: Firmware | None = None  # autopilot with the gains; None: ours
    tolerances: str = ""  # origin of tolerances not stated by hand
    # Limit by axis, if requested; or why there is none.
    performance: Mapping[str, AxisLimit | str] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether every requirement is kept."""
        return not self.reason

    @property
    def is_written(self) -> bool:
        """Whether a controller file is written: also one not proved, if only off-design flights failed."""
        if self.ok or self.proof is None or self.reason != self.proof.reason:
            return self.ok
        as_designed = [flight.fault for flight in self.proof.flights if flight.is_as_designed]
        return bool(as_designed) and not any(as_designed)

    @property
    def engine_dynamics(self) -> Dynamics:
        """Identified engine dynamics, which act on height in every vehicle."""
        return self.axes["altitude"].channel.actuator.dynamics

    @property
    def controller(self) -> str:
        """Name of the chosen controller, or of the best candidate if none is acceptable."""
        chosen = self.axes["roll"].after
        return chosen.controller if chosen else BASELINE.name


def design(
    engine: str,
    aircraft: str = "hexjet",
    *,
    controller: str = "auto",
    need: Requirements | None = None,
    settings: Sequence[str] = (),
    model: Path | None = None,
    amplitude: float | None = None,
    lead: bool = True,
    scheduled: bool = True,
    start: Path | None = None,
    unsure: tuple[tuple[float, float], ...] = (),
    firmware: Firmware | None = None,
    say: Say = lambda text: None,
) -> Design:
    """Design controller, predictor and gains of an aircraft for an engine.

    ``engine`` a name or a file; ``controller`` one of the candidates, or "auto" for the best of them; ``settings``
    ``KEY=VALUE`` over a scenario, such as ``engine_parameters.delay_samples=40``; ``model`` a file with the identified
    response of an axis, taken instead of what engine and airframe make together.  ``amplitude`` of the sweep of the
    engine, in throttle: larger for an engine whose limits the flight will reach.  The air is the standard atmosphere's
    at sea level.

    ``start`` a controller file: its candidate alone is searched for, from its gains on.  ``scheduled``: whether gains
    may follow the thrust level where the vehicle burns fuel.  ``unsure``: (Hz, share) by which the engine may differ
    from its model, in place of what the model leaves of the sweep.  ``firmware``: the gains are those of another
    autopilot's loop, with its filters, delays and whole numbers; the height is ours, and so is its loop.

    Tolerances that ``need`` does not state are those of the engine's uncertainty, where its mapping file has one.

    Raises InputError for an unknown name, a vehicle that the engines do not lift, or an engine that does not answer.
    """
    need = need or Requirements()
    names = candidate_names(controller, start)
    scenario, vehicle = _scenario(engine, aircraft, settings)
    engine, unchecked, apart = scenario.engine, scenario.engine_unchecked, scenario.engine_isolated
    spec = load_engine(engine, scenario.engine_parameters, scenario.step_s, unchecked=unchecked, isolated=apart)
    level = hover_fraction(vehicle, spec)
    limits = vehicle.control.allocation
    if not limits.throttle_min < level < limits.throttle_max:
        raise InputError(
            f"engine {spec.name}: {vehicle.name} ({vehicle.mass_kg:g} kg) would hover at {level:.2f} of its range, "
            f"outside {limits.throttle_min:g} to {limits.throttle_max:g}: it cannot be controlled, whatever the gains"
        )
    say(f"identifying {spec.name}")
    identified = identify_hover(scenario, vehicle, spec, amplitude)
    dynamics = Actuator.of(spec.name, make_dynamics(identified, unsure))
    plants = channels(scenario, vehicle, spec, dynamics)
    say(f"uncertainty of {spec.name}")
    tolerances = engine_tolerances(need, scenario, vehicle, spec, plants.values())
    need = tolerances.need
    models = spec.models_in(read_models(model) if model else {})
    if model and not models:
        raise InputError(f"{model}: holds no model of {vehicle.name} with engine {spec.family!r}")
    for axis, of_axis in models.items():
        if not spec.matches_model(of_axis.engine_sha256):
            raise InputError(f"{model}: its model of {axis} is of another {spec.family}: its hash is another")
        plants[axis] = replace(plants[axis], identified=of_axis)
    if plants["roll"].is_by_servo:
        names = servo_candidates(names, controller, vehicle, firmware)
    source = f"{identified.source}; with the airframe of {vehicle.name}"
    begin = None if start is None else _read_start(start, plants, scenario.aircraft, vehicle, spec)
    inputs = _AxisInputs(vehicle, spec, names, need, source, lead, firmware, say)
    axes, inputs = _design_axes(plants, inputs, begin)
    reason = explain_failure(axes, need)
    allowing = (
        find_allowances(axes["roll"], names, need, say, lead)
        if reason and start is None and not firmware and names != (LAW,)
        else {}
    )
    burning: list[LevelDesign] = []
    plan: Schedule | None = None
    if vehicle.fuel is not None and not reason and not model:
        there = _make_levels(scenario, vehicle, spec, dynamics, amplitude, unsure, say)
        plan, burning, reason = _design_levels(axes, there, need, begin, scheduled, say)
    return Design(
        spec, vehicle, scenario, need, identified, source, axes, burning, plan, reason, allowing,
        firmware=inputs.firmware, tolerances=tolerances.words,
    )  # fmt: skip


def add_limits(design: Design, say: Say = lambda text: None) -> Design:
    """Return the design with the limit of performance of each attitude axis, or why there is none.

    Raises InputError where the solver is not installed.
    """
    need_solver()
    limits: dict[str, AxisLimit | str] = {}
    for axis in AXES:
        channel, after = design.axes[axis].channel, design.axes[axis].after
        if after is not None and after.load_error is not None:
            say(f"{axis}: the limit of performance")
            try:
                limits[axis] = axis_limit(
                    fine_loop(channel, after.tuning), after.load_error, priced=not channel.is_by_servo
                )
            except InputError as error:
                limits[axis] = str(error)
    return replace(design, performance=limits)


def axis_requirements(axis: str, need: Requirements) -> Requirements:
    """Return the requirements of one channel; a bandwidth is required of roll and pitch only."""
    return need if axis in ("roll", "pitch") else need.model_copy(update={"min_bandwidth_hz": 0.0})


def _make_levels(
    scenario: Scenario,
    vehicle: Vehicle,
    spec: EngineSpec,
    full: Actuator,
    amplitude: float | None,
    unsure: tuple[tuple[float, float], ...],
    say: Say,
) -> list[Level]:
    def identify_at(there: Vehicle) -> Actuator:
        if there.mass_kg == vehicle.mass_kg:
            return full
        say(f"identifying {spec.name} at {there.mass_kg:.4g} kg")
        return Actuator.of(spec.name, make_dynamics(identify_hover(scenario, there, spec, amplitude), unsure))

    return make_levels(scenario, vehicle, spec, identify_at)


def _design_levels(
    axes: Mapping[str, AxisDesign],
    levels: Sequence[Level],
    need: Requirements,
    begin: Mapping[str, Mapping[float, Tuning]] | None,
    scheduled: bool,
    say: Say,
) -> tuple[Schedule | None, list[LevelDesign], str]:
    """Return gain schedule or None, design per fuel level, and the reason of failure or ""."""
    full = {
        axis: axis_design.after.tuning
        for axis, axis_design in axes.items()
        if axis in THRUST_AXES and axis_design.after is not None
    }
    law = full["roll"].law is not None  # the law's gains do not follow thrust
    step, needs = axes["roll"].channel.step, {axis: axis_requirements(axis, need) for axis in THRUST_AXES}
    fits = all(
        meets_requirements(level.channels[axis], full[axis], needs[axis]) for level in levels for axis in THRUST_AXES
    )
    unscheduled = [
        {axis: assess(level.channels[axis], full[axis], needs[axis]) for axis in THRUST_AXES} for level in levels
    ]
    level_tunings = {axis: dict((begin or {}).get(axis, {})) for axis in THRUST_AXES}
    designed = {*DESIGN_FUELS, *(fuel for of in level_tunings.values() for fuel in of)}
    while True:
        plan: Schedule | None = None
        if scheduled and not fits and not law:
            for axis in THRUST_AXES:
                say(f"{axis}: with less fuel")
                followed = tune_levels(axis, levels, full[axis], needs[axis], level_tunings[axis], designed)
                if followed is None:
                    return None, [], f"{axis}: no gains keep the requirements with less fuel"
                level_tunings[axis] = followed
            plan = make_schedule(levels, level_tunings)
        burning = []
        for level, before in zip(levels, unscheduled, strict=True):
            acting, after = full, before
            if plan:
                acting = tunings_at(plan, full, level.thrust_fraction, step)
                after = {axis: assess(level.channels[axis], acting[axis], needs[axis]) for axis in THRUST_AXES}
            is_kept = {
                axis: meets_requirements(level.channels[axis], acting[axis], needs[axis]) for axis in THRUST_AXES
            }
            burning.append(LevelDesign(level, level.fuel in designed, before, after, is_kept))
        missed = {level.level.fuel for level in burning if (plan or law) and not all(level.is_kept.values())}
        if plan is None or missed <= designed:
            # Without a schedule there is nothing to design at other levels.
            where = ", ".join(f"{fuel:.0%} of the fuel" for fuel in sorted(missed))
            by = "schedule" if plan else "controller at the limit, which follows no thrust level,"
            return plan, burning, f"a requirement is missed by the {by} with {where}" if missed else ""
        designed |= missed  # interpolated gains fail there


def _read_start(
    start: Path, plants: Mapping[str, Channel], aircraft: str, vehicle: Vehicle, spec: EngineSpec
) -> dict[str, dict[float, Tuning]]:
    """Return the tunings of a controller file as starts of a search: by axis, then by fuel."""
    file = read_controller(start, aircraft)
    if file.controller == LAW:
        raise InputError(f"{start}: is of controller {LAW!r}, whose search begins at the limit: leave start out")
    changes = merge(file.vehicle, {"mass_kg": vehicle.mass_kg})
    designed, _ = load_vehicle(aircraft, changes, f"{start}: vehicle")
    tunings: dict[str, dict[float, Tuning]] = {}
    for axis, channel in plants.items():
        tuning = shipped_tuning(channel, designed, spec)
        tunings[axis] = {1.0: replace(tuning, controller=file.design.axes[axis].controller)}
    plan = designed.control.schedule
    if plan and designed.fuel:
        step = plants["roll"].step
        full = {axis: tunings[axis][1.0] for axis in THRUST_AXES}
        fuels = [level.fuel for level in file.design.levels if level.designed]
        for level, fuel in zip(reversed(plan.level), fuels, strict=False):
            there = tunings_at(plan, full, level.share, step)
            for axis in THRUST_AXES:
                tunings[axis][fuel] = there[axis]
    return tunings


def _resume_axis(channel: Channel, inputs: _AxisInputs, roll: Tuning | None, start: Tuning) -> AxisDesign:
    """Design an axis by a search that begins at ``start``, with the candidate that ``start`` has."""
    axis, vehicle, need = channel.name, inputs.vehicle, axis_requirements(channel.name, inputs.need)
    inputs.say(f"{axis}: {start.controller}")
    model, predictor = predictor_model(channel, inputs.source), roll.predictor if roll else start.predictor
    start = replace(start, model=model, lead=adapt_lead(start.lead, channel), predictor=predictor)
    tuned = tune_near(channel, start, need, not _follows_roll(axis, vehicle))
    before = assess(channel, shipped_tuning(channel, vehicle, inputs.spec), need)
    key = start.controller + (WITH_LEAD if start.lead else "")
    if tuned is None:
        return AxisDesign(channel, before, {key: inf}, None, {}, {})
    after = assess(channel, tuned, need)
    value = objective(fine_loop(channel, tuned))
    return AxisDesign(channel, before, {key: value}, after, {}, tolerance_checks(channel, tuned, need))


def _scenario(engine: str, aircraft: str, settings: Sequence[str]) -> tuple[Scenario, Vehicle]:
    """Return the scenario of a hover with this engine and its aircraft, at the sample time of the aircraft's models."""
    table: dict[str, Any] = {"name": "design", "duration_s": 1.0}
    table["aircraft"] = aircraft_seen_from(aircraft, Path())
    table["engine"] = file_seen_from(engine, Path())
    for text in settings:
        key, value = parse_setting(text)
        set_path(table, key, value, "design: settings")
    scenario = Scenario.from_table(table, Path(), "design")
    if scenario.stations:
        raise InputError("design: settings stations: a design is for one engine at all stations")
    load_vehicle(scenario.aircraft, scenario.vehicle, "design: vehicle")  # reports wrong keys as the design's
    return scenario, scenario.resolved_vehicle()[0]


def identify_hover(scenario: Scenario, vehicle: Vehicle, spec: EngineSpec, amplitude: float | None) -> Identification:
    """Identify the engine around its throttle in hover."""
    throttle = throttle_for(spec, vehicle)
    # Of the throttle, around hover: limits on an engine's acceleration do not act on so small a change.
    min_swing = 0.005
    if amplitude is None:
        # An engine whose steady thrust ripples is moved by twice the ripple.
        rest_swing = 2.0 * spec.archive.starting.rest_n / (spec.curve.thrust[-1] - spec.curve.thrust[0])
        amplitude = min(max(min_swing, rest_swing), 0.4 * min(throttle, 1.0 - throttle))
    return identify_engine(spec, step=scenario.step_s, throttle=throttle, amplitude=amplitude)


def make_dynamics(identified: Identification, unsure: tuple[tuple[float, float], ...] = ()) -> Dynamics:
    """Return the identified lag and delay, or larger dynamics with their misfit where these miss the response."""
    model = identified.chosen.model
    # Above this misfit of one lag and a delay, further forms are fitted.
    max_misfit = 0.005
    if identified.chosen.misfit <= max_misfit and model.rate > 0.0:
        one = make_lag_dynamics([1.0 / model.rate], model.delay_samples, model.step)
        return replace(one, misfit=identified.chosen.misfit, unsure=unsure)
    fitted = fit_dynamics(identified.response, model.delay_samples, 1.0 / max(model.rate, 0.01))
    return replace(fitted, unsure=unsure) if unsure else with_misfit(fitted, identified.response)


def throttle_for(spec: EngineSpec, vehicle: Vehicle) -> float:
    """Return the throttle, 0 to 1, at which each engine carries its part of the weight."""
    curve = spec.curve
    thrust = curve.thrust[0] + hover_fraction(vehicle, spec) * (curve.thrust[-1] - curve.thrust[0])
    return float(np.interp(thrust, curve.thrust, curve.throttle))


@dataclass(frozen=True)
class _AxisInputs:
    """The inputs that all axes of a design have in common."""

    vehicle: Vehicle
    spec: EngineSpec
    names: Sequence[str]  # candidates, simplest first
    need: Requirements
    source: str  # origin of the predictor's model
    lead: bool  # whether a lead may be tried
    firmware: Firmware | None
    say: Say


def _follows_roll(axis: str, vehicle: Vehicle) -> bool:
    """Return whether an axis flies through roll's predictor: pitch and yaw of rotors, but not of jets that tilt."""
    return axis in ("pitch", "yaw") and vehicle.allocation == "rotors"


def _firmware_on_axis(firmware: Firmware | None, axis: str, roll: Tuning | None) -> Firmware | None:
    """Return the autopilot's loop on another axis, with what roll chose for all; None for height."""
    if firmware is None or axis == "altitude":
        return None
    smooth = roll.gains.d_filter_s if roll is not None and firmware.common_filter else None
    angle = roll.angle_gain if roll is not None and firmware.common_angle and axis == "pitch" else None
    return replace(firmware, axis=axis, d_filter_s=smooth, angle_gain=angle)


def _design_axes(
    plants: Mapping[str, Channel], inputs: _AxisInputs, begin: Mapping[str, Mapping[float, Tuning]] | None
) -> tuple[dict[str, AxisDesign], _AxisInputs]:
    """Return the design of each channel, and its inputs.

    ``begin``: tunings that a search begins at, instead of everywhere.
    """
    axes: dict[str, AxisDesign] = {}
    for axis in CHANNELS:
        roll = axes["roll"].after if axes else None
        chosen = roll.tuning if roll else None
        if begin is not None:
            axes[axis] = _resume_axis(plants[axis], inputs, chosen, begin[axis][1.0])
            continue
        axes[axis] = _tune(plants[axis], inputs, chosen)
        if axis == "pitch" and (shared := _share_angle_gain(axes, plants, inputs)) is not None:
            inputs = shared
            axes = {"roll": _tune(plants["roll"], inputs, None)}
            again = axes["roll"].after
            axes["pitch"] = _tune(plants["pitch"], inputs, again.tuning if again else None)
    return axes, inputs


def _share_angle_gain(
    axes: Mapping[str, AxisDesign], plants: Mapping[str, Channel], inputs: _AxisInputs
) -> _AxisInputs | None:
    """Return the inputs with pitch's attitude gain for roll too, where pitch has no design with that of roll.

    None: the gains are not shared, both have a design, or pitch has none with any gain.
    """
    firmware, roll = inputs.firmware, axes["roll"].after
    if firmware is None or not firmware.common_angle or roll is None or axes["pitch"].after is not None:
        return None
    alone = _tune(plants["pitch"], replace(inputs, firmware=replace(firmware, common_angle=False)), roll.tuning).after
    if alone is None:
        return None
    return replace(inputs, firmware=replace(firmware, angle_gain=alone.tuning.angle_gain))


def _tune(channel: Channel, inputs: _AxisInputs, roll: Tuning | None) -> AxisDesign:
    """Tune all candidates of an axis and choose the best; ``roll`` is roll's tuning, None for roll."""
    axis, vehicle, say, need = channel.name, inputs.vehicle, inputs.say, axis_requirements(channel.name, inputs.need)
    predicted = roll is not None and _follows_roll(axis, vehicle)
    names = inputs.names if axis == "roll" else (roll.controller if predicted and roll else BASELINE.name,)
    firmware = inputs.firmware if axis == "roll" else _firmware_on_axis(inputs.firmware, axis, roll)
    lead = engine_lead(channel) if inputs.lead else None
    fixed = shipped_tuning(channel, vehicle, inputs.spec)
    if firmware is not None:
        late = channel.added_delay + firmware.output_delay
        channel = replace(channel, angle_from_gyro=firmware.estimates_attitude, added_delay=late)
        fixed = replace(fixed, controller=BASELINE.name, lead=None, firmware=firmware)
    before = assess(channel, fixed, need)
    model = predictor_model(channel, inputs.source)
    start = replace(fixed, predictor=roll.predictor if roll else vehicle.control.predictor)
    if names == (LAW,):
        return design_axis_at_limit(AxisDesign(channel, before, {}, None, {}, {}), start, model, need, roll, say)
    tried: dict[str, TuningResult] = {}
    for with_lead in (None,) if lead is None else (None, lead):
        for name in names:
            if with_lead and len(names) > 1 and not PREDICTORS[name].with_lead:
                continue
            key = name + WITH_LEAD if with_lead else name
            say(f"{axis}: {key}")
            tried[key] = tune(channel, name, model, start, need, not predicted, with_lead)
    objectives = {key: result.objective for key, result in tried.items()}
    best = tried[find_simplest(objectives)]
    if not isfinite(best.objective):
        nearest = describe_nearest(channel, tried, need)
        return AxisDesign(channel, before, objectives, None, {}, {}, nearest=nearest)
    settled = tune_digits(channel, best.tuning, need, not predicted)
    if settled is None and firmware is not None and firmware.units is not None:
        return AxisDesign(channel, before, dict.fromkeys(tried, inf), None, {}, {})  # no rounded tuning is feasible
    after = assess(channel, settled or best.tuning, need)
    limits = {}
    if axis == "roll":
        say("what limits it")
        limits = bandwidths_without_limits(channel, after, need, lead)
    return AxisDesign(channel, before, objectives, after, limits, tolerance_checks(channel, after.tuning, need))
