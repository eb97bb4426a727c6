"""A controller as C and as FMUs, a vehicle as FMUs: what ``hexjet export controller`` and ``vehicle`` call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cosim.api.call import Progress, Result, checked
from cosim.api.call.choices import choose
from cosim.base.errors import InputError
from cosim.spec.scenario import Scenario

if TYPE_CHECKING:
    from cosim.base.signals import Vector3
    from hexjet_export.controller.export import ExportedController
    from hexjet_export.vehicle.export import ExportedVehicle


class ControllerExport(Result):
    """A controller as C99, with its test and its FMUs.

    Attributes
    ----------
    exported : ExportedController
        Everything.
    """

    def __init__(self, exported: ExportedController, loops: bool) -> None:
        self.exported = exported
        self.files = {name: exported.folder / name for name in exported.files}
        self._loops = loops

    @property
    def folder(self) -> Path:
        """The folder that the files are in."""
        return self.exported.folder

    @property
    def same(self) -> bool | None:
        """Whether the C repeats the flight to the last bit; None where there is no C compiler to try it with."""
        return None if self.exported.measured is None else self.exported.measured.same

    def to_dict(self) -> dict[str, Any]:
        """Return what ``hexjet export controller --json`` prints."""
        from dataclasses import asdict

        return asdict(self.exported) | {"folder": str(self.exported.folder)}

    def lines(self) -> list[str]:
        """Return the files, and how the test went."""
        from hexjet_export.controller.export import list_figures

        done = self.exported
        figures = [f"{quantity}: {value}" for quantity, value in list_figures(done.measured, self._loops)]
        missing = [] if done.without_fmus is None else [f"no FMUs: {done.without_fmus}"]
        return [f"{done.folder}: {', '.join(done.files)}", f"test vectors: {done.steps} steps", *figures, *missing]


class VehicleExport(Result):
    """A vehicle as FMUs or as a system of them.

    Attributes
    ----------
    exported : ExportedVehicle
        Everything.
    """

    def __init__(self, exported: ExportedVehicle) -> None:
        self.exported = exported
        self.files = {name: exported.folder / name for name in exported.files}

    def to_dict(self) -> dict[str, Any]:
        """Return what ``hexjet export vehicle --json`` prints."""
        return self.exported.json_data

    def lines(self) -> list[str]:
        """Return the files, the interface, and who flies them."""
        done = self.exported
        return [
            f"{done.folder}: {', '.join(done.files)}",
            f"{done.inputs} inputs, {done.outputs} outputs, communication step {done.step_s:g} s or a multiple",
            f"flown by {done.python}, unless HEXJET_PYTHON names another",
        ]


@checked()
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
        Stated in every file that is ours alone, an SPDX expression; None: NOASSERTION.
    fmus : bool
        Whether FMUs are built too.
    loops : bool
        Whether it is the attitude, rate and altitude loops alone, for a mixer of your own.
    inside : sequence of str
        Autopilots that get its rate loop for their inside, each in a folder of its own.
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
    from hexjet_export.controller.export import export_controller as write
    from hexjet_sitl.firmware_parameters import find_torque_scale

    hears = progress or Progress()
    flown = choose(scenario, controller, aircraft, engine, settings, note=hears.note)
    source = next((Path(each.file).name for each in flown.parameter_files if each.kind == "design"), "")
    vehicle, _ = flown.resolved_vehicle()
    torques: dict[str, Vector3] = {autopilot: find_torque_scale(autopilot, vehicle) for autopilot in inside}
    folder = Path(name) if out is None else Path(out)
    exported = write(flown, folder, name, licence, fmus, source, torques, loops)
    for text in _licence_notes(licence, inside):
        hears.note(text)
    return ControllerExport(exported, loops)


def _licence_notes(licence: str | None, inside: Sequence[str]) -> list[str]:
    """Return which files of an adapter have another licence than the one that was asked for, a line each."""
    from hexjet_export.controller.adapters import PROGRAM_LICENCES

    programs = {each: PROGRAM_LICENCES.get(each) for each in inside}
    return [
        f"--licence {licence}: not for what touches or includes {autopilot}'s code: {program}"
        for autopilot, program in programs.items()
        if program is not None and licence not in (None, program)
    ]


@checked()
def export_vehicle(
    scenario: Scenario | str | Path = "roll-doublet",
    out: str | Path | None = None,
    *,
    controller: str | Path | None = None,
    aircraft: str | Path | None = None,
    engine: str | Path | Sequence[str] | None = None,
    settings: Sequence[str] | Mapping[str, object] = (),
    outside: Sequence[Literal["engines", "controller"]] = (),
    kind: Literal["fmu", "ssp"] = "fmu",
    name: str = "vehicle",
    progress: Progress | None = None,
) -> VehicleExport:
    """Write the vehicle as FMI 2.0 and 3.0 co-simulation FMUs for other masters.

    Parameters
    ----------
    scenario : Scenario or str or Path
        What is flown, with aircraft, engine and controller where they are not given.
    out : str or Path or None
        A new or an empty folder; or one file, of FMI 3.0, or of 2.0 if its name ends in -fmi2; None: a folder called
        ``name``.
    controller : str or Path or None
        In place of the scenario's.
    aircraft : str or Path or None
        In place of the scenario's, with the engine that it is made for.
    engine : str or Path or sequence of str or None
        In place of the scenario's.
    settings : sequence of str or mapping
        Written over the scenario's.
    outside : sequence of str
        What is not in the FMU: its inputs and outputs become the FMU's.
    kind : str
        ``fmu``, or ``ssp``: archives of a system, with the engines as components.
    name : str
        Name of the files, an identifier.
    progress : Progress or None
        Hears notes.

    Returns
    -------
    VehicleExport
        The files and their interface.

    Raises
    ------
    InputError
        For a scenario that cannot be flown so, a folder that is not empty, and where there is no C compiler.
    """
    from hexjet_export.vehicle.export import export_vehicle as write
    from hexjet_export.vehicle.ports import VehicleContents

    hears = progress or Progress()
    flown = choose(scenario, controller, aircraft, engine, settings, note=hears.note)
    contents = VehicleContents("engines" not in outside, "controller" not in outside)
    path = Path(name) if out is None else Path(out)
    is_single = path.suffix.lower() in (".fmu", ".ssp") and not path.is_dir()
    if is_single and path.suffix.lower() != f".{kind}":
        raise InputError(f"--out {path}: --to {kind} writes .{kind}")
    folder, file = (path.parent, path.name) if is_single else (path, "")
    return VehicleExport(write(flown, folder, name, contents, system=kind == "ssp", file=file))
