"""Rendering of an exported controller's files from templates and the controller's constants."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from cosim import InputError
from cosim.base.constants import GRAVITY
from cosim.blocks import MIN_HOVER_FRACTION, MIN_UPRIGHT
from hexjet_export.controller.hinged import render_solver
from hexjet_export.controller.predictor_form import Form
from hexjet_export.controller.vectors import (
    INPUTS,
    LOOP_INPUTS,
    LOOP_OUTPUTS,
    RecordedFlight,
    list_output_names,
    make_loop_rows,
)

TEMPLATES = Path(__file__).resolve().parent / "templates"  # folder of the C templates
# Names that a controller may not have, as headers of these names are included by its C or by its FMU.
_RESERVED = ("math", "stdbool", "stdint", "stdio", "string", "time", "engine", "slave", "variables", "fmi2", "fmi3")

NO_LICENCE = "not stated (choose a licence)"  # text for files without a licence


@dataclass(frozen=True)
class Labels:
    """Name, title and licence of the exported files as the user chose them, and the origin of their numbers."""

    name: str  # C identifier, used in file names too
    title: str
    licence: str | None  # SPDX expression or a name
    origin: tuple[str, ...]  # lines on the origin of the numbers

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z][a-z0-9_]{0,39}", self.name) or self.name in _RESERVED:
            raise InputError(
                f"name {self.name}: must be a C identifier of small letters, digits and _, at most 40, and not "
                + ", ".join(_RESERVED)
            )
        if self.licence is not None and not re.fullmatch(r"[A-Za-z0-9.+() -]{1,120}", self.licence):
            raise InputError(
                f"licence {self.licence}: must be one line of letters, digits, spaces, . + - and brackets, as in SPDX"
            )


def render_sources(form: Form, vectors: RecordedFlight, labels: Labels) -> dict[str, str]:
    """Return the text of every C file by its name, the test and its vectors included."""
    n = labels.name
    if form["loops"]:
        inputs, outputs = LOOP_INPUTS, LOOP_OUTPUTS
        rows = make_loop_rows(vectors, form["jets"], form["servos"])
    else:
        inputs, outputs, rows = INPUTS, list_output_names(form["jets"], form["servos"]), vectors.rows
    values = {
        "columns": [*inputs, *outputs],
        "inputs": len(inputs),
        "rows": [[repr(x) for x in row] for row in rows],
        "start": [repr(x) for x in vectors.start],
        "burnt": repr(vectors.burnt),
        "on_ground": vectors.on_ground,
    }
    test = {f"{n}_vectors.h": "vectors.h", f"{n}_vectors.c": "vectors.c", f"test_{n}.c": "test.c"}
    return render_controller(form, labels) | render_files(test, make_common_values(form, labels) | values)


def render_controller(form: Form, labels: Labels, single: bool = False) -> dict[str, str]:
    """Return the C files of the controller without test; ``single`` makes single precision the default."""
    n = labels.name
    files = {f"{n}.h": "controller.h", f"{n}.c": "controller.c", f"{n}_parameters.c": "parameters.c"}
    return render_files(files, make_common_values(form, labels) | {"single": single})


def licence_line(licence: str | None) -> str:
    """Return the first line of a source file, a comment that states this licence."""
    return f"/* SPDX-License-Identifier: {licence or 'NOASSERTION'} */"


def make_common_values(form: Form, labels: Labels) -> dict[str, Any]:
    """Return the template values that every C file gets."""
    f = _prepare_form(form)
    hinged = form["allocation"]["kind"] == "effectiveness"
    types, functions = render_solver(labels.name) if hinged else ("", "")
    return {
        "solver_types": types,
        "solver_functions": functions,
        "torque_unit": "rad/s^2, angular accelerations" if form["accelerations"] else "as the vehicle's gains have it",
        "n": labels.name,
        "N": labels.name.upper(),
        "f": f,
        "title": labels.title,
        "maker": f"hexjet-cosim {version('hexjet-cosim')}",
        "licence": licence_line(labels.licence),
        "step": repr(form["step"]),
        "gravity": repr(GRAVITY),
        "least_upright": repr(MIN_UPRIGHT),
        "least_share": repr(MIN_HOVER_FRACTION),
        "origin": [part for line in labels.origin for part in textwrap.wrap(line.replace("*/", "* /"), 110)],
        "values": _list_parameters(f),
    }


def render_files(files: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, str]:
    """Return the rendered files by their names; ``files`` maps these to the names of their templates."""
    environment = _make_template_environment()
    return {name: environment.get_template(template).render(**values) for name, template in files.items()}


def render(template: str, **values: Any) -> str:
    """Return one rendered template of this package."""
    return str(_make_template_environment().get_template(template).render(**values))


def _make_template_environment() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        variable_start_string="[[",
        variable_end_string="]]",
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    environment.filters["c"] = _format_c
    return environment


def _format_c(value: Any, indent: str = "        ") -> str:
    """Return a number, a list or a mapping as a C initializer; a string is returned unchanged."""
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        separator = f",\n{indent}" if any(isinstance(x, Sequence) for x in value.values()) else ", "
        return "{" + separator.join(f".{key} = {_format_c(x)}" for key, x in value.items()) + "}"
    if isinstance(value, Sequence):
        text = "{" + ", ".join(_format_c(x) for x in value) + "}"
        wrapped = textwrap.wrap(text, 90, break_long_words=False, break_on_hyphens=False)
        return wrapped[0] if len(wrapped) == 1 else ("\n" + indent).join(wrapped)
    return f"R({float(value)!r})"


def _prepare_form(form: Form) -> Form:
    """Return the form with additional template values that say which C helpers are used."""
    axes = form["axes"]
    predictors = [axis["predictor"] for axis in axes]
    leads = [axis["lead"] for axis in axes] + [form["altitude"]["lead"]]
    scheduled = [axes[0]["lead"], form["altitude"]["lead"]] if form["schedule"] else []
    return form | {
        "uses_line": bool(form["delay"] or any(predictor["line"] for predictor in predictors)),
        "uses_discrete": any("now_a" in predictor for predictor in predictors),
        "uses_sent": any("weights" in predictor for predictor in predictors),
        "uses_lead": any(leads),
        "lead_orders": sorted({lead["order"] for lead in scheduled if lead}),
    }


def _list_parameters(f: Form) -> list[tuple[str, Any]]:
    """Return the fields of the C struct of parameters, in its order, with their values."""
    height, allocation, schedule = f["altitude"], f["allocation"], f["schedule"]
    values: list[tuple[str, Any]] = [
        ("step", f["step"]),
        ("mass", f["mass"]),
        ("attitude_gain", f["attitude"]["gain"]),
        ("attitude_limit", f["attitude"]["limit"]),
        *([("rate_scale", [axis["scale"] for axis in f["axes"]])] if f["law"] else []),
    ]
    for axis in f["axes"]:
        values.append((axis["name"], axis["gains"]))
        if axis["predictor"]["kind"] != "none":
            values.append((f"{axis['name']}_predictor", axis["predictor"]["values"]))
        if axis["lead"] and not axis["scheduled"]:
            values.append((f"{axis['name']}_lead", axis["lead"]["constants"]))
    values += [(key, height[key]) for key in ("position", "up", "down", "velocity", "integral")]
    values.append(("integral_limit", height["limit"]))
    if height["lead"] and not schedule:
        values.append(("altitude_lead", height["lead"]["constants"]))
    if schedule:
        values.append(("level_share", schedule["share"]))
        values += [(f"{name}_level", rows) for name, rows in schedule["levels"].items()]
        values += [("level_follow", schedule["follow"]), ("level_fine", schedule["fine"])]
    values += [
        ("throttle_min", allocation["low"]),
        ("throttle_max", allocation["high"]),
        ("hover", allocation["hover"]),
    ]
    if allocation["kind"] == "tilt":
        values += [("idle", allocation["idle"]), ("hover_thrust", allocation["hover_thrust"])]
        values += [("tilt_range", allocation["range"]), ("pitch_sign", allocation["pitch_sign"])]
    elif allocation["kind"] == "effectiveness":
        values += allocation["values"].items()
    elif allocation["kind"] == "rotor":
        values.append(("signs", allocation["signs"]))
    values += [("thrust_low", f["thrust"]["low"]), ("thrust_span", f["thrust"]["span"])]
    for number, curve in enumerate(f["thrust"]["curves"]):
        values += [(f"curve_{number}_{key}", curve[key]) for key in ("thrust", "throttle", "slope")]
    return values
