"""``hexjet export vehicle``: the vehicle of a scenario as co-simulation FMUs that fly it in a process of their own."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import read_file
from cosim.base.storage.paths import data_folder
from cosim.base.storage.scratch import scratch, temporary
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
from cosim.results.resolved_scenario import resolve
from cosim.results.run import scenario_toml
from cosim.results.summary import versions
from cosim.spec.scenario import Scenario
from hexjet_export.controller.files import Labels
from hexjet_export.controller.quantity import define_variables
from hexjet_export.vehicle.ports import ExportedFlight, VehicleContents
from hexjet_export.vehicle.process import FLIGHT, MANIFEST
from hexjet_export.vehicle.ssp import write_ssp

MOST_SEED = 2**31 - 1  # largest integer of FMI


@dataclass(frozen=True)
class ExportedVehicle:
    """The files of an exported vehicle, and its interface."""

    folder: Path
    files: list[str]
    inputs: int
    outputs: int
    step_s: float
    python: str

    @property
    def json_data(self) -> dict[str, Any]:
        """All fields as values for JSON."""
        return asdict(self) | {"folder": str(self.folder)}


def export_vehicle(
    scenario: Scenario,
    folder: Path,
    name: str,
    contents: VehicleContents,
    fmis: Sequence[int] = FMI_VERSIONS,
    system: bool = False,
    file: str = "",
) -> ExportedVehicle:
    """Write the vehicle of a scenario as FMUs, of FMI 3.0 and 2.0 unless ``fmis`` says otherwise.

    ``name``: of the files, an identifier.  ``system``: as SSP archives in place of the FMUs, with the engines, which
    are outside then, as components.  ``file``: write this one file in ``folder`` alone, of FMI 3.0, or of 2.0 where its
    name ends in ``-fmi2``.  Raises InputError for a scenario that cannot be flown so, for a folder that is not empty or
    a file that is there, and where there is no C compiler.
    """
    if sys.platform != "linux":
        raise InputError(
            f"export vehicle: how the FMU starts its process is made for Linux, and this is {sys.platform}"
        )
    labels = Labels(name, f"{scenario.aircraft_name}: scenario {scenario.name}", None, ())  # this checks the name
    if file:
        if (folder / file).exists():
            raise InputError(f"{folder / file}: is there already; name another with --out or remove it")
        fmis = (2 if Path(file).stem.endswith(FMI2_SUFFIX) else 3,)
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: is there already and not an empty folder; name another with --out")
    if system and not contents.controller:
        raise InputError("export vehicle --to ssp: has the controller in the vehicle; leave out --outside controller")
    contents = VehicleContents(False) if system else contents
    flight = ExportedFlight(scenario, contents, _no_exchange)
    try:
        resources = _resources(flight, contents)
        engine = _as_engine(flight, labels)
    finally:
        flight.close()
    files = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for fmi in fmis:
            with temporary("export-") as build_folder:
                fmu = archive_path(build_folder, name, fmi)
                build_one(engine, data_folder("engines") / "fmi", fmi, fmu, resources, scratch())
                target = folder / (file or fmu.name)
                if system:
                    target = folder / (file or fmu.with_suffix(".ssp").name)
                    write_ssp(flight, fmu, target, fmi, scenario.duration_s)
                else:
                    shutil.copyfile(fmu, target)
            files.append(target.name)
            remember_written(folder, [target])
    except BuildError as error:
        raise InputError(f"export vehicle: {error}") from error
    except OSError as error:
        raise FlightError(f"{folder}: {error.strerror or error}") from error
    return ExportedVehicle(
        folder, files, len(flight.inputs), len(flight.outputs), scenario.step_s, str(Path(sys.executable))
    )


def _no_exchange() -> None:
    raise AssertionError("a flight that is only looked at does not step")


def _resources(flight: ExportedFlight, contents: VehicleContents) -> Mapping[str, bytes]:
    """Return the FMU's resources: the flight with its files, the manifest for its process, and the interpreter."""
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


def _as_engine(flight: ExportedFlight, labels: Labels) -> EngineDefinition:
    """Return the vehicle as the FMU build takes an engine: variables, and the C that starts the process."""
    text, seed = "Of the sensors' noise and the turbulence", float(flight.simulation.scenario.seed)
    parameter = VariableDefinition("seed", 1, "parameter", True, None, 0.0, float(MOST_SEED), seed, text)
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
