"""An FMU as a controller: reading of its description, and the process that runs it.

Ports are those of :mod:`cosim.base.controller_wire`, found by name as engines' are, by its letters and digits
without case, or stated in a mapping file ``NAME.fmu.toml``::

    fmu = "theirs.fmu"
    [ports]
    roll_rate = "gyro.p"

A whole controller's ``tilt_`` outputs are for the actuators of a vehicle, whose names are known when it flies; until
then they are those that it has.

An FMU without an input for a signal is not given it.  Its other outputs of numbers become columns of the log, its
parameters the controller's own.  It runs in a process of its own.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from ctypes import c_double
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

from cosim.base import controller_wire as wire
from cosim.base.constants import SERVOS
from cosim.base.errors import InputError, nearest
from cosim.base.runtime.host import python_command, serve_pipes
from cosim.base.runtime.pipes import Pipes
from cosim.base.signals import MAX_JETS
from cosim.base.storage.scratch import temporary
from cosim.base.storage.toml import read_toml
from cosim.engine._bank import Log
from cosim.engine.fmu.archive import parse_number
from cosim.engine.fmu.container import (
    DAMAGE_ERRORS,
    UnusableError,
    Zip,
    open_archive,
    parse_xml,
    read_bytes,
    read_fmi_version,
    to_one_line,
)
from cosim.engine.fmu.description import read_description
from cosim.engine.fmu.ports import normalise_name
from cosim.engine.fmu.slave import CallError, Slave
from cosim.engine.fmu.variables import INTEGERS, REALS
from cosim.engine.library import LIBRARY_SUFFIX, platform_folder

MAPPING_SUFFIX = ".fmu.toml"  # file ending of mappings
_SERVE_CODE = "from cosim.engine.make.controller_fmu import serve; serve(sys.argv[1])"  # code of the FMU's process
_STEP_HEADER, _NUMBER = wire.frame_layout(0), 8  # step number; bytes of a number
_ON_GROUND = "on_ground"  # parameter that the simulation sets
_SCALAR_TYPES = {*REALS, *INTEGERS, "Boolean"}  # FMI types of scalar variables


@dataclass(frozen=True)
class ControllerFmu:
    """Controller in an FMU; its variables are those of FMPy's description."""

    path: Path  # path of the archive
    mapping: Path | None
    fmi: int
    level: str
    jets: int  # number of jets of a whole controller
    servos: tuple[str, ...]  # servos that a whole controller moves
    extras: tuple[str, ...]
    inputs: Mapping[str, Any]  # variables by port name
    outputs: Mapping[str, Any]
    parameters: Sequence[Any]
    column_outputs: Sequence[Any]  # outputs logged as columns
    notes: tuple[str, ...]
    description: Any
    data: bytes

    @property
    def files(self) -> dict[str, Path]:
        """Files of the controller by name, beginning with the one that the user named."""
        paths = [self.path] if self.mapping is None else [self.mapping, self.path]
        return {path.name: path for path in paths}


class IncompleteError(UnusableError):
    """Error for an FMU that has only some outputs of a controller."""


def is_controller(path: Path) -> bool:
    """Return whether a file is an FMU with the outputs of a controller; False for an unreadable file too."""
    if not path.name.lower().endswith((".fmu", MAPPING_SUFFIX)):
        return False
    try:
        read_controller_fmu(path)
    except InputError as error:
        return path.name.lower().endswith(MAPPING_SUFFIX) or isinstance(error.__cause__, IncompleteError)
    return True


def read_controller_fmu(path: Path, servos: Sequence[str] | None = None) -> ControllerFmu:
    """Return the controller in an FMU, given by its archive or a mapping file.  Raises InputError.

    ``servos``: the names of the vehicle's actuators, which the FMU may spell its own way; None: not known yet.
    """
    mapping, mapped = None, {}
    if path.name.lower().endswith(MAPPING_SUFFIX):
        table = read_toml(path)
        unknown = [key for key in table if key not in ("fmu", "ports")]
        if unknown or not isinstance(table.get("fmu"), str) or not isinstance(table.get("ports", {}), dict):
            raise InputError(f'{path}: must have fmu = "FILE.fmu" and a table [ports] of names, nothing else')
        if Path(table["fmu"]).name != table["fmu"]:
            raise InputError(f"{path}: fmu = {table['fmu']!r}: must be the name of a file beside it")
        mapping, mapped = path, {str(key): str(value) for key, value in table.get("ports", {}).items()}
        path = path.with_name(table["fmu"])
    try:
        return _read(path, mapping, mapped, servos)
    except UnusableError as reason:
        raise InputError(f"{path}: {reason}") from reason


