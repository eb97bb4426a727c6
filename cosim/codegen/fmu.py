"""An exported controller as co-simulation FMUs: the same C behind the FMI adapter of the engines."""

from __future__ import annotations

from pathlib import Path

from cosim.base.storage.paths import data_folder
from cosim.base.storage.scratch import temporary
from cosim.codegen.files import Labels, render
from cosim.codegen.form import Form
from cosim.codegen.quantity import Quantity, define_variables
from cosim.codegen.vectors import INPUT_QUANTITIES, RecordedFlight, list_output_names
from cosim.engine.library import FMI_VERSIONS, BuildError, EngineDefinition, VariableDefinition, archive_path, build_one

_OUTPUTS = {
    "throttle": ("1", "Throttle of jet"),
    "tilt": ("rad", "Tilt, positive forward: servo"),
    "unallocated": ("1", "Asked for less given:"),
    "shown": ("1", "To look at:"),
    "off": ("1", "1 where shut off on purpose: jet"),
}


def build_fmus(
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
