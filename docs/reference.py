"""Pages of reference, made of the code: ``pages()`` gives each by its name.

Commands from the command line's own tree, keys from the models that read the files, columns from the one description
of the log, metrics from their records.  They are made anew whenever the site is built and are not kept, so none can be
older than the code.  A key's meaning is the comment behind its field, or above it; a name that is used in many tables
has it here.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
import types
from collections.abc import Iterable, Iterator
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from cosim.base.signals import JETS, MAX_JETS
from cosim.base.storage.paths import data_folder, files_in
from cosim.base.storage.toml import read_toml
from cosim.campaign.study.autopilot import StudyAutopilot
from cosim.campaign.study.key import unit_of
from cosim.campaign.study.study import Study
from cosim.cli import table as commands
from cosim.cli.declare import Command
from cosim.cli.main import DONE, FLIGHT_FAILED, INTERRUPTED, TERMINATED, WRONG_INPUT
from cosim.engine.fmu.mapping import MappingFile
from cosim.results.log.columns import log_columns
from cosim.results.metrics import Metrics
from cosim.simulation.controllers.controller_file import ControllerFile
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle
from hexjet_sitl.study import AutopilotTable

# --- tables -----------------------------------------------------------------------------------------------------------


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown, whose cells are Markdown."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def cell(text: str) -> str:
    """One line that does not end a cell; what Markdown would read as HTML or emphasis stays as it is."""
    shown = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text.replace("``", "`"))
    pieces = re.split(r"(`[^`]*`)", " ".join(shown.split()))
    pieces[::2] = [re.sub(r"([\\*_<>$\[\]])", r"\\\1", piece) for piece in pieces[::2]]
    return "".join(pieces).replace("|", "\\|")


# --- commands ---------------------------------------------------------------------------------------------------------


def commands_page() -> str:
    """Every command: usage, what it does, arguments and options."""
    said = (
        "# Commands\n\nAs `hexjet COMMAND --help` prints it. `hexjet --version` says which version runs. [What a command "
        "leaves behind as its exit status, and what it reads from the environment](environment.md).\n"
    )
    return said + "".join(_command(name) for name in commands.list_names())


def _command(name: str) -> str:
    command = commands.load(name)
    if not isinstance(command, Command):
        return f"\n## hexjet {name}\n\n```text\n{command.help(80)}\n```\n"
    about = "\n\n".join(map(cell, command.texts[0].split("\n\n")))
    rows = [[f"`{each.label.replace('|', chr(92) + '|')}`", cell(each.meaning)] for each in command.rows]
    shown = f"\n## hexjet {name}\n\n{about}\n\n{table(('option', 'meaning'), rows)}"
    return f"{shown}\n```text\nhexjet {name} {command.example}\n```\n"


# --- keys of files ----------------------------------------------------------------------------------------------------


class Key(NamedTuple):
    """One key of a file."""

    table: str  # such as [control.rate.roll]
    name: str
    kind: str
    default: str
    meaning: str


# What a name means wherever its field has no comment of its own.
COMMON = {
    "kind": "which of them it is",
    "name": "what it is called; that of the file or folder, where it has one",
    "title": "one line about it",
    "description": "some lines about it, for people",
    "start_s": "when it begins",
    "duration_s": "how long it lasts",
    "signal": "which set-point it moves",
    "amplitude": "how far, in the unit of the signal",
    "axis": "about which it acts",
    "jet": "the number of the jet, or a list of them",
    "servo": "which of the two tilt servos",
    "sensor": "which sensor",
    "file": "a CSV, seen from the scenario's folder",
    "from_hz": "frequency at its beginning",
    "to_hz": "frequency at its end",
    "noise_m": "standard deviation of the white noise on each sample",
    "latency_samples": "control steps by which it is late",
    "source": "where the numbers come from",
    "p": "proportional gain",
    "i": "integral gain, per second",
    "d": "gain of the derivative of the measurement, in seconds",
    "north_m": "the place, north of the start",
    "east_m": "the place, east of the start",
    "altitude_m": "height above the ground below the start",
    "yaw_deg": "heading, from north",
    "speed_m_s": "at most on the way; not stated: the vehicle's own",
    "min": "not below",
    "max": "not above",
}
# What needs more than its name and has no comment in the model: by class and field.
MEANING = {
    "DoubletCommand.width_s": "length of each of its two sides",
    "RampCommand.duration_s": "until the amplitude is reached",
    "SweepCommand.duration_s": "of the whole sweep",
    "TableCommand.interpolate": "between two rows: the first of them is held, or a straight line",
    "SticksCommand.tilt_deg": "lean at full stick",
    "SticksCommand.yaw_rate_deg_s": "turn rate at full stick",
    "SticksCommand.climb_m_s": "climb rate at full stick",
    "Waypoint.hold_s": "at this one; not stated: as at all",
    "WaypointsCommand.hold_s": "at each, before the next is flown to",
    "WaypointsCommand.waypoint": "the places, in order",
    "VelocityCommand.north_m_s": "velocity over the ground, to the north",
    "VelocityCommand.east_m_s": "velocity over the ground, to the east",
    "ForceDisturbance.force_n": "the force, body axes",
    "MomentDisturbance.moment_n_m": "the moment, body axes",
    "TorqueCommandDisturbance.shape": "how it goes over time",
    "TorqueCommandDisturbance.amplitude": "throttle on roll, rad of tilt on pitch and yaw",
    "TorqueCommandDisturbance.at": "where it is added",
    "PayloadDisturbance.mass_kg": "of the point mass",
    "PayloadDisturbance.offset_m": "where it is fixed, body, from the centre of gravity as built",
    "WindDisturbance.velocity_ned_m_s": "where the air moves to, beside the wind that is there",
    "GustDisturbance.velocity_ned_m_s": "where the air moves to at the gust's height",
    "GustDisturbance.rise_s": "from nothing to all of it",
    "GustDisturbance.hold_s": "at all of it",
    "GustDisturbance.fall_s": "from all of it to nothing",
    "StuckThrottle.throttle": "at which it stays; not stated: the one that it has at the start",
    "ThrustLoss.share": "of the thrust that is missing",
    "SlowSpool.lag_s": "time constant of the further lag",
    "DelayGrowth.delay_s": "of the further delay",
    "ServoJam.angle_deg": "where it stays; not stated: where it stands",
    "Initial.on_ground": "the vehicle stands on its legs, the engines as `initial.engines` says",
    "Initial.attitude_deg": "roll, pitch, yaw",
    "Initial.velocity_ned_m_s": "over the ground",
    "Initial.rate_deg_s": "body rates",
    "Environment.latitude_deg": "of the start",
    "Environment.longitude_deg": "of the start",
    "Environment.ground_m": "height of the ground above the sea, which sets the air",
    "Environment.wind_ned_m_s": "where the air moves to, steadily",
    "Expectation.controller": "for which this is expected",
    "Expectation.engine": "for which this is expected",
    "Expectation.outcome": "those that are right",
    "Expectation.metrics": "a table of [metrics](metrics.md), each with `min`, `max` or both",
    "Scenario.engine": "of the library, or the path of an FMU or of a mapping file",
    "Scenario.controller": "a predictor, a controller file of `hexjet design`, or [one of your own](../docs/own-controller.md)",
    "Scenario.duration_s": "of the flight",
    "Scenario.step_s": "control step; a whole multiple of every engine's internal step",
    "Scenario.substeps": "runs of JSBSim in a control step",
    "Scenario.seed": "of sensor noise and turbulence: the same seed, the same flight to the last bit",
    "Scenario.sensor_noise": "whether the sensors have the noise that the vehicle states",
    "Scenario.initial": "where the flight begins",
    "Scenario.environment": "place, wind, turbulence",
    "Scenario.mismatch": "how what flies differs from what the controller knows",
    "Scenario.command": "what is asked of the vehicle, in any order",
    "Scenario.disturbance": "what acts on it from outside",
    "Scenario.fault": "what fails",
    "Scenario.engine_parameters": "written over the parameters of the engines, by the FMU's names",
    "Scenario.vehicle": "written over the [vehicle's keys](vehicle.md)",
    "Scenario.limits": "the most that the flight may come to",
    "Scenario.expect": "what it must come to",
    "Vehicle.mass_kg": "of the whole vehicle, with a full tank",
    "Vehicle.inertia_kg_m2": "about the body axes through the centre of gravity, with a full tank",
    "Vehicle.jets": "jet 1 first",
    "Vehicle.contacts": "legs and points of the hull",
    "Vehicle.servo": "the tilt servos; none where no jet tilts",
    "Vehicle.fuel": "the tank; none: nothing is burnt off",
    "Vehicle.aero": "drag and damping",
    "Vehicle.sensors": "errors and latency of each sensor",
    "Vehicle.control": "gains of the built-in controller",
    "Vehicle.identified": "models by engine and axis, which predictors believe",
    "Vehicle.limits": "where a flight is over",
    "Airflow.kg_s": "air that one engine swallows at the thrust beside it",
    "Airflow.at_thrust_n": "thrust at which it does so",
    "Airflow.exponent": "of the thrust",
    "Servo.lag_s": "time constant of its first-order lag",
    "Servo.rate_limit_rad_s": "most it can turn",
    "Vehicle.surfaces": "control surfaces, whose forces the JSBSim model knows",
    "Hinge.lag_s": "time constant of its first-order lag",
    "Hinge.rate_limit_rad_s": "most it can turn",
    "Hinge.mass_kg": "of what it carries, for the reaction on the body",
    "Hinge.effort": "of allocation by effectiveness: how dear its range is beside that of the others",
    "Surface.lag_s": "time constant of its first-order lag",
    "Surface.range": "of its command, least and most",
    "Surface.effort": "of allocation by effectiveness: how dear its range is beside that of the others",
    "Fuel.mass_kg": "in a full tank",
    **{f"Mismatch.thrust_factor_{jet}": f"the same, of jet {jet}" for jet in range(2, 7)},
    "Aero.damping_n_m_s": "moment per rate about x, y, z",
    "Contact.kind": "a leg carries the vehicle; a hull that touches is a crash",
    "Contact.position_m": "body, from the centre of gravity",
    "Contact.spring_n_m": "stiffness",
    "Contact.damping_n_s_m": "damping",
    "Contact.friction_static": "coefficient while it sticks",
    "Contact.friction_dynamic": "coefficient while it slides",
    "GyroSensor.filter_s": "time constant of its low-pass",
    "GyroSensor.noise_rad_s": "standard deviation of the white noise on each sample",
    "GyroSensor.bias_rad_s": "constant, body axes",
    "AttitudeSensor.noise_rad": "standard deviation about each body axis",
    "AttitudeSensor.bias_rad": "constant, about the body axes",
    "AttitudeSensor.ahrs_time_constant_s": "of a complementary filter; 0: the lean is the true one",
    "PositionSensor.position_noise_m": "standard deviation of each fix, each axis",
    "PositionSensor.velocity_noise_m_s": "standard deviation of each fix, each axis",
    "PositionSensor.period_samples": "control steps from one fix to the next",
    "AltitudeSensor.bias_m": "constant",
    "ForceSensor.noise_m_s2": "standard deviation of the white noise on each sample",
    "ForceSensor.bias_m_s2": "constant, body axes",
    "Sensors.gyro": "angular rate", "Sensors.attitude": "attitude quaternion", "Sensors.gnss": "place and velocity",
    "Sensors.barometer": "height", "Sensors.accelerometer": "specific force",
    "AttitudeGains.gain_1_s": "rate set-point per attitude error: roll, pitch, yaw",
    "AttitudeGains.rate_limit_rad_s": "most rate asked for: roll, pitch, yaw",
    "RateGains.d_filter_s": "time constant of the derivative's filter",
    "RateGains.integral_limit": "most of the integral's share, in the unit of the output",
    "RateControl.roll": "its gains", "RateControl.pitch": "its gains", "RateControl.yaw": "its gains",
    "Leads.roll": "of the roll command; false: none", "Leads.pitch": "of the pitch command; false: none",
    "Leads.yaw": "of the yaw command; false: none", "Leads.altitude": "of the collective; false: none",
    "ScheduledGains.d": "factor on the derivative gain",
    "ScheduledGains.damping": "of the engine's two poles at this thrust",
    "ScheduledGains.pole_rad_s": "each of them is moved to minus this",
    "EngineLead.damping": "of the engine's two poles; not stated: it is one lag",
    "ThrustLevel.roll": "factors on the roll gains", "ThrustLevel.altitude": "factors on the height gains",
    "AltitudeGains.position_1_s": "climb rate per height error",
    "AltitudeGains.climb_limit_m_s": "most climb asked for",
    "AltitudeGains.descent_limit_m_s": "most sink asked for",
    "AltitudeGains.velocity_1_s": "acceleration per error of the climb rate",
    "AltitudeGains.integral_1_s2": "of that error's integral",
    "AltitudeGains.integral_limit_m_s2": "most of the integral's share",
    "AllocationLimits.throttle_min": "least throttle in flight",
    "AllocationLimits.throttle_max": "most throttle in flight",
    "PositionGains.position_1_s": "velocity asked for per position error",
    "PositionGains.velocity_1_s": "acceleration asked for per velocity error",
    "PilotSettings.speed_m_s": "over the ground, at most",
    "PilotSettings.acceleration_m_s2": "of horizontal set-points, at most",
    "PilotSettings.jerk_m_s3": "of horizontal set-points, at most",
    "PilotSettings.climb_m_s": "climb, at most", "PilotSettings.descent_m_s": "sink, at most",
    "PilotSettings.land_m_s": "sink in the last metres of a landing",
    "PilotSettings.yaw_rate_rad_s": "turn rate, at most",
    "PilotSettings.stick_lean_rad": "lean at full stick",
    "PilotSettings.takeoff_height_m": "to which a take-off goes that names no height",
    "PilotSettings.return_height_m": "at which it flies home, at least",
    "Control.attitude": "attitude loop", "Control.rate": "rate loops", "Control.altitude": "height loop",
    "Control.allocation": "throttles", "Control.predictor": "what predictors are tuned with",
    "Control.lead": "on the commands that engines answer", "Control.position": "place and velocity loops",
    "Control.monitor": "the engine monitor; none: `monitor` of a scenario is refused",
    "Control.pilot": "the autopilot's defaults",
    "RateModel.gain": "of the response, with poles and zeros as they stand",
    "RateModel.zeros": "real zeros, of z", "RateModel.poles": "real poles, of z",
    "RateModel.pole_pairs": "real and imaginary part",
    "RateModel.sample_time_s": "of the model, which is the control step of the flights that it is for",
    "Limits.rate_deg_s": "any axis, in the air: diverged",
    "Study.design": "how draws are made",
    "Study.seed": "of the draws; each flight's own seed follows from it",
    "Study.vary": "what is drawn", "Study.correlate": "rank correlations between what is drawn",
    "Study.case": "named variants of the scenario, values of the key `case`",
    "Case.settings": "written over the scenario; a seed is the case's own",
    "Case.autopilot": "written over `[autopilot]`",
    "Correlation.keys": "two varied keys", "Correlation.rank": "Spearman's, of what is drawn for them",
    "Vary.key": "the dotted name of a number of the scenario; `hexjet sweep --keys` lists them",
    "Vary.range": "uniform between two numbers", "Vary.levels": "grid points in the range, both ends among them",
    "Vary.scale": "uniform in the number, or in its logarithm", "Vary.values": "each equally likely",
    "Vary.normal": "a normal distribution", "Vary.lognormal": "a log-normal distribution",
    "Vary.triangular": "a triangular distribution",
    "Vary.relative": "a factor on the nominal value, or an offset to it; not stated: the value itself",
    "Normal.mean": "before it is truncated", "Normal.sd": "standard deviation before it is truncated",
    "LogNormal.median": "before it is truncated", "LogNormal.sigma": "standard deviation of the logarithm",
    "Triangular.mode": "the likeliest",
    "MappingFile.fmu": "the archive, seen from this file",
    "MappingFile.ports": "which variable stands at which port",
    "MappingFile.units": "units that the FMU does not declare, or declares wrongly",
    "MappingFile.range": "the throttle's ends", "MappingFile.scale": "the port is so many times the variable",
    "MappingFile.parameters": "set before the flight, by the FMU's names",
    "MappingFile.inputs": "held at a value, by the FMU's names", "MappingFile.start": "how it is started",
    "MappingFile.rest": "when a thrust stands still", "MappingFile.rotor": "for the gyroscopic moment",
    "MappingFile.flame_out": "how it goes out", "MappingFile.ledger": "what the delay ledger is told",
    "_Ports.*": "name of the FMU's variable for this [port](../docs/own-engine.md#ports)",
    "_Units.*": "unit of the variable, a name of the [table of units](../docs/own-engine.md#units)",
    "_Scale.*": "factor, where several of it are one engine, say",
    "_Range.throttle": "the variable's values at throttle 0 and 1",
    "_Rotor.inertia_kg_m2": "about the jet's axis",
    "_FlameOut.electric": "true: a motor, without a flame",
    "_FlameOut.thrust_left": "share of the thrust that the run-down begins with",
    "_FlameOut.run_down_s": "time constant of the run-down", "_FlameOut.exponent": "of the run-down's law",
    "_FlameOut.relight_s": "from the relight to idle",
    "_Start.warm_up_s": "at throttle 0, before checks, measurements and flights",
    "_Rest.thrust": "N, peak to peak, within which a thrust stands still",
    "_Ledger.delay_s": "transport delay, where no tool can know it",
    "ControllerFile.controller": "the predictor", "ControllerFile.design": "what it was designed for; for people",
    "ControllerFile.vehicle": "written over the [vehicle's keys](vehicle.md): gains, leads, models",
    "AxisRecord.*": "of the finished design", "LevelRecord.mass_kg": "with this fuel",
    "LevelRecord.axes": "what is said of each channel there",
    "Purpose.*": "with which it was designed", "Requirements.*": "what it must keep",
}  # fmt: skip

# Tables that a tool reads.
OF_TOOLS: dict[type, type[BaseModel]] = {StudyAutopilot: AutopilotTable}


def tables(model: type[BaseModel], table: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Every table of a file by its heading, with its model; one that may be of several kinds comes once for each."""
    yield table, model
    for name, field in model.model_fields.items():
        kind, inside = repr(field.annotation), list(_models(field.annotation))
        for each in inside:
            named = ("NAME", "AXIS")[: kind.count("dict[") + kind.count("Dict[")]
            path = ".".join(filter(None, (table.strip("[]").partition("]")[0], name, *named)))
            which = each.model_fields.get("kind") if len(inside) > 1 else None
            heading = f"[[{path}]]" if "list[" in kind else f"[{path}]"
            yield from tables(each, f'{heading} kind = "{get_args(which.annotation)[0]}"' if which else heading)


