"""``hexjet export controller``: a folder with a controller as C, its test and its FMUs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

from cosim.base.errors import FlightError, InputError
from cosim.base.signals import Vector3
from cosim.base.storage.paths import data_folder
from cosim.base.storage.scratch import temporary
from cosim.base.trust import remember_written
from cosim.engine.library import FMI_VERSIONS, BuildError, EngineDefinition, VariableDefinition, archive_path, build_one
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from hexjet_export.controller.adapters import PROGRAM_LICENCES, render_adapter
from hexjet_export.controller.files import NO_LICENCE, Labels, render, render_sources
from hexjet_export.controller.form import make_form
from hexjet_export.controller.measure import Measurements, measure
from hexjet_export.controller.predictor_form import Form
from hexjet_export.controller.quantity import Quantity, define_variables
from hexjet_export.controller.vectors import INPUT_QUANTITIES, RecordedFlight, list_output_names, record_vectors

_OUTPUTS = {
    "throttle": ("1", "Throttle of jet"),
    "tilt": ("rad", "Tilt, positive forward: servo"),
    "unallocated": ("1", "Asked for less given:"),
    "shown": ("1", "To look at:"),
    "off": ("1", "1 where shut off on purpose: jet"),
}


@dataclass(frozen=True)
class ExportedController:
    """The files of an exported controller, and the measurements of its C."""

    folder: Path
    files: list[str]
    steps: int  # of the flight in the test vectors
    measured: Measurements | None  # None: no C compiler here
    without_fmus: str | None  # why there are none


def export_controller(
    scenario: Scenario,
    folder: Path,
    name: str,
    licence: str | None = None,
    fmus: bool = True,
    source: str = "",
    inside: Mapping[str, Vector3] | None = None,
    loops: bool = False,
) -> ExportedController:
    """Fly a scenario and write its controller, as C and as FMUs, with the flight as test vectors.

    ``name``: of files, functions and types; ``licence``: stated in every file but those of adapters that are a
    part of an autopilot's program; ``source``: the controller's file;
    ``loops``: the loops alone, for a mixer of one's own;
    ``inside``: autopilots that get adapters, and what a torque of 1 is to each, see :func:`.adapters.adapter_texts`.
    Raises InputError for what has no C form, for a folder that is not empty, and for a flight that fails.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: is there already and not an empty folder; name another with --out")
    if loops and inside:
        raise InputError("--loops: not with --for, whose adapters have the allocation")
    if scenario.requests is not None:
        raise InputError(f"scenario {scenario.name}: is flown by an autopilot's requests; choose one with commands")
    labels = Labels(name, f"{scenario.aircraft_name} with {scenario.controller}", licence, ())  # before the flight
    with build(scenario) as simulation:
        form = make_form(simulation, loops)
        origin = _origin(scenario, source, simulation.engine.name, simulation.engine.sha256)
        vectors = record_vectors(simulation)
    labels = replace(labels, origin=origin)
    sources = render_sources(form, vectors, labels)
    adapters = {
        f"{autopilot}/{file}": text
        for autopilot, torque_scale in (inside or {}).items()
        for file, text in render_adapter(form, labels, autopilot, torque_scale).items()
    }
    try:
        for file, text in (sources | adapters).items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(text, encoding="utf-8")
        measurements = measure(folder, name)
        archives, reason = _build_fmus(form, vectors, labels, sources, folder) if fmus else ([], "left out, as asked")
        readme = _readme(form, vectors, labels, measurements, archives, [*(inside or {})])
        (folder / "README.md").write_text(readme, encoding="utf-8")
        remember_written(folder, [folder / archive for archive in archives])
    except OSError as error:
        raise FlightError(f"{folder}: {error.strerror or error}") from error
    return ExportedController(
        folder, [*sources, *archives, "README.md", *adapters], len(vectors.rows), measurements, reason
    )


def _origin(scenario: Scenario, source: str, engine: str, sha256: str) -> tuple[str, ...]:
    lines = [
        f"aircraft {scenario.aircraft_name}, engine {engine} (sha256 {sha256[:16]}), controller {scenario.controller}"
        + (f" of {source}" if source else ""),
        f"test vectors: scenario {scenario.name}, seed {scenario.seed}, {scenario.duration_s:g} s",
    ]
    if scenario.added_delay_samples:
        lines.append(f"with {scenario.added_delay_samples} samples of added delay on roll, as the scenario states")
    return tuple(lines)


