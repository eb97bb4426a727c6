"""Adapter sources that run an exported controller's rate loop inside an autopilot.

An autopilot keeps its attitude loop, its mixer and its outputs; rate set-point and gyro go to the controller, at the
autopilot's collective, and what the controller would do with throttles and tilts goes back to three torques.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from cosim import InputError
from cosim.base.signals import Vector3
from hexjet_export.controller.files import (
    NO_LICENCE,
    Labels,
    licence_line,
    make_common_values,
    render_controller,
    render_files,
)
from hexjet_export.controller.predictor_form import Form

# A file compiled into a program, or that includes its headers, has the program's licence. PX4's BSD-3-Clause leaves the
# choice to the user.
PROGRAM_LICENCES = {"ardupilot": "GPL-3.0-or-later", "betaflight": "GPL-3.0-or-later"}
AUTOPILOTS = ("px4", "ardupilot", "betaflight")  # autopilots that have an adapter
_TITLES = {"px4": "PX4", "ardupilot": "ArduPilot", "betaflight": "Betaflight"}  # autopilots' names in messages
_SCALE_ORIGINS = {  # origin of each program's torque scale
    "px4": "by its control allocation with the vehicle's geometry",
    "ardupilot": "half of the motors' range, and the whole range of tilts",
    "betaflight": "of pidData[].Sum, by its mixer's 1000 and the range of motors and tilts",
}


def render_adapter(form: Form, labels: Labels, autopilot: str, torque_scale: Vector3) -> dict[str, str]:
    """Return the text of every file of an adapter, by its path in the autopilot's folder.

    ``torque_scale``: what a torque of 1 is to the autopilot: throttle about roll, rad of tilt about pitch and yaw
    (throttle without tilts).  What touches or includes code of the autopilot's has its licence in
    :data:`PROGRAM_LICENCES`, the rest that of ``labels``.  Raises InputError for an autopilot that is not known.
    """
    if autopilot not in _RENDERERS:
        raise InputError(f"autopilot {autopilot!r}: allowed: {', '.join(AUTOPILOTS)}")
    thrust = form["thrust"]
    curve: int | None = None
    # The adapter converts throttle to thrust by one curve: the reference engine's, or else that of the first station.
    if not thrust["identity"]:
        curve = thrust["mapped"][0]["curve"] if thrust["reference"] is None else thrust["reference"]
    values = make_common_values(form, labels) | {
        "autopilot": _TITLES[autopilot],
        "tilts": form["allocation"]["kind"] == "tilt",
        "inverse": form["allocation"]["inverse"],
        "torque_scale": list(torque_scale),
        "origin_of_scale": _SCALE_ORIGINS[autopilot],
        "curve": curve,
        "points": 0 if curve is None else len(thrust["curves"][curve]["thrust"]),
        "Class": "".join(part.capitalize() for part in labels.name.split("_")),
        "rate": f"{1.0 / form['step']:g}",
        "idle": repr(form["allocation"]["low"]),
        "motor_idle": round(1e4 * form["allocation"]["low"]),
        "range": repr(form["allocation"].get("range", 0.0)),
        "step_us": round(1e6 * form["step"]),
        "program_licence": PROGRAM_LICENCES.get(autopilot),
        "own_licence": labels.licence or NO_LICENCE,
    }
    n = labels.name
    rates = {f"{n}_rates.h": "adapters/rates.h", f"{n}_rates.c": "adapters/rates.c"}
    controller_files = render_controller(form, labels, single=True) | render_files(rates, values)
    return _RENDERERS[autopilot](n, controller_files, values)


def _add_program_licence(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the template values with the autopilot's licence, for files that are compiled into it."""
    return dict(values) | {"licence": licence_line(values["program_licence"])}


def _render_betaflight(n: str, controller_files: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, str]:
    """Return the files of Betaflight's adapter: a patch with all sources, and a README."""
    program_files = {f"{n}_betaflight.h": "adapters/betaflight.h", f"{n}_betaflight.c": "adapters/betaflight.c"}
    files = dict(controller_files) | render_files(program_files, _add_program_licence(values))
    sources = sorted(name for name in files if name.endswith(".c"))
    patch = render_files({"": "adapters/betaflight.patch"}, dict(values) | {"sources": sources})[""]
    for name, text in sorted(files.items()):
        lines = text.splitlines()
        patch += f"--- /dev/null\n+++ b/src/main/flight/{name}\n@@ -0,0 +1,{len(lines)} @@\n"
        patch += "".join(f"+{line}\n" for line in lines)
    readme = render_files({"README.md": "adapters/betaflight.md"}, values)
    return {f"{n}-betaflight.patch": patch} | readme


def _render_ardupilot(n: str, controller_files: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, str]:
    """Return the files of ArduPilot's adapter: a backend of ``AC_CustomControl``, and a README."""
    name = f"AC_CustomControl_{values['Class']}"
    program_files = {f"{name}.h": "adapters/ardupilot.h", f"{name}.cpp": "adapters/ardupilot.cpp"}
    files = dict(controller_files) | render_files(program_files, _add_program_licence(values))
    return {f"AC_CustomControl/{file}": text for file, text in files.items()} | render_files(
        {"README.md": "adapters/ardupilot.md"}, values
    )


def _render_px4(n: str, controller_files: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, str]:
    """Return the files of PX4's adapter: one module for ``EXTERNAL_MODULES_LOCATION``, and a README."""
    sources = [f"{n}_px4.cpp", *sorted(name for name in controller_files if name.endswith(".c"))]
    program_files = {
        f"{n}_px4.cpp": "adapters/px4.cpp",
        "CMakeLists.txt": "adapters/px4_module.txt",
        "Kconfig": "adapters/px4_kconfig.txt",
    }
    module = dict(controller_files) | render_files(program_files, dict(values) | {"sources": sources})
    outer_files = {"src/CMakeLists.txt": "adapters/px4_list.txt", "README.md": "adapters/px4.md"}
    return {f"src/modules/{n}/{file}": text for file, text in module.items()} | render_files(outer_files, values)


_RENDERERS: dict[str, Callable[[str, Mapping[str, str], Mapping[str, Any]], dict[str, str]]] = {  # by autopilot
    "px4": _render_px4,
    "ardupilot": _render_ardupilot,
    "betaflight": _render_betaflight,
}