def keys(model: type[BaseModel]) -> Iterator[Key]:
    """Every key of a file, table by table."""
    for heading, each in tables(model):
        said = comments(each)
        for name, field in each.model_fields.items():
            default = "needed" if field.is_required() else _default(field.get_default(call_default_factory=True))
            meaning = said.get(name) or _known(each, name)
            yield Key(heading, name, _kind(field.annotation, field.metadata), default, meaning)


def keys_page(model: type[BaseModel], head: str) -> str:
    """All keys of a file, a heading for each of its tables."""
    rows: dict[str, list[list[str]]] = {}
    for key in keys(model):
        rows.setdefault(key.table, []).append([f"`{key.name}`", key.kind, key.default, key.meaning])
    shown = head
    for heading, each in tables(model):
        title = f"`{heading}`" if heading else "At the top of the file"
        said = f"{cell(each.__doc__)}\n\n" if heading and each.__doc__ else ""
        shown += f"\n## {title}\n\n{said}{table(('key', 'type', 'default', 'meaning'), rows[heading])}"
    return shown


def _models(kind: Any) -> Iterator[type[BaseModel]]:
    if inspect.isclass(kind) and get_origin(kind) is None:
        kind = OF_TOOLS.get(kind, kind)
        if issubclass(kind, BaseModel):
            yield kind
        return
    for each in get_args(kind):
        yield from _models(each)