def _readme(
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
    """Return the measurements as pairs of a quantity's name and its value in words."""
    first, second, unit = ("the collective", "torque", "") if loops else ("throttle", "tilt", " rad")
    if measurements is None:
        return [("measured", "nothing: no C compiler was found where this was made")]
    lines = [
        ("compiler", f"{measurements.compiler}, -O2 -ffp-contract=off"),
        (
            "double",
            "every number of the flight to the last bit" if measurements.same else "not the bits of the flight",
        ),
        (
            "float",
            f"{first} within {measurements.float_throttle:.2g}, {second} within {measurements.float_tilt:.2g}{unit} "
            "over the flight, "
            + ("" if measurements.float_passes else "not ")
            + "within half a step of a 12-bit command",
        ),
    ]
    if measurements.state is not None:
        lines.append(("state", f"{measurements.state} bytes"))
    if measurements.code is not None:
        lines.append(("code and constants, without parameters", f"{measurements.code} bytes"))
    if measurements.stack is not None:
        lines.append(
            (
                "worst-case stack",
                f"{measurements.stack} bytes by gcc's call graph, beside that of the library of mathematics",
            )
        )
    if measurements.cycles is not None:
        worst, mean = measurements.cycles
        lines.append(
            (
                "cycles of a step",
                f"worst {worst}, mean {mean}: measured, time-stamp counter of the machine that made it, the least of "
                "20 flights at each step; not a bound for another processor",
            )
        )
    return lines


# ---- the same C behind the FMI adapter of the engines


def _build_fmus(
    form: Form, vectors: RecordedFlight, labels: Labels, sources: dict[str, str], folder: Path
) -> tuple[list[str], str | None]:
    """Write the FMUs into ``folder``, and return their names and, where there are none, why in one line."""
    n, jets = labels.name, form["jets"]
    if form["loops"]:
        return [], "the loops alone are C for a mixer of yours"
    # a vehicle without servos has no tilts
    tilts, servos = form["allocation"]["kind"] in ("tilt", "effectiveness"), form["servos"]
    pairs = zip(list_output_names(jets, servos), _expressions(jets, len(servos)), strict=True)
    expressions = {name: expression for name, expression in pairs if tilts or not name.startswith("tilt_")}
    outputs = tuple(expressions)
    with temporary("export-") as build_folder:
        glue = build_folder / f"{n}_fmu.c"
        text = render(
            "fmu.c",
            n=n,
            N=n.upper(),
            title=labels.title,
            licence=sources[f"{n}.c"].splitlines()[0],
            outputs=outputs,
            jets=jets,
            places=list(expressions.items()),
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
            variables=_variables(vectors, outputs),
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


def _variables(vectors: RecordedFlight, outputs: tuple[str, ...]) -> tuple[VariableDefinition, ...]:
    on_ground, text = float(vectors.on_ground), "1: it starts standing"
    parameter = VariableDefinition("on_ground", 1, "parameter", True, None, 0.0, 1.0, on_ground, text)
    inputs = [q._replace(start=vectors.burnt) if q.name == "fuel_burnt" else q for q in INPUT_QUANTITIES]
    return define_variables(parameter, inputs, map(_describe_output, outputs))


def _describe_output(name: str) -> Quantity:
    kind, _, rest = name.partition("_")
    unit, text = _OUTPUTS[kind]
    if name.startswith(("shown_rate_setpoint", "shown_predicted")):
        unit = "rad/s"
    return Quantity(name, unit, f"{text} {rest.replace('_', ' ')}")


def _expressions(jets: int, servos: int) -> list[str]:
    """Return the C expression of each output, in the order of :func:`list_output_names`."""
    return [
        *(f"output.throttle[{jet}]" for jet in range(jets)),
        *(f"output.tilt[{servo}]" for servo in range(servos)),
        *(f"output.unallocated[{i}]" for i in range(4)),
        *(f"output.{name}[{i}]" for name in ("rate_setpoint", "rate_predicted", "torque") for i in range(3)),
        "output.collective",
        "output.allocated",
        *(f"output.off[{jet}] ? 1.0 : 0.0" for jet in range(jets)),
    ]
