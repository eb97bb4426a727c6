"""One flight from a scenario to a finished run.

What it is made of is imported when it flies: whoever has no more than the name does not wait for it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.base.errors import FlightError, InputError

if TYPE_CHECKING:
    from cosim.base.protocols import Observer
    from cosim.results.autopilot.request_log import Replay
    from cosim.results.log.recorder import KeepingSink
    from cosim.results.run import Recording, Run
    from cosim.simulation.controllers.source import Source
    from cosim.simulation.pacing import Pace
    from cosim.simulation.step import Simulation
    from cosim.spec.scenario import Scenario


def list_warnings(scenario: Scenario, controller: Any = None) -> list[str]:
    """Return warnings that the summary lacks: a design that differs from its file, useless times and formulas."""
    from cosim.results.requirements.stated import note_first_row
    from cosim.spec.controller_name import is_design

    lines = [f"scenario {scenario.name}: {text}" for text in (*scenario.after_the_end(), *note_first_row(scenario))]
    if isinstance(controller, (str, Path)) and is_design(str(controller)):
        from cosim.simulation.controllers.controller_file import list_differences

        lines += [f"{controller}: {text}" for text in list_differences(scenario, Path(controller), noted=False)]
    return lines


def check_arguments(scenario: object, out: object, realtime_factor: object) -> None:
    """Raise InputError for arguments of ``cosim.fly`` of a wrong type."""
    from cosim.spec.scenario import Scenario

    for name, value, allowed in (
        ("scenario", scenario, (Scenario, str, Path)),
        ("out", out, (str, Path, type(None))),
        ("realtime_factor", realtime_factor, (float, int, type(None))),
    ):
        if not isinstance(value, allowed):
            names = " | ".join("None" if each is type(None) else each.__name__ for each in allowed)
            raise InputError(f"fly: {name}: {value!r} is a value of type {type(value).__name__}; allowed: {names}")
        if isinstance(value, (str, Path)) and "\0" in str(value):
            raise InputError(f"fly: {name}: {str(value)!r} has a zero in it, and is no name")
    if isinstance(realtime_factor, (float, int)) and not realtime_factor >= 0.0:
        raise InputError(f"fly: realtime_factor: {realtime_factor:g}; allowed: above 0, or None for as fast as it goes")


def fly_watched(
    scenario: Scenario | str | Path,
    out: Path | str | None = None,
    *,
    controller: Any = None,
    observers: Sequence[Observer] = (),
    realtime_factor: float | None = None,
    report: bool = True,
    shared_assets: bool = False,
    watch: Callable[[Simulation, Pace, Path | None, float | None], Observer] | None = None,
    sink: KeepingSink | None = None,
) -> Run:
    """Fly a scenario like ``cosim.fly``, with further observers or another receiver of the log.

    ``watch`` makes a further observer of the flight when it is built, from the simulation, its pace, the folder and the
    planned duration [s].  ``sink`` may keep a part of the log, at least the columns of
    :func:`cosim.results.metrics.columns`; the summary has no delay ledger and no notes on how models and vehicle agree
    then, which take longer than a thousand steps.  Raises InputError.
    """
    from cosim.results.expectations import check_expected
    from cosim.results.resolved_scenario import resolve
    from cosim.simulation.build import build
    from cosim.simulation.ending import Ending
    from cosim.simulation.pacing import Pace
    from cosim.simulation.user_code import check_scenario_trust

    scenario, own = name_controller(scenario, controller)
    check_scenario_trust(scenario)  # trust is checked before metrics are read
    check_expected(scenario)
    with build(scenario, own, with_ledger=sink is None) as simulation:
        replay = _attach_replay(simulation) if scenario.requests is not None else None
        folder = None if out is None else Path(out)
        recording = record(simulation, folder, sink=sink)
        noting = None
        if replay is not None and folder:
            from cosim.results.autopilot.autopilot_record import PilotRecord
            from cosim.results.run import AUTOPILOT

            noting = PilotRecord(replay.pilot, folder / AUTOPILOT, simulation.dt)
        pace = Pace(simulation.dt, realtime_factor)
        watching = [*simulation.plugins.observers, *observers, *([noting] if noting else [])]
        watching += [watch(simulation, pace, folder, realtime_factor)] if watch else []
        begin = time.perf_counter()
        try:
            ending = simulation.run([recording, *watching], pace if realtime_factor or watch else None, replay)
            if noting is not None:
                noting.close()
            simulation.plugins.close()
        except FlightError as error:  # for example a full disk
            ending = Ending("failed", str(error))
        except KeyboardInterrupt:
            if sink is not None:  # a campaign stops too
                raise
            ending = Ending("failed", f"interrupted at {simulation.k * simulation.dt:.3f} s")
        wall = time.perf_counter() - begin
        if noting is not None:
            with suppress(FlightError):  # the error was reported before
                noting.close()
        reason = ending.reason
        if replay is not None and replay.otherwise:
            reason += f"; {len(replay.otherwise)} requests were answered otherwise, the first: {replay.otherwise[0]}"
        if simulation.faults.commanded and replay is None:  # faults commanded in flight
            recording.replace_scenario(resolve(simulation)[0])
        recording.note_repeatable(simulation.check_repeatable())
        run = recording.finish(ending.outcome, reason, wall, pace.report if realtime_factor else None)
        return write_run_page(run, shared_assets) if report else run


def _attach_replay(simulation: Simulation) -> Replay:
    """Attach an autopilot that repeats the recorded requests in place of commands.  Raises InputError."""
    from cosim.results.autopilot.request_log import Replay, read_requests
    from cosim.simulation.autopilot_setup import attach_autopilot

    scenario = simulation.scenario
    assert scenario.requests is not None
    pilot = attach_autopilot(simulation, not scenario.initial.on_ground)
    return Replay(pilot, read_requests(scenario.folder / scenario.requests))


def name_controller(scenario: Scenario | str | Path, controller: Any = None) -> tuple[Scenario, Source | None]:
    """Return a loaded scenario that names ``controller``, and that controller's source if it is an object.

    The parameters are those of ``cosim.fly``.  Raises InputError.
    """
    from cosim.simulation.controllers.controller_file import apply_controller
    from cosim.simulation.controllers.source import make_object_source
    from cosim.spec.controller_name import is_design, resolve_controller
    from cosim.spec.scenario import Scenario

    if isinstance(controller, (str, Path)) and is_design(str(controller)):
        return apply_controller(scenario, Path(controller)), None
    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(scenario)
    if controller is None:
        return scenario, None
    if isinstance(controller, (str, Path)):
        return scenario.replace(controller=resolve_controller(str(controller), Path())), None
    own = make_object_source(controller)
    return scenario.replace(controller=own.name), own


def write_run_page(run: Run, shared_assets: bool = False) -> Run:
    """Write a run's HTML page into its folder, if it has one, and return the run.  Raises FlightError."""
    if run.folder is not None:
        from cosim.results.report.flight import write_report
        from cosim.results.run import REPORT

        write_report(run, run.folder / REPORT, shared_assets)
    return run