def _known(model: type[BaseModel], name: str) -> str:
    """What is said of a name above; with the links that it has."""
    own = f"{model.__name__}.{name}"
    return MEANING.get(own) or MEANING.get(f"{model.__name__}.*") or COMMON.get(name, "")


def _default(value: Any) -> str:
    if value is None:
        return "-"
    if value is PydanticUndefined:
        return ""
    if isinstance(value, BaseModel):
        return "as below"
    if value in ("", [], {}, ()):
        return "none"
    if isinstance(value, (list, tuple)):
        return f"`[{', '.join(_toml(each) for each in value)}]`"
    return f"`{_toml(value)}`"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(value)


def _kind(kind: Any, metadata: Iterable[Any] = ()) -> str:
    """A type in words, with its bounds."""
    said = " ".join(filter(None, [_word(kind), _bounds(metadata)]))
    return said.replace("|", "\\|")


def _word(kind: Any) -> str:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return " ".join(filter(None, [_word(arguments[0]), _bounds(arguments[1:])]))
    if origin is Literal:
        return ", ".join(f"`{_toml(each)}`" for each in arguments)
    if origin in (Union, types.UnionType):
        words = dict.fromkeys(_word(each) for each in arguments if each is not type(None))
        return " or ".join(words)
    if origin is tuple:
        if len(set(arguments)) == 1:
            return (
                f"{len(arguments)} numbers" if _word(arguments[0]).startswith("number") else f"{len(arguments)} texts"
            )
        return "pair of " + " and ".join(_word(each) for each in arguments)
    if origin is list:
        return f"list: {_word(arguments[0])}"
    if origin is dict:
        return f"table: {_word(arguments[1])} by name"
    if inspect.isclass(kind) and issubclass(OF_TOOLS.get(kind, kind), BaseModel):
        return "table"
    return {float: "number", int: "whole number", bool: "true, false", str: "text", Any: "any"}.get(kind, "text")


