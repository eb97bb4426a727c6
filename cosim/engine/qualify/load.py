"""The way in for every engine: one of the library as it is, any other after it was tried in another process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.load import load_unchecked
from cosim.engine.measure import Measured
from cosim.engine.qualify.check import measure_apart, measure_unjudged
from cosim.engine.qualify.remembered import misbehaves
from cosim.engine.spec import EngineSpec, find_source


def load_engine(
    name_or_path: str,
    parameters: Mapping[str, float],
    step: float,
    *,
    unchecked: bool = False,
    measured: Measured | None = None,
    air: Air = STANDARD_AIR,
) -> EngineSpec:
    """Find, validate and measure an engine that will be stepped by ``step`` seconds.

    As :func:`cosim.engine.load.load_unchecked`, but an engine that is not of the library is tried in another process
    before this one loads it, and refused if ``hexjet fmu check`` finds it unfit; ``unchecked`` leaves that out.  One
    that was found to crash, hang, print or bring a run time of its own asks for a process of its own, unless its
    mapping file says ``isolated = false``.

    Raises InputError: one line that names the engine, what is wrong, and what is allowed.
    """
    source = find_source(name_or_path)
    mine = source.engine is not None or source.mapping.isolated is False  # or stated to be harmless
    known = "" if mine else misbehaves(source.archive.sha256)
    foreign = (measure_unjudged if known else None) if unchecked else measure_apart
    spec = load_unchecked(name_or_path, parameters, step, measured=measured, air=air, foreign=foreign)
    why = "" if mine else misbehaves(source.archive.sha256)  # it may have been found out just now
    return replace(spec, isolated=True, misbehaves=why) if why else spec
