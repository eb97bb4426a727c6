"""Engines and aircraft looked over: what ``hexjet engine check``, ``engine map`` and ``aircraft check`` call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api.call import FolderResult, Limits, Result, Table, check_types
from cosim.base.storage.settings import as_settings
from cosim.base.trust import trust_named_code

if TYPE_CHECKING:
    from cosim.aircraft_check.check import AircraftCheck
    from cosim.engine import CheckReport
    from cosim.engine.make.mapping_file import BegunMapping

CHECK_FILES = ("check.json", "report.html")  # files that an engine check writes
_MOMENTS_NOTE = (  # note under the table of moments
    "Largest moment either way while the weight is held and the other two moments are zero; all throttles and hinges "
    "are free within their limits."
)
_BOUNDS_NOTE = (  # note if values are only bounded
    "Two numbers are what is attained and what nothing exceeds; one with at least, or none found: what lies beyond is "
    "not known."
)


class EngineCheckResult(FolderResult):
    """Verdict on an FMU as an engine, with its static curve and step responses.

    ``check`` has everything; ``write`` leaves ``check.json`` and ``report.html``.
    """

    def __init__(self, check: CheckReport) -> None:
        self.check = check
        self.files = {}

    @property
    def is_fit(self) -> bool:
        return self.check.ok

    def _write(self, folder: Path) -> dict[str, Path]:
        from cosim.results.report.engine_check import write_check

        page = write_check(self.check, folder)
        return {"report": page, "json": page.with_name(CHECK_FILES[0])}

    def to_dict(self) -> dict[str, Any]:
        return self.check.to_dict()

    def lines(self) -> list[str]:
        """Return the verdict, and a line for each problem."""
        verdict = "fit to fly" if self.is_fit else "not fit to fly"
        return [f"{self.check.name}: {verdict}", *(f"problem: {problem}" for problem in self.check.problems)]

    def tables(self) -> list[Table]:
        return [Table("", ("finding", "what it is"), self.check.lines())]

    def _figures(self) -> Mapping[str, Any]:
        from cosim.results.report.engine_check import check_figures

        return check_figures(self.check)


@check_types(step_s=Limits(0.0, is_open=True), time_limit_s=Limits(1.0))
def check_engine(
    engine: str | Path,
    *,
    step_s: float | None = None,
    settings: Sequence[str] | Mapping[str, object] = (),
    time_limit_s: float = 120.0,
    out: str | Path | None = None,
) -> EngineCheckResult:
    """Tell whether an FMU is fit to be an engine, and how it answers its throttle.

    It runs in a process of its own: if it crashes, hangs or eats memory, that is told, and nothing else happens.

    >>> check_engine("edf").is_fit
    True

    Parameters
    ----------
    engine : str or Path
        A name, an FMU or its mapping file.
    step_s : float or None
        Control step [s]; None: 0.004, or the library engine's.
    settings : sequence of str or mapping
        Parameters of the engine: numbers, or the names of an enumeration's items.
    time_limit_s : float
        Time of the clock for the whole check [s].
    out : str or Path or None
        A folder for page and data; without it nothing is written.

    Returns
    -------
    EngineCheckResult
        The findings, and whether one of them prevents a flight.

    Raises
    ------
    InputError
        For a file that cannot be used as an engine at all.
    """
    from cosim.base.storage.files import check_results_folder
    from cosim.base.storage.toml import parse_values
    from cosim.engine import check_fmu

    check_results_folder(out, *CHECK_FILES)
    texts = as_settings(settings)
    trust_named_code([*texts, engine], Path())
    result = EngineCheckResult(check_fmu(str(engine), step_s, parse_values(texts), time_limit_s))
    return result if out is None else result.write(out)


class MappingResult(Result):
    """Draft of a mapping file for an engine's FMU; ``begun.text`` is the file."""

    def __init__(self, begun: BegunMapping) -> None:
        self.begun = begun
        self.files = {}

    @property
    def found(self) -> Mapping[str, str]:
        """FMU variables by the engine port that they were assigned to."""
        return self.begun.found

    @property
    def open(self) -> Mapping[str, str]:
        """What the user has to state of each engine port without a variable, by port."""
        return self.begun.open

    @property
    def is_complete(self) -> bool:
        """Whether every port that an engine needs has a variable."""
        return self.begun.is_complete

    def to_dict(self) -> dict[str, Any]:
        begun = self.begun
        return {
            "fmu": str(begun.archive.path),
            "mapping": str(begun.path),
            "found": dict(begun.found),
            "open": dict(begun.open),
            "complete": begun.is_complete,
        }

    def lines(self) -> list[str]:
        """Return a line for each port that has a variable, and for each that the user has to state."""
        begun = self.begun
        found = ", ".join(f"{port} = {name}" for port, name in begun.found.items()) or "no port"
        return [f"found: {found}", *(f"open: {port}: {trouble}" for port, trouble in begun.open.items())]