def _read(path: Path, mapping: Path | None, mapped: Mapping[str, str], servos: Sequence[str] | None) -> ControllerFmu:
    data = read_bytes(path)
    _, xml = open_archive(data)
    fmi = read_fmi_version(parse_xml(xml))
    description, blemishes = read_description(data)
    scalars = [v for v in description.modelVariables if v.type in _SCALAR_TYPES and not v.shape]
    all_inputs, all_outputs, parameters = (
        [v for v in scalars if v.causality == causality] for causality in ("input", "output", "parameter")
    )
    jets_known = range(1, MAX_JETS + 1)
    if servos is None:
        servos = _find_servos([v.name for v in all_outputs], mapped)
    names = [name for n in jets_known for name in wire.output_names("controller", n, servos, wire.OPTIONAL)]
    names += [name for level in ("rate", "attitude", "predictor") for name in wire.output_names(level, 1, ())]
    outputs = _match_ports(all_outputs, {normalise_name(name): name for name in names}, mapped)
    level = next((known_level for name, known_level in wire.LEVEL_BY_OUTPUT.items() if name in outputs), "")
    if not level:
        raise UnusableError(
            f"is no controller: it has no output {', '.join(wire.LEVEL_BY_OUTPUT)}; a mapping file {path.name}.toml "
            "names its ports"
        )
    jets = next(number for number in reversed(jets_known) if number == 1 or f"throttle_{number}" in outputs)
    moved = tuple([name for name in servos if f"tilt_{name}" in outputs])
    extras = tuple([e for e in wire.OPTIONAL if level == "controller" and _extra_outputs(jets, e) <= set(outputs)])
    needed = wire.output_names(level, jets, moved, extras)
    if missing := [name for name in needed if name not in outputs]:
        raise IncompleteError(f"has no output {missing[0]}, which a {level} needs")
    outputs = {name: outputs[name] for name in needed}
    input_ports = {normalise_name(name): name for name in wire.input_names(level, jets, servos or SERVOS, True)}
    inputs = _match_ports(all_inputs, input_ports, mapped)
    used = {id(v) for v in (*inputs.values(), *outputs.values())}
    unset = [v.name for v in all_inputs if id(v) not in used]
    names = [name for name in wire.input_names(level, jets, servos or SERVOS) if name not in inputs]
    unread = list(dict.fromkeys(re.sub(r"_\d+$", "_1 and on", name) for name in names))
    notes = (
        *blemishes,
        *([f"inputs that stay at their start values: {', '.join(unset)}"] if unset else []),
        *([f"is not told of: {', '.join(unread)}"] if unread else []),
    )
    for port, name in mapped.items():
        if port not in (*input_ports.values(), *needed):
            allowed = nearest(port, [*input_ports.values(), *needed])
            raise UnusableError(f"ports.{port}: unknown port of a {level}; {allowed}")
        causality, variables = ("output", all_outputs) if port in needed else ("input", all_inputs)
        if name not in [v.name for v in variables]:
            allowed = nearest(name, [v.name for v in variables])
            raise UnusableError(f"ports.{port} = {name!r}: is no {causality} of it; {allowed}")
    tuned = [v for v in parameters if v.name != _ON_GROUND and v.start is not None]
    return ControllerFmu(
        path,
        mapping,
        fmi,
        level,
        jets,
        moved,
        extras,
        inputs,
        outputs,
        [v for v in tuned if v.variability != "constant"],
        [v for v in all_outputs if id(v) not in used],
        notes,
        description,
        data,
    )


def _find_servos(outputs: Sequence[str], mapped: Mapping[str, str]) -> tuple[str, ...]:
    """Return the servo names of the ``tilt_`` outputs, mapped ones and others, in the order of the servos."""
    servos = [name[5:] for name in mapped if name.startswith("tilt_") and not name.endswith("_applied")]
    short = [
        normalise_name(name)[4:]
        for name in outputs
        if normalise_name(name).startswith("tilt") and name not in mapped.values()
    ]
    banks = set(SERVOS) <= {*servos, *short}
    mapped_servos = {normalise_name(name) for name in servos}
    servos += [name for name in short if name not in mapped_servos and (name in SERVOS if banks else name)]
    return tuple(sorted(servos, key=lambda name: SERVOS.index(name) if name in SERVOS else len(SERVOS)))


