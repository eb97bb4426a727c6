"""The way in for every engine: one of the library as it is, any other after it was tried in another process."""

from __future__ import annotations

from collections.abc import Mapping

from cosim.engine.load import load_unchecked
from cosim.engine.measure import Measured
from cosim.engine.ports import STANDARD_AIR, Air
from cosim.engine.qualify.check import measure_apart
from cosim.engine.spec import EngineSpec


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
    before this one loads it, and refused if ``hexjet fmu check`` finds it unfit; ``unchecked`` leaves that out.

    Raises InputError: one line that names the engine, what is wrong, and what is allowed.
    """
    foreign = None if unchecked else measure_apart
    return load_unchecked(name_or_path, parameters, step, measured=measured, air=air, foreign=foreign)
