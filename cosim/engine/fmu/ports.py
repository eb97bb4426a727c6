"""What an engine's variables are called and measured in, and what the co-simulation calls them.

A port is found by causality, name and unit, or stated in a mapping file::

    fmu = "their.fmu"
    [ports]
    throttle = "PLA"          # an element of an array as "levers[1]"; "" leaves a port unconnected
    thrust = "Fn"             # ["F1", "F2"] or "F*": the FMU holds several engines, and serves as many stations
    [units]
    thrust = "lbf"            # only where the FMU declares none or the wrong one
    [range]
    throttle = [20.0, 100.0]  # what 0 and 1 are, in the FMU's own unit
    [scale]
    thrust = -1.0             # the port is so many times the variable
    [parameters]
    gain = 1.0
    [inputs]                  # inputs that are held: numbers, true or false, the name of an enumeration's item
    fuel_valve = 1.0
    [start]                   # what is done with every instance before anything else: see cosim.engine.fmu.starting
    sequence = [{ set = { ignition = true }, until = "N1 > 30000", at_most_s = 60.0 }]
    [rest]
    thrust = 0.2              # N, peak to peak: a thrust that moves no more stands still
    [rotor]
    inertia_kg_m2 = 2.0e-4
    [flame_out]               # without a port run; electric = true for a fan
    thrust_left = 0.4
    run_down_s = 1.2
    exponent = 2.6
    relight_s = 13.0
    [log]                     # further outputs, in the flight's log under names of one's own
    shaft_torque_Nm = "tau"
    [ledger]
    delay_s = 0.1             # of the thrust behind the throttle, if known
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import floor, inf, isfinite, log, sqrt
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field, field_validator, model_validator

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.signals import MOST_JETS
from cosim.base.storage.toml import (
    Model,
    NotNegative,
    Positive,
    read_toml,
    validate,
)
from cosim.engine.fmu.units import (
    ANGULAR_SPEED,
    DENSITY,
    FORCE,
    LENGTH,
    MASS_FLOW,
    MOMENT,
    PRESSURE,
    RATIO,
    SPEED,
    TEMPERATURE,
    Quantity,
    Unit,
    UnitError,
    by_name,
    measures,
    to_si,
)
from cosim.engine.rundown import FlameOutLaw, law_of

# In the order of the C loop.
BASE = ("throttle", "ambient_pressure", "ambient_temperature", "air_speed")
DERIVED = ("altitude", "mach", "density", "total_pressure", "total_temperature")  # from those: Air.derived
INPUTS = (*BASE, *DERIVED)
ASIDE = ("force_forward", "force_right", "torque")  # what an engine does to the airframe beside its thrust
OUTPUTS = ("thrust", "spool_speed", "exhaust_temperature", "fuel_flow", *ASIDE)
AMBIENT = INPUTS[1:]
NEEDED = ("throttle", "thrust")
SPEEDS = ("air_speed", "mach", "total_pressure", "total_temperature")  # of the air into one engine's intake
OWN = ("throttle", *OUTPUTS, "ram_drag", "run", "start")  # that no two engines of one FMU share

REALS = ("Real", "Float64", "Float32")
INTEGERS = ("Integer", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")
LEVERS = (*REALS, *INTEGERS)
SWITCHES = (*REALS, "Boolean", *INTEGERS)
LONGEST_START_S = 600.0  # of one stage: chosen by us; a turbojet is at idle within two minutes
CONDITION = re.compile(r"\s*(\S+)\s*(>=|<=|>|<)\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*")
RANGE = "a mapping file does: [range] throttle = [what 0 is, what 1 is]"
LEAST_STEPS = 20  # of a throttle in whole numbers, chosen by us: coarser than 5 % it is a switch
NO_BOUND = 1e9  # tools write bounds such as 1e60 where there is none


# Dry air and the standard atmosphere: ISO 2533:1975.
GAMMA = 1.4
GAS = 287.05287  # J/(kg K)
PRESSURE_0, TEMPERATURE_0, LAPSE = 101325.0, 288.15, 0.0065  # Pa, K, K/m
TROPOPAUSE, STRATOSPHERE = 11000.0, 216.65  # m, K


class Air(NamedTuple):
    """The air around one engine."""

    pressure: float  # Pa, static
    temperature: float  # K, static
    speed: float  # m/s, into the intake

    def derived(self) -> dict[str, float]:
        """The same air in other words, as the C loop computes them: :data:`DERIVED`, SI units.

        ``altitude`` is the geopotential pressure altitude of ISO 2533, which engine decks mean; density that of dry
        air as an ideal gas; total values isentropic, with a ratio of specific heats of 1.4.
        """
        share = (self.pressure / PRESSURE_0) ** (GAS * LAPSE / GRAVITY)
        altitude = TEMPERATURE_0 / LAPSE * (1.0 - share)
        if altitude > TROPOPAUSE:
            there = (STRATOSPHERE / TEMPERATURE_0) ** (GRAVITY / (GAS * LAPSE)) * PRESSURE_0
            altitude = TROPOPAUSE + GAS * STRATOSPHERE / GRAVITY * log(there / self.pressure)
        mach = self.speed / sqrt(GAMMA * GAS * self.temperature)
        ram = 1.0 + 0.5 * (GAMMA - 1.0) * mach * mach
        density = self.pressure / (GAS * self.temperature)
        total = self.pressure * ram ** (GAMMA / (GAMMA - 1.0))
        return dict(zip(DERIVED, (altitude, mach, density, total, self.temperature * ram), strict=True))


STANDARD_AIR = Air(101325.0, 288.15, 0.0)  # the standard atmosphere's at sea level, at rest


class Kind(NamedTuple):
    """What a port is, and what it is usually called.

    Names are compared in lower case and without anything but letters and digits.  They are plain words and the symbols
    of gas turbine performance programs: FN and N as in the glossary of GSP, Fnet, Nmech and Wf as in NASA's T-MATS, PLA
    for the power lever's angle, thrust-lbs, n1 and fuel-flow-rate-pps as in JSBSim's properties.  Left out is what
    means different things to different tools: ``P0`` and ``T0`` (static or total), ``FG`` (gross thrust, without ram
    drag), ``T4`` and ``T5`` (on one side of the turbine or the other).
    """

    causality: str
    quantity: Quantity
    types: tuple[str, ...]
    names: tuple[str, ...]
    vague: tuple[str, ...] = ()  # names that count where no better one is found
    stated: bool = False  # never looked for, because an FMU that has it may mean another thing by it


KINDS: Mapping[str, Kind] = {
    "throttle": Kind(
        "input",
        RATIO,
        LEVERS,
        (
            "throttle", "throttlecmd", "throttlecommand", "throttlecmdnorm", "throttleinput", "throttlelever",
            "throttleposition", "throttlepos", "throttlesetting", "thr", "thrcmd", "thrustlever", "thrustleverangle",
            "tla", "pla", "powerlever", "powerleverangle", "powersetting",
        ),
        ("lever", "command", "cmd", "control", "u"),
    ),
    "ambient_pressure": Kind(
        "input",
        PRESSURE,
        REALS,
        (
            "ambientpressure", "pressureambient", "pambient", "pamb", "ps0", "staticpressure", "atmosphericpressure",
            "patm", "pinf",
        ),
        ("pressure",),
    ),
    "ambient_temperature": Kind(
        "input",
        TEMPERATURE,
        REALS,
        (
            "ambienttemperature", "temperatureambient", "ambienttemp", "tambient", "tamb", "ts0", "oat",
            "outsideairtemperature", "statictemperature", "tinf",
        ),
        ("temperature",),
    ),
    "air_speed": Kind(
        "input",
        SPEED,
        REALS,
        (
            "airspeed", "trueairspeed", "tas", "vtas", "flightspeed", "flightvelocity", "freestreamvelocity", "v0",
            "vinf", "vair",
        ),
    ),
    "altitude": Kind(
        "input",
        LENGTH,
        REALS,
        ("altitude", "alt", "pressurealtitude", "flightaltitude", "hp", "zp"),
    ),
    "mach": Kind("input", RATIO, REALS, ("mach", "machnumber", "flightmach", "mn", "xm")),
    "density": Kind("input", DENSITY, REALS, ("density", "airdensity", "ambientdensity", "rho", "rhoamb", "rhoair")),
    "total_pressure": Kind(
        "input",
        PRESSURE,
        REALS,
        ("totalpressure", "ptotal", "ptot", "stagnationpressure", "pt0", "pt1", "inlettotalpressure"),
    ),
    "total_temperature": Kind(
        "input",
        TEMPERATURE,
        REALS,
        ("totaltemperature", "ttotal", "ttot", "stagnationtemperature", "tt0", "tt1", "totalairtemperature", "tat"),
    ),
    "run": Kind("input", RATIO, SWITCHES, ("run", "enginerun", "runcommand", "runcmd", "fuelon", "runswitch")),
    "thrust": Kind(
        "output",
        FORCE,
        REALS,
        (
            "thrust", "fn", "fnet", "netthrust", "thrustnet", "thrustforce", "jetthrust", "enginethrust",
        ),
        ("force", "f"),
    ),
    "ram_drag": Kind("output", FORCE, REALS, (), stated=True),  # taken from a thrust that is the gross one
    "spool_speed": Kind(
        "output",
        ANGULAR_SPEED,
        REALS,
        (
            "spoolspeed", "rotorspeed", "shaftspeed", "rotationalspeed", "enginespeed", "nmech", "xn", "n1", "n2",
            "rpm",
        ),
        ("n", "speed", "omega", "w"),
    ),
    "exhaust_temperature": Kind(
        "output",
        TEMPERATURE,
        REALS,
        ("exhausttemperature", "exhaustgastemperature", "exhausttemp", "egt"),
    ),
    "fuel_flow": Kind(
        "output",
        MASS_FLOW,
        REALS,
        (
            "fuelflow", "fuelmassflow", "fuelflowrate", "fuelrate", "fuelconsumption", "wf", "wfuel", "mdotfuel",
            "mdotf", "mfuel", "ff",
        ),
    ),
    # in the frame of the jet, which tilts with it; a torque of an engine is most often that of its shaft
    "force_forward": Kind("output", FORCE, REALS, (), stated=True),
    "force_right": Kind("output", FORCE, REALS, (), stated=True),
    "torque": Kind("output", MOMENT, REALS, (), stated=True),
    "start": Kind(
        "parameter",
        RATIO,
        REALS,
        ("throttlestart", "startthrottle", "initialthrottle", "throttleinitial", "throttleinit", "throttle0"),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Variable:
    """One scalar variable of an FMU, or one element of an array; ``start`` is None where none is stated."""

    name: str
    type: str  # FMI's name of the type
    reference: int
    unit: str | None
    min: float | None
    max: float | None
    start: float | None
    description: str
    causality: str = ""
    variability: str = ""
    base: Unit | None = None  # what the description says of the unit
    items: tuple[tuple[str, int], ...] = ()  # of an enumeration
    index: int = 0  # in the array, counted from 0 in the order in which FMI passes it
    starts: tuple[float, ...] = (0.0,)  # of the whole array, 0 where none is stated
    clocks: tuple[int, ...] = ()  # FMI 3.0: references of the clocks at whose ticks alone it may be set

    @property
    def is_array(self) -> bool:
        """Whether setting it means setting other elements too."""
        return len(self.starts) > 1


@dataclass(frozen=True)
class Port:
    """A variable of an FMU as the co-simulation sees it: ``canonical = scale * value + offset``.

    The other way round it is ``value = gain * canonical + bias``, limited to ``low .. high``: both ways are kept, so
    that the ends of a range are met exactly.
    """

    variable: Variable
    scale: float = 1.0
    offset: float = 0.0
    gain: float = 1.0
    bias: float = 0.0
    low: float = field(default=-inf, repr=False)
    high: float = field(default=inf, repr=False)

    def value(self, canonical: float) -> float:
        """What the FMU is given, as the C loop computes it."""
        value = self.gain * canonical
        if self.bias != 0.0:
            value += self.bias
        value = min(max(value, self.low), self.high)
        return float(floor(value + 0.5)) if self.variable.type in INTEGERS else value


VariableName = str | list[str]  # a variable's name; several, or one with a * for a number: an engine each


class _Ports(Model):
    throttle: VariableName | None = None
    thrust: VariableName | None = None
    ambient_pressure: VariableName | None = None
    ambient_temperature: VariableName | None = None
    air_speed: VariableName | None = None
    altitude: VariableName | None = None
    mach: VariableName | None = None
    density: VariableName | None = None
    total_pressure: VariableName | None = None
    total_temperature: VariableName | None = None
    run: VariableName | None = None
    ram_drag: VariableName | None = None
    spool_speed: VariableName | None = None
    exhaust_temperature: VariableName | None = None
    fuel_flow: VariableName | None = None
    force_forward: VariableName | None = None
    force_right: VariableName | None = None
    torque: VariableName | None = None
    start: VariableName | None = None


class _Units(Model):
    throttle: str | None = None
    thrust: str | None = None
    ambient_pressure: str | None = None
    ambient_temperature: str | None = None
    air_speed: str | None = None
    altitude: str | None = None
    mach: str | None = None
    density: str | None = None
    total_pressure: str | None = None
    total_temperature: str | None = None
    ram_drag: str | None = None
    spool_speed: str | None = None
    exhaust_temperature: str | None = None
    fuel_flow: str | None = None
    force_forward: str | None = None
    force_right: str | None = None
    torque: str | None = None


class _Scale(Model):
    thrust: float | None = None
    ambient_pressure: float | None = None
    ambient_temperature: float | None = None
    air_speed: float | None = None
    altitude: float | None = None
    ram_drag: float | None = None
    spool_speed: float | None = None
    fuel_flow: float | None = None
    force_forward: float | None = None
    force_right: float | None = None
    torque: float | None = None

    @field_validator("*")
    @classmethod
    def _not_nothing(cls, value: float | None) -> float | None:
        if value is not None and (value == 0.0 or not isfinite(value)):
            raise ValueError("must be a finite number other than 0")
        return value


class _Range(Model):
    throttle: tuple[float, float] | None = None


class _Rotor(Model):
    inertia_kg_m2: NotNegative = 0.0


class _FlameOut(Model):
    electric: Literal[True] | None = None
    thrust_left: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    run_down_s: Positive | None = None
    exponent: Positive | None = None
    relight_s: Positive | None = None

    @model_validator(mode="after")
    def _one_or_the_other(self) -> _FlameOut:
        stated = [self.thrust_left, self.run_down_s, self.exponent, self.relight_s]
        if self.electric and any(value is not None for value in stated):
            raise ValueError("electric = true stands alone")
        if not self.electric and None in stated:
            raise ValueError("state thrust_left, run_down_s, exponent and relight_s, or electric = true")
        return self

    def law(self) -> FlameOutLaw:
        return law_of(self.model_dump(exclude_none=True))


def flat(table: object) -> object:
    """``emf.k = 1`` in TOML is a table ``emf``; what it means here is the dotted name that Modelica gives."""
    if not isinstance(table, dict):
        return table
    values: dict[str, object] = {}
    for name, value in table.items():
        inner = flat(value)
        values |= {f"{name}.{rest}": v for rest, v in inner.items()} if isinstance(inner, dict) else {name: value}
    return values


Held = bool | float | str  # of an input: a number, true or false, or the name of an enumeration's item


class _Stage(Model):
    set: Annotated[dict[str, Held], BeforeValidator(flat)] = Field(default_factory=dict)
    throttle: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    for_s: Positive | None = None
    until: str | None = None
    at_most_s: Annotated[float, Field(gt=0.0, le=LONGEST_START_S)] | None = None

    @model_validator(mode="after")
    def _ends(self) -> _Stage:
        if (self.for_s is None) == (self.until is None):
            raise ValueError("say how it ends: for_s = 5.0, or until = 'output > number'")
        if self.until is not None and CONDITION.fullmatch(self.until) is None:
            raise ValueError("until is an output, one of > < >= <=, and a number: until = 'N1 > 30000'")
        return self


class _Start(Model):
    sequence: list[_Stage] = Field(default_factory=list)
    warm_up_s: Annotated[float, Field(ge=0.0, le=LONGEST_START_S)] = 0.0


class _Rest(Model):
    thrust: NotNegative = 0.0


class _Ledger(Model):
    delay_s: NotNegative | None = None


class MappingFile(Model):
    """A mapping file, as its author wrote it."""

    fmu: str = Field(min_length=1)
    title: str = ""
    isolated: bool | None = None  # flown in a process of its own; None: where a check found that it needs one
    ports: _Ports = _Ports()
    units: _Units = _Units()
    range: _Range = _Range()
    scale: _Scale = _Scale()
    parameters: Annotated[dict[str, float], BeforeValidator(flat)] = Field(default_factory=dict)
    inputs: Annotated[dict[str, Held], BeforeValidator(flat)] = Field(default_factory=dict)
    start: _Start = _Start()
    rest: _Rest = _Rest()
    rotor: _Rotor = _Rotor()
    flame_out: _FlameOut | None = None
    ledger: _Ledger = _Ledger()
    log: Annotated[dict[str, VariableName], BeforeValidator(flat)] = Field(default_factory=dict)  # column: output
    parameter_set: str | None = Field(default=None, min_length=1)  # a file (SSV) beside it; [parameters] go before it


@dataclass(frozen=True)
class PortMap:
    """What is stated about an FMU's ports; everything else is found."""

    ports: Mapping[str, VariableName] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    throttle_range: tuple[float, float] | None = None
    search: bool = True  # look for the ports that are not stated
    scale: Mapping[str, float] = field(default_factory=dict)  # the port is so many times the variable
    inputs: Mapping[str, Held] = field(default_factory=dict)  # that are held
    start: _Start = field(default_factory=_Start)
    rest_n: float = 0.0  # N, peak to peak, within which a thrust stands still