def record(
    simulation: Simulation,
    folder: Path | None,
    contents: Mapping[str, Path | bytes] | None = None,
    background: bool = False,
    sink: KeepingSink | None = None,
) -> Recording:
    """Begin recording a flight in ``folder`` or in memory; ``contents``: files of the scenario.

    ``sink`` may keep a part of the log in memory.  ``background``: a thread writes the rows.  Raises InputError if the
    folder is not usable.
    """
    from cosim.results.log.columns import log_columns, logged_vehicle
    from cosim.results.resolved_scenario import resolve
    from cosim.results.run import begin_run
    from cosim.results.setup import make_setup

    resolved, files = resolve(simulation)
    columns = log_columns(logged_vehicle(simulation.vehicle), simulation.columns)
    files |= dict(contents or {})
    metrics = simulation.plugins.metrics
    setup = make_setup(simulation, resolved, notes=sink is None)  # a campaign needs no notes per flight
    if folder is None:  # paths of parameter files are kept
        scenario = simulation.scenario
        resolved = resolved.resolved(parameter_files=[f.resolve(scenario.folder) for f in scenario.parameter_files])
    return begin_run(setup, resolved, folder, files, background, sink, columns, metrics)


def new_folder(parent: Path, name: str) -> Path:
    """Return the path ``parent/name-001``, or the first number whose folder does not exist.

    >>> new_folder(Path("runs"), "hover").name
    'hover-001'
    """
    number = 1
    while (folder := parent / f"{name}-{number:03d}").exists():
        number += 1
    return folder


def reserve_folder(parent: Path, name: str) -> Path:
    """Create the folder of :func:`new_folder`; concurrent callers get different folders.  Raises InputError."""
    while True:
        folder = new_folder(parent, name)
        try:
            parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir()
        except FileExistsError:
            if not parent.is_dir():
                raise InputError(f"{parent}: is no folder") from None
        except OSError as error:
            raise InputError(f"{folder}: {error.strerror or error}") from error
        else:
            return folder
