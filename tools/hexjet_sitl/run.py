"""A flight flown by an external autopilot as a run: folder, report, and a record from which it flies again."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

from cosim import FlightError, InputError, Run, Scenario
from cosim.base.geodesy import gravity
from cosim.base.outcomes import Outcome
from cosim.base.protocols import Observer
from cosim.base.signals import Sample
from cosim.files import write_whole
from cosim.flight import record, with_page
from cosim.results.resolved_scenario import resolve
from cosim.results.run import AUTOPILOT
from cosim.simulation.build import build
from cosim.simulation.controllers.recorded import ACTUATORS, COLUMNS, format_header, format_row
from cosim.simulation.controllers.source import Source
from cosim.simulation.pacing import Pace
from hexjet_sitl.block import AutopilotBlock, StationarySensors
from hexjet_sitl.lockstep import Autopilot, FirmwareReport, LockstepCounts

LOCKSTEP = "lockstep.json"  # in a run's folder: what was counted


@dataclass(frozen=True)
class AutopilotRun:
    """A run, and the counts of its lockstep."""

    run: Run
    counts: LockstepCounts
    autopilot: str


class _AnswerWriter:
    """Writer of the autopilot's answers beside the log, so that what was flown is there after a kill too."""

    def __init__(self, path: Path, block: AutopilotBlock, jets: int, servo: bool) -> None:
        self._block, self._servo, self._written = block, servo, 0
        try:
            self._file: IO[str] = path.open("w")
            self._file.write(format_header(jets, servo) + "\n")
            self._file.flush()
        except OSError as error:
            raise InputError(f"{path}: {error.strerror or error}") from error

    def observe(self, sample: Sample, flush_rows: int = 250) -> None:
        """Write the new answers once there is about a second of them.  ``flush_rows``: rows, a second of flight."""
        if len(self._block.rows) - self._written >= flush_rows:
            self.write()

    def write(self) -> None:
        """Write all new answers.  Raises FlightError where the disk is full."""
        rows = self._block.rows
        try:
            for row in rows[self._written :]:
                self._file.write(format_row(row, self._servo) + "\n")
            self._file.flush()
        except OSError as error:
            raise FlightError(f"{self._file.name}: {error.strerror or error}") from error
        self._written = len(rows)

    def close(self) -> None:
        self.write()
        self._file.close()


def _close_and_check_names(outcome: Outcome, reason: str, autopilot: Autopilot) -> tuple[Outcome, str]:
    """Close the autopilot, and return how the flight ended: failed if a parameter's name is none that it has."""
    autopilot.close()
    try:
        unchecked_reason = autopilot.check_parameters()
    except FlightError as error:
        return "failed", f"{reason}; {error}" if outcome != "completed" and reason else str(error)
    return outcome, "; ".join(filter(None, (reason, unchecked_reason)))


def _identify_parameters(firmware: FirmwareReport, details: Mapping[str, Any]) -> dict[str, Any]:
    """Return the hash of the parameters that flew: all of the autopilot's by its log, else those that it was given."""
    flown = firmware.parameters or details.get("parameters") or {}
    if not flown:
        return {}
    text = "".join(f"{name}={value:.9g}\n" for name, value in sorted(flown.items()))
    return {"parameters_flown": len(flown), "parameters_sha256": sha256(text.encode()).hexdigest()}


def _write_messages(folder: Path, firmware: FirmwareReport, start: float, step: float) -> None:
    """Write what the autopilot said into the run's record, from which its page has it; ``start`` [s] of the flight.

    What it said before is at the first step.
    """
    if not firmware.messages:
        return
    said = [] if not firmware.version else [(start, 6, f"version {firmware.version}")]
    lines = [
        json.dumps({"k": max(round((time_s - start) / step), 0), "kind": "message", "severity": severity, "text": text})
        for time_s, severity, text in [*said, *firmware.messages]
    ]
    write_whole(folder / AUTOPILOT, "\n".join([*lines, ""]), FlightError)