def is_mapping(path: Path) -> bool:
    """Whether a path looks like a mapping file."""
    return path.suffix.lower() == ".toml"


def read_mapping(path: Path) -> tuple[MappingFile, Path, PortMap]:
    """A mapping file, the archive it speaks of, and what it states about the ports.

    Raises InputError: one line with file, key and what is allowed.
    """
    data = read_toml(path)
    if "fmu" not in data:
        raise InputError(f'{path}: has no key fmu; a mapping file names its archive: fmu = "their.fmu"')
    file = validate(MappingFile, data, str(path))
    limits = file.range.throttle
    if limits and limits[0] == limits[1]:
        raise InputError(f"{path}: range.throttle = {list(limits)}: what 0 and 1 are must differ")
    for port, unit in _stated(file.units).items():
        quantity = KINDS[port].quantity
        if port != "throttle" and by_name(unit, quantity) is None:
            raise InputError(f"{path}: units.{port} = {unit!r}: allowed: {', '.join(quantity.units)}")
    return (
        file,
        path.parent / file.fmu,
        PortMap(
            _stated(file.ports),
            _stated(file.units),
            limits,
            scale=_stated(file.scale),
            inputs=file.inputs,
            start=file.start,
            rest_n=file.rest.thrust,
        ),
    )


def _stated(table: Model) -> dict[str, Any]:
    return {name: value for name, value in table.model_dump().items() if value is not None}


