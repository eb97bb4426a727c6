"""The mapping file: what its author states about an FMU's ports.

Of these only ``fmu`` is needed; ports that are not stated are found (:mod:`cosim.engine.fmu.ports`)::

    fmu = "their.fmu"
    [ports]
    throttle = "PLA"          # an element of an array as "levers[1]"; "" leaves a port unconnected
    thrust = "Fn"
    [units]
    thrust = "lbf"            # only where the FMU declares none or the wrong one
    [range]
    throttle = [20.0, 100.0]  # what 0 and 1 are, in the FMU's own unit
    [scale]
    thrust = -1.0             # the port is so many times the variable
    [parameters]              # numbers, true or false, the name of an enumeration's item
    gain = 1.0
    [inputs]                  # inputs that are held from the beginning, in the same way
    ignition = true
    [start]                   # how long every instance runs at throttle 0 before anything else
    warm_up_s = 20.0
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
    [uncertainty]             # of the parameters, as identified: see cosim.engine.fmu.uncertainty
    parameters = ["gain"]
    deviation = [0.02]        # standard deviation of each
    spread = [0.01]           # between engines
"""

from collections.abc import Iterable
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, create_model, model_validator

from cosim.base.errors import InputError
from cosim.base.removed import describe_removed
from cosim.base.storage.toml import Model, NotNegative, Positive, Scalar, read_toml, validate
from cosim.engine.fmu.port_kinds import KINDS
from cosim.engine.fmu.ports import PortMap
from cosim.engine.fmu.uncertainty import Uncertainty
from cosim.engine.fmu.units import find_unit
from cosim.spec.file_kind import MAPPING, check_kind


def _require_nonzero(value: float) -> float:
    if value == 0.0 or not isfinite(value):
        raise ValueError("must be a finite number other than 0")
    return value


def _check_one_variable(name: object) -> object:
    if isinstance(name, list) or (isinstance(name, str) and "*" in name):
        raise ValueError(f"is one variable; {describe_removed('several engines')}")
    return name


if TYPE_CHECKING:
    _Ports = Model
    _Units = Model
    _Scale = Model
else:

    def _make_table_model(name: str, ports: Iterable[str], kind: Any) -> type[Model]:
        """Return the class of a mapping file's table that may have a value for each of ``ports``."""
        return create_model(name, __base__=Model, __module__=__name__, **dict.fromkeys(ports, (kind | None, None)))

    _Ports = _make_table_model("_Ports", KINDS, Annotated[str, BeforeValidator(_check_one_variable)])
    _Units = _make_table_model("_Units", [port for port in KINDS if port not in ("run", "start")], str)
    _Scale = _make_table_model(
        "_Scale",
        ["thrust", "ambient_pressure", "ambient_temperature", "air_speed", "altitude", "ram_drag", "spool_speed",
         "fuel_flow", "force_forward", "force_right", "torque"],
        Annotated[float, AfterValidator(_require_nonzero)],
    )  # fmt: skip


class _ThrottleRangeTable(Model):
    throttle: tuple[float, float] | None = None


class _RotorInertiaTable(Model):
    inertia_kg_m2: NotNegative = 0.0


class _FlameOutTable(Model):
    electric: Literal[True] | None = None
    thrust_left: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    run_down_s: Positive | None = None
    exponent: Positive | None = None
    relight_s: Positive | None = None

    @model_validator(mode="after")
    def _check_one_form(self) -> Self:
        numbers = [self.thrust_left, self.run_down_s, self.exponent, self.relight_s]
        if self.electric and any(value is not None for value in numbers):
            raise ValueError("electric = true stands alone")
        if not self.electric and None in numbers:
            raise ValueError("state thrust_left, run_down_s, exponent and relight_s, or electric = true")
        return self


def flatten(table: object) -> object:
    """Return nested tables with dotted keys: ``emf.k = 1`` means Modelica's name, TOML reads a table ``emf``."""
    if not isinstance(table, dict):
        return table
    values: dict[str, object] = {}
    for name, value in table.items():
        inner = flatten(value)
        values |= {f"{name}.{rest}": v for rest, v in inner.items()} if isinstance(inner, dict) else {name: value}
    return values


class _WarmUpTable(Model):
    warm_up_s: Annotated[float, Field(ge=0.0, le=600.0)] = 0.0


class _RestThrustTable(Model):
    thrust: NotNegative = 0.0


class _LedgerDelayTable(Model):
    delay_s: NotNegative | None = None


class MappingFile(Model):
    """Contents of a mapping file as its author wrote it."""

    fmu: str = Field(min_length=1)
    title: str = ""
    isolated: bool | None = None  # own process; None: as the scenario says
    ports: _Ports = Field(default_factory=_Ports.model_construct)
    units: _Units = Field(default_factory=_Units.model_construct)
    range: _ThrottleRangeTable = Field(default_factory=_ThrottleRangeTable.model_construct)
    scale: _Scale = Field(default_factory=_Scale.model_construct)
    parameters: Annotated[dict[str, Scalar], BeforeValidator(flatten)] = Field(default_factory=dict)
    inputs: Annotated[dict[str, Scalar], BeforeValidator(flatten)] = Field(default_factory=dict)
    start: _WarmUpTable = Field(default_factory=_WarmUpTable.model_construct)
    rest: _RestThrustTable = Field(default_factory=_RestThrustTable.model_construct)
    rotor: _RotorInertiaTable = Field(default_factory=_RotorInertiaTable.model_construct)
    flame_out: _FlameOutTable | None = None
    ledger: _LedgerDelayTable = Field(default_factory=_LedgerDelayTable.model_construct)
    uncertainty: Uncertainty | None = None  # uncertainty of identified parameters
    # Further outputs to log, by column name.
    log: Annotated[dict[str, str], BeforeValidator(flatten)] = Field(default_factory=dict)


def read_mapping(path: Path) -> tuple[MappingFile, Path, PortMap]:
    """Return the contents of a mapping file, the path of its archive, and its port map.

    Raises InputError: one line with file, key and what is allowed.
    """
    data = read_toml(path)
    check_kind(data, path, MAPPING)
    file = validate(MappingFile, data, str(path))
    limits = file.range.throttle
    if limits and limits[0] == limits[1]:
        raise InputError(f"{path}: range.throttle = {list(limits)}: what 0 and 1 are must differ")
    for port, unit in _list_stated_values(file.units).items():
        quantity = KINDS[port].quantity
        if port != "throttle" and find_unit(unit, quantity) is None:
            raise InputError(f"{path}: units.{port} = {unit!r}: allowed: {', '.join(quantity.units)}")
    return (
        file,
        path.parent / file.fmu,
        PortMap(
            _list_stated_values(file.ports),
            _list_stated_values(file.units),
            limits,
            scale=_list_stated_values(file.scale),
            inputs=file.inputs,
            warm_up_s=file.start.warm_up_s,
            rest_n=file.rest.thrust,
        ),
    )


def _list_stated_values(table: Model) -> dict[str, Any]:
    return {name: value for name, value in table.model_dump().items() if value is not None}