def _bounds(metadata: Iterable[Any]) -> str:
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    found = []
    for each in metadata:
        inside = getattr(each, "metadata", None) or [each]
        found += [
            f"{sign} {getattr(part, name):g}" for part in inside for name, sign in signs.items() if hasattr(part, name)
        ]
        for part in inside:
            if hasattr(part, "min_length") and part.min_length:
                found.append(f"at least {part.min_length}")
    return ", ".join(found).replace("<", "&lt;").replace(">", "&gt;")


@cache
def comments(model: type[BaseModel]) -> dict[str, str]:
    """What the comments of a model's source say of its fields: those behind a field, else those right above it."""
    found = {name: text for base in model.__mro__[1:] if base.__module__.startswith("cosim") and issubclass(base, BaseModel)
             for name, text in comments(base).items()}  # fmt: skip
    try:
        source = textwrap.dedent(inspect.getsource(model))
    except (OSError, TypeError):  # a model that is made of a list of names
        return found
    lines = source.splitlines()
    (node,) = ast.parse(source).body
    assert isinstance(node, ast.ClassDef)
    for each in node.body:
        if not isinstance(each, ast.AnnAssign):
            continue
        behind = [_behind(line) for line in lines[each.lineno - 1 : each.end_lineno]]
        above = []
        for line in reversed(lines[: each.lineno - 1]):
            if not line.lstrip().startswith("#"):
                break
            above.insert(0, line.strip().removeprefix("#").strip())
        text = " ".join(filter(None, behind)) or " ".join(above)
        if text:
            found[ast.unparse(each.target)] = cell(text)
    return found


