"""A flight flown by an external autopilot as a run: folder, report, and a record from which it flies again."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import IO, Any, Literal

from cosim import FlightError, InputError, Run, Scenario, design
from cosim.api.call import Limits, Progress, check_types
from cosim.api.call.choices import apply_choices
from cosim.api.flights import FlightResult
from cosim.base.geodesy import gravity
from cosim.base.outcomes import Outcome
from cosim.base.protocols import Observer
from cosim.base.signals import Sample
from cosim.base.storage.settings import as_settings
from cosim.files import parse_numbers, write_whole
from cosim.flight import new_folder, record, write_run_page
from cosim.results.resolved_scenario import resolve
from cosim.results.run import AUTOPILOT
from cosim.simulation.build import build
from cosim.simulation.controllers.recorded import ACTUATORS, COLUMNS, format_header, format_row
from cosim.simulation.controllers.source import Source
from cosim.simulation.pacing import Pace
from hexjet_sitl.ardupilot import PORT_SPACING, RC_PORT
from hexjet_sitl.block import AutopilotBlock, StationarySensors
from hexjet_sitl.lockstep import Autopilot, FirmwareReport, LockstepCounts, Setup
from hexjet_sitl.prepare import MAX_INSTANCES, describe_missing, find_program, prepare

LOCKSTEP_FILE = "lockstep.json"  # a run's file of lockstep counts


@dataclass(frozen=True)
class AutopilotRun:
    """Run flown by an autopilot, with the counts of its lockstep."""

    run: Run
    counts: LockstepCounts
    autopilot: str


class _AnswerWriter:
    """Observer that writes the autopilot's answers to a file during the flight, so that they survive a kill."""

    def __init__(self, path: Path, block: AutopilotBlock, jets: int, servo: bool) -> None:
        self._block, self._servo, self._written = block, servo, 0
        try:
            self._file: IO[str] = path.open("w")
            self._file.write(format_header(jets, servo) + "\n")
            self._file.flush()
        except OSError as error:
            raise InputError(f"{path}: {error.strerror or error}") from error

    def observe(self, sample: Sample, flush_rows: int = 250) -> None:
        """Write the answers of every ``flush_rows`` steps, 250 of which are about a second."""
        if len(self._block.rows) - self._written >= flush_rows:
            self.write()

    def write(self) -> None:
        """Write all answers since the last time.  Raises FlightError if the disk is full."""
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


def _close_and_check_parameters(outcome: Outcome, reason: str, autopilot: Autopilot) -> tuple[Outcome, str]:
    """Close the autopilot and return the outcome, which is failed if it lacks a given parameter."""
    autopilot.close()
    try:
        unchecked_reason = autopilot.check_parameters()
    except FlightError as error:
        return "failed", f"{reason}; {error}" if outcome != "completed" and reason else str(error)
    return outcome, "; ".join(filter(None, (reason, unchecked_reason)))


def _hash_parameters(firmware: FirmwareReport, details: Mapping[str, Any]) -> dict[str, Any]:
    """Return number and hash of the flown parameters, from the autopilot's log or else the given ones."""
    flown = firmware.parameters or details.get("parameters") or {}
    if not flown:
        return {}
    text = "".join(f"{name}={value:.9g}\n" for name, value in sorted(flown.items()))
    return {"parameters_flown": len(flown), "parameters_sha256": sha256(text.encode()).hexdigest()}


def _write_messages(folder: Path, firmware: FirmwareReport, start: float, step: float) -> None:
    """Write the autopilot's messages to the run's record; the flight begins at ``start`` [s] of its clock.

    Earlier messages are written at the first step.
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
            outcome, reason = _close_and_check_parameters(outcome, reason, autopilot)
            digest = sha256((folder / ACTUATORS).read_bytes()).hexdigest()
            recording.replace_scenario(
                resolve(simulation)[0].model_copy(update=recorded | {"controller_sha256": digest})
            )
            firmware = autopilot.report()
            _write_messages(folder, firmware, block.start_s, simulation.dt)
            report = {"autopilot": label, "version": firmware.version, "steps": simulation.k}
            report |= asdict(autopilot.counts) | autopilot.details | _hash_parameters(firmware, autopilot.details)
            (folder / LOCKSTEP_FILE).write_text(json.dumps(report, indent=2) + "\n")
            run = recording.finish(outcome, reason, wall, pace.report if realtime_factor else None)
            return AutopilotRun(write_run_page(run) if page else run, autopilot.counts, label)
    finally:
        autopilot.close()


class AutopilotResult(FlightResult):
    """Result of a flight by an autopilot, with lockstep counts and the origin of gains."""

    def __init__(self, flown: AutopilotRun, gains: str) -> None:
        super().__init__(flown.run)
        self.flown, self.gains = flown, gains

    def to_dict(self) -> dict[str, Any]:
        """Return the flight's summary, with the counts of the lockstep."""
        return super().to_dict() | {"lockstep": asdict(self.flown.counts) | {"gains": self.gains}}

    def lines(self) -> list[str]:
        """Return the printed lines of the flight, and the counts of the lockstep."""
        counts = self.flown.counts
        lockstep = (
            f"lockstep with {self.flown.autopilot}: {counts.frames} states sent, {counts.boot} before its first "
            f"answer, {counts.answers} answers, {counts.missing} missing, {counts.repeated} repeated, "
            f"{counts.foreign} foreign packets; longest wait {1e3 * counts.longest_s:.1f} ms"
        )
        gains = [] if self.gains in ("vehicle", "stock") else [f"gains of {self.gains}"]
        return [*super().lines(), lockstep, *gains]