class PortError(ValueError):
    """A port is missing, ambiguous or unfit: one line without the FMU's name, which the caller knows."""


def find_engines(variables: Sequence[Variable], stated: PortMap) -> tuple[tuple[dict[str, Port], ...], list[str]]:
    """The ports of each engine that an FMU holds, and notes on what was assumed or left out.

    It holds one, unless ports are stated as several variables.  Of what is not an engine's own, all have the same.
    Raises PortError as :func:`find_ports`, and where the engines are not as many everywhere.
    """
    members = {name: members_of(name, KINDS[name].causality, variable, variables)
               for name, variable in stated.ports.items() if is_several(variable)}  # fmt: skip
    if not members:
        ports, notes = find_ports(variables, stated)
        return (ports,), notes
    counts = {name: len(names) for name, names in members.items()}
    lone = [name for name in NEEDED if name not in members]
    if lone:
        raise PortError(f"[ports] states several engines by {', '.join(members)}; their {' and '.join(lone)} too "
                        "must be stated, one for each")  # fmt: skip
    if len(set(counts.values())) > 1:
        shown = ", ".join(f"{count} of {name}" for name, count in counts.items())
        raise PortError(f"[ports] states {shown}: must be as many")
    count = counts["throttle"]
    if not 2 <= count <= MOST_JETS:
        raise PortError(f"[ports] states {count} engines; 2 to {MOST_JETS} may be in one FMU")
    shared = [name for name in OWN if name not in members and stated.ports.get(name)]
    if shared:
        raise PortError(f"[ports] {shared[0]} is one for {count} engines; state one for each, or an output in [log]")
    if "start" in members:
        raise PortError("[ports] start: several engines in one FMU are run up before a flight; leave it out")
    rest = {name: variable for name, variable in stated.ports.items() if name not in members}
    rest |= {name: "" for name in OWN if name not in members}
    engines = []
    notes = []
    for k in range(count):
        own = {name: names[k] for name, names in members.items()}
        ports, said = find_ports(variables, replace(stated, ports={**rest, **own}))
        engines.append(ports)
        notes += [note for note in said if note not in notes]
    _need_apart(engines)
    pairs = ", ".join(f"{ports['throttle'].variable.name} and {ports['thrust'].variable.name}" for ports in engines)
    return tuple(engines), [f"holds {count} engines, stepped as one: {pairs}", *notes]