def _behind(line: str) -> str:
    """The comment at the end of a line; a ``#`` in a text is none."""
    match = re.search(r"\s#\s(.*)$", re.sub(r"\"[^\"]*\"|'[^']*'", lambda text: "x" * len(text[0]), line))
    return line[match.start(1) :] if match else ""


# --- the log, metrics, the rest ---------------------------------------------------------------------------------------


def columns_page() -> str:
    """Every column of the log."""
    head = (
        "# Columns of the log\n\nOne row of `flight.parquet` is one control step `k`. True and measured quantities are taken at `t_k`, before the "
        f"step; everything else acts over `[t_k, t_k+1)`. All are float64. A vehicle with more than {JETS} jets has the columns of jets up "
        f"to {MAX_JETS} too; one with fewer has NaN there. Body is forward-right-down, NED north-east-down with its origin on the ground "
        "below the start. Columns that a block [of your own](../docs/own-controller.md#your-own-metric-wind-sensors-and-observer) shows come last. In exports the names are the same, or "
        "[stated beside](../docs/runs.md#the-log-in-other-tools).\n\n"
    )
    rows = [
        [f"`{each.name}`", cell(each.unit) or "-", cell(each.frame) or "-", cell(each.meaning)]
        for each in log_columns()
    ]
    return head + table(("column", "unit", "frame", "meaning"), rows)


