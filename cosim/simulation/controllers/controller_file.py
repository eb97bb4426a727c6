"""The controller file: the result of a design, as ``hexjet fly --controller FILE.toml`` reads it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from cosim.base.errors import InputError, nearest
from cosim.base.removed import WRITTEN_BEFORE
from cosim.base.storage.toml import Model, NotNegative, merge, parse_setting, read_toml, set_path, validate
from cosim.control.predictors.registry import PREDICTORS
from cosim.engine import EngineSpec, find_source, load_engine
from cosim.spec.file_kind import DESIGN, check_kind
from cosim.spec.scenario import FlownParameters, Scenario, find_scenario, parameter_files
from cosim.spec.scenario.parameter_file import parse_table
from cosim.spec.vehicle import Vehicle, aircraft_name, aircraft_names, aircraft_seen_from, load_vehicle

NO_PROOF = "has no proof flights: made without one, or for another autopilot, or before designs had them"
LAW = "optimal"  # name of the law by convex optimisation


class Requirements(Model):
    """The requirements that a design must meet."""

    max_sensitivity: float = 1.7
    delay_tolerance: NotNegative = 0.3  # fraction of the delay, or one sample
    gain_tolerance: NotNegative = 0.3
    # Relative error of one engine's gain and lag in the proof; None: 0.3, or a smaller gain tolerance.
    engine_spread: Annotated[float | None, Field(ge=0.0, lt=1.0, exclude_if=lambda value: value is None)] = None
    # Least bandwidth [Hz] of roll and pitch: a loop of 1 rad/s settles within 5 % in 3 s, half of the roll doublet.
    min_bandwidth_hz: NotNegative = 0.16
    max_overshoot: float = 0.2  # step's overshoot, oscillatory engine
    # Deviation of the command by noise, over its range: three standard deviations take a quarter of it.
    noise_share: float = 0.0833
    step_rad: float = 0.1745  # roll doublet that must not saturate

    def delay_samples(self, transport: float) -> float:
        """Return the tolerance of a transport delay, both in samples."""
        return max(1.0, self.delay_tolerance * transport) if self.delay_tolerance else 0.0


class AxisRecord(Model):
    """Design results of one channel, for people; not read by flights."""

    controller: str
    peak_sensitivity: float
    gain_margin_db: float | None = None  # margin for more gain
    gain_margin_down_db: float | None = None  # margin for less gain; None: older file
    phase_margin_deg: float | None = None
    delay_margin_s: float | None = None
    bandwidth_hz: float
    tolerated: float  # stable up to this times the tolerances
    overshoot: float | None = None  # overshoot of a step; None: older file
    settling_s: float | None = None  # time to within 5 % of a step
    candidates: dict[str, float] = Field(default_factory=dict)  # acceptable ones by minimised objective


class LevelRecord(Model):
    """Design results at one level of fuel, of the channels that engines drive."""

    fuel: float  # fraction of the tank
    mass_kg: float
    share: float  # hover thrust in the engines' range
    designed: bool  # False: interpolated between two levels
    held: dict[str, float] = Field(default_factory=dict)  # peak sensitivity with full-tank gains
    axes: dict[str, AxisRecord]


class FlownRecord(Model):
    """Measures of one proof flight with shipped and designed gains; not read by flights.

    By the keys of :data:`hexjet_design.proof.comparison.MEASURES`; what a flight does not tell is left out.
    """

    flight: str  # "hover", or a doublet
    shipped_lost: str = ""  # failure of the shipped gains, if any
    shipped: dict[str, float] = Field(default_factory=dict)  # measures of flight with shipped gains
    designed: dict[str, float] = Field(default_factory=dict)  # measures of flight with designed gains


class ProofRecord(Model):
    """Record of the flights that proved a design, without effect on later flights."""

    flights: int  # flights that met the requirements
    failed: str | None = None  # why an earlier proof failed
    lean_deg: float  # amplitude of the doublets
    worse: list[str] = Field(default_factory=list)  # measures worse than with shipped gains
    flown: list[FlownRecord] = Field(default_factory=list)  # pairs of flights, shipped and designed


class Purpose(Model):
    """The vehicle, engine and step that a controller was designed for."""

    aircraft: str
    engine: str
    # Paths of aircraft and engine from the controller file's folder; None: not files, or version 0.2.0.
    aircraft_path: str | None = None
    engine_path: str | None = None
    family: str  # engine family of the models
    # Hash of a shipped engine's equations, else of the archive; older files always have the archive's.
    engine_sha256: str
    engine_parameters: dict[str, float] = Field(default_factory=dict)  # parameters not at the engine's own value
    vehicle_changes: dict[str, Any] = Field(default_factory=dict)  # vehicle keys not at the aircraft's value
    step_s: float
    substeps: int
    added_delay_samples: int = 0
    bank_inertia_kg_m2: float | None = None  # of a tilting bank; None: older file
    model: str  # origin of the model
    misfit: float | None = None  # engine model's misfit; None: negligible
    # (Hz, ratio): relative error bound of the engine model.
    unsure: list[tuple[float, float]] | None = None
    requirements: Requirements
    tolerances: str | None = None  # origin: engine's uncertainty, or None
    axes: dict[str, AxisRecord]
    levels: list[LevelRecord] = Field(default_factory=list)
    proof: ProofRecord | None = None  # None: left out, or an older file

    def find_engine(self, file: Path) -> str:
        """Return the engine of the design in a controller file, a name or an absolute path."""
        return self.engine if self.engine_path is None else os.path.abspath(file.parent / self.engine_path)

    def find_aircraft(self, file: Path) -> str:
        """Return the aircraft of the design in a controller file, a name or an absolute path.

        Raises InputError where it is not there.
        """
        if self.aircraft_path is None and self.aircraft in aircraft_names():
            return self.aircraft
        path = None if self.aircraft_path is None else os.path.abspath(file.parent / self.aircraft_path)
        if path is not None and os.path.exists(path):
            return path
        where = "is not shipped" if path is None else f"is not at {path}"
        raise InputError(f"{file}: designed for aircraft {self.aircraft!r}, which {where}; name it as aircraft")


class ControllerFile(Model):
    """Contents of a controller file."""

    controller: str
    controller_parameters: dict[str, float] = Field(default_factory=dict)  # parameters of a law at the limit
    vehicle: dict[str, Any]
    design: Purpose

    def check_step(self, path: Path, step: float) -> None:
        """Raise InputError if the controller was designed for another control step [s]."""
        if abs(step - self.design.step_s) > 1e-9:
            raise InputError(f"{path}: designed for steps of {self.design.step_s:g} s, not of {step:g} s")


def read_purpose(path: Path) -> Purpose:
    """Return the vehicle, engine and step that a controller file was made for.  Raises InputError."""
    return validate(ControllerFile, read_toml(path), str(path)).design


def describe_proof(purpose: Purpose) -> str:
    """Return lines on a design's proof, and on measures that are worse than with shipped gains."""
    proof = purpose.proof
    if proof is None:
        return NO_PROOF
    if proof.failed:
        return "; ".join([f"its proof failed: {proof.failed}", *proof.worse])
    return "; ".join([f"its proof of {proof.flights} flights kept what was promised", *proof.worse])


