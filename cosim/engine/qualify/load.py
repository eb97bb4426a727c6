"""The way in for every engine: one of the library as it is, any other after it was tried in another process."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from cosim.base.trust import need_trust
from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.load import load_unchecked
from cosim.engine.measure import EngineMeasurement
from cosim.engine.qualify.check import measure_in_child, measure_unchecked
from cosim.engine.qualify.misbehaviour_record import read_misbehaviour
from cosim.engine.spec import EngineSpec, find_source


def load_engine(
    name_or_path: str,
    parameters: Mapping[str, float],
    step: float,
    *,
    unchecked: bool = False,
    measured: EngineMeasurement | None = None,
    air: Air = STANDARD_AIR,
    isolated: bool = False,
) -> EngineSpec:
    """Find, validate and measure an engine that will be stepped by ``step`` seconds.

    As :func:`cosim.engine.load.load_unchecked`, but an engine that is not of the library is tried in another process
    before this one loads it, and refused if ``hexjet fmu check`` finds it unfit; ``unchecked`` leaves that out.  One
    that was found to crash, hang, print or bring a run time of its own asks for a process of its own, unless its
    mapping file says ``isolated = false``.  This process loads none that asks for one, nor any where ``isolated``
    is set.
    An archive is code, which the user has to trust.

    Raises InputError: one line that names the engine, what is wrong, and what is allowed.
    """
    source = find_source(name_or_path)
    need_trust(source.code, f"engine {source.path.name}")
    is_harmless = source.engine is not None or source.mapping.isolated is False
    isolated = isolated or bool(
        source.mapping.isolated or (not is_harmless and read_misbehaviour(source.archive.sha256))
    )
    measure_foreign: Callable[[str, Mapping[str, float], float, Air], EngineMeasurement] | None
    if unchecked or source.engine is not None:
        measure_foreign = measure_unchecked if isolated else None
    else:
        measure_foreign = partial(measure_in_child, isolated=isolated)
    spec = load_unchecked(
        name_or_path, parameters, step, measured=measured, air=air, measure_foreign=measure_foreign, source=source
    )
    spec = replace(spec, isolated=True) if isolated else spec
    misbehaviour = "" if is_harmless else read_misbehaviour(source.archive.sha256)  # known only now that it is measured
    return replace(spec, isolated=True, misbehaviour=misbehaviour) if misbehaviour else spec