def _extra_outputs(jets: int, extra: str) -> set[str]:
    """Return the names of the outputs that an extra adds to a whole controller."""
    return {*wire.output_names("controller", jets, (), (extra,))} - {*wire.output_names("controller", jets, ())}


def _match_ports(variables: Sequence[Any], ports: Mapping[str, str], mapped: Mapping[str, str]) -> dict[str, Any]:
    """Return variables by port: mapped ones, else those with the port's name without case and punctuation."""
    by_name = {v.name: v for v in variables}
    by_port = {ports[normalise_name(v.name)]: v for v in variables if normalise_name(v.name) in ports}
    return by_port | {
        port: by_name[name] for port, name in mapped.items() if port in ports.values() and name in by_name
    }


def make_command(path: Path) -> list[str]:
    """Return the command line of the process that runs the FMU."""
    return python_command(_SERVE_CODE, str(path))


def describe_controller(fmu: ControllerFmu) -> dict[str, Any]:
    """Return the FMU's level, extras, parameters and columns as a controller process reports them."""
    return {
        "level": fmu.level,
        "extras": fmu.extras,
        "parameters": [[_identifier(v), *_number_and_range(v)] for v in fmu.parameters],
        "columns": [[_identifier(v), v.unit or "1", "", v.description or v.name] for v in fmu.column_outputs],
    }


def _identifier(v: Any) -> str:
    """Return a variable's name as an identifier, for columns and parameters."""
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in v.name)


def _number_and_range(v: Any) -> tuple[float, str, str, float, float]:
    """Return a parameter's default, unit, meaning, least and greatest value."""
    start, low, high = map(parse_number, (v.start, v.min, v.max))
    return (
        start or 0.0,
        v.unit or "",
        v.description or "",
        -1e308 if low is None else low,
        1e308 if high is None else high,
    )


def serve(path: str, max_bytes: int = 2**26) -> None:
    """Run as the controller process: answer input frames until the input ends."""
    pipes = serve_pipes()
    fmu = read_controller_fmu(Path(path))
    pipes.send(json.dumps(describe_controller(fmu)).encode() + b"\n")
    try:
        settings = json.loads(pipes.receive_line(max_bytes))
    except EOFError:
        return
    columns, servos_known = [_identifier(v) for v in fmu.column_outputs], fmu.servos
    if fmu.level == "controller":
        fmu = read_controller_fmu(Path(path), settings["servos"])
    input_frame, output_frame = wire.frame_layout(len(settings["inputs"])), wire.frame_layout(len(settings["outputs"]))
    try:
        with temporary("controller-") as folder:
            if settings["outputs"] != [*fmu.outputs, *columns] or columns != [
                _identifier(v) for v in fmu.column_outputs
            ]:
                moved = f"servos {', '.join(servos_known)}" if servos_known else "no servos"
                has = f"servos {', '.join(settings['servos'])}" if settings["servos"] else "no servos"
                name, jets = settings["vehicle"]["name"], len(settings["vehicle"]["jets"])
                raise RuntimeError(f"is for {fmu.jets} jets and {moved}; {name} has {jets} and {has}")
            instance = _ControllerInstance(fmu, folder, settings)
            while (frame := _receive(pipes, input_frame.size)) is not None:
                pipes.send(frame[:_NUMBER] + instance.step(frame))
    except Exception as error:
        pipes.send(output_frame.pack(-1.0, *[0.0] * len(settings["outputs"])) + f"{to_one_line(error)}\n".encode())


def _receive(pipes: Pipes, count: int) -> bytes | None:
    """Return the next ``count`` bytes of the input, or None at its end."""
    with suppress(EOFError):
        return pipes.receive(count)
    return None


