"""Every predictor by its name: what it is, what it needs, how it is tuned and how it answers.

A user chooses a controller by the name of its predictor: the same cascade and gains, one of these between measurement
and rate loop.  Whoever flies, tunes, designs, offers or compares them asks :data:`PREDICTORS`.  One from elsewhere is
made known with a :class:`PredictorSpec`, by :meth:`Registry.register` in a program, or by an installed package, in
whose processes and in those of a campaign it is then found by its name::

    [project.entry-points."hexjet.plugins"]
    "predictor.my-predictor" = "my_package.my_module:SPEC"
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from zlib import crc32

from cosim.base.errors import InputError, nearest
from cosim.base.protocols import Predictor
from cosim.base.trust import CodeRefusedError, is_code_forbidden
from cosim.control.predictors.smith import FilteredSmithPredictor, NoPredictor, SmithPredictor, robustness_filter
from cosim.spec.vehicle import PredictorTuning, RateModel

if TYPE_CHECKING:
    from cosim.control.predictors.linear import PairResponse, PredictorSpace

_PREDICTOR_NAME = re.compile(r"[a-z][a-z0-9-]*")  # form of a predictor's name
_MAVLINK_NAME = re.compile(r"HJ_PRED_[A-Z0-9_]{1,8}")  # form of a MAVLink parameter's name

OwnParameters = Mapping[str, float]  # parameter values by name


@dataclass(frozen=True)
class TuningParameter:
    """One tuning parameter of a predictor.

    It stands in ``[control.predictor]`` of ``vehicle.toml`` where that has a key of this name, else in
    ``[control.predictor.own.<predictor>]``, and is ``default`` where it is not stated.  A design searches the range
    ``search``: times the channel's delay where the unit is s, over it for 1/s.
    """

    name: str
    unit: str
    text: str  # meaning of the parameter, for users
    least: float
    most: float
    search: tuple[float, float]
    default: float | None = None
    mavlink: str | None = None  # MAVLink name; None: fixed in flight
    decimals: int = 3

    def scale(self, delay_s: float) -> float:
        """Return the unit that ``search`` is counted in, for a channel with this delay [s] at low frequency."""
        return {"s": delay_s, "1/s": 1.0 / delay_s, "rad/s": 1.0 / delay_s}.get(self.unit, 1.0)


@dataclass(frozen=True)
class PredictorSpec:
    """Registry entry of a predictor: its name, parameters, factory, and linear response for a design.

    ``make`` makes a predictor from its model, with the delay that a controller adds itself, and its parameters; the
    model is None where the vehicle states none and ``needs_model`` is false.  Raises InputError for an unsuitable one.
    ``response`` and ``space`` are the same as a linear system, for a design: ``P_y`` and ``P_u`` for any ``|z| >= 1``.
    A design needs the first; without the second it finds responses in time from the first.

    >>> [(parameter.name, parameter.unit) for parameter in PREDICTORS["filtered-smith"].parameters]
    [('filter_s', 's')]
    """

    name: str
    title: str
    make: Callable[[Any, OwnParameters], Predictor]
    number: int | None = None  # permanent id; None: hash of the name
    needs_model: bool = True
    parameters: tuple[TuningParameter, ...] = ()
    response: Callable[[RateModel, OwnParameters], PairResponse] | None = None
    space: Callable[[RateModel, OwnParameters], PredictorSpace] | None = None
    automatic: bool = False  # an automatic design tries it
    with_lead: bool = False  # an automatic design tries it with a lead
    compared: bool = False  # flown where controllers are compared

    @property
    def value(self) -> int:
        """Number of the predictor in MAVLink's parameter HJ_PRED_TYPE."""
        return number_of(self.name) if self.number is None else self.number

    def own(self, tuning: PredictorTuning) -> dict[str, float]:
        """Return the values of the predictor's own parameters, by name."""
        stated = tuning.own.get(self.name, {})
        return {
            name: getattr(tuning, name) if name in _BUILT_IN_FIELDS else stated.get(name, default or 0.0)
            for name, default in ((parameter.name, parameter.default) for parameter in self.parameters)
        }

    def tuned(self, tuning: PredictorTuning, values: OwnParameters) -> PredictorTuning:
        """Return ``tuning`` with some parameters of this predictor replaced by ``values``."""
        fields = {name: value for name, value in values.items() if name in _BUILT_IN_FIELDS}
        if others := {name: value for name, value in values.items() if name not in _BUILT_IN_FIELDS}:
            fields["own"] = tuning.own | {self.name: tuning.own.get(self.name, {}) | others}  # type: ignore[assignment]
        return tuning.model_copy(update=fields)

    def predictor(self, model: RateModel | None, tuning: PredictorTuning) -> Predictor:
        """Return a new predictor at rest, for a model and a tuning."""
        return self.make(model, self.own(tuning))


