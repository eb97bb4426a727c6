"""The validated model of a scenario's TOML: vehicle, controller, commands, disturbances and expected results."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from operator import not_
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, Self, Unpack

from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from cosim.base.errors import InputError
from cosim.base.storage.settings import as_settings
from cosim.base.storage.toml import Duration, Model, Samples, merge, nest, parse_setting, read_toml, set_path, validate
from cosim.base.trust import trust_named_code
from cosim.spec.file_kind import SCENARIO, check_kind
from cosim.spec.meanings import meaning_of
from cosim.spec.scenario.changes import Changes
from cosim.spec.scenario.commands import CommandEntry
from cosim.spec.scenario.disturbances import DisturbanceEntry
from cosim.spec.scenario.faults import FaultEntry, SensorBias, SensorDropout, ServoJam, StationNumber
from cosim.spec.scenario.files import find_scenario
from cosim.spec.scenario.mismatch import Mismatch
from cosim.spec.scenario.parameter_file import ParameterFile
from cosim.spec.scenario.sections import (
    Environment,
    Expectation,
    FlightLimits,
    Initial,
    RequireEntry,
    Station,
    unique_names,
)
from cosim.spec.scenario.substeps import SUBSTEPS, check_measured_step, runs_for
from cosim.spec.vehicle import STEP_S, Step, Vehicle, is_aircraft_path
from cosim.spec.vehicle.sensor_profile import STATED, load_with_profile, profile_names, refuse_restated

# Remarks on an engine parameter: set for the flight only, so that models keep the old value; or set as a mismatch.
PREDICTOR_KEEPS_MODEL: Final = "the predictor's model stays"
UNKNOWN_TO_CONTROLLER: Final = "no controller knows it"


class Scenario(Model):
    """One flight: keys of a scenario's TOML as attributes, with units in their names.

    ``vehicle`` and ``engine_parameters`` override values of the aircraft and the engine.

    >>> Scenario.load("hover").replace(duration_s=0.2).steps
    50
    """

    listed_by: ClassVar[str] = "hexjet sweep --keys"
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    title: str = ""
    description: str = ""
    aircraft: str = "hexjet"  # name, or folder with a vehicle.toml
    engine: str = "edf-as-flown"
    controller: str = "smith"
    controller_parameters: dict[str, float] = {}  # parameters of a custom controller
    controller_sha256: str | None = None  # hash that the controller must match
    # Wall time that one answer of a process or an FMU may take, s.
    controller_limit_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 10.0
    duration_s: Duration
    step_s: Step = STEP_S  # default: the aircraft's step_s
    # JSBSim runs in a control step; or an error instead, "0.01 deg", or "campaign".
    substeps: Annotated[int, Field(ge=1, le=100)] = SUBSTEPS
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    sensor_noise: bool = True
    added_delay_samples: Samples = 0  # on the roll output; the predictor knows
    initial: Initial = Field(default_factory=Initial)
    environment: Environment = Field(default_factory=Environment)
    mismatch: Mismatch = Field(default_factory=Mismatch)
    command: list[CommandEntry] = []
    disturbance: list[DisturbanceEntry] = []
    fault: list[FaultEntry] = []
    # Whether engines are monitored and failed ones allocated around; None: only where an engine is to fail.
    monitor: bool | None = None
    engine_parameters: dict[str, float] = {}
    engine_unchecked: bool = False  # True: fly foreign engines unchecked
    engine_isolated: bool | None = None  # own process; None: if it is foreign
    stations: dict[StationNumber, Station] = {}  # engine of a station, by jet number
    requests: str | None = None  # file of requests to the autopilot
    # The user's metrics, beside the built-in ones: FILE.py:Name, package.module:Name or an entry point.
    metrics: list[str] = []
    observers: list[str] = []  # the user's observers, named as metrics
    # The user's, which get the built-in ones' measurements; or a profile: "stated" (default) or "measured".
    sensors: str | None = None
    # The user's wind over time and place, or a table over time, FILE.csv; added to the environment's.
    wind: str | None = None
    own_sha256: dict[str, str] = {}  # hashes of these four that must match
    parameter_files: list[ParameterFile] = []  # sources of vehicle; written by hexjet
    changed: list[str] = []  # values that override the file
    vehicle: dict[str, Any] = {}
    limits: FlightLimits = Field(default_factory=FlightLimits)
    expect: list[Expectation] = []
    require: Annotated[list[RequireEntry], AfterValidator(unique_names), Field(exclude_if=not_)] = []  # to be met

    _folder: Path = PrivateAttr(default_factory=Path)
    _origin: "Scenario | None" = PrivateAttr(default=None)  # unshortened scenario; None: this one
    _step_error: str | None = PrivateAttr(default=None)  # tolerance from which substeps follows
    _resolved: tuple[tuple[Any, ...], dict[str, Any], tuple[Vehicle, Path]] | None = PrivateAttr(default=None)

    @model_validator(mode="before")
    @classmethod
    def _leave_out_engine_start(cls, data: Any) -> Any:
        """Drop the engine start key of version 0.2.0, which had a single value."""
        if isinstance(data, dict) and data.get("engine_start") == "before flight":
            return {key: value for key, value in data.items() if key != "engine_start"}
        return data

    @model_validator(mode="before")
    @classmethod
    def _fill_expected_aircraft(cls, data: Any) -> Any:
        """Set the file's aircraft in its expectations before overrides, because they hold only for it."""
        if not isinstance(data, dict) or not isinstance(data.get("expect"), list):
            return data
        own = {"aircraft": data.get("aircraft", "hexjet")}
        return data | {"expect": [own | entry if isinstance(entry, dict) else entry for entry in data["expect"]]}

    @model_validator(mode="after")
    def _refuse_two_pilots(self) -> Self:
        if self.requests is not None and self.command:
            raise ValueError("requests: the autopilot flies then, there can be no command")
        if self.initial.engines == "off" and (self.requests is None or not self.initial.on_ground):
            raise ValueError(
                'initial.engines = "off": only on the ground, and with an autopilot (requests) that is armed'
            )
        return self

    def __repr__(self) -> str:
        flown = f"{self.aircraft}, engine {self.engine}, controller {self.controller}"
        return f"<Scenario {self.name}: {flown}, {self.duration_s:g} s>"

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str:
        """Return an HTML table for notebooks of every key that differs from its default."""
        table = self.model_dump(mode="json", exclude_defaults=True, exclude={"name", "title", "description"})
        rows = "".join(
            f"<tr><td>{escape(key)}</td><td>{escape(_truncate(str(value)))}</td></tr>" for key, value in table.items()
        )
        return f"<p><b>{escape(self.name)}</b>: {escape(self.title)}</p><table>{rows}</table>"

    @property
    def folder(self) -> Path:
        """Folder against which relative file names of the scenario are resolved."""
        return self._folder

    @property
    def origin(self) -> "Scenario | None":
        """Scenario as in its file, if changed since; else None."""
        return self._origin

    def resolved_vehicle(self) -> tuple[Vehicle, Path]:
        """Return the aircraft with :attr:`vehicle` merged over it, and its folder; cached after the first call.

        Raises
        ------
        InputError
            As :func:`cosim.spec.vehicle.load_vehicle`.
        """
        cached, key = self._resolved, (self.aircraft, self.sensors, self.step_s)
        # A copy of a scenario shares the cache, but may have another vehicle.
        if cached is None or cached[0] != key or cached[1] is not self.vehicle:
            where, profile, origin = f"scenario {self.name}", self.sensor_profile, self._origin
            if origin is not None and origin.sensor_profile != profile:
                refuse_restated(origin.vehicle.get("sensors", {}), (origin.sensor_profile, profile), where)
            vehicle = load_with_profile(
                self.aircraft, self.vehicle, f"{where}: vehicle", self.folder, profile, self.step_s
            )
            cached = self._resolved = (key, self.vehicle, vehicle)
        return cached[2]

    @property
    def sensor_profile(self) -> str:
        """Name of the profile applied to the aircraft's sensors."""
        return self.sensors if self.sensors is not None and self.sensors in profile_names() else STATED

    @property
    def sensor_plugin(self) -> str | None:
        """Name of the user's sensors, or None."""
        return None if self.sensors is None or self.sensors in profile_names() else self.sensors

    @property
    def aircraft_name(self) -> str:
        """Name of the aircraft, also if given by path."""
        return self.resolved_vehicle()[0].name if is_aircraft_path(self.aircraft) else self.aircraft

    @property
    def step_error(self) -> str | None:
        """Error that ``substeps`` states, or None for a number."""
        return self._step_error

    @property
    def monitored(self) -> bool:
        """Whether the engine monitor runs."""
        if self.monitor is not None:
            return self.monitor
        return any(not isinstance(fault, (ServoJam, SensorBias, SensorDropout)) for fault in self.fault)

    def after_the_end(self) -> list[str]:
        """Return a line on each command, disturbance or fault that begins at or after the flight's end."""
        return [
            f"{kind}.{number} begins at {entry.start_s:g} s and the flight ends at {self.duration_s:g} s"
            for kind, entries in (("command", self.command), ("disturbance", self.disturbance), ("fault", self.fault))
            for number, entry in enumerate(entries)
            if entry.start_s >= self.duration_s
        ]

    @property
    def steps(self) -> int:
        """Control steps in the whole flight."""
        return self.count(self.duration_s, "duration_s")

    def count(self, seconds: float, key: str) -> int:
        """Return the number of control steps in ``seconds``.

        Parameters
        ----------
        seconds : float
            The time [s].
        key : str
            Name of the time in error messages.

        Raises
        ------
        InputError
            If it is not one to within a millionth of a step.
        """
        steps = round(seconds / self.step_s)
        if abs(steps * self.step_s - seconds) > 1e-6 * self.step_s:
            raise InputError(
                f"scenario {self.name}: {key} = {seconds:g} s is not a whole number of {self.step_s:g} s steps"
            )
        return steps

    @classmethod
    def load(cls, name: str | Path, settings: str | Sequence[str] | Mapping[str, object] = ()) -> Self:
        """Return the validated scenario of a name or a file; for changes see :meth:`replace`.

        >>> Scenario.load("hover", settings={"engine": "edf", "duration_s": 1.0}).steps
        250

        Parameters
        ----------
        name : str or Path
            Its name in ``scenarios/``, or the path of its file.
        settings : sequence of str or mapping
            Overrides: ``KEY=VALUE`` with the value as in TOML, or values by their dotted keys.

        Raises
        ------
        InputError
            For an unknown name (lists the known ones), wrong TOML, or a wrong key or value, the vehicle's among them.
        """
        scenario = cls.read(name, settings)
        scenario.resolved_vehicle()
        return scenario

    @classmethod
    def read(cls, name: str | Path, settings: str | Sequence[str] | Mapping[str, object] = ()) -> Self:
        """Return a scenario validated without its vehicle, such as one that will get another aircraft.

        Parameters
        ----------
        name : str or Path
            Its name in ``scenarios/``, or the path of its file.
        settings : sequence of str or mapping
            As of :meth:`load`.

        Raises
        ------
        InputError
            As :meth:`load`, for all but the vehicle.
        """
        path = find_scenario(name)
        data = read_toml(path)
        check_kind(data, path, SCENARIO)
        origin = cls.as_filed(path) if settings else None
        for text in as_settings(settings):
            key, value = parse_setting(text)
            set_path(data, key, value, f"{path}: settings")
        return cls.from_table(data, path.parent, str(path) if origin is None else f"{path}: settings", origin)

    @classmethod
    def as_filed(cls, path: Path) -> "Scenario | None":
        """Return the scenario of a file without settings; None if the file is invalid without them.

        Parameters
        ----------
        path : Path
            The scenario's TOML file.
        """
        try:
            return cls.from_table(read_toml(path), path.parent, str(path))
        except InputError:
            return None

    @classmethod
    def from_table(cls, data: dict[str, Any], folder: Path, where: str, origin: "Scenario | None" = None) -> Self:
        """Return the validated scenario of a parsed table.

        Parameters
        ----------
        data : dict
            The table as parsed from TOML.
        folder : Path
            Folder that relative file names in it start from.
        where : str
            Name of the table in error messages.
        origin : Scenario or None
            The scenario as in its file, where the table differs from it; None: it does not.

        Raises
        ------
        InputError
            For a wrong key or value.
        """
        error = data.get("substeps")
        if isinstance(error, str):
            data = data | {"substeps": runs_for(error, str(data.get("aircraft", "hexjet")), where)}
        unknown = data.keys() - cls.model_fields.keys()
        tables = [key for key in ("engine", *unknown) if isinstance(data.get(key), Mapping)]
        for key in (*(f"{table}.{name}" for table in tables for name in data[table]), *unknown):
            if (meant := suggest_key(key)) is not None:
                raise InputError(f"{where}: unknown key {key!r}; {meant}")
        scenario = validate(cls, data, where)
        scenario._folder = folder
        scenario._origin = origin
        scenario._step_error = error if isinstance(error, str) else None
        if "step_s" not in data:
            scenario = scenario._with_aircraft_step()
        if isinstance(error, str):
            check_measured_step(error, scenario.aircraft, scenario.step_s, where)
        return scenario

    def _with_aircraft_step(self) -> Self:
        """Return the scenario with its aircraft's control step; errors are reported where the aircraft is used."""
        try:
            step = self.resolved_vehicle()[0].control_step
        except InputError:
            return self
        if step == self.step_s:
            return self
        changed = self.model_copy(update={"step_s": step})
        changed.model_fields_set.discard("step_s")  # step_s may follow from the aircraft
        return changed

    def stated(self, mode: Literal["python", "json"] = "python") -> dict[str, Any]:
        """Return the stated values by key, as :meth:`from_table` reads them, without None or the aircraft's own step.

        Parameters
        ----------
        mode : {"python", "json"}
            Of pydantic: ``python`` keeps tuples, ``json`` has only types that files have.
        """
        data = self.model_dump(mode=mode, exclude_none=True)
        if "step_s" not in self.model_fields_set:
            del data["step_s"]
        if self._step_error is not None:
            data["substeps"] = self._step_error
        return data

    def replace(self, **changes: Unpack[Changes]) -> Self:
        """Return a validated copy with changed values.

        Code named in the changes is trusted (:func:`cosim.trust`), because the caller names it.

        >>> Scenario.load("hover").replace(**{"vehicle.mass_kg": 6.0}).vehicle
        {'mass_kg': 6.0}

        Parameters
        ----------
        **changes : Changes
            Values by the scenario's keys, dotted ones too (``**{"vehicle.mass_kg": 6.0}``): tables are merged
            into its own, everything else is replaced.

        Raises
        ------
        InputError
            For a wrong key or value.
        """
        nested = nest(changes)
        trust_named_code(_list_code_texts(nested), self.folder)
        data = self.stated()
        if nested.get("controller", self.controller) != self.controller:  # these keys belong to the old controller
            data = {
                key: value for key, value in data.items() if key not in ("controller_parameters", "controller_sha256")
            }
        data = merge(data, nested)
        return self.from_table(data, self.folder, f"scenario {self.name}", self._origin or self)

    def resolved(self, **parts: Any) -> Self:
        """Return a copy with validated parts replaced and without :attr:`origin`.

        Parameters
        ----------
        **parts : object
            Values of fields by name, as validation leaves them; they are not checked again.
        """
        copy = self.model_copy(update=parts)
        copy._origin = None
        return copy

    def seen_from(self, folder: Path) -> Self:
        """Return a copy with file names relative to another folder, where the files were copied.

        Parameters
        ----------
        folder : Path
            Where the files are; a relative path is seen from the working directory.
        """
        copy = self.model_copy()
        copy._folder = folder.absolute()
        return copy


