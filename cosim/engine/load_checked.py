"""Loading of an engine for a flight: checked where it is not of the library, measured, and ready for a bank."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.storage.cache import RecentCache
from cosim.base.storage.files import write_if_possible
from cosim.base.storage.user import cache_folder
from cosim.base.trust import need_trust
from cosim.engine import check
from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.isolated import acquire_host, measure_in, release_host
from cosim.engine.load import load_unchecked
from cosim.engine.measure import EngineMeasurement, make_measurement_adapter, measure_once
from cosim.engine.response import find_curve_problems
from cosim.engine.source import EngineSource, find_source, resolve_parameters
from cosim.engine.spec import EngineSpec, make_behaviour_key


def load_engine(
    engine: str | EngineSource,
    parameters: Mapping[str, float],
    step: float,
    *,
    unchecked: bool = False,
    air: Air = STANDARD_AIR,
    isolated: bool | None = None,
) -> EngineSpec:
    """Return an engine by name or file, validated for steps of ``step`` seconds, and measured.

    The engine is an FMI 2.0 or 3.0 co-simulation FMU, by its name in the library, by path, or by the path of a mapping
    file; see ``cosim.engine.fmu.mapping`` for it, ``ports`` for how its ports are found.  One not of the library
    is refused if ``hexjet engine check`` finds it unfit; ``unchecked`` leaves that out.

    ``isolated``: whether it runs in a process of its own, by default as its mapping file says, and else if it is not of
    the library.  This process never loads one that does.  An archive is code, which the user has to trust.

    Raises InputError: one line that names the engine, what is wrong, and what is allowed.
    """
    source = find_source(engine)
    need_trust(source.code, f"engine {source.path.name}")
    foreign = source.engine is None
    if isolated is None:
        isolated = foreign if source.mapping.isolated is None else source.mapping.isolated
    measure = measure_checked if foreign and not unchecked else measure_isolated if isolated else _measure_locally
    return replace(load_unchecked(source, parameters, step, measure, air), isolated=isolated)


_fit_engines: set[tuple[str, str, float]] = set()  # sha256, mapping, step of checked engines
_measured: RecentCache[EngineMeasurement] = RecentCache(256)


def _measure_locally(source: EngineSource, parameters: Mapping[str, float], step: float, air: Air) -> EngineMeasurement:
    archive, (_, settings) = source.archive, resolve_parameters(source, parameters)
    return measure_once(archive, settings, archive.start, step, air, small=source.engine is None)


def measure_isolated(source: EngineSource, parameters: Mapping[str, float], step: float, air: Air) -> EngineMeasurement:
    """Return an engine's static curve and response, measured in another process and cached in this one.

    Raises EngineError where that fails.
    """
    archive, (_, settings) = source.archive, resolve_parameters(source, parameters)
    small = source.engine is None

    def measure() -> EngineMeasurement:
        host = acquire_host([archive])
        host.label = ""
        try:
            return measure_in(host, archive, settings, step, air, small)
        finally:
            release_host(host)

    return _measured.get((*make_behaviour_key(archive, settings, air), archive.start, step, small), measure)


def measure_checked(
    source: EngineSource, parameters: Mapping[str, float], step: float, air: Air = STANDARD_AIR
) -> EngineMeasurement:
    """Check a user's FMU, and return its static curve and response; raise InputError if it is unfit.

    The result is cached by archive, mapping file, parameters, step and air, and a fit FMU is not checked again: in
    another ``air`` than the standard one at sea level, and with other parameters in the same process, it is only
    measured.

    Raises InputError if it is unfit: one line with the first problem.  EngineError if it fails while it is measured.
    """
    key = source.archive.sha256, source.mapping.model_dump_json(), step
    path = _cache_path(source, parameters, step, air)
    measured, is_new = _read_cached(path), key not in _fit_engines
    if measured is None and is_new and air == STANDARD_AIR:
        report, measured = check.check_and_measure(source, step, parameters, check.MAX_CHECK_S)
        _refuse_problems(source, report.problems)
        assert measured is not None
    elif measured is None:
        if is_new:
            measure_checked(source, parameters, step)
        measured = measure_isolated(source, parameters, step, air)
        rest = source.archive.starting.rest_n
        _refuse_problems(source, find_curve_problems(measured.curve, measured.ripple, rest))
    if is_new:
        write_if_possible(path, make_measurement_adapter().dump_json(measured).decode())
    _fit_engines.add(key)
    return measured


def _refuse_problems(source: EngineSource, problems: Sequence[str]) -> None:
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise InputError(
            f"{source.path}: is not fit to fly: {problems[0]}{more}; hexjet engine check says all, "
            "unchecked_engine flies it all the same"
        )


def _cache_path(source: EngineSource, parameters: Mapping[str, float], step: float, air: Air) -> Path:
    """Return the path of an engine's cached measurement; its name is a hash of everything that it depends on."""
    key = {
        "archive": source.archive.sha256,
        "mapping": source.mapping.model_dump(mode="json"),
        "parameters": dict(sorted(parameters.items())),
        "step": step,
        "air": air,
        "python": sys.version,
        "code": _hash_modules(),
    }
    name = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
    return cache_folder() / "engines" / f"{name}.json"


@cache
def _hash_modules() -> str:
    """Return a hash of this package's modules, so that results of older versions are not used."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*")):
        if path.suffix in (".py", ".c"):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _read_cached(path: Path) -> EngineMeasurement | None:
    """Return a cached measurement, or None if there is none that can be read."""
    try:
        measured = make_measurement_adapter().validate_json(path.read_bytes())
        sane = len(measured.curve.throttle) == len(measured.curve.thrust) > 1 and measured.response.delay >= 0
        return measured if sane else None
    except (OSError, ValueError):
        return None