def number_of(name: str) -> int:
    """Return the number over MAVLink of a predictor that specifies none."""
    # Ids below 1000 are reserved for permanent ones.
    return 1000 + crc32(name.encode()) % 60000


_BUILT_IN_FIELDS = frozenset(PredictorTuning.model_fields) - {"own"}  # fields of the built-in tuning


class Registry(Mapping[str, PredictorSpec]):
    """Predictors by name: registered ones, then those of installed packages."""

    def __init__(self, specs: Iterable[PredictorSpec]) -> None:
        self._specs: dict[str, PredictorSpec] = {}
        self._waiting: dict[str, Any] | None = None  # None: not searched yet
        for spec in specs:
            self.register(spec)

    def register(self, spec: PredictorSpec) -> None:
        """Register a predictor.  Raises InputError for ambiguous or untunable ones."""
        where = f"predictor {spec.name!r}"
        if not _PREDICTOR_NAME.fullmatch(spec.name):
            raise InputError(f"{where}: a name has small letters, digits and hyphens, and begins with a letter")
        if spec.name in self._specs:
            raise InputError(f"{where}: there is one of this name already")
        if not spec.title.strip() or "\n" in spec.title:
            raise InputError(f"{where}: title = {spec.title!r}: must be one line that says what it is")
        if twin := next((other.name for other in self._specs.values() if other.value == spec.value), None):
            raise InputError(f"{where}: its number {spec.value} is that of {twin!r}; state another")
        for parameter in spec.parameters:
            low, high = parameter.search
            if parameter.name not in _BUILT_IN_FIELDS and (
                parameter.default is None or not parameter.least <= parameter.default <= parameter.most
            ):
                raise InputError(
                    f"{where}: {parameter.name}: needs a default from {parameter.least:g} to {parameter.most:g}"
                )
            taken = {"HJ_PRED_TYPE", "HJ_PRED_DELAY"} | {p.mavlink for s in self._specs.values() for p in s.parameters}
            if parameter.mavlink is not None and (
                parameter.mavlink in taken or not _MAVLINK_NAME.fullmatch(parameter.mavlink)
            ):
                raise InputError(
                    f"{where}: {parameter.name}: mavlink = {parameter.mavlink!r}: must begin with HJ_PRED_, have at "
                    "most 16 characters and be nobody else's"
                )
            if not 0.0 < low < high:
                raise InputError(
                    f"{where}: {parameter.name}: search = {parameter.search}: must be two numbers above 0, in order"
                )
        self._specs[spec.name] = spec

    def forget(self, name: str) -> None:
        """Undo :meth:`register`."""
        del self._specs[name]

    def find(self, name: str, complaint: str) -> PredictorSpec:
        """Return the predictor of this name.  Raises InputError: ``complaint`` and the known names."""
        if name not in self:
            raise InputError(f"{complaint}; {nearest(name, self)}")
        return self[name]

    def check(self, tuning: PredictorTuning, where: str) -> None:
        """Check the tuning of plug-in predictors in a vehicle against their parameters.  Raises InputError."""
        for name, values in tuning.own.items():
            parameters = {
                parameter.name: parameter
                for parameter in self.find(name, f"{where}.own.{name}: unknown predictor").parameters
            }
            for key, value in values.items():
                if key not in parameters or key in _BUILT_IN_FIELDS:
                    names = set(parameters) - _BUILT_IN_FIELDS
                    suggestion = nearest(key, names) if names else "there are none"
                    raise InputError(f"{where}.own.{name}.{key}: unknown parameter; {suggestion}")
                least, most, unit = parameters[key].least, parameters[key].most, parameters[key].unit
                if not least <= value <= most:
                    raise InputError(f"{where}.own.{name}.{key} = {value:g}: must be from {least:g} to {most:g} {unit}")

    def __getitem__(self, name: str) -> PredictorSpec:
        if name not in self._specs:
            self._register_installed()
        return self._specs[name]

    def __iter__(self) -> Iterator[str]:
        self._register_installed()
        return iter(self._specs)

    def __len__(self) -> int:
        self._register_installed()
        return len(self._specs)

    def _register_installed(self) -> None:
        """Register the predictors of installed packages, when they are first needed."""
        if self._waiting == {}:
            return
        from cosim.base.plugins.entry_points import describe_entry, find_entries, load_entry

        waiting = find_entries("predictor") if self._waiting is None else self._waiting
        self._waiting, refused = {}, None
        for name, entry in waiting.items():
            try:
                spec, _ = load_entry(entry)
            except CodeRefusedError as error:
                self._waiting[name], refused = entry, error
                continue
            if not isinstance(spec, PredictorSpec) or spec.name != name:
                raise InputError(f"{describe_entry(entry)}: must be a PredictorSpec of this name, not {spec!r}")
            self.register(spec)
        if refused is not None and not is_code_forbidden():  # lists omit what cannot be imported
            raise refused