def is_several(stated: VariableName) -> bool:
    """Whether what is stated for a port speaks of several engines."""
    return isinstance(stated, list) or "*" in stated


def members_of(port: str, causality: str, stated: VariableName, variables: Sequence[Variable]) -> list[str]:
    """The variables that are stated for a port: a list as it is, a ``*`` as the numbers that there are, rising."""
    if isinstance(stated, list):
        return stated
    shape = re.compile(re.escape(stated).replace(r"\*", r"(\d+)", 1))
    fitting = [v.name for v in variables if v.causality == causality]
    hits = sorted((int(match[1]), name) for name in fitting if (match := shape.fullmatch(name)))
    if not hits:
        raise PortError(f"has no {causality} like {stated}, with a number for *, for {port} "
                        f"({_list(causality, [v for v in variables if v.causality == causality])})")  # fmt: skip
    return [name for _, name in hits]


def _need_apart(engines: Sequence[Mapping[str, Port]]) -> None:
    """Refuse what two engines of one FMU share and may not, and throttles of several types."""
    taken: dict[tuple[str, str, int, int], str] = {}
    for k, ports in enumerate(engines, start=1):
        for name in OWN:
            if name not in ports:
                continue
            v = ports[name].variable
            other = taken.setdefault((v.causality, v.type, v.reference, v.index), f"{name} of engine {k}")
            if other != f"{name} of engine {k}":
                raise PortError(f"its {v.name} is both {other} and {name} of engine {k}; each has its own")
    types = {ports["throttle"].variable.type for ports in engines}
    if len(types) > 1:
        raise PortError(f"its throttles are of several types, {', '.join(sorted(types))}; must be of one")