def metrics() -> Iterator[tuple[str, str]]:
    """Every metric, with what its record says of it."""
    axes = {"axes": ("roll", "pitch", "yaw")}
    said = comments(Metrics)
    for name, field in Metrics.model_fields.items():
        inside = list(_models(field.annotation))
        for model in inside:
            for prefix in axes.get(name, (name,)):
                about = (inspect.getdoc(model) or "").replace(
                    "One axis.  None stands for what this flight cannot tell.", ""
                )
                for inner in model.model_fields:
                    yield f"{prefix}.{inner}", comments(model).get(inner) or cell(about)
        if not inside:
            yield name, said.get(name, "")


def metrics_page() -> str:
    """Every metric with its unit."""
    head = (
        "# Metrics\n\nNames as `[[expect]]`, `[success]`, `--success`, `summary.json` and campaigns use them; the [definitions](../docs/metrics.md), "
        "with what each leaves out. A metric [of your own](../docs/own-controller.md#your-own-metric-wind-sensors-and-observer) is `own.NAME`.\n\n"
    )
    rows = [[f"`{name}`", _unit(name), meaning] for name, meaning in metrics()]
    return head + table(("metric", "unit", "meaning"), rows)


def _unit(name: str) -> str:
    return "%" if name.endswith("_percent") else unit_of(name) or "-"


