"""An exported controller as co-simulation FMUs: the same C behind the FMI adapter of the engines."""

from __future__ import annotations

from pathlib import Path

from cosim.base.signals import AXES
from cosim.base.storage.paths import data_folder
from cosim.base.storage.scratch import temporary
from cosim.codegen.files import Labels, render
from cosim.codegen.form import Form
from cosim.codegen.vectors import INPUTS, Vectors, output_names
from cosim.engine.library import FMI_VERSIONS, BuildError, EngineDefinition, VariableDefinition, archive_path, build_one

# unit and meaning; attitude's quaternion starts upright
_INPUTS: dict[str, tuple[str, str]] = {
    **{f"{axis}_setpoint": ("rad", f"Attitude asked for: {axis}") for axis in AXES},
    "altitude_setpoint": ("m", "Height above the ground asked for"),
    **{f"{axis}_rate_setpoint": ("rad/s", f"Body rate asked for where rates_commanded: {axis}") for axis in AXES},
    "collective_setpoint": ("1", "Mean throttle asked for where collective_commanded"),
    "rates_commanded": ("1", "1: body rates are asked for in place of an attitude"),
    "collective_commanded": ("1", "1: a mean throttle is asked for in place of a height"),
    "engines": ("1", "0: as the loops ask; 1: idle; 2: off"),
    **{f"{axis}_rate": ("rad/s", f"Measured body rate: {axis}") for axis in AXES},
    **{f"attitude_{part}": ("1", f"Measured attitude, quaternion body to NED: {part}") for part in "wxyz"},
    "velocity_down": ("m/s", "Measured velocity downwards"),
    "altitude": ("m", "Measured height above the ground"),
    "fuel_burnt": ("kg", "Fuel burnt since the full tank"),
}
_OUTPUTS = {
    "throttle": ("1", "Throttle of jet"),
    "tilt": ("rad", "Tilt, positive forward: servo"),
    "unallocated": ("1", "Asked for less given:"),
    "shown": ("1", "To look at:"),
    "off": ("1", "1 where shut off on purpose: jet"),
}


def build_fmus(
    form: Form, vectors: Vectors, labels: Labels, made: dict[str, str], folder: Path
) -> tuple[list[str], str | None]:
    """Write the FMUs into ``folder``, and return their names and, where there are none, why in one line."""
    n, jets = labels.name, form["jets"]
    # a vehicle without servos has no tilts
    tilts = form["allocation"]["kind"] == "tilt"
    every = zip(output_names(jets), _places(jets), strict=True)
    places = [(name, place) for name, place in every if tilts or not name.startswith("tilt_")]
    outputs = tuple(name for name, _ in places)
    with temporary("export-") as place:
        glue = place / f"{n}_fmu.c"
        text = render(
            "fmu.c",
            n=n,
            N=n.upper(),
            title=labels.title,
            licence=made[f"{n}.c"].splitlines()[0],
            outputs=outputs,
            jets=jets,
            places=places,
        )
        glue.write_text(text, encoding="utf-8")
        engine = EngineDefinition(
            name=n,
            folder=place,
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
                build_one(engine, data_folder("engines") / "fmi", fmi, target, {}, place)
                archives.append(target.name)
        except BuildError as error:
            for name in archives:
                (folder / name).unlink(missing_ok=True)
            return [], str(error)
    return archives, None


def _variables(vectors: Vectors, outputs: tuple[str, ...]) -> tuple[VariableDefinition, ...]:
    variables = [
        VariableDefinition(
            "on_ground", 1, "parameter", True, None, 0.0, 1.0, float(vectors.on_ground), "1: it starts standing"
        )
    ]
    for name in INPUTS:
        unit, text = _INPUTS[name]
        start = 1.0 if name == "attitude_w" else vectors.burnt if name == "fuel_burnt" else 0.0
        variables.append(VariableDefinition(name, len(variables) + 1, "input", False, unit, None, None, start, text))
    for name in outputs:
        kind, _, rest = name.partition("_")
        unit, text = _OUTPUTS[kind]
        if name.startswith(("shown_rate_setpoint", "shown_predicted")):
            unit = "rad/s"
        text = f"{text} {rest.replace('_', ' ')}"
        variables.append(VariableDefinition(name, len(variables) + 1, "output", False, unit, None, None, None, text))
    return tuple(variables)


def _places(jets: int) -> list[str]:
    """Return the C expression of each output, in the order of :func:`output_names`."""
    return [
        *(f"output.throttle[{jet}]" for jet in range(jets)),
        "output.tilt[0]",
        "output.tilt[1]",
        *(f"output.unallocated[{i}]" for i in range(4)),
        *(f"output.{name}[{i}]" for name in ("rate_setpoint", "rate_predicted", "torque") for i in range(3)),
        "output.collective",
        "output.allocated",
        *(f"output.off[{jet}] ? 1.0 : 0.0" for jet in range(jets)),
    ]