def find_ports(variables: Sequence[Variable], stated: PortMap) -> tuple[dict[str, Port], list[str]]:
    """Every port that is stated or found of one engine, and notes on what was assumed or left out.

    Raises PortError if a needed or stated port does not serve; what is optional and does not is left out with a note.
    """
    ports: dict[str, Port] = {}
    notes: list[str] = []
    for name, kind in KINDS.items():
        asked_for = stated.ports.get(name)
        assert not isinstance(asked_for, list)  # of one engine
        insist = name in NEEDED or asked_for or name in stated.units
        if asked_for == "" and name in NEEDED:
            raise PortError(f"its {name} cannot be left unconnected")
        if asked_for == "" or (asked_for is None and (kind.stated or not stated.search)):
            continue
        try:
            variable = _named(name, kind, asked_for, variables) if asked_for else _search(name, kind, variables, ports)
            if variable is None and insist:
                raise PortError(f"has no {kind.causality} that is known as its {name}; {_how(name)}")
            if variable is not None:
                ports[name] = _connect(name, kind, variable, stated, ports, notes)
        except PortError as error:
            if insist:
                raise
            notes.append(f"no {name}: {error}")
    taken: dict[tuple[str, int, int], str] = {}
    for name, port in ports.items():
        other = taken.setdefault((port.variable.type, port.variable.reference, port.variable.index), name)
        if other != name:
            raise PortError(f"its {port.variable.name} is both {other} and {name}; state one of them in [ports]")
    return ports, notes


