"""From a design to its controller file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.simulation.controllers.controller_file import AxisRecord, FlownRecord, LevelRecord, ProofRecord, Purpose
from cosim.spec.vehicle import RateModel, is_aircraft_path
from hexjet_design.assessment import Assessment
from hexjet_design.design import Design
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.tuning import round_gain
from hexjet_design.proof.comparison import FlownMeasures, worse_lines
from hexjet_design.proof.result import Proof


def make_controller_table(design: Design, folder: Path | None = None) -> dict[str, Any]:
    """Return the content of a controller file as a table; paths are relative to ``folder``, or absolute.

    Raises InputError for a design that was not found.
    """
    if not design.is_written:
        raise InputError(f"no acceptable design: {design.reason}")
    chosen = {axis: axis_design.after for axis, axis_design in design.axes.items() if axis_design.after is not None}
    roll, altitude = chosen["roll"].tuning, chosen["altitude"].tuning
    vehicle: dict[str, Any] = {
        "control": {
            "attitude": {"gain_1_s": [round_gain(chosen[axis].tuning.angle_gain) for axis in AXES]},
            "rate": {axis: _round_all(chosen[axis].tuning.gains.model_dump()) for axis in AXES},
            "altitude": {
                "position_1_s": round_gain(altitude.angle_gain),
                "velocity_1_s": round_gain(altitude.gains.p),
                "integral_1_s2": round_gain(altitude.gains.i),
            },
            "predictor": _round_all(roll.predictor.model_dump()),
        }
    }
    leads = {axis: axis_design.tuning.lead for axis, axis_design in chosen.items()}
    if any(leads.values()) or design.vehicle.control.lead is not None:
        # "False" overrides a lead that the aircraft states.
        vehicle["control"]["lead"] = {
            axis: _round_all(lead.model_dump(exclude_none=True)) if lead else False for axis, lead in leads.items()
        }
    if design.schedule is not None:
        vehicle["control"]["schedule"] = design.schedule.model_dump(mode="json", exclude_none=True)
    elif design.vehicle.control.schedule:
        vehicle["control"]["schedule"] = False  # overrides the aircraft's schedule
    if roll.needs_model:
        vehicle["identified"] = {
            design.engine.family: {
                axis: _undelayed_model(design.axes[axis].channel, chosen[axis], design).model_dump()
                for axis in AXES
                if chosen[axis].tuning.needs_model
            }
        }
    scenario, spec = design.scenario, design.engine
    dynamics = design.engine_dynamics
    purpose = Purpose(
        aircraft=design.vehicle.name,
        engine=spec.name,
        aircraft_path=_relative_path(scenario.aircraft, folder) if is_aircraft_path(scenario.aircraft) else None,
        engine_path=None if spec.library else _relative_path(scenario.engine, folder),
        family=spec.family,
        engine_sha256=spec.identity,
        engine_parameters=dict(scenario.engine_parameters),
        vehicle_changes=dict(scenario.vehicle),
        step_s=scenario.step_s,
        substeps=scenario.substeps,
        added_delay_samples=scenario.added_delay_samples,
        bank_inertia_kg_m2=design.vehicle.servo.bank_inertia_kg_m2 if design.vehicle.servo else None,
        model=design.model_source,
        misfit=round_gain(dynamics.misfit) if dynamics.unsure else None,
        unsure=[(round_gain(at), round_gain(misfit)) for at, misfit in dynamics.unsure] or None,
        requirements=design.need,
        tolerances=design.tolerances or None,
        axes={
            axis: _axis_record(axis_design.after, axis_design.candidates)
            for axis, axis_design in design.axes.items()
            if axis_design.after
        },
        levels=[
            LevelRecord(
                fuel=level.level.fuel,
                mass_kg=round_gain(level.level.mass_kg),
                share=round_gain(level.level.thrust_fraction),
                designed=level.designed,
                held={
                    axis: state.peak_sensitivity for axis, state in level.unscheduled.items() if state.peak_sensitivity
                },
                axes={axis: _axis_record(state) for axis, state in level.after.items() if state.stable},
            )
            for level in design.levels
        ],
        proof=make_proof_record(design.proof) if design.proof else None,
    )
    return {
        "controller": roll.controller,
        **({} if roll.law is None else {"controller_parameters": dict(roll.law)}),
        "vehicle": vehicle,
        "design": purpose.model_dump(mode="json", exclude_none=True),
    }


def _relative_path(file: str, folder: Path | None) -> str:
    return file if folder is None else Path(os.path.relpath(file, folder)).as_posix()


def make_proof_record(proof: Proof) -> ProofRecord:
    """Return the record of a proof for a controller file."""
    return ProofRecord(
        flights=len(proof.flights),
        failed=proof.reason or None,
        lean_deg=round_gain(proof.lean_deg),
        worse=worse_lines(proof.compared),
        flown=[
            FlownRecord(
                flight=pair.flight,
                shipped_lost=pair.shipped.failure,
                shipped=_round_measures(pair.shipped),
                designed=_round_measures(pair.designed),
            )
            for pair in proof.compared
        ],
    )


def _round_measures(measures: FlownMeasures) -> dict[str, float]:
    return {key: round_gain(value) for key, value in measures.values.items() if value is not None}


def _round_all(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _round_all(value) if isinstance(value, dict) else round_gain(value) for key, value in table.items()}


def _undelayed_model(channel: Channel, chosen: Assessment, design: Design) -> RateModel:
    """Return the predictor's model without the controller's added delay, which the flight adds again."""
    model = chosen.tuning.model
    origin = {"source": design.model_source, "engine_sha256": design.engine.fingerprint}
    return model.model_copy(update={"delay_samples": model.delay_samples - channel.added_delay, **origin})


def _axis_record(after: Assessment, candidates: Mapping[str, float] | None = None) -> AxisRecord:
    assert after.margins is not None
    same = ("controller", "peak_sensitivity", "bandwidth_hz", "tolerated", "overshoot", "settling_s")
    return AxisRecord.model_validate(
        {
            **{name: getattr(after, name) for name in same},
            "gain_margin_db": after.margins.gain_db,
            "gain_margin_down_db": after.margins.gain_down_db,
            "phase_margin_deg": after.margins.phase_deg,
            "delay_margin_s": after.margins.delay_s,
            "candidates": {name: value for name, value in (candidates or {}).items() if isfinite(value)},
        }
    )