def read_controller(path: Path, aircraft: str | None = None, folder: Path = Path()) -> ControllerFile:
    """Read a controller file, for ``aircraft`` if given; paths are relative to ``folder``.

    Raises InputError that names the file and what is wrong with it, also for one that was made for another aircraft.
    """
    table = read_toml(path)
    check_kind(table, path, DESIGN)
    file = validate(ControllerFile, table, str(path))
    _check_controller(file, path)
    made_for = file.design.aircraft
    if aircraft is not None and aircraft_name(aircraft, folder) != made_for:
        flown = aircraft_name(aircraft, folder)
        raise InputError(f"{path}: designed for aircraft {made_for!r}, not for {flown!r}")
    aircraft = aircraft or file.design.find_aircraft(path)
    load_vehicle(aircraft, file.vehicle, f"{path}: vehicle", folder)
    original, _ = load_vehicle(aircraft, folder=folder)
    control = file.vehicle.get("control", {})
    if "schedule" not in control and original.control.schedule:
        # In a file from before schedules the gains hold for every thrust: the aircraft's schedule must not apply.
        without = merge(file.vehicle, {"control": {"schedule": False}})
        file = file.model_copy(update={"vehicle": without})
    if _predates_bank_reaction(file, original):
        raise InputError(f"{path}: {WRITTEN_BEFORE}")
    return file


def _check_controller(file: ControllerFile, path: Path) -> None:
    """Refuse a controller that designs do not make, and unknown parameters.  Raises InputError."""
    from cosim.simulation.controllers.source import find_controller_source

    complaint = f"{path}: controller = {file.controller!r}"
    if file.controller == LAW:
        source = find_controller_source(LAW, Path(), complaint)
        assert source is not None
        source.resolve_values(file.controller_parameters, f"{path}: controller_parameters")
        return
    if file.controller not in PREDICTORS:
        raise InputError(f"{complaint}; {nearest(file.controller, [*PREDICTORS, LAW])}")
    if file.controller_parameters:
        raise InputError(f"{path}: controller_parameters: of controller {LAW!r} alone, not of {file.controller!r}")


def _predates_bank_reaction(file: ControllerFile, original: Vehicle) -> bool:
    """Return whether a file predates the model of the banks' reaction, which version 0.2.0 has."""
    servo = original.servo
    stated = any(
        "bank_inertia_kg_m2" in table.get("servo", {}) for table in (file.vehicle, file.design.vehicle_changes)
    )
    return file.design.bank_inertia_kg_m2 is None and not stated and bool(servo and servo.bank_inertia_kg_m2)