def suggest_key(name: str) -> str | None:
    """Return a clause ``did you mean KEY?`` on a name that is no key of a scenario, or None."""
    if not name.startswith("engine.") and "delay" not in name:
        return None if (key := find_similar_key(name)) is None else f"did you mean {key!r}?"
    delays = {"added_delay_samples": Scenario, "mismatch.delay_samples": Mismatch} if "delay" in name else {}
    parameter = "delay_samples" if delays else name.partition(".")[2]
    shown = [f"{key} ({meaning_of(model, key.rpartition('.')[2])})" for key, model in delays.items()]
    shown += [f"engine_parameters.{parameter} ({PREDICTOR_KEEPS_MODEL})"]
    shown += [] if delays else [f"mismatch.engine_parameters.{parameter} ({UNKNOWN_TO_CONTROLLER})"]
    return f"did you mean {', '.join(shown[:-1])} or {shown[-1]}?"


def find_similar_key(name: str) -> str | None:
    """Return the dotted key of a scenario whose last part is ``name``, with or without a unit; None if there is none.

    The scenario's own keys come first, then those of its vehicle and of its sections.
    """
    tables: dict[str, type[Model]] = {
        "": Scenario,
        "vehicle.": Vehicle,
        "environment.": Environment,
        "initial.": Initial,
        "mismatch.": Mismatch,
    }
    keys = {f"{before}{key}": key for before, model in tables.items() for key in model.model_fields}
    same = [path for path, key in keys.items() if key == name]
    return next(iter([*same, *(path for path, key in keys.items() if key.startswith(f"{name}_"))]), None)


def _truncate(text: str, letters: int = 200) -> str:
    """Return a text cut to ``letters`` characters, for a cell of a notebook's table."""
    return text if len(text) <= letters else f"{text[: letters - 3]}..."


def _list_code_texts(changes: Mapping[str, Any]) -> Iterator[str]:
    """Yield the texts in changes of a scenario that may name code."""
    for key in ("controller", "metrics", "observers", "sensors", "wind", "engine"):
        value = changes.get(key)
        yield from (text for text in (value if isinstance(value, list) else [value]) if isinstance(text, str))
    for station in (changes.get("stations") or {}).values():
        engine = station.get("engine") if isinstance(station, Mapping) else getattr(station, "engine", None)
        yield from [engine] if isinstance(engine, str) else []