@check_types(
    realtime_factor=Limits(0.0), time_limit_s=Limits(0.1, 600.0), port=Limits(1024, 65000),
    instance=Limits(0, MAX_INSTANCES), hold_from_s=Limits(0.0), station=Limits(1024, 65535),
)  # fmt: skip
def fly(
    autopilot: Literal["betaflight", "px4", "ardupilot"],
    scenario: Scenario | str | Path = "hover",
    out: str | Path | None = None,
    *,
    aircraft: str | Path | None = None,
    engine: str | Path | Sequence[str] | None = None,
    settings: Sequence[str] | Mapping[str, object] = (),
    seed: int | None = None,
    binary: Path | None = None,
    realtime_factor: float = 0.0,
    time_limit_s: float = 5.0,
    gains: str | None = None,
    lines: Sequence[str] = (),
    port: int = 9001,
    instance: int = 0,
    parameters: Sequence[str] = (),
    hold_from_s: float | None = None,
    hands_off: bool = False,
    magnetic_field: str | None = None,
    defaults: Path | None = None,
    channels: Sequence[str] = (),
    station: int | None = None,
    progress: Progress | None = None,
) -> AutopilotResult:
    """Let an external autopilot fly the vehicle: a program of its own, in strict lockstep with the flight.

    Vehicle, sensors, engines, wind and faults are those of the scenario; the autopilot is in the place of the
    controller.  The run's folder has its commands in actuators.csv, and hexjet fly on its scenario.toml repeats the
    flight bit for bit without it.  It is flown by the sticks: lean as the scenario asks, height and heading held by
    the pilot with the vehicle's own loops.

    Parameters
    ----------
    autopilot : str
        ``betaflight``, ``px4`` or ``ardupilot``.
    scenario : Scenario or str or Path
        What is flown.
    out : str or Path or None
        The run's folder; None: a new one in ``runs/``.
    aircraft : str or Path or None
        In place of the scenario's, with its engine.
    engine : str or Path or sequence of str or None
        In place of the scenario's, for all jets or for one, N.
    settings : sequence of str or mapping
        Written over the scenario's.
    seed : int or None
        In place of the scenario's.
    binary : Path or None
        The autopilot's program.
    realtime_factor : float
        Pace it at so many times real time; 0: as fast as both can.
    time_limit_s : float
        Time of the clock for an answer: an autopilot that takes longer is taken for hung.
    gains : str or None
        Rate and attitude gains: ``vehicle``, its own; ``stock``, as the autopilot ships; of a file of hexjet design
        for it; of Betaflight also ``designed``, searched for now as hexjet design does; None: that of Betaflight, else
        the vehicle's own.
    lines : sequence of str
        For Betaflight's console, e.g. "set p_roll = 12".
    port : int
        The first of its ports: N to N+3, and N+10 its console.  Flights at the same time need some each.
    instance : int
        Which of several at the same time: its ports, and what it is started with.
    parameters : sequence of str
        Over those of hexjet sitl params.
    hold_from_s : float or None
        From this second of the flight on it holds place and height by itself, by GNSS: Position mode, or Loiter.
    hands_off : bool
        Leave the vehicle, on the ground, to a ground station: sticks in the middle, no throttle, nobody is armed or
        disarmed, and what the scenario commands and limits is left out.
    magnetic_field : str or None
        The magnetic field to north, east and down [gauss]; None: the Earth's at the place.
    defaults : Path or None
        Its parameters; None: as hexjet sitl params ardupilot writes them.
    channels : sequence of str
        A switch of the transmitter [us], from second S of the flight on: 8=2000@2.
    station : int or None
        A ground station's UDP port on this machine, which it talks to; None: it talks to none.
    progress : Progress or None
        Hears notes, and how far a search for gains is.

    Returns
    -------
    AutopilotResult
        The run, and the counts of the lockstep.

    Raises
    ------
    InputError
        For a wrong choice, and for what the autopilot cannot be told.
    FlightError
        For an autopilot that does not begin.
    """
    hears = progress or Progress()
    for setting in as_settings(settings):
        if setting.partition("=")[0].strip() == "controller":
            raise InputError(
                f"settings: {setting}: the autopilot flies in the place of the controller; the gains of a design go "
                "into it by gains"
            )

    def load_with_controller(designed: str | None) -> Scenario:
        return apply_choices(scenario, designed, aircraft, engine, settings, seed, hears.note)

    gains = gains or ("designed" if autopilot == "betaflight" else "vehicle")
    words = [*(["designed"] if autopilot == "betaflight" else []), "vehicle", "stock"]
    if gains not in words and not gains.lower().endswith(".toml"):
        raise InputError(f"gains {gains}: must be {', '.join(words)}, or a file of hexjet design (.toml)")
    setup = Setup(
        instance, time_limit_s, port if autopilot == "betaflight" else None, gains, lines,
        parse_numbers(parameters, "parameters"), _parse_field(magnetic_field), hold_from_s, hands_off, defaults,
        channels, station,
    )  # fmt: skip
    flown = _relax_for_autopilot(load_with_controller(None if gains in words else gains), setup)
    program = find_program(autopilot, binary)
    folder = Path(out) if out else new_folder(Path("runs"), f"{flown.name}-{autopilot}")
    if gains == "designed":
        file = folder / autopilot / "gains.toml"
        flown = load_with_controller(str(search_gains(flown, as_settings(settings), file, hears)))
    prepared = prepare(autopilot, flown, folder, program, setup)
    if prepared.remark:
        hears.note(prepared.remark)
    if autopilot == "ardupilot":
        hears.note(
            f"ArduPilot listens for sticks at UDP port {RC_PORT + PORT_SPACING * instance} on every network interface "
            "of this machine, for states at one that the system draws, and cannot be told otherwise: close them to "
            "others"
        )
    if program is None:
        missing = f"no program is named ({describe_missing(autopilot)})"
        hears.note(f"{missing}: waiting for one at {prepared.endpoint} of this machine")
    return AutopilotResult(fly_autopilot(flown, prepared, folder, realtime_factor=realtime_factor or None), gains)