@check_types()
def map_engine(fmu: str | Path, out: str | Path | None = None) -> MappingResult:
    """Write a mapping file for an engine's FMU: the ports that are found, and what is to be stated of others.

    Nothing of the FMU is run.

    >>> from cosim.files import data_folder
    >>> map_engine(data_folder("fmus") / "edf.fmu", "mine.toml").lines()[0]
    'found: throttle = throttle, thrust = thrust, start = throttle_start'

    Parameters
    ----------
    fmu : str or Path
        The FMU of an engine.
    out : str or Path or None
        The mapping file, which must not be there, or its folder; None: beside the FMU, under its name.

    Returns
    -------
    MappingResult
        What is found, what is open, and the file.

    Raises
    ------
    InputError
        For what is no FMU of an engine, and a mapping file that is there already.
    """
    from cosim.engine.make.mapping_file import begin_mapping, write_mapping

    result = MappingResult(begin_mapping(Path(fmu), None if out is None else Path(out)))
    result.files = {"mapping": write_mapping(result.begun)}
    return result


class AircraftCheckResult(Result):
    """Verdict on an aircraft; ``check`` has the results of all checks."""

    def __init__(self, check: AircraftCheck) -> None:
        self.check = check
        self.files = {} if check.drawing is None else {"drawing": check.drawing}

    @property
    def is_fit(self) -> bool:
        return self.check.is_fit

    def to_dict(self) -> dict[str, Any]:
        return self.check.to_dict()

    def lines(self) -> list[str]:
        """Return the verdict, and a line for each fault."""
        check = self.check
        faults = [f"{line.name}: {line.fault}" for line in check.lines if line.fault]
        verdict = "fit to fly" if check.is_fit else "not fit to fly"
        return [f"{check.aircraft} ({check.title}) with {check.engine}: {verdict}", *faults]

    def tables(self) -> list[Table]:
        """Return the checks' results, and the attainable moments with each engine out."""
        rows = []
        for row in self.check.authority:
            moments = [row.moment_range(axis).describe() for axis in range(3)]
            if row.moment is None:
                moments = ["falls" if row.cannot_hover else "none found", "", ""]
            rows.append((", ".join(map(str, row.lost)) or "none", f"{row.lift:.2f}", *moments))
        lines = [(line.name, line.text, line.fault) for line in self.check.lines]
        meaning = _MOMENTS_NOTE if self.check.is_exact else f"{_MOMENTS_NOTE} {_BOUNDS_NOTE}"
        return [
            Table("", ("check", "what it is", "fault"), lines),
            Table(meaning, ("engine out", "lift / weight", "roll, N m", "pitch, N m", "yaw, N m"), rows),
        ]


@check_types()
def check_aircraft(
    aircraft: str | Path, engine: str | Path | None = None, *, out: str | Path | None = None
) -> AircraftCheckResult:
    """Check frames, signs, units, inertia, hover, authority with every engine and without any one, and a flight.

    >>> check_aircraft("hexjet").is_fit
    True

    Parameters
    ----------
    aircraft : str or Path
        Name or folder.
    engine : str or Path or None
        A name, an FMU or its mapping file; None: the aircraft's own.
    out : str or Path or None
        A folder for a drawing in three views; without it nothing is drawn.

    Returns
    -------
    AircraftCheckResult
        Every check, and whether the aircraft is fit to fly.

    Raises
    ------
    InputError
        For an aircraft or an engine that cannot be read.
    """
    from cosim.aircraft_check.check import check_aircraft as check

    flown = None if engine is None else str(engine)
    trust_named_code([engine], Path())
    return AircraftCheckResult(check(str(aircraft), flown, None if out is None else Path(out)))
