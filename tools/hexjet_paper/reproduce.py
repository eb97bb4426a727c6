"""``hexjet paper``: every experiment in both fidelities, the comparison, the claims, and the report.

The work is cut into parts that do not depend on one another; each is kept in ``parts/`` when it is done, under a name
that changes with whatever it was made from, so that a second call goes on where the first one ended.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import numpy as np
import tomli_w
from pydantic import TypeAdapter
from scipy import constants

import cosim
from cosim import FlightError, InputError, Run, Scenario, fly, load_vehicle, versions
from cosim.api.call import Limits, Progress, check_types
from cosim.campaign import as_finished
from cosim.files import data_folder, write_whole
from cosim.identify import fit, identify_axis, identify_engine
from hexjet_paper import numbers
from hexjet_paper.claims import CONSISTENCY, Evidence, claim_rows
from hexjet_paper.comparison import LinearPart, comparison_rows, linear_part, write_csv
from hexjet_paper.experiments import CONTROLLERS, Experiment, Result, experiments, quadrotor_axis
from hexjet_paper.extensions import Reach, turbojet_plant
from hexjet_paper.flight import flight, scenario
from hexjet_paper.frozen import load
from hexjet_paper.linear import STATE_AS_PRINTED
from hexjet_paper.loops import LOW_END_HZ, Sweep, controllers_response, measured_sweep
from hexjet_paper.readings import READINGS, fly_model_errors, fly_reading
from hexjet_paper.report.page import write_page
from hexjet_paper.report.result import (
    COMPARISON,
    DATA,
    REPORT,
    Identified,
    Manual,
    Offset,
    Reproduction,
    Response,
    TurbojetFlight,
)

if TYPE_CHECKING:
    from cosim.identify import FrequencyResponse

FLIGHT_LOOPS = ("baseline", "smith", "state")  # controllers swept in flight
OFFSET_CONTROLLERS = tuple(c for c in CONTROLLERS if c not in ("baseline", STATE_AS_PRINTED))  # by offset
SCENARIOS = "scenarios"  # folder of the flown scenarios

Say = Callable[[str, int, int], None]  # label, done, total
Task = tuple[Callable[..., Any], tuple[Any, ...]]  # function and its arguments


@check_types(workers=Limits(1, 64))
def reproduce(out: str | Path = "runs/paper", *, workers: int = 2, progress: Progress | None = None) -> Reproduction:
    """Reproduce the paper: every experiment on the linear plant and in six degrees of freedom, number by number.

    Leaves comparison.csv, comparison.json and report.html.  An interrupted call goes on where it ended.

    Parameters
    ----------
    out : str or Path
        Where the result goes; parts that are there already are taken up.
    workers : int
        Processes.
    progress : Progress or None
        Hears which part is done.

    Returns
    -------
    Reproduction
        The numbers and the claims, and where the files are.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    folder, say = Path(out), (progress or Progress()).update
    _check_writable(folder)
    tasks = _list_tasks()
    parts = _run_tasks(tasks, folder / "parts", say, workers)
    parts |= _run_tasks(_list_turbojet_tasks(parts), folder / "parts", say, workers)
    write_scenarios(folder / SCENARIOS)
    files = {"comparison": folder / COMPARISON, "data": folder / DATA, "report": folder / REPORT}
    reproduction = replace(_assemble_parts(parts), files=files)
    write_csv(reproduction.rows, files["comparison"])
    write_whole(files["data"], json.dumps(reproduction.to_dict(), indent=1, allow_nan=False) + "\n")
    write_page(reproduction, files["report"])
    return reproduction


def _list_tasks() -> dict[str, Task]:
    """Return the parts by name, the longest first: for each a function for another process and its arguments."""
    tasks: dict[str, Task] = {"linear": (linear_part, ())}
    for controller in FLIGHT_LOOPS:
        tasks[f"loop.{controller}"] = (fly_sweep, (controller,))
    tasks["identification"] = (identify, ())
    tasks |= {f"reading.{key}": (fly_reading, (key,)) for key in READINGS}
    tasks["model-errors"] = (fly_model_errors, ())
    for experiment in sorted(flight_experiments(), key=lambda e: -e.run):
        tasks[experiment.name] = (fly_experiment, (experiment,))
    tasks["manual"] = (fly_manual, ())
    for controller in OFFSET_CONTROLLERS:
        tasks[f"offset.{controller}"] = (fly_offset, (controller,))
    return tasks