def search_gains(scenario: Scenario, settings: Sequence[str], out: Path, progress: Progress) -> Path:
    """Search gains for Betaflight's loops that suit a scenario; return the controller file.

    As ``hexjet design --for betaflight`` does, with its defaults; the file is ``out``, its page beside it.  Raises
    InputError where no gains keep the requirements.
    """
    made = design(scenario.engine, scenario.aircraft, autopilot="betaflight", settings=settings, progress=progress)
    files: dict[str, Path] = made.write(out).files
    if not made.ok:
        raise InputError(
            f"betaflight: no gains of its own loops keep the requirements of a design for {scenario.aircraft} with "
            f"engine {scenario.engine}, see {files['report']}; allowed: gains vehicle, stock, or a file"
        )
    return files["controller"]


def _relax_for_autopilot(scenario: Scenario, setup: Setup) -> Scenario:
    """Return the scenario without commands and limits that an autopilot, or a ground station, may not keep.

    In position hold an autopilot chooses its lean itself; a ground station ignores the scenario's commands.
    """
    limits: dict[str, Any] = scenario.limits.model_dump()
    if setup.hands_off:
        limits |= dict.fromkeys(("height_error_m", "place_error_m", "drift_m", "speed_m_s", "oscillation_rad"), False)
        return scenario.replace(command=[], expect=[], limits=limits)
    if setup.hold_from_s is None or scenario.limits.oscillation_rad is not None:
        return scenario
    return scenario.replace(limits=limits | {"oscillation_rad": False})


def _parse_field(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    try:
        north, east, down = (float(part) for part in text.split(","))
        if not 0.0 < north * north + east * east + down * down < 4.0:
            raise ValueError
    except ValueError:
        raise InputError(f"field {text}: must be north, east and down [gauss], such as 0.37,-0.02,0.24") from None
    return north, east, down