# The names in the environment that anything reads.
ENVIRONMENT = {
    "COLUMNS": "width of tables in the terminal and in a pipe",
    "NO_COLOR": "set: no colours in the terminal",
    "TMPDIR": "where temporary files are made",
    "XDG_CACHE_HOME": "where it is remembered what an engine's check and its measured curve said; `~/.cache` without it",
    "XDG_DATA_HOME": "where `hexjet --install-completion bash` writes its file; `~/.local/share` without it",
    "XDG_CONFIG_HOME": "where it is remembered whose code is run (`hexjet/trusted`); `~/.config` without it",
    "HEXJET_TRUST": "1: code that files name is run and remembered without a question, as with `--trust`",
    "HEXJET_PURE": "set at run time: everything runs from source, nothing compiled; set at the build: nothing is compiled",
    "HEXJET_OPTIMISATION": "at the build: the C compiler's level for the compiled modules, `-O2` without it; the bits are the same",
    "HEXJET_PORT": "set by `hexjet sitl` for Betaflight: where its ports begin",
    "HEXJET_PROCESS": "set by `hexjet` for the processes that it starts, which are found by it and ended with all that they started",
    "ARDUPILOT_SITL": "the ArduPilot program that `hexjet sitl` runs",
    "BETAFLIGHT_SITL": "the Betaflight program that `hexjet sitl` runs",
    "PX4_SITL": "the PX4 program that `hexjet sitl` runs",
    "HEXJET_BROWSER": "the browser that tests, pictures of pages and `hexjet benchmark` drive",
    "CC": "the C compiler that builds FMUs and extensions; `cc` without it",
    "PYTHONPATH": "where Python finds modules of your own; a campaign's workers on this machine have the same",
    "PATH": "where compiler and CMake are found",
    "OMP_NUM_THREADS": "threads of numpy's libraries; 1 unless it is stated, as of OpenBLAS, MKL and the like",
}  # fmt: skip