def plain(name: str) -> str:
    """A name in lower case and without anything but letters and digits."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def without_unit(name: str, quantity: Quantity) -> tuple[str, str | None]:
    """A name such as ``thrust_lbf`` or ``fuel-flow-kg_h`` as its stem and the unit behind it, None if there is none."""
    words = re.split(r"[^A-Za-z0-9%]+", name)
    for count in (3, 2, 1):
        unit = "/".join(word for word in words[-count:] if word.lower() != "per")
        if len(words) > count and unit and by_name(unit, quantity) is not None:
            return "_".join(words[:-count]), unit
    return name, None


def _named(port: str, kind: Kind, stated: str, variables: Sequence[Variable]) -> Variable:
    """The variable that is stated for a port."""
    fitting = [v for v in variables if v.causality == kind.causality]
    hits = [v for v in fitting if v.name == stated] or [v for v in fitting if v.name.lower() == stated.lower()]
    if not hits:
        raise PortError(f"has no {kind.causality} called {stated} for {port} ({_list(kind.causality, fitting)})")
    if len(hits) > 1:
        raise PortError(f"has several {kind.causality}s called {stated} in other case; state the exact name")
    if hits[0].type not in kind.types:
        raise PortError(f"its {hits[0].name} is of type {hits[0].type}; it must be one of: {', '.join(kind.types)}")
    return hits[0]


def _search(port: str, kind: Kind, variables: Sequence[Variable], ports: Mapping[str, Port]) -> Variable | None:
    """The variable of a port by its usual names, and for a needed port by its unit alone.

    None if there is none and none is needed.
    """
    taken = {port.variable.name for port in ports.values()}
    fitting = [v for v in variables if v.causality == kind.causality and v.name not in taken and not v.is_array]
    usable = [v for v in fitting if v.type in kind.types and not _other_quantity(port, kind, v)]
    reals = [v for v in usable if v.type in REALS]
    whole = usable if kind.types == LEVERS and len(reals) < len(usable) else []  # a lever in whole numbers comes second
    for tier in (*_tiers(port, kind, reals if whole else usable), *_tiers(port, kind, whole)):
        if len(tier) == 1:
            return tier[0]
        if tier:
            names = ", ".join(v.name for v in tier)
            raise PortError(f"has several {kind.causality}s that may be its {port}: {names}; {_how(port)}")
    if port not in NEEDED:
        return None
    unfit = [v for v in fitting if v not in usable and plain(v.name) in kind.names + kind.vague]
    if unfit and unfit[0].type not in kind.types:
        raise PortError(f"its {unfit[0].name} is of type {unfit[0].type}; it must be one of: {', '.join(kind.types)}")
    if unfit:
        raise _wrong_unit(port, unfit[0], _unit_complaint(unfit[0], kind))
    listed = [v for v in variables if v.causality == kind.causality]
    all_of_them = _list(kind.causality, listed)
    raise PortError(f"has no {kind.causality} that is known as its {port} ({all_of_them}); {_how(port)}")


def _tiers(port: str, kind: Kind, usable: Sequence[Variable]) -> Iterable[list[Variable]]:
    """Candidates for a port, the surest first."""
    yield [v for v in usable if plain(v.name) == plain(port)]
    stems = [plain(without_unit(v.name.rpartition(".")[2], kind.quantity)[0]) for v in usable]
    for names in (kind.names, kind.vague):
        yield [v for v, stem in zip(usable, stems, strict=True) if stem in names or plain(v.name) in names]
    if port == "thrust":
        yield [v for v in usable if measures(v.unit, v.base, kind.quantity)]
    if port == "throttle":
        others = [
            name
            for kind_of_port in KINDS.values()
            for name in kind_of_port.names
            if kind_of_port.causality == kind.causality
        ]
        left = [v for v, stem in zip(usable, stems, strict=True) if stem not in others]
        yield left if len(left) == 1 else []


def _other_quantity(port: str, kind: Kind, v: Variable) -> bool:
    """Whether the declared unit rules a variable out."""
    if v.unit is None or port in ("throttle", "run", "start"):
        # a lever may be in degrees, in volts, in anything that has a range
        return port == "throttle" and any(
            measures(v.unit, v.base, other) for other in (PRESSURE, TEMPERATURE, SPEED, FORCE)
        )
    return not measures(v.unit, v.base, kind.quantity)


def _unit_complaint(v: Variable, kind: Kind) -> str:
    try:
        to_si(v.unit or "", v.base, kind.quantity)
    except UnitError as error:
        return str(error)
    return f"must be {kind.quantity.name}"


def _wrong_unit(port: str, v: Variable, complaint: str) -> PortError:
    return PortError(f"its {v.name} {complaint}; a mapping file states it: [units] {port} = ...")


def _how(port: str) -> str:
    return f'a mapping file states it: [ports] {port} = "..."'


def _list(causality: str, variables: Sequence[Variable]) -> str:
    names = [v.name for v in variables]
    shown = ", ".join(names[:20]) + (f" and {len(names) - 20} more" if len(names) > 20 else "")
    return f"{causality}s: {shown or 'none'}"


def _connect(name: str, kind: Kind, v: Variable, stated: PortMap, ports: Mapping[str, Port], notes: list[str]) -> Port:
    """A port on a variable, with its conversion."""
    if name == "throttle":
        return _lever(v, stated, notes)
    if name == "start":
        own = _declared_range(v)
        return _over_range(v, *own) if own else replace(ports["throttle"], variable=v)
    if name == "run":
        if v.is_array:
            raise PortError(f"its {v.name} is an element of an array; {name} must be a scalar")
        return Port(v)
    unit = stated.units.get(name, v.unit)
    if unit is None:
        unit = without_unit(v.name, kind.quantity)[1]
        if unit is not None:
            notes.append(f"{v.name} states no unit; it is taken to be in {unit}, as its name says")
    scale = stated.scale.get(name, 1.0)
    if unit is None and kind.quantity is RATIO:
        return Port(v)
    if unit is None:
        if name not in NEEDED:
            raise PortError(f'{v.name} states no unit; a mapping file does: [units] {name} = "{kind.quantity.si}"')
        notes.append(f"{v.name} states no unit; it is taken to be in {kind.quantity.si}")
        return Port(v, scale, 0.0, 1.0 / scale)
    try:
        factor, offset = to_si(unit, None if name in stated.units else v.base, kind.quantity)
    except UnitError as error:
        raise _wrong_unit(name, v, str(error)) from error
    if name in stated.units and v.unit is not None and v.unit != unit:
        notes.append(f"{v.name} is in {v.unit}, says the FMU; the mapping file says {unit}, and that counts")
    if not (isfinite(factor) and factor != 0.0 and isfinite(offset)):
        raise PortError(f"its {v.name} is in {unit}, which the FMU defines by {factor:g} and {offset:g}")
    factor, offset = scale * factor, scale * offset
    return Port(v, factor, offset, 1.0 / factor, -offset / factor if offset else 0.0)


def _lever(v: Variable, stated: PortMap, notes: list[str]) -> Port:
    """The throttle from 0 to 1, over the range that is stated, declared, or meant by the unit."""
    limits = stated.throttle_range or _declared_range(v)
    if limits is None and v.type in INTEGERS and stated.units.get("throttle", v.unit) is None:
        raise PortError(f"its {v.name} is a whole number and states no range; {RANGE}")
    if limits is None:
        limits = _range_of_unit(v, stated.units.get("throttle", v.unit))
        notes.append(f"{v.name} states no range; it is taken to run from {limits[0]:g} to {limits[1]:g}")
    if v.type in INTEGERS:
        steps = abs(limits[1] - limits[0])
        if steps < LEAST_STEPS:
            raise PortError(f"its {v.name} is a whole number from {limits[0]:g} to {limits[1]:g}: a throttle needs "
                            f"{LEAST_STEPS} steps at least; {RANGE}")  # fmt: skip
        notes.append(f"{v.name} is a whole number: the throttle moves in {steps:.0f} steps")
    return _over_range(v, *limits)


def _declared_range(v: Variable) -> tuple[float, float] | None:
    if v.min is None or v.max is None or max(abs(v.min), abs(v.max)) >= NO_BOUND:
        return None
    if not v.min < v.max:
        raise PortError(f"its {v.name} runs from {v.min:g} to {v.max:g}, which is no range")
    return v.min, v.max


def _over_range(v: Variable, low: float, high: float) -> Port:
    span = high - low
    return Port(v, 1.0 / span, -low / span if low else 0.0, span, low, min(low, high), max(low, high))


def _range_of_unit(v: Variable, unit: str | None) -> tuple[float, float]:
    """What the unit alone says: a ratio from 0 to 1, a percentage to 100."""
    if unit is None and plain(v.name).endswith(("pla", "tla", "angle")):
        raise PortError(f"its {v.name} states neither range nor unit; {RANGE}")
    base = v.base if unit == v.unit else None
    if unit is not None and not measures(unit, base, RATIO):
        raise PortError(f"its {v.name} is in {unit} and states no range; {RANGE}")
    high = 1.0 if unit is None else 1.0 / to_si(unit, base, RATIO)[0]
    if not 0.0 <= (v.start or 0.0) <= high:
        raise PortError(f"its {v.name} states no range and starts at {v.start:g}, outside 0 to {high:g}; {RANGE}")
    return 0.0, high