def apply_controller(
    scenario: Scenario | str | Path, path: Path, settings: Sequence[str] = (), aircraft: str | None = None
) -> Scenario:
    """Return a scenario with a controller file applied, and then settings; a scenario is given as such or by name.

    What it expects was stated with other gains and is left out.  ``settings``: ``KEY=VALUE``, the value as TOML has it.
    ``aircraft``: who flies it; None: the scenario's, or the design's with its engine where the scenario's file names
    none.
    Raises InputError for a file made for another aircraft or control step, and as :meth:`Scenario.load`.
    """
    if isinstance(scenario, Scenario):
        original: Scenario | None = scenario.origin or scenario
        where = f"scenario {scenario.name}"
        table, folder, known = scenario.stated(), scenario.folder, scenario.parameter_files
    else:
        source = find_scenario(scenario)
        original, where, table, folder = Scenario.as_filed(source), str(source), read_toml(source), source.parent
        known = original.parameter_files if original is not None else []
    named, seen_from = (table.get("aircraft"), folder) if aircraft is None else (aircraft, Path())
    flown = None if named is None else aircraft_seen_from(named, seen_from)
    file = read_controller(path, flown)
    for key in ("controller_parameters", "controller_sha256"):  # these keys belong to the scenario's own
        table.pop(key, None)
    if flown is None:
        flown = file.design.find_aircraft(path)
        if flown != Scenario.model_fields["aircraft"].default:
            table["engine"] = file.design.find_engine(path)
    written = {"aircraft": flown, "controller": file.controller, "vehicle": file.vehicle, "expect": []}
    if file.controller_parameters:
        written["controller_parameters"] = file.controller_parameters
    table = merge(table, written | {"parameter_files": parameter_files(known, "design", path)})
    for text in settings:
        keys, value = parse_setting(text)
        set_path(table, keys, value, f"{where}: settings")
    changed = Scenario.from_table(table, folder, where, original)
    file.check_step(path, changed.step_s)
    return changed


def list_differences(scenario: Scenario, path: Path, noted: bool = True) -> list[str]:
    """Return lines on how a flight differs from what its controller file was designed for.

    Without ``noted`` those are left out that the flight's own record has (:func:`list_design_notes`).
    """
    file = validate(ControllerFile, read_toml(path), str(path))
    made = file.design
    source, parameters = find_source(scenario.engine, scenario.folder), scenario.engine_parameters
    unchecked, apart = scenario.engine_unchecked, scenario.engine_isolated
    spec = load_engine(source, parameters, scenario.step_s, unchecked=unchecked, isolated=apart)
    lines = _list_proof_and_engine_notes(made, spec) if noted else []
    if made.engine_sha256 in (spec.identity, spec.sha256) and (
        any(spec.parameters.get(key) != value for key, value in made.engine_parameters.items())
        or any(made.engine_parameters.get(key) != value for key, value in scenario.engine_parameters.items())
    ):
        lines.append(
            f"designed for engine parameters {made.engine_parameters or 'of its own'}, flown with "
            f"{dict(scenario.engine_parameters) or 'its own'}"
        )
    flown, given = _airframe_changes(scenario.vehicle), _airframe_changes(made.vehicle_changes)
    if flown != given:
        lines.append(f"designed for {made.aircraft} with {given or 'no changes'}, flown with {flown or 'none'}")
    for key in ("substeps", "added_delay_samples"):
        if getattr(scenario, key) != getattr(made, key):
            lines.append(f"designed for {key} = {getattr(made, key)}, flown with {getattr(scenario, key)}")
    return lines


def list_design_notes(parameters: Iterable[FlownParameters], engine: EngineSpec) -> list[str]:
    """Return notes on the design in a flight's record: failed or missing proof, or another engine.

    Empty where no design is among ``parameters``.  Raises InputError for one that is none.
    """
    return [
        f"{Path(each.file).name}: {line}"
        for each in parameters
        if each.kind == "design"
        for line in _list_proof_and_engine_notes(
            validate(ControllerFile, parse_table(each.content, each.file), each.file).design, engine
        )
    ]


def _list_proof_and_engine_notes(made: Purpose, spec: EngineSpec) -> list[str]:
    lines = [f"its proof failed: {made.proof.failed}"] if made.proof and made.proof.failed else []
    if made.proof is None:
        lines.append(NO_PROOF)
    if made.engine_sha256 not in (spec.identity, spec.sha256):
        lines.append(f"designed for engine {made.engine} ({made.engine_sha256[:12]}), flown with {spec.name} "
                     f"({spec.identity[:12]})")  # fmt: skip
    return lines


def _airframe_changes(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the changes of a vehicle other than those of its controller."""
    return {key: value for key, value in changes.items() if key not in ("control", "identified")}