def environment_page() -> str:
    """Exit statuses, and what is read from the environment."""
    statuses = {
        DONE: "done: flown as planned, or completed within its limits and nothing checked, or what was asked for is written",
        FLIGHT_FAILED: "the flight crashed, diverged or failed, went beyond [its limits](../docs/metrics.md#limits), or missed what its "
        "scenario expects or requires; a check found a fault; a margin is less than was asked for; the machine had no more to give (disk, memory)",
        WRONG_INPUT: "the input was wrong: one line on standard error says what, where, and what is allowed",
        INTERRUPTED: "Ctrl-C: one line says what is kept",
        TERMINATED: "SIGTERM, the same",
    }
    return (
        "# Exit statuses, environment\n\n## Exit statuses\n\n"
        + table(("status", "when"), [[str(status), said] for status, said in statuses.items()])
        + "\n## Environment\n\n"
        + table(("name", "meaning"), [[f"`{name}`", said] for name, said in ENVIRONMENT.items()])
    )


def catalogue_page(kind: str, head: str) -> str:
    """What is shipped of a kind: name, title, and what its file says."""
    shown = head
    for name in files_in(kind):
        data = read_toml(data_folder(kind) / f"{name}.toml")
        shown += (
            f"\n## {name}\n\n{cell(data.get('title', ''))}\n\n{cell(data.get('description', ''))}\n\n"
            f"```{{literalinclude}} ../{kind}/{name}.toml\n:language: toml\n```\n"
        )
    return shown


def pages() -> dict[str, str]:
    """Every page by its file's name."""
    return {
        "commands.md": commands_page(),
        "scenario.md": keys_page(
            Scenario,
            "# Keys of a scenario\n\nThe tables and keys of a scenario's TOML; on the command line they are dotted names: "
            "`--set initial.altitude_m=12`, `--set command.0.amplitude=5`. [The shipped ones](scenarios.md).\n",
        ),
        "vehicle.md": keys_page(
            Vehicle,
            "# Keys of a vehicle\n\nThe tables and keys of `vehicle.toml`; a scenario writes over them under `vehicle.`. "
            "[An aircraft of your own](../docs/own-aircraft.md).\n",
        ),
        "study.md": keys_page(
            Study, "# Keys of a study\n\nThe tables and keys of a study's TOML. [Campaigns](../docs/campaigns.md).\n"
        ),
        "mapping.md": keys_page(
            MappingFile,
            "# Keys of a mapping file\n\nWhat may be said of a foreign engine. [An engine of your own](../docs/own-engine.md).\n",
        ),
        "controller.md": keys_page(
            ControllerFile,
            "# Keys of a controller file\n\nWhat `hexjet design --out` writes. [Control design](../docs/control-design.md).\n",
        ),
        "columns.md": columns_page(),
        "metrics.md": metrics_page(),
        "environment.md": environment_page(),
        "scenarios.md": catalogue_page("scenarios", "# Scenarios that are shipped\n\nEach is an example and a test.\n"),
        "studies.md": catalogue_page("studies", "# Studies that are shipped\n\nEach is an example.\n"),
    }
