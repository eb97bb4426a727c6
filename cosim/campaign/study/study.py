"""A study as its TOML states it: which scenario is flown, what is drawn for each flight, and what counts as success.

One draw gives every varied key a value, and one seed to the noise and the turbulence of its flight.  Each draw is flown
with every controller of the study, so that controllers are compared on the same draws.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, PlainValidator, PrivateAttr, model_validator

from cosim.base.errors import FlightError, InputError, nearest
from cosim.base.storage.files import write_whole
from cosim.base.storage.toml import Model, read_toml, set_path, split_key, toml_text, validate
from cosim.base.trust import Code, is_code_forbidden, need_trust
from cosim.campaign.study.autopilot import StudyAutopilot, read_autopilot
from cosim.campaign.study.case import Case, find_study, flatten_settings, study_names, vary_cases
from cosim.campaign.study.distributions import CASE, Correlation, Vary, first_repeated, parse_vary, vary_tables
from cosim.campaign.study.engine_draw import EngineDraw, brings_engine, default_draw, engine_draw
from cosim.campaign.study.key import Key, Value
from cosim.campaign.study.keys import CUSTOM_PARAMETERS, custom_keys, find_key, with_values
from cosim.campaign.study.sequential import MAX_TESTED, parse_claim
from cosim.campaign.study.values import check_vary
from cosim.results.metrics import metric_names
from cosim.results.requirements.stated import check_requirements, note_first_row
from cosim.simulation.controllers.source import find_controller_source
from cosim.simulation.notes import note_few_substeps, note_varied_turbulence
from cosim.simulation.plugins import load_metrics
from cosim.simulation.user_code import list_aircraft_code, list_block_code, list_engine_code, list_scenario_code
from cosim.spec.controller_name import is_design, resolve_controller
from cosim.spec.scenario import Range, RequireEntry, Scenario, find_scenario, unique_names

__all__ = [
    "Case", "Correlation", "Study", "Vary", "check", "find_study", "flatten_settings", "parse_vary", "study_names",
    "vary_cases",
]  # fmt: skip

Design = Literal["grid", "latin-hypercube", "random", "sobol"]
DESIGNS: tuple[Design, ...] = ("grid", "latin-hypercube", "random", "sobol")  # kinds of sampling
MAX_DRAWS = 10_000_000  # a year of one machine; more is a typo
ROW_COLUMNS = {  # columns of a row that no key may have
    "controller": "list controllers: each draw is flown with every one",
    "seed": "every draw has a seed of its own, made from the study's",
    "duration_s": "a row says under this name how long the flight lasted; set it with settings",
}


def _refuse_repeats(names: list[str]) -> list[str]:
    repeated = first_repeated(names)
    if repeated is not None:
        raise ValueError(f"{repeated} is there twice")
    return names


class Study(Model):
    """Many flights of one scenario, with the keys that vary."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    title: str = ""
    description: str = ""
    scenario: str  # name, or file relative to the study
    settings: dict[str, Any] = Field(default_factory=dict)  # override the scenario, by dotted key
    controllers: Annotated[list[str], AfterValidator(_refuse_repeats)] = Field(
        default_factory=list
    )  # empty: the scenario's controller
    design: Design
    runs: Annotated[int, Field(ge=1, le=MAX_DRAWS)] | None = None  # number of draws; of a grid its points
    repeats: Annotated[int, Field(ge=1, le=MAX_DRAWS)] = 1  # grid flown again with other seeds
    seed: Annotated[int, Field(ge=0, lt=2**53)] = 1
    vary: Annotated[list[Vary], Field(min_length=1), BeforeValidator(vary_tables)]
    case: list[Case] = Field(default_factory=list)  # named cases, varied by the key "case"
    nominal_engine: bool = False  # True: do not draw an uncertain engine
    correlate: list[Correlation] = Field(default_factory=list)
    success: dict[str, Range] = Field(default_factory=dict)  # metrics that success requires too
    require: Annotated[list[RequireEntry], AfterValidator(unique_names)] = Field(
        default_factory=list
    )  # requirements added to the scenario's
    until: str | None = None  # claim that ends the study: 99.9%@95%
    batch: bool = False  # flown on arrays, many flights at once
    # An autopilot of others flies in place of the controller, with the controller's gains.
    autopilot: Annotated[StudyAutopilot, PlainValidator(read_autopilot)] | None = None

    _folder: Path = PrivateAttr(default_factory=Path)
    _where: str = PrivateAttr(default="study")
    _bases: dict[str | None, Scenario] = PrivateAttr(default_factory=dict)  # scenario of each case, made on demand
    _keys: dict[str, Key] = PrivateAttr(default_factory=dict)
    _drawn: list[str] | None = PrivateAttr(default=None)

    @property
    def folder(self) -> Path:
        """Folder that relative paths in the study start from."""
        return self._folder

    @property
    def draws(self) -> int:
        """The number of draws; times the controllers, the number of flights."""
        if self.design != "grid":
            assert self.runs is not None
            return self.runs
        return self.repeats * prod(vary.levels or 1 if vary.values is None else len(vary.values) for vary in self.vary)

    @property
    def tried(self) -> list[str]:
        """Controllers that the flights use, at least one."""
        return self.controllers or [resolve_controller(self.base().controller, self.base().folder)]

    @property
    def controller_names(self) -> list[str]:
        """Controllers as rows name them, or the autopilot that flies in their place."""
        return self.tried if self.autopilot is None else [self.autopilot.name]

    def base(self, case: str | None = None) -> Scenario:
        """Return the scenario with the study's settings and a case's, before any draw; expectations are left out."""
        if case not in self._bases:
            path = _scenario_path(self.scenario, self.folder)
            data = read_toml(path)
            own = self._find_case(case).settings if case is not None else {}
            origin = Scenario.as_filed(path) if self.settings or own else None
            where = f"{self._where}: settings" if self.settings else str(path)
            for settings, place in ((self.settings, where), (own, f"{self._where}: case {case!r}")):
                for key, value in flatten_settings(settings):
                    set_path(data, split_key(key), value, place)
                where = place if settings else where
            changed = {**data, "expect": []}
            if self.require:
                required = [entry.model_dump(exclude_defaults=True) for entry in self.require]
                changed["require"] = [*data.get("require", []), *required]
            self._bases[case] = Scenario.from_table(changed, path.parent, where, origin)
        return self._bases[case]

    def _find_case(self, name: str) -> Case:
        return next(case for case in self.case if case.name == name)

    @property
    def case_keys(self) -> list[str]:
        """The keys of the scenario that some case sets."""
        return list(dict.fromkeys(key for case in self.case for key, _ in flatten_settings(case.settings)))

    @property
    def case_seeds(self) -> dict[Value, int]:
        """Seeds of the cases that state one, by case name."""
        return {case.name: case.settings["seed"] for case in self.case if "seed" in case.settings}

    def autopilot_of(self, case: str | None) -> StudyAutopilot:
        """Return the autopilot as it flies a case.  Raises ValueError for a wrong key."""
        assert self.autopilot is not None
        changes = self._find_case(case).autopilot if case is not None else {}
        if not changes:
            return self.autopilot
        stated = self.autopilot.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
        return read_autopilot({**stated, **changes})

    def key(self, name: str) -> Key:
        """Return a varied key, with the nominal value that factors and offsets start from."""
        if name == CASE and self.case:
            return Key(CASE, "choice", None, choices=tuple(case.name for case in self.case))
        if name not in self._keys:
            base = self.base()
            if name.startswith(CUSTOM_PARAMETERS):  # applies to whatever controller is flown
                scenarios = [with_values(base, {"controller": controller}) for controller in self.tried]
                scenarios.sort(
                    key=lambda scenario: [
                        name in [key.path for key in custom_keys(scenario)],
                        bool(custom_keys(scenario)),
                    ]
                )
                base = scenarios[-1]
            self._keys[name] = find_key(base, name)
        return self._keys[name]

    def set_keys(self, keys: Mapping[str, Key]) -> None:
        """Set the keys of the values, instead of finding them in the scenario and its code."""
        self._keys |= keys
        self._drawn = list(keys)

    def engine_draw(self) -> EngineDraw | None:
        """Return the draw of the engine's uncertainty, or None.  Raises InputError."""
        return engine_draw(self.base()) if any(vary.uncertainty for vary in self.vary) else None

    @property
    def drawn(self) -> list[str]:
        """Keys that get a value in each draw, in the order of the columns: an uncertain engine has several."""
        if self._drawn is None:
            engine = self.engine_draw()
            of_engine = {} if engine is None else {key.path: key for key in engine.keys}
            self._keys |= of_engine
            self._drawn = [name for vary in self.vary for name in (list(of_engine) if vary.uncertainty else [vary.key])]
        return self._drawn

    def correlations(self, sides: int | None = None) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return the normal variables' correlation matrix for the requested rank correlations, ordered as ``vary``.

        ``sides``: the size of the matrix, where more is drawn than there are keys; the rest is independent.
        """
        indices = {vary.key: index for index, vary in enumerate(self.vary)}
        matrix = np.eye(len(self.vary) if sides is None else sides)
        for correlation in self.correlate:
            a, b = (indices[key] for key in correlation.keys)
            matrix[a, b] = matrix[b, a] = correlation.normal
        return matrix

    def notes(self) -> list[str]:
        """Return notes on settings that are allowed but that a user should know of before flying."""
        base, keys = self.base(), [vary.key for vary in self.vary]
        lines = [*note_first_row(base), *note_varied_turbulence(base, keys)]
        lines += [self.engine_note] if self.engine_note else []
        if "substeps" not in keys and "aircraft" not in keys:
            lines += note_few_substeps(base, keys)
        if self.design == "sobol" and self.draws & (self.draws - 1):
            below = 1 << (self.draws.bit_length() - 1)
            lines.append(
                f"sobol: {self.draws} runs are no power of two; Sobol's points are balanced at {below} and {2 * below}"
            )
        return lines

    @property
    def engine_note(self) -> str:
        """Sentence on whether the engine's uncertainty is drawn; empty without an uncertainty."""
        if any(vary.uncertainty for vary in self.vary):
            return default_draw(self.base(), False)[1]
        return default_draw(self.base(), True, [vary.key for vary in self.vary])[1]

    def __eq__(self, other: object) -> bool:
        """Whether both state the same, wherever they were read."""
        return isinstance(other, Study) and self.table() == other.table()

    __hash__ = None  # type: ignore[assignment]

    def table(self) -> dict[str, Any]:
        """Return the study as a table of TOML, with the values that it sets and no defaults."""
        values = self.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
        return {key: values[key] for key in Study.model_fields if key in values}

    def resolved(self, scenario: Path | None = None) -> Study:
        """Return the same study, valid in any folder: files by absolute path.

        ``scenario``: a file that has settings and requirements in it already, to be flown instead; a relative path
        stays relative to the study's folder, that of the file which :meth:`save` writes.
        """
        changes: dict[str, Any] = {}
        if self.autopilot is not None:
            changes["autopilot"] = self.autopilot.seen_from(self.folder)
        if scenario is not None:
            changes |= {"scenario": scenario.as_posix(), "settings": {}, "require": []}
        elif is_path(self.scenario):
            changes |= {"scenario": str(_scenario_path(self.scenario, self.folder).absolute())}
        return self.changed(**changes)

    def changed(self, **changes: Any) -> Study:
        """Return a copy with these fields changed, not checked against the scenario."""
        copy = self.model_copy(update=changes)
        copy._bases, copy._keys, copy._drawn = {}, {}, None
        return copy

    def save(self, path: Path) -> None:
        """Write the study as TOML.  Raises FlightError if that fails."""
        write_whole(path, toml_text(self.table(), multiline=True), FlightError)

    @classmethod
    def load(cls, name: str | Path) -> Study:
        """Read a study by its name in ``studies/`` or by path.

        Raises InputError for an unknown name (lists the known ones), wrong TOML, or a wrong key or value.
        """
        path = find_study(name)
        return cls.from_table(read_toml(path), path.parent, str(path))

    @classmethod
    def from_table(cls, data: Mapping[str, Any], folder: Path, where: str) -> Study:
        """Validate a parsed table together with its scenario; ``where`` names its source in errors."""
        study = cls.unchecked(data, folder, where)
        if not is_code_forbidden():
            # A study that is only displayed was checked when it was flown.
            need_trust(study_code(study), where)
            check(study, where)
        return study

    @classmethod
    def unchecked(cls, data: Mapping[str, Any], folder: Path, where: str) -> Study:
        """Validate a parsed table without its scenario; ``where`` names its source in errors."""
        study = validate(cls, data, where)
        study._folder, study._where = folder, where
        files = [resolve_controller(name, folder) for name in study.controllers]
        return study.model_copy(update={"controllers": files}) if files != study.controllers else study

    @model_validator(mode="before")
    @classmethod
    def _accept_vary_texts(cls, data: Any) -> Any:
        return vary_cases(data) if isinstance(data, Mapping) else data

    @model_validator(mode="after")
    def _check_autopilot(self) -> Study:
        if self.autopilot is not None and self.controllers:
            raise ValueError(
                f"controllers: {self.autopilot.name} flies in their place, with the gains of the scenario's "
                "controller; leave them out (settings.controller = a file of hexjet design)"
            )
        return self

    @model_validator(mode="after")
    def _check_design(self) -> Study:
        """Refuse a grid with a number of runs, and other samplings without one or with levels."""
        if self.design != "grid":
            for vary in self.vary:
                if vary.levels is not None:
                    raise ValueError(
                        f"{vary.key} has {vary.levels} levels, which only a grid has; leave them out under "
                        f"design = {self.design!r}, or give every key levels or values under design = 'grid'"
                    )
            if self.runs is None:
                raise ValueError(f"runs is missing: how many draws the {self.design} has")
            if self.repeats != 1:
                raise ValueError(f"repeats: only a grid is repeated; a {self.design} has more runs instead")
            return self
        for vary in [vary for vary in self.vary if not vary.uncertainty] or self.vary:
            if not vary.discrete:
                example = "engine=A,B" if vary.uncertainty else f"{vary.key}=LO:HI:5"
                raise ValueError(
                    f"{vary.key} needs levels or values in a grid, such as {example}; distributions belong to "
                    "latin-hypercube, random and sobol"
                )
        if self.runs is not None:
            raise ValueError("runs: a grid has as many draws as it has points; repeats flies it more than once")
        if self.draws > MAX_DRAWS:
            raise ValueError(f"a grid of {self.draws} draws; at most {MAX_DRAWS}")
        return self

    @model_validator(mode="after")
    def _check_claim(self) -> Study:
        """Refuse a claim that this study cannot prove, or whose error probability would be wrong."""
        if self.until is None:
            return self
        try:
            claim = parse_claim(self.until)
        except InputError as error:
            raise ValueError(str(error)) from error
        if self.design != "random":
            raise ValueError(f"until = {self.until}: counts independent draws; design must be random")
        if self.draws > MAX_TESTED:
            raise ValueError(f"until = {self.until}: at most {MAX_TESTED:,} runs")
        if claim.fewest > self.draws:
            raise ValueError(
                f"until = {self.until}: {self.draws} flights do not show it, even if all succeed; that takes "
                f"{claim.fewest:,} without a failure, and more with one"
            )
        return self

    @model_validator(mode="after")
    def _check_correlations(self) -> Study:
        """Refuse repeated pairs, keys without an order, and inconsistent correlations."""
        by_key = {vary.key: vary for vary in self.vary}
        pairs: set[frozenset[str]] = set()
        for correlation in self.correlate:
            if self.design == "grid":
                raise ValueError("correlate: the points of a grid are not drawn; use latin-hypercube, random or sobol")
            for key in correlation.keys:
                if key not in by_key:
                    raise ValueError(f"correlate: {key!r} is not varied; {nearest(key, by_key)}")
                if not by_key[key].is_ordered:
                    raise ValueError(f"correlate: the values of {key} have no order, and no correlation")
            if correlation.keys[0] == correlation.keys[1]:
                raise ValueError(f"correlate: {correlation.keys[0]} with itself")
            if frozenset(correlation.keys) in pairs:
                raise ValueError(f"correlate: {correlation.keys[0]} and {correlation.keys[1]} are there twice")
            pairs.add(frozenset(correlation.keys))
        smallest = float(np.linalg.eigvalsh(self.correlations())[0])
        if smallest < 1e-6:
            raise ValueError(
                "correlate: these correlations cannot hold together (the matrix is not positive definite: its smallest "
                f"eigenvalue is {smallest:.3g})"
            )
        needed = 1 + len({key for pair in pairs for key in pair})
        if pairs and self.design == "latin-hypercube" and (self.runs or 0) < needed:
            raise ValueError(f"runs = {self.runs}: a latin-hypercube with these correlations needs at least {needed}")
        return self


