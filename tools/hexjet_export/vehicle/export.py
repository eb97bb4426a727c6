"""``hexjet export vehicle``: the vehicle of a scenario as co-simulation FMUs that fly it in a process of their own."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from cosim import FlightError, InputError, Scenario, versions
from cosim.api.call import Progress, Result, check_types
from cosim.api.call.choices import apply_choices
from cosim.base.storage.files import read_file
from cosim.base.trust import remember_written
from cosim.engine.library import (
    FMI2_SUFFIX,
    FMI_VERSIONS,
    BuildError,
    EngineDefinition,
    VariableDefinition,
    archive_path,
    build_one,
)
from cosim.files import data_folder, scratch, temporary
from cosim.results.resolved_scenario import resolve
from cosim.results.run import scenario_toml
from hexjet_export.controller.files import Labels
from hexjet_export.controller.quantity import define_variables
from hexjet_export.vehicle.ports import ExportedFlight, VehicleContents
from hexjet_export.vehicle.process import FLIGHT, MANIFEST
from hexjet_export.vehicle.ssp import write_ssp


@dataclass(frozen=True)
class ExportedVehicle:
    """Files of an exported vehicle, and its numbers of inputs and outputs."""

    folder: Path
    files: list[str]
    inputs: int
    outputs: int
    step_s: float
    python: str


class VehicleExport(Result):
    """Result of ``hexjet export vehicle``: the vehicle as FMUs, or as a system with its engines.

    Attributes
    ----------
    exported : ExportedVehicle
        Files and interface.
    """

    def __init__(self, exported: ExportedVehicle) -> None:
        self.exported = exported
        self.files = {name: exported.folder / name for name in exported.files}

    def to_dict(self) -> dict[str, Any]:
        return asdict(self.exported) | {"folder": str(self.exported.folder)}

    def lines(self) -> list[str]:
        """Return the printed lines: numbers of inputs and outputs, communication step, and the Python that flies it."""
        done = self.exported
        return [
            f"{done.inputs} inputs, {done.outputs} outputs, communication step {done.step_s:g} s or a multiple",
            f"flown by {done.python}, unless HEXJET_PYTHON names another",
        ]


@check_types()
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
    """Write the vehicle as FMI 2.0 and 3.0 co-simulation FMUs.

    The FMU flies the scenario in a Python with hexjet-cosim, which it starts itself: this one, or that which
    HEXJET_PYTHON names.

    >>> export_vehicle("hover").lines()[0]
    '12 inputs, 56 outputs, communication step 0.004 s or a multiple'

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
    hears = progress or Progress()
    flown = apply_choices(scenario, controller, aircraft, engine, settings, note=hears.note)
    if sys.platform != "linux":
        raise InputError(
            f"export vehicle: how the FMU starts its process is made for Linux, and this is {sys.platform}"
        )
    labels = Labels(name, f"{flown.aircraft_name}: scenario {flown.name}", None, ())  # checks the name
    targets = _list_targets(Path(name if out is None else out), name, kind)
    contents = VehicleContents("engines" not in outside and kind == "fmu", "controller" not in outside)
    if kind == "ssp" and not contents.controller:
        raise InputError("export vehicle: an ssp has the controller in the vehicle; outside may be engines")
    flight = ExportedFlight(flown, contents, _refuse_step)
    try:
        resources = _make_resources(flight, contents)
        definition = _make_engine_definition(flight, labels)
    finally:
        flight.close()
    folder = next(iter(targets.values())).parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for fmi, target in targets.items():
            with temporary("export-") as build_folder:
                fmu = archive_path(build_folder, name, fmi)
                build_one(definition, data_folder("engines") / "fmi", fmi, fmu, resources, scratch())
                if kind == "ssp":
                    write_ssp(flight, fmu, target, fmi, flown.duration_s)
                else:
                    shutil.copyfile(fmu, target)
            remember_written(folder, [target])
    except BuildError as error:
        raise InputError(f"export vehicle: {error}") from error
    except OSError as error:
        raise FlightError(f"{folder}: {error.strerror or error}") from error
    files = [target.name for target in targets.values()]
    return VehicleExport(
        ExportedVehicle(folder, files, len(flight.inputs), len(flight.outputs), flown.step_s, sys.executable)
    )


def _list_targets(out: Path, name: str, kind: str) -> dict[int, Path]:
    """Return the file to write per version of FMI.  Raises InputError for a file or a full folder that exists."""
    if out.suffix.lower() in (".fmu", ".ssp") and not out.is_dir():
        if out.suffix.lower() != f".{kind}":
            raise InputError(f"{out}: {kind} is written to a file .{kind}")
        if out.exists():
            raise InputError(f"{out}: is there already; name another or remove it")
        return {2 if out.stem.endswith(FMI2_SUFFIX) else 3: out}
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is there already and not an empty folder; name another")
    return {fmi: archive_path(out, name, fmi).with_suffix(f".{kind}") for fmi in FMI_VERSIONS}


def _refuse_step() -> None:
    raise AssertionError("a flight that is only looked at does not step")


def _make_resources(flight: ExportedFlight, contents: VehicleContents) -> Mapping[str, bytes]:
    """Return the FMU's resources: scenario with its files, manifest, and path of the Python interpreter."""
    resolved, files = resolve(flight.simulation)
    flight_files = {
        f"{FLIGHT}/{name}": source if isinstance(source, bytes) else read_file(source) for name, source in files.items()
    }
    manifest = {
        "versions": versions(),
        "engines_inside": contents.engines,
        "controller_inside": contents.controller,
        "inputs": [variable.name for variable in flight.inputs],
        "outputs": [variable.name for variable in flight.outputs],
    }
    return flight_files | {
        f"{FLIGHT}/scenario.toml": scenario_toml(resolved),
        MANIFEST: json.dumps(manifest, indent=1).encode() + b"\n",
        "python.txt": f"{sys.executable}\n".encode(),
    }


def _make_engine_definition(flight: ExportedFlight, labels: Labels) -> EngineDefinition:
    """Return the vehicle as the FMU build takes an engine: variables, and the C that starts its process."""
    text, seed = "Of the sensors' noise and the turbulence", float(flight.simulation.scenario.seed)
    parameter = VariableDefinition("seed", 1, "parameter", True, None, 0.0, float(2**31 - 1), seed, text)
    return EngineDefinition(
        name=labels.name,
        folder=Path(tempfile.gettempdir()),
        title=labels.title,
        description=f"one control step every {flight.simulation.dt!r} s, inputs held over it; flown by hexjet-cosim",
        sources=(),
        internal_step=flight.simulation.dt,
        ports={},
        ledger={},
        rotor_inertia=0.0,
        flame_out={},
        variables=define_variables(parameter, flight.inputs, flight.outputs),
        tool=Path(__file__).with_name("process.c"),
    )