def flight_experiments() -> list[Experiment]:
    """Return the experiments that are flown: all without the matrices as printed."""
    return [e for e in experiments() if e.controller != STATE_AS_PRINTED]


def _list_turbojet_tasks(parts: Mapping[str, Any]) -> dict[str, Task]:
    """Return the parts whose gains the linear plant gives, and which are flown after it."""
    linear: LinearPart | None = parts.get("linear")
    return {
        f"turbojet.{reach.controller}": (fly_turbojet, (reach,))
        for reach in (linear.turbojet if linear else [])
        if reach.engine == "turbojet" and reach.tuning is not None
    }


def fly_turbojet(reach: Reach) -> TurbojetFlight:
    """Fly the roll doublet on true turbojets at the gains of a searched loop, with noise."""
    assert reach.tuning is not None
    _, believed = turbojet_plant()
    gains = load_vehicle("hexjet")[0].control.attitude.gain_1_s
    control = {
        "rate": {"roll": {"p": reach.p, "i": 0.0, "d": reach.d}},
        "attitude": {"gain_1_s": [reach.attitude_gain, *gains[1:]]},
        "predictor": reach.tuning.model_dump(),
    }
    vehicle = {"identified": {"turbojet": {"roll": believed.model_dump()}}, "control": control}
    doublet = Scenario.load("roll-doublet")
    run = fly(doublet.replace(controller=reach.controller, engine="turbojet", expect=[], vehicle=vehicle))
    roll = run.metrics["roll"]
    return TurbojetFlight(reach.controller, run.outcome, roll.overshoot_percent, roll.settling_time_s, roll.rmse_rad)


