"""What is known of an engine before it runs: its archive, its parameters, its static curve, its share of the delay."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cosim.config import nearest
from cosim.engine import _bank, build
from cosim.engine.archive import INTEGERS, Archive, Variable, read_archive, unpack
from cosim.engine.response import Curve, Response, ResponseError, settle, static_curve, step_response, window_for
from cosim.engine.slave import Setting, Slave, SlaveError
from cosim.errors import InputError
from cosim.paths import data_folder

START = "throttle_start"  # by convention, in an FMU that is not ours


@dataclass(frozen=True)
class EngineSpec:
    """One engine, ready to be put into a bank.

    ``pole`` and ``delay_samples`` belong to ``G(z) = gain / (z - pole) z^-delay_samples`` at ``internal_step``, where
    the engine's ``engine.toml`` names the parameters; they are None for any other FMU.
    """

    name: str
    title: str
    library: bool  # one of the shipped engines
    path: Path
    fmi: str  # version
    sha256: str  # of the archive
    parameters: Mapping[str, float]  # every one, as the engine will run
    curve: Curve  # steady thrust [N] over throttle
    internal_step: float | None  # s
    pole: float | None
    delay_samples: int | None
    start: str | None  # the parameter that starts the engine in equilibrium at a throttle
    archive: Archive = field(repr=False)
    settings: tuple[Setting, ...] = field(repr=False)
    window: int = field(repr=False)  # communication steps, longer than the engine's delay

    @property
    def family(self) -> str:
        """What an identified model is filed under: the library's name in either FMI version, else the file's name.

        With the file's suffix, so that somebody's ``edf.fmu`` is not taken for the library's ``edf``.
        """
        return self.name.removesuffix(build.FMI2_SUFFIX) if self.library else self.path.name

    @property
    def delay(self) -> float | None:
        """Transport delay [s]."""
        if self.delay_samples is None or self.internal_step is None:
            return None
        return self.delay_samples * self.internal_step

    @property
    def lag(self) -> float | None:
        """Time constant [s]: -internal_step / ln(pole)."""
        if self.pole is None or self.internal_step is None:
            return None
        return -self.internal_step / math.log(self.pole) if self.pole > 0.0 else 0.0

    def thrust_at(self, throttle: float) -> float:
        """Steady thrust [N] at a throttle, linear between the measured points."""
        throttles, thrusts = self.curve
        k = min(max(bisect_right(throttles, throttle), 1), len(throttles) - 1)
        share = (throttle - throttles[k - 1]) / (throttles[k] - throttles[k - 1])
        return thrusts[k - 1] + (thrusts[k] - thrusts[k - 1]) * min(max(share, 0.0), 1.0)


def engine_names() -> list[str]:
    """Every engine that is shipped; each exists as FMI 3.0, and with ``-fmi2`` behind the name as FMI 2.0."""
    return build.engine_folders(data_folder("engines"))


def build_engines(names: list[str] | None = None) -> list[Path]:
    """Build the FMUs of the shipped engines, those up to date excepted, and return the paths of all.

    Raises InputError if one cannot be built.
    """
    try:
        return build.build_all(data_folder("engines"), data_folder("fmus"), names)
    except build.BuildError as error:
        raise InputError(str(error)) from error


def load_engine(name_or_path: str, parameters: Mapping[str, float], step: float) -> EngineSpec:
    """Find, validate and measure an engine that will be stepped by ``step`` seconds.

    The engine is an FMI 2.0 or 3.0 co-simulation FMU, by its name in the library or by path; by path it needs an input
    ``throttle`` (0..1) and an output ``thrust`` [N].

    Raises InputError: one line that names the engine, what is wrong, and what is allowed.
    """
    archive, engine = find_archive(name_or_path)
    need_whole_steps(archive, engine, step)
    start = _start_parameter(archive, engine)
    resolved, settings = resolve_parameters(archive, parameters, start)
    ledger = engine.ledger if engine else {}
    delay = resolved.get(ledger.get("delay", ""))
    try:
        curve, response, start = _measure(archive, settings, start, step)
    except (SlaveError, ResponseError) as error:
        raise InputError(f"{archive.path}: {error}") from error
    return EngineSpec(
        name=name_or_path if engine else archive.path.stem,
        title=engine.title if engine else archive.model,
        library=engine is not None,
        path=archive.path,
        fmi=archive.version,
        sha256=archive.sha256,
        parameters=resolved,
        curve=curve,
        internal_step=engine.internal_step if engine else archive.internal_step,
        pole=resolved.get(ledger.get("pole", "")),
        delay_samples=None if delay is None else round(delay),
        start=start,
        archive=archive,
        settings=settings,
        window=window_for(response.delay),
    )


def find_archive(name_or_path: str) -> tuple[Archive, build.Engine | None]:
    """The archive of an engine by name or path, and its definition if it is one of the library.

    Raises InputError for an unknown name (lists the known ones) or a file that cannot be used.
    """
    path = Path(name_or_path)
    if path.suffix.lower() == ".fmu" or len(path.parts) > 1 or path.is_file():
        return read_archive(path), None
    name = name_or_path.removesuffix(build.FMI2_SUFFIX)
    if name not in engine_names():
        allowed = nearest(name, engine_names())
        raise InputError(f"unknown engine {name_or_path!r}; {allowed}, or the path of an .fmu file")
    try:
        engine = build.read_engine(data_folder("engines") / name)
    except build.BuildError as error:
        raise InputError(str(error)) from error
    path = build.archive_path(data_folder("fmus"), name, 2 if name_or_path != name else 3)
    if not path.is_file():
        raise InputError(f"engine {name_or_path}: {path} has not been built; run: hexjet fmu build")
    return read_archive(path, engine.ports["throttle"], engine.ports["thrust"]), engine


def need_whole_steps(archive: Archive, engine: build.Engine | None, step: float) -> None:
    """Refuse a communication step that the engine states it cannot make."""
    internal = engine.internal_step if engine else archive.internal_step
    if internal is None:
        return
    count = round(step / internal)
    if count < 1 or abs(step - count * internal) > 1e-9 * step:
        raise InputError(
            f"{archive.path}: step {step:g} s is not a whole multiple of the engine's internal step {internal:g} s"
        )


def _start_parameter(archive: Archive, engine: build.Engine | None) -> str | None:
    if engine:
        return engine.ports.get("start")
    return next((v.name for v in archive.parameters if v.name.lower() == START), None)


def resolve_parameters(
    archive: Archive, given: Mapping[str, float], start: str | None
) -> tuple[dict[str, float], tuple[Setting, ...]]:
    """Every parameter's value, and those to be set because they were given.

    Raises InputError for an unknown parameter, one that the simulation sets itself, or a value out of range.
    """
    values = {v.name: v.start for v in archive.parameters if v.name != start and v.start is not None}
    settings = []
    for name, value in given.items():
        if name not in [v.name for v in archive.parameters if v.name != start]:
            known = [v.name for v in archive.parameters if v.name != start]
            allowed = nearest(name, known) if known else "it has none"
            owned = " is set by the simulation itself" if name == start else ": no such parameter"
            raise InputError(f"{archive.path}: {name}{owned}; {allowed}")
        variable = archive.parameter(name)
        _need_value(archive, variable, value)
        values[name] = float(value)
        settings.append((variable, float(value)))
    return values, tuple(settings)


def _need_value(archive: Archive, variable: Variable, value: float) -> None:
    low = -math.inf if variable.min is None else variable.min
    high = math.inf if variable.max is None else variable.max
    whole = variable.type in INTEGERS | {"Boolean"}
    if variable.type == "Boolean":
        low, high = 0.0, 1.0
    if not math.isfinite(value) or not low <= value <= high or (whole and value != round(value)):
        kind = "a whole number" if whole else "a number"
        raise InputError(f"{archive.path}: {variable.name} = {value:g}: must be {kind} from {low:g} to {high:g}")


def _measure(
    archive: Archive, settings: tuple[Setting, ...], start: str | None, step: float
) -> tuple[Curve, Response, str | None]:
    """Static curve and step response of an engine, and its start parameter if that does what it should."""
    with unpack(archive) as folder:
        slave = Slave(archive, Path(folder), "measured")
        try:
            slave.initialize(settings, 0.0)
            native = _bank.Bank([slave.row()], step)

            def hold(throttle: float, steps: int) -> list[float]:
                return native.hold(0, throttle, steps)

            at_rest = settle(hold, 0.0, max(1, round(1.0 / step)), step)
            response = step_response(hold, at_rest, 1.0, step)
            curve = static_curve(hold, window_for(response.delay), step)
        except _bank.FailureError as failure:
            raise SlaveError(slave.explain(failure, "while its thrust was measured")) from failure
        finally:
            slave.close()
        if start is not None and not _starts_level(archive, Path(folder), settings, start, step, curve, response):
            start = None
    return curve, response, start


def _starts_level(
    archive: Archive,
    folder: Path,
    settings: tuple[Setting, ...],
    start: str,
    step: float,
    curve: Curve,
    response: Response,
) -> bool:
    """Whether the start parameter starts the engine on its static curve and keeps it there, tried at half throttle."""
    middle = len(curve.throttle) // 2
    throttle, thrust = curve.throttle[middle], curve.thrust[middle]
    slave = Slave(archive, folder, "started")
    try:
        first = slave.initialize([*settings, (archive.parameter(start), throttle)], throttle)
        rest = _bank.Bank([slave.row()], step).hold(0, throttle, window_for(response.delay))
    except SlaveError:
        return False
    except _bank.FailureError as failure:
        slave.explain(failure, "")
        return False
    finally:
        slave.close()
    tolerance = 1e-6 * max(1.0, abs(response.after))
    return all(abs(value - thrust) <= tolerance for value in [first, *rest])