def study_code(study: Study) -> list[Code]:
    """Return the files with code that a study names: of scenario, controllers and varied keys."""
    base = study.base()
    code = [
        *(
            each
            for case in (None, *(case.name for case in study.case))
            for each in list_scenario_code(study.base(case))
        ),
        *(each for name in study.controllers for each in list_block_code(name, study.folder)),
    ]
    for vary in study.vary:
        kind = vary.key.split(".")[-1]
        for value in [value for value in vary.values or [] if isinstance(value, str)]:
            if kind == "engine":
                code += list_engine_code(value, base.folder)
            elif kind == "controller":
                code += list_block_code(value, base.folder)
            elif kind == "aircraft":
                code += list_aircraft_code(value, base.folder, with_engine=True)
    if study.autopilot is not None and (program := study.autopilot.program(study.folder)):
        code.append(Code(program))
    return list(dict.fromkeys(code))


def check(study: Study, where: str) -> None:
    """Check a study against its scenario: keys, their ranges, controllers, metrics.

    Raises InputError: one line with the key, the value and what is allowed.
    """
    _check_names(study, where)
    custom = [name for name, _ in flatten_settings(study.settings) if name.startswith(CUSTOM_PARAMETERS)]
    try:
        for case in study.case:
            _check_case(study, case)
        for name in custom:
            study.key(name)
        for vary in study.vary:
            if vary.uncertainty:
                _check_uncertain_engine(study)
            else:
                check_vary(vary, study.key(vary.key))
        for controller in study.tried:  # check that files exist and fit the model
            with_values(study.base(), {"controller": controller})
        _check_engine_conflicts(study)
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(where) else f"{where}: {error}") from error