def fly_autopilot(
    scenario: Scenario,
    autopilot: Autopilot,
    folder: Path,
    *,
    observers: Sequence[Observer] = (),
    realtime_factor: float | None = None,
    page: bool = True,
) -> AutopilotRun:
    """Fly a scenario with an autopilot in the place of the controller, and close the autopilot.

    ``page``: whether to make one.  A crash, an autopilot that ends or hangs, and Ctrl-C are outcomes, and the run is
    kept.  Raises InputError for what cannot be flown, and FlightError for an autopilot that does not begin; there is no
    run then.  The autopilots' own bounds of a step are shorter than its hour.
    """
    label, block = autopilot.name, AutopilotBlock(autopilot)
    try:
        vehicle = scenario.resolved_vehicle()[0]
        if vehicle.allocation == "effectiveness":
            raise InputError(
                f"{vehicle.name}: is flown by effectiveness; the outputs and parameters of an autopilot are known here "
                "for two banks, and for jets that all point straight up"
            )
        source = Source(
            f"autopilot:{label}",
            "controller",
            lambda: block,
            {} if autopilot.program is None else {autopilot.program.name: autopilot.program},
            columns=COLUMNS,
            is_copied=False,
        )
        scenario = scenario.replace(controller=source.name, controller_limit_s=3600.0, expect=[])
        with build(scenario, source) as simulation:
            autopilot.start()
            recording = record(simulation, folder)
            vehicle = simulation.vehicle
            block.truth, block.silent = lambda: simulation.state, lambda: simulation.sensors.silent
            environment, state = scenario.environment, simulation.state
            local_gravity = gravity(environment.latitude_deg, environment.ground_m + state.altitude)
            block.stand = StationarySensors(
                vehicle.sensors, simulation.dt, scenario.seed, scenario.sensor_noise, state, local_gravity
            )
            writer = _AnswerWriter(folder / ACTUATORS, block, len(vehicle.jets), vehicle.servo is not None)
            recorded: dict[str, Any] = {"controller": ACTUATORS, "controller_sha256": None, "controller_parameters": {}}
            recording.replace_scenario(resolve(simulation)[0].model_copy(update=recorded))
            pace = Pace(simulation.dt, realtime_factor)
            begin = time.perf_counter()
            try:
                block.begin(simulation.measured)
                begin = time.perf_counter()
                all_observers: list[Observer] = [recording, writer, *simulation.plugins.observers, *observers]
                ending = simulation.run(all_observers, pace if realtime_factor else None)
                simulation.plugins.close()
                outcome, reason = ending.outcome, ending.reason
            except FlightError as error:
                outcome, reason = "failed", f"{error}, before the flight" if simulation.k == 0 else str(error)
            except KeyboardInterrupt:
                outcome, reason = "failed", f"interrupted at {simulation.k * simulation.dt:.3f} s"
            wall = time.perf_counter() - begin
            writer.close()
            outcome, reason = _close_and_check_names(outcome, reason, autopilot)
            digest = sha256((folder / ACTUATORS).read_bytes()).hexdigest()
            recording.replace_scenario(
                resolve(simulation)[0].model_copy(update=recorded | {"controller_sha256": digest})
            )
            firmware = autopilot.report()
            _write_messages(folder, firmware, block.start_s, simulation.dt)
            report = {"autopilot": label, "version": firmware.version, "steps": simulation.k}
            report |= asdict(autopilot.counts) | autopilot.details | _identify_parameters(firmware, autopilot.details)
            (folder / LOCKSTEP).write_text(json.dumps(report, indent=2) + "\n")
            run = recording.finish(outcome, reason, wall, pace.report if realtime_factor else None)
            return AutopilotRun(with_page(run) if page else run, autopilot.counts, label)
    finally:
        autopilot.close()