def write_scenarios(folder: Path) -> None:
    """Write each flown experiment as a scenario file for ``hexjet fly FILE``."""
    folder.mkdir(parents=True, exist_ok=True)
    frozen = load().parameters
    for experiment in flight_experiments():
        paper_scenario = scenario(experiment, frozen)
        text = tomli_w.dumps(paper_scenario.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
        write_whole(folder / f"{experiment.name}.toml", text)


def fly_experiment(experiment: Experiment) -> Result:
    """Fly one experiment in six degrees of freedom; return its metrics and series."""
    return flight(load().parameters)(experiment)


def fly_sweep(controller: str) -> Sweep:
    """Return the quadrotor's open loop ``C G*`` with 5 samples, measured in flight.

    A chirp is added to the rate controller's output; ``G* = y^ / u`` is the ratio of the Fourier transforms of the
    predicted rate and the command with the chirp in it (the record begins and ends at rest), ``C`` is known.
    """
    frozen = load().parameters
    experiment = Experiment("step", controller, 5)
    chirp = {
        "kind": "torque_command",
        "axis": "roll",
        "shape": "sweep",
        "start_s": 1.0,
        "duration_s": 30.0,
        "amplitude": 0.004,
        "from_hz": 0.5,
        "to_hz": 25.0,
        "at": "controller",
        "seen": True,
    }
    chirped = scenario(experiment, frozen, noisy=False).replace(duration_s=35.0, command=[], disturbance=[chirp])
    log = fly(chirped).log
    command = log["torque_roll"] + log["disturbance_torque_roll"]
    hertz = np.geomspace(0.8, 15.0, 160)
    kernel = np.exp(-2j * np.pi * hertz[:, None] * log["time_s"])
    axis = quadrotor_axis(frozen, controller, 5, noisy=False)
    of_error, of_slope = controllers_response(axis, np.exp(2j * np.pi * hertz * axis.step))
    response = (of_error + of_slope) * (kernel @ log["rate_p_predicted_rad_s"]) / (kernel @ command)
    return measured_sweep(hertz, response)


def fly_manual() -> Manual:
    """Fly the Hex-Jet's manual flight; return tracking errors, and every tenth sample for the figure."""
    run = fly(Scenario.load("manual"))
    tracking: dict[str, float] = {}
    angle, rate = {}, {}
    for (axis, metrics), letter in zip(run.metrics.items(), "pqr", strict=True):
        assert metrics.rmse_rad is not None
        assert metrics.rate_rmse_rad_s is not None
        tracking[f"hexjet-manual.{axis}.rmse"] = metrics.rmse_rad
        tracking[f"hexjet-manual.{axis}.rate_rmse"] = metrics.rate_rmse_rad_s
        angle[axis] = _take_every_tenth(run, f"{axis}_setpoint_rad", f"{axis}_rad")
        rate[axis] = _take_every_tenth(run, f"rate_{letter}_setpoint_rad_s", f"rate_{letter}_measured_rad_s")
    return Manual(tracking, run.log["time_s"][::10].tolist(), angle, rate)


def _take_every_tenth(run: Run, *names: str) -> tuple[list[float], list[float]]:
    command, response = (run.log[name][::10].tolist() for name in names)
    return command, response


def fly_offset(controller: str) -> Offset:
    """Fly hover for 26 s with half a kilogram 1 cm to the right from 1 s on; return roll over time."""
    load = {"kind": "payload", "start_s": 1.0, "mass_kg": 0.5, "offset_m": [0.0, 0.01, 0.0]}
    hover = Scenario.load("hover")
    log = fly(
        hover.replace(controller=controller, disturbance=[load], duration_s=26.0, sensor_noise=False, expect=[])
    ).log
    time, roll = log["time_s"], log["roll_rad"]
    tenth = round(0.1 / hover.step_s)
    start = round(1.0 / hover.step_s)
    last = roll[-round(1.0 / hover.step_s) :]
    return Offset(
        controller,
        [round(float(t) - 1.0, 6) for t in time[start::tenth]],
        [float(angle) for angle in roll[start::tenth]],
        float(np.mean(last)),
    )


def identify() -> Identified:
    """Identify the paper's models with this program, on FMUs and in flight."""

    values: dict[str, float] = {}
    responses = {}
    for engine in ("turbojet", "edf"):
        identified = identify_engine(engine)
        model = identified.model
        responses[engine] = _normalised_response(identified.response, constants.g)
        values[f"{engine}.gain"] = model.gain / constants.g
        values[f"{engine}.pole"] = model.poles[0]
        values[f"{engine}.time_constant"] = -model.sample_time_s / float(np.log(model.poles[0]))
        if engine == "turbojet":
            values["turbojet.delay"] = model.delay_samples * model.sample_time_s
    # One lag stands for those of engine and gyro filter. Lag and delay can be split in many ways, of which the paper
    # has one: so the lag is fitted with the paper's delay, and the delay with the paper's lag.
    delay, step = numbers.value("hexjet.delay"), numbers.value("hexjet.step")
    roll = identify_axis("roll", hold={"delay_samples": delay})
    values["roll.pole_slow"], values["roll.pole_fast"] = max(roll.model.poles), min(roll.model.poles)
    lag = -step / float(np.log(numbers.value("roll.pole_fast")))
    values["hexjet.delay"] = fit(roll.response, 1, "the paper's lag", {"lag_s": lag}).model.delay_samples
    responses["roll"] = _normalised_response(roll.response, 1.0)
    deviation = roll.reference_deviation()
    assert deviation is not None  # as G(z) is printed for this axis
    return Identified(values, responses, deviation, (roll.sweep.from_hz, roll.sweep.to_hz))


def _normalised_response(measured: FrequencyResponse, unit: float) -> Response:
    gain = measured.magnitude_db - 20.0 * np.log10(unit)
    return Response(measured.hertz.tolist(), gain.tolist(), measured.phase_deg.tolist())


def _run_tasks(tasks: Mapping[str, Task], folder: Path, say: Say, workers: int) -> dict[str, Any]:
    fingerprint = _hash_sources()
    files = {name: folder / f"{name}-{fingerprint}.json" for name in tasks}
    kinds = {name: TypeAdapter(get_type_hints(function)["return"]) for name, (function, _) in tasks.items()}
    parts = {name: part for name, file in files.items() if (part := _read_part(file, kinds[name])) is not None}
    say("parts", len(parts), len(tasks))
    names = [name for name in tasks if name not in parts]
    try:
        for index, part in as_finished(_run_task, [tasks[name] for name in names], workers):
            name = names[index]
            parts[name] = part
            write_whole(files[name], json.dumps(kinds[name].dump_python(part, mode="json")))
            say(name, len(parts), len(tasks))
    except FlightError as error:
        raise FlightError(f"{error}; what was finished is kept, call again") from error
    for old in {*folder.glob("*.json"), *folder.glob("*.pickle")} - set(files.values()):
        if old.name.rsplit("-", 1)[0] in tasks:
            old.unlink()  # made by other sources
    return {name: parts[name] for name in tasks}


def _run_task(task: Task) -> Any:
    function, arguments = task
    return function(*arguments)


def _check_writable(folder: Path) -> None:
    """Raise InputError if ``folder`` cannot be written to, before minutes of work."""
    try:
        (folder / "parts").mkdir(parents=True, exist_ok=True)
        write_whole(folder / "parts" / "test", b"")
        (folder / "parts" / "test").unlink()
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to: {error.strerror or error}") from error


def _read_part(file: Path, kind: TypeAdapter[Any]) -> Any:
    """Return a part that an earlier call wrote; None if it is missing or invalid.

    Parts are read as text and numbers alone, as the folder may be somebody else's.
    """
    try:
        return kind.validate_python(json.loads(file.read_bytes()))
    except (OSError, ValueError, RecursionError):  # ValidationError is a ValueError
        return None


def _hash_sources() -> str:
    """Return a hash of all that parts depend on: packages, vehicles, engines, scenarios, libraries."""
    digest = hashlib.sha256(json.dumps(versions(), sort_keys=True).encode())
    packages = [Path(__file__).parent, Path(cosim.__file__).parent]
    sources = [file for package in packages for file in package.resolve().rglob("*") if file.suffix in (".py", ".toml")]
    for folder, pattern in (("aircraft", "*/*.*ml"), ("engines", "**/*.[ct]*"), ("scenarios", "*.*")):
        sources += data_folder(folder).glob(pattern)
    for file in sorted(set(sources)):
        digest.update(file.name.encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _assemble_parts(parts: Mapping[str, Any]) -> Reproduction:
    part: LinearPart = parts["linear"]
    flights: dict[str, Result] = {e.name: parts[e.name] for e in flight_experiments()}
    sweeps: dict[str, Sweep] = {controller: parts[f"loop.{controller}"] for controller in FLIGHT_LOOPS}
    evidence = Evidence(
        metrics={name: result.metrics for name, result in flights.items()},
        margins={name: sweep.margins for name, sweep in sweeps.items()},
        gain_at_low_end={name: _interpolate_gain(sweep, LOW_END_HZ) for name, sweep in sweeps.items()},
        gain_at_8_hz={name: _interpolate_gain(sweep, 8.0) for name, sweep in sweeps.items()},
        tracking=parts["manual"].numbers,
    )
    extra: dict[str, float] = {**parts["manual"].numbers, **parts["identification"].numbers}
    return Reproduction(
        linear=part,
        flight_results=flights,
        flight_evidence=evidence,
        flight_sweeps=sweeps,
        offsets=[parts[f"offset.{controller}"] for controller in OFFSET_CONTROLLERS],
        turbojet=[part for name, part in parts.items() if name.startswith("turbojet.")],
        manual=parts["manual"],
        extra=extra,
        rows=comparison_rows(part.frozen, part.evidence, evidence, extra),
        claims=claim_rows(part.evidence, evidence),
        consistency=claim_rows(part.evidence, evidence, CONSISTENCY),
        readings=[parts[f"reading.{key}"] for key in READINGS],
        model_errors=parts["model-errors"],
        identified=parts["identification"],
    )


def _interpolate_gain(sweep: Sweep, hertz: float) -> float:
    return float(np.interp(np.log(hertz), np.log(sweep.frequency), sweep.gain))