def _make_state_predictor(model: RateModel, own: OwnParameters) -> Predictor:
    from cosim.control.predictors.state import DoubleIntegratorObserver, StateModel, StatePredictor

    observer = DoubleIntegratorObserver(own["observer_rad_s"], model.sample_time_s)
    return StatePredictor(model, observer, StateModel(model))


def _specify_observer_predictor(
    name: str, title: str, number: int, parameter: str, mavlink: str, disturbance: bool, compared: bool
) -> PredictorSpec:
    """Return the specification of a state predictor with an observer of the identified model."""

    def make_predictor(model: RateModel, own: OwnParameters) -> Predictor:
        from cosim.control.predictors.state import ModalPredictor, ModelObserver, StateModel, StatePredictor

        if len(model.poles) != 2 or model.pole_pairs or model.zero_pairs:
            return ModalPredictor(model, own[parameter], disturbance)
        state = StateModel(model)
        return StatePredictor(model, ModelObserver(state, own[parameter], disturbance), state)

    def make_response(model: RateModel, own: OwnParameters) -> PairResponse:
        from cosim.control.predictors.linear import observer_response

        return observer_response(model, own[parameter], disturbance)

    def make_state_space(model: RateModel, own: OwnParameters) -> PredictorSpace:
        from cosim.control.predictors.linear import ObserverSpace

        return ObserverSpace(model, own[parameter], disturbance)

    tuned = _specify_observer_parameter(parameter, mavlink)
    return PredictorSpec(
        name, title, make_predictor, number, parameters=(tuned,), response=make_response, space=make_state_space,
        automatic=True, with_lead=True, compared=compared,
    )  # fmt: skip


def _specify_observer_parameter(parameter: str, mavlink: str) -> TuningParameter:
    text = "how fast its observer is"
    return TuningParameter(parameter, "rad/s", text, 0.1, 400.0, (0.3, 30.0), mavlink=mavlink, decimals=1)


def _baseline_response(model: RateModel, own: OwnParameters) -> PairResponse:
    from cosim.control.predictors.linear import no_response

    return no_response


def _baseline_state_space(model: RateModel, own: OwnParameters) -> PredictorSpace:
    from cosim.control.predictors.linear import NoSpace

    return NoSpace()


def _smith_response(model: RateModel, own: OwnParameters) -> PairResponse:
    from cosim.control.predictors.linear import smith_response

    return smith_response(model, own.get("filter_s"))


def _smith_state_space(model: RateModel, own: OwnParameters) -> PredictorSpace:
    """Return the Smith predictor in state space, with its filter time from the predictor's own parameters."""
    from cosim.control.predictors.linear import SmithSpace

    return SmithSpace(model, own.get("filter_s"))


BASELINE = PredictorSpec(  # no predictor
    "baseline",
    "cascaded P and PID, fed with the measured rate",
    lambda model, own: NoPredictor(),
    0,
    needs_model=False,
    response=_baseline_response,
    space=_baseline_state_space,
    automatic=True,
    with_lead=True,
    compared=True,
)
SMITH = PredictorSpec(  # Smith predictor
    "smith",
    "the same gains, fed with Smith's predictor (paper)",
    lambda model, own: SmithPredictor(model),
    1,
    response=_smith_response,
    space=_smith_state_space,
    automatic=True,
    compared=True,
)
FILTERED_SMITH = PredictorSpec(  # filtered Smith predictor
    "filtered-smith",
    "Smith's predictor with a robustness filter: no offset under a constant disturbance (ours)",
    lambda model, own: FilteredSmithPredictor(model, *robustness_filter(model, own["filter_s"])),
    2,
    parameters=(
        TuningParameter(
            "filter_s", "s", "time constant of the robustness filter", 0.0, 10.0, (0.05, 5.0), mavlink="HJ_PRED_FILT"
        ),
    ),
    response=_smith_response,
    space=_smith_state_space,
    automatic=True,
    compared=True,
)
STATE = PredictorSpec(  # state predictor
    "state",
    "d-step state predictor with a double-integrator observer (paper)",
    _make_state_predictor,
    3,
    parameters=(_specify_observer_parameter("observer_rad_s", "HJ_PRED_OBS"),),
)
PREDICTORS = Registry(  # all predictors by name
    [
        BASELINE,
        SMITH,
        FILTERED_SMITH,
        STATE,
        _specify_observer_predictor(
            "state-model", "d-step state predictor with an observer of the identified model (ours)", 4,
            "model_observer_rad_s", "HJ_PRED_OBS_M", disturbance=False, compared=False,
        ),
        _specify_observer_predictor(
            "state-disturbance",
            "the same, with the input disturbance estimated and predicted (ours, after Sanz et al.)",
            5, "disturbance_observer_rad_s", "HJ_PRED_OBS_D", disturbance=True, compared=True,
        ),
    ]
)  # fmt: skip