def _check_case(study: Study, case: Case) -> None:
    """Refuse a case that makes no valid scenario, or needs columns of its own."""
    base, flown = study.base(), study.base(case.name)
    if [entry.name for entry in flown.require] != [entry.name for entry in base.require]:
        raise InputError(f"case {case.name!r}: require: must have the names that the scenario has")
    if case.autopilot:
        if study.autopilot is None:
            raise InputError(f"case {case.name!r}: autopilot: the study has no table [autopilot]")
        try:
            study.autopilot_of(case.name)
        except ValueError as error:
            raise InputError(f"case {case.name!r}: autopilot: {error}") from error


def _check_uncertain_engine(study: Study) -> None:
    """Refuse an engine without uncertainty, and keys that conflict with drawing it."""
    drawn = study.drawn
    for key in [*(vary.key for vary in study.vary if not vary.uncertainty), *study.case_keys]:
        if drawn.count(key) > 1:
            raise InputError(f"vary {key}: engine draws it by its [uncertainty] already; leave one of them out")
        if brings_engine(key):
            raise InputError(f"vary {key}: brings another engine than the one that is drawn; leave one of them out")


def _check_names(study: Study, where: str) -> None:
    """Refuse unknown controllers and metrics, and keys that are other columns or repeated."""
    for name in study.controllers:
        if not is_design(name):
            find_controller_source(name, study.folder, f"{where}: controllers: unknown controller {name!r}")
    check_requirements(study.base())
    names = [*metric_names(), *(name for metric in load_metrics(study.base()) for name in metric.names)]
    for name in study.success:
        if name not in names:
            raise InputError(f"{where}: success: unknown metric {name!r}; {nearest(name, names, 'docs/metrics.md')}")
    checked: set[str] = set()
    for vary in study.vary:
        if vary.key in ROW_COLUMNS:
            raise InputError(f"{where}: vary {vary.key}: {ROW_COLUMNS[vary.key]}")
        if vary.key in checked:
            raise InputError(f"{where}: vary {vary.key}: is there twice")
        if vary.key in study.case_keys:
            raise InputError(f"{where}: vary {vary.key}: a case sets it")
        checked.add(vary.key)
    if repeated := first_repeated([case.name for case in study.case]):
        raise InputError(f"{where}: case {repeated!r} is there twice")


def _check_engine_conflicts(study: Study) -> None:
    """Refuse to draw an aircraft or engine together with keys of the present one."""
    nominal = {vary.key: study.key(vary.key).nominal for vary in study.vary}
    values = {name: value for name, value in nominal.items() if value is not None}
    for vary in study.vary:
        for value in (vary.values or []) if vary.key.split(".")[-1] in ("aircraft", "engine") else []:
            with_values(study.base(), {**values, vary.key: value})


def is_path(name: str) -> bool:
    return name.lower().endswith(".toml") or "/" in name


def _scenario_path(name: str, folder: Path) -> Path:
    return find_scenario(folder / name if is_path(name) else name)
