"""``hexjet export controller``: a folder with a controller as C, its test and its FMUs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from cosim import FlightError, InputError, Scenario
from cosim.api.call import Progress, Result, check_types
from cosim.api.call.choices import apply_choices
from cosim.base.trust import remember_written
from cosim.blocks import build
from cosim.engine.library import FMI_VERSIONS, BuildError, EngineDefinition, VariableDefinition, archive_path, build_one
from cosim.files import data_folder, temporary
from hexjet_export.controller.adapters import PROGRAM_LICENCES, render_adapter
from hexjet_export.controller.files import NO_LICENCE, Labels, render, render_sources
from hexjet_export.controller.form import make_form
from hexjet_export.controller.measure import Measurements, measure_compiled
from hexjet_export.controller.predictor_form import Form
from hexjet_export.controller.quantity import Quantity, define_variables
from hexjet_export.controller.vectors import INPUT_QUANTITIES, RecordedFlight, list_outputs, record_vectors


@dataclass(frozen=True)
class ExportedController:
    """Files of an exported controller, and the measurements of its compiled C."""

    folder: Path
    files: list[str]
    steps: int  # steps of the flight in the test vectors
    measured: Measurements | None  # None if there is no C compiler
    without_fmus: str | None  # why there are no FMUs; else None


class ControllerExport(Result):
    """Result of ``hexjet export controller``: the controller as C99, its test and its FMUs.

    Attributes
    ----------
    exported : ExportedController
        Files and measurements.
    """

    def __init__(self, exported: ExportedController, loops: bool) -> None:
        self.exported = exported
        self.files = {name: exported.folder / name for name in exported.files}
        self._loops = loops

    @property
    def folder(self) -> Path:
        return self.exported.folder

    @property
    def same(self) -> bool | None:
        """Whether the C repeats the flight to the last bit; None without a C compiler."""
        return None if self.exported.measured is None else self.exported.measured.same

    def to_dict(self) -> dict[str, Any]:
        return asdict(self.exported) | {"folder": str(self.exported.folder)}

    def lines(self) -> list[str]:
        """Return the printed lines: whether the C repeats the flight, its measurements, and why there are no FMUs."""
        done = self.exported
        verdict = {None: "was not compared with", True: "repeats", False: "does not repeat"}[self.same]
        figures = [f"{quantity}: {value}" for quantity, value in list_figures(done.measured, self._loops)]
        missing = [] if done.without_fmus is None else [f"no FMUs: {done.without_fmus}"]
        return [f"the C {verdict} the flight of {done.steps} steps", *figures, *missing]


@check_types()
def export_controller(
    scenario: Scenario | str | Path = "roll-doublet",
    out: str | Path | None = None,
    *,
    controller: str | Path | None = None,
    aircraft: str | Path | None = None,
    engine: str | Path | Sequence[str] | None = None,
    settings: Sequence[str] | Mapping[str, object] = (),
    name: str = "controller",
    licence: str | None = None,
    fmus: bool = True,
    loops: bool = False,
    inside: Sequence[Literal["px4", "ardupilot", "betaflight"]] = (),
    progress: Progress | None = None,
) -> ControllerExport:
    """Write a controller as C99 with parameters, test vectors and test program, and as FMI 2.0 and 3.0 FMUs.

    The scenario is flown once; the C is compiled and compared with that flight where there is a compiler.

    >>> "controller.c" in export_controller("hover", settings={"duration_s": 0.2}, fmus=False).files
    True

    Parameters
    ----------
    scenario : Scenario or str or Path
        The flight that becomes the test, with aircraft, engine and controller where they are not given.
    out : str or Path or None
        A new or an empty folder; None: one called ``name``.
    controller : str or Path or None
        In place of the scenario's: a name, or a design's file.
    aircraft : str or Path or None
        In place of the scenario's, with the engine that it is made for.
    engine : str or Path or sequence of str or None
        In place of the scenario's.
    settings : sequence of str or mapping
        Written over the scenario's.
    name : str
        Name of files, functions and types, an identifier.
    licence : str or None
        Stated in every file that is ours alone, e.g. MIT or "LicenseRef-Ours", yours to choose; None: NOASSERTION.
        What goes into Betaflight's or ArduPilot's own code is GPL-3.0-or-later.
    fmus : bool
        Build FMUs too, or the C alone.
    loops : bool
        Write the attitude, rate and altitude loops alone, for a mixer of your own; without FMUs.
    inside : sequence of str
        Autopilots that get its rate loop for their inside, with instructions, each in a folder of its own.
    progress : Progress or None
        Hears notes.

    Returns
    -------
    ControllerExport
        The files, and whether the C repeats the flight.

    Raises
    ------
    InputError
        For what has no C form, for a folder that is not empty, and for a flight that fails.
    """
    from hexjet_sitl.firmware_parameters import find_torque_scale

    hears, folder = progress or Progress(), Path(name if out is None else out)
    flown = apply_choices(scenario, controller, aircraft, engine, settings, note=hears.note)
    source = next((Path(each.file).name for each in flown.parameter_files if each.kind == "design"), "")
    vehicle, _ = flown.resolved_vehicle()
    torques = {autopilot: find_torque_scale(autopilot, vehicle) for autopilot in inside}
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: is there already and not an empty folder; name another")
    if loops and inside:
        raise InputError("loops: not with an autopilot, whose adapters have the allocation")
    if flown.requests is not None:
        raise InputError(f"scenario {flown.name}: is flown by an autopilot's requests; choose one with commands")
    labels = Labels(name, f"{flown.aircraft_name} with {flown.controller}", licence, ())  # checks the name
    with build(flown) as simulation:
        form = make_form(simulation, loops)
        origin = _describe_origin(flown, source, simulation.engine.name, simulation.engine.sha256)
        vectors = record_vectors(simulation)
    labels = replace(labels, origin=origin)
    sources = render_sources(form, vectors, labels)
    adapters = {
        f"{autopilot}/{file}": text
        for autopilot, torque_scale in torques.items()
        for file, text in render_adapter(form, labels, autopilot, torque_scale).items()
    }
    try:
        for file, text in (sources | adapters).items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(text, encoding="utf-8")
        measurements = measure_compiled(folder, name)
        archives, reason = _build_fmus(form, vectors, labels, sources, folder) if fmus else ([], "left out, as asked")
        readme = _render_readme(form, vectors, labels, measurements, archives, [*inside])
        (folder / "README.md").write_text(readme, encoding="utf-8")
        remember_written(folder, [folder / archive for archive in archives])
    except OSError as error:
        raise FlightError(f"{folder}: {error.strerror or error}") from error
    for text in _licence_notes(licence, inside):
        hears.note(text)
    written = [*sources, *archives, "README.md", *adapters]
    return ControllerExport(ExportedController(folder, written, len(vectors.rows), measurements, reason), loops)


def _licence_notes(licence: str | None, inside: Sequence[str]) -> list[str]:
    """Return a note for each autopilot whose adapter must have another licence than the requested one."""
    programs = {each: PROGRAM_LICENCES.get(each) for each in inside}
    return [
        f"licence {licence}: not for what touches or includes {autopilot}'s code: {program}"
        for autopilot, program in programs.items()
        if program is not None and licence not in (None, program)
    ]


def _describe_origin(scenario: Scenario, source: str, engine: str, sha256: str) -> tuple[str, ...]:
    lines = [
        f"aircraft {scenario.aircraft_name}, engine {engine} (sha256 {sha256[:16]}), controller {scenario.controller}"
        + (f" of {source}" if source else ""),
        f"test vectors: scenario {scenario.name}, seed {scenario.seed}, {scenario.duration_s:g} s",
    ]
    if scenario.added_delay_samples:
        lines.append(f"with {scenario.added_delay_samples} samples of added delay on roll, as the scenario states")
    return tuple(lines)


def _render_readme(
    form: Form,
    vectors: RecordedFlight,
    labels: Labels,
    measurements: Measurements | None,
    fmus: list[str],
    inside: list[str],
) -> str:
    kinds = [f"{axis['name']}: {axis['predictor']['title']}" for axis in form["axes"]]
    leads = [axis["lead"] for axis in form["axes"]] + [form["altitude"]["lead"]]
    return render(
        "README.md",
        n=labels.name,
        title=labels.title,
        maker=f"hexjet-cosim {version('hexjet-cosim')}",
        licence_name=labels.licence or NO_LICENCE,
        program_licences={name: PROGRAM_LICENCES[name] for name in inside if name in PROGRAM_LICENCES},
        step=repr(form["step"]),
        steps=len(vectors.rows),
        fmus=fmus,
        inside=inside,
        origin=labels.origin,
        predictors="predictors " + ", ".join(kinds),
        leads=any(leads),
        schedule=bool(form["schedule"]),
        loops=form["loops"],
        straight=form["thrust"]["identity"],
        figures=list_figures(measurements, form["loops"]),
    )


def list_figures(measurements: Measurements | None, loops: bool = False) -> list[tuple[str, str]]:
    """Return each measurement as its quantity and its value in words."""
    first, second, unit = ("the collective", "torque", "") if loops else ("throttle", "tilt", " rad")
    if measurements is None:
        return [("measured", "nothing: no C compiler was found where this was made")]
    found = measurements
    same = "every number of the flight to the last bit" if found.same else "not the bits of the flight"
    deviation = f"{first} within {found.float_throttle:.2g}, {second} within {found.float_tilt:.2g}{unit}"
    passes = "within" if found.float_passes else "not within"
    lines = [
        ("compiler", f"{found.compiler}, -O2 -ffp-contract=off"),
        ("double", same),
        ("float", f"{deviation} over the flight, {passes} half a step of a 12-bit command"),
    ]
    if found.state is not None:
        lines.append(("state", f"{found.state} bytes"))
    if found.code is not None:
        lines.append(("code and constants, without parameters", f"{found.code} bytes"))
    if found.stack is not None:
        beside = "by gcc's call graph, beside that of the library of mathematics"
        lines.append(("worst-case stack", f"{found.stack} bytes {beside}"))
    if found.cycles is not None:
        worst, mean = found.cycles
        how = (
            "measured, time-stamp counter of the machine that made it, the least of 20 flights at each step; not a "
            "bound for another processor"
        )
        lines.append(("cycles of a step", f"worst {worst}, mean {mean}: {how}"))
    return lines


def _build_fmus(
    form: Form, vectors: RecordedFlight, labels: Labels, sources: dict[str, str], folder: Path
) -> tuple[list[str], str | None]:
    """Build the FMUs from the same C in ``folder``; return their names and, if none, the reason."""
    n, jets = labels.name, form["jets"]
    if form["loops"]:
        return [], "the loops alone are C for a mixer of yours"
    # Only the allocations to banks and to hinges have tilt outputs.
    tilts = form["allocation"]["kind"] in ("tilt", "effectiveness")
    outputs = [each for each in list_outputs(jets, form["servos"]) if tilts or not each[0].name.startswith("tilt_")]
    with temporary("export-") as build_folder:
        glue = build_folder / f"{n}_fmu.c"
        text = render(
            "fmu.c",
            n=n,
            N=n.upper(),
            title=labels.title,
            licence=sources[f"{n}.c"].splitlines()[0],
            outputs=[quantity.name for quantity, _ in outputs],
            jets=jets,
            places=[(quantity.name, expression) for quantity, expression in outputs],
        )
        glue.write_text(text, encoding="utf-8")
        engine = EngineDefinition(
            name=n,
            folder=build_folder,
            title=labels.title,
            description=f"one control step every {form['step']!r} s, inputs held over it",
            sources=(glue, *(folder / file for file in (f"{n}.h", f"{n}.c", f"{n}_parameters.c"))),
            internal_step=form["step"],
            ports={},
            ledger={},
            rotor_inertia=0.0,
            flame_out={},
            variables=_define_fmu_variables(vectors, [quantity for quantity, _ in outputs]),
        )
        archives = []
        try:
            for fmi in FMI_VERSIONS:
                target = archive_path(folder, n, fmi)
                build_one(engine, data_folder("engines") / "fmi", fmi, target, {}, build_folder)
                archives.append(target.name)
        except BuildError as error:
            for name in archives:
                (folder / name).unlink(missing_ok=True)
            return [], str(error)
    return archives, None


def _define_fmu_variables(vectors: RecordedFlight, outputs: Sequence[Quantity]) -> tuple[VariableDefinition, ...]:
    on_ground, text = float(vectors.on_ground), "1: it starts standing"
    parameter = VariableDefinition("on_ground", 1, "parameter", True, None, 0.0, 1.0, on_ground, text)
    inputs = [q._replace(start=vectors.burnt) if q.name == "fuel_burnt" else q for q in INPUT_QUANTITIES]
    return define_variables(parameter, inputs, outputs)