class _VariableGroup:
    """FMU variables of one type that one call sets or gets; ``positions``: their indices in a frame's numbers."""

    def __init__(self, slave: Slave, way: str, kind: str, positions: Sequence[int], references: Sequence[int]) -> None:
        self._positions = positions
        self._make: Callable[[float], Any] = float if kind in REALS else bool if kind == "Boolean" else int
        self._values = slave.make_values(kind, len(references))
        self._call = slave.bind_values(way, kind, references, self._values)

    def set(self, numbers: Sequence[float]) -> None:
        """Set the variables from the numbers of an input frame."""
        for index, position in enumerate(self._positions):
            self._values[index] = self._make(numbers[position])
        self._call()

    def get(self, numbers: list[float]) -> None:
        """Write the variables into the numbers of an answer."""
        self._call()
        for position, value in zip(self._positions, self._values, strict=True):
            numbers[position] = float(value)


def _group_by_type(slave: Slave, way: str, variables: Mapping[int, Any]) -> list[_VariableGroup]:
    """Return one group for each type of variables, which are given by their positions."""
    groups = []
    for kind in dict.fromkeys(v.type for v in variables.values()):
        of_kind = {position: v.valueReference for position, v in variables.items() if v.type == kind}
        groups.append(_VariableGroup(slave, way, kind, list(of_kind), list(of_kind.values())))
    return groups


class _ControllerInstance:
    """Instance of a controller FMU, advanced by control steps."""

    def __init__(self, fmu: ControllerFmu, folder: Path, settings: Mapping[str, Any]) -> None:
        self._fmu, self._dt = fmu, float(settings["step_s"])
        self._settings = {v: settings["parameters"].get(_identifier(v)) for v in fmu.parameters}
        ground = [v for v in fmu.description.modelVariables if v.name == _ON_GROUND and v.causality == "parameter"]
        self._settings |= {v: float(settings["on_ground"]) for v in ground}
        inputs = {i: fmu.inputs[name] for i, name in enumerate(settings["inputs"]) if name in fmu.inputs}
        answers = dict(enumerate([*fmu.outputs.values(), *fmu.column_outputs]))
        self._in, self._answer = wire.layout(len(settings["inputs"])), [0.0] * len(answers)
        self._out = wire.layout(len(answers))
        try:
            with Zip(BytesIO(fmu.data)) as archive:
                archive.extractall(folder)
        except DAMAGE_ERRORS as error:
            raise RuntimeError(f"cannot be unpacked: {to_one_line(error)}") from error
        place = Path("binaries", platform_folder(fmu.fmi))
        if not (folder / place).is_dir():
            raise RuntimeError(f"has no library for this machine, {place}")
        name = f"{fmu.description.coSimulation.modelIdentifier}{LIBRARY_SUFFIX}"
        self._slave, self._log = Slave(folder / place / name, fmu.fmi), Log()
        token = fmu.description.guid if fmu.fmi == 2 else fmu.description.instantiationToken
        if not self._slave.instantiate("controller", token, folder / "resources", self._log):
            raise RuntimeError("cannot be instantiated")
        self._inputs = _group_by_type(self._slave, "Set", inputs)
        self._outputs = _group_by_type(self._slave, "Get", answers)
        self._now = c_double()
        self._do_step = self._slave.bind_step(self._now, self._dt)
        self._has_begun = False

    def step(self, frame: bytes) -> bytes:
        """Return the numbers of the answer to a frame."""
        try:
            k, numbers = int(_STEP_HEADER.unpack_from(frame)[0]), self._in.unpack_from(frame, _NUMBER)
            if k == 0:
                self._initialize(numbers)
            else:
                self._set_inputs(numbers)
            self._now.value = k * self._dt
            self._do_step()
            for group in self._outputs:
                group.get(self._answer)
        except CallError as error:
            said = to_one_line(self._log.take())
            raise RuntimeError(f"{error}: {said}" if said else str(error)) from error
        return self._out.pack(*self._answer)

    def _initialize(self, numbers: Sequence[float]) -> None:
        slave = self._slave
        if self._has_begun:
            slave.terminate()
            slave.call("Reset")
        self._has_begun = True
        slave.set_up()
        for v, value in self._settings.items():
            if value is not None:
                _VariableGroup(slave, "Set", v.type, (0,), [v.valueReference]).set((value,))
        slave.enter_initialization()
        self._set_inputs(numbers)
        slave.call("ExitInitializationMode")

    def _set_inputs(self, numbers: Sequence[float]) -> None:
        for group in self._inputs:
            group.set(numbers)
