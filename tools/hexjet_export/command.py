"""``hexjet export controller`` and ``hexjet export vehicle``."""

from __future__ import annotations

from cosim.commands import Command

_OPTIONS = {"scenario": "--scenario"}  # command-line option by argument
_METAVARS = {"engine": "[N=]NAME|FILE", "name": "NAME"}  # placeholders of values in the help

controller = Command(
    "export controller",
    "hexjet_export.controller.export:export_controller",
    "--controller turbojet.toml --engine turbojet",
    options=_OPTIONS | {"fmus": "--fmu", "inside": "--for"},
    metavars=_METAVARS | {"licence": "SPDX"},
    succeeded=lambda result: result.same is not False,
    ends="Status 1: the C does not repeat the flight to the last bit.",
)
vehicle = Command(
    "export vehicle",
    "hexjet_export.vehicle.export:export_vehicle",
    "--controller smith --out vehicle",
    options=_OPTIONS | {"kind": "--to --as"},
    metavars=_METAVARS | {"out": "DIR|FILE.fmu|FILE.ssp"},
    writes=(".fmu", ".ssp"),
)
