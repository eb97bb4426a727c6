"""Measurement of an engine by stepping it: static curve, step response, and whether it can start in equilibrium."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import cosim.engine._bank as _bank
from cosim.base.storage.cache import RecentCache
from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.fmu.archive import Archive
from cosim.engine.fmu.instance import FmuInstance, InstanceError
from cosim.engine.fmu.starting import Setting
from cosim.engine.fmu.unpacked import unpack
from cosim.engine.response import (
    REST_TOLERANCE,
    SOLVER_TOLERANCE,
    Curve,
    Hold,
    Response,
    ResponseError,
    RestlessError,
    SmallStep,
    measure_static_curve,
    measure_step_response,
    settle,
    settling_window,
)
from cosim.engine.spec import make_behaviour_key

if TYPE_CHECKING:
    from pydantic import TypeAdapter


class EngineMeasurement(NamedTuple):
    """Measured behaviour of an engine."""

    curve: Curve
    response: Response  # response to a throttle step from 0 to 1
    start: str | None  # parameter that starts it at rest, if any
    ripple: float  # relative ripple of steady thrust
    small: SmallStep | None = None  # None: not measured, or below the ripple


@cache
def make_measurement_adapter() -> TypeAdapter[EngineMeasurement]:
    """Return the pydantic adapter that converts a measurement to JSON and back, for transmission and caching."""
    from pydantic import TypeAdapter

    return TypeAdapter(EngineMeasurement)


_measured: RecentCache[EngineMeasurement] = RecentCache(256)


def measure_once(
    archive: Archive,
    settings: tuple[Setting, ...],
    start: str | None,
    step: float,
    air: Air = STANDARD_AIR,
    small: bool = True,
) -> EngineMeasurement:
    """Return the measurement by :func:`measure`, made once per process for the same archive, settings and air."""
    key = (*make_behaviour_key(archive, settings, air), start, step, small)
    return _measured.get(key, lambda: measure(archive, settings, start, step, air, small))


def measure(
    archive: Archive,
    settings: tuple[Setting, ...],
    start: str | None,
    step: float,
    air: Air = STANDARD_AIR,
    small: bool = True,
) -> EngineMeasurement:
    """Measure an engine's static curve and step response in ``air``, and test its start parameter.

    ``small``: whether a small step is measured too.

    An engine that goes on trembling at rest is measured once more with more patience.
    Raises InstanceError or ResponseError if it fails, never settles or never answers.
    """
    try:
        return _measure_unpacked(archive, settings, start, step, REST_TOLERANCE, air, small)
    except RestlessError:
        return _measure_unpacked(archive, settings, start, step, SOLVER_TOLERANCE, air, small)


def _measure_unpacked(
    archive: Archive,
    settings: tuple[Setting, ...],
    start: str | None,
    step: float,
    ripple: float,
    air: Air,
    small: bool,
) -> EngineMeasurement:
    with unpack(archive) as folder:
        instance = FmuInstance(archive, folder, "measured")
        try:
            instance.initialize(settings, 0.0, air, step=step)
            native = _bank.Bank([instance.make_row()], step)
            rest = archive.starting.rest_n

            def hold(throttle: float, steps: int) -> list[float]:
                return native.hold(0, throttle, steps)

            at_rest = settle(hold, 0.0, max(1, round(1.0 / step)), step, ripple, rest)
            response = measure_step_response(hold, at_rest, 1.0, step, ripple, rest)
            window = settling_window(response.delay)
            curve = measure_static_curve(hold, window, step, ripple, rest)
            span = abs(response.after - response.before)
            small_step = _small_step(hold, window, step, ripple, rest, span) if small else None
            measured = EngineMeasurement(curve, response, None, ripple, small_step)
        except _bank.FailureError as failure:
            raise InstanceError(instance.explain(failure, "while its thrust was measured")) from failure
        finally:
            instance.close()
        if start is not None and not _starts_settled(archive, folder, settings, step, measured, air):
            start = None
    return measured._replace(start=start)


def _small_step(
    hold: Hold, window: int, step: float, ripple: float, rest: float, span: float, min_change_over_rest: float = 5.0
) -> SmallStep | None:
    """Return the response to a small throttle step around the middle, if it exceeds the ripple of steady thrust."""
    throttle, opened = 0.5, 0.55
    thrusts: list[float] = []

    def hold_and_record(held: float, steps: int) -> list[float]:
        chunk = list(hold(held, steps))
        thrusts.extend(chunk)
        return chunk

    try:
        before = settle(hold, throttle, window, step, ripple, rest, span)
        response = measure_step_response(hold_and_record, before, opened, step, ripple, rest)
    except ResponseError:
        return None
    change = response.after - response.before
    if abs(change) < min_change_over_rest * rest:
        return None
    return SmallStep(response.delay, sum((response.after - thrust) / change for thrust in thrusts))


def _starts_settled(
    archive: Archive, folder: Path, settings: tuple[Setting, ...], step: float, measured: EngineMeasurement, air: Air
) -> bool:
    """Return whether the start parameter starts the engine at rest on its static curve, at half throttle."""
    curve, response = measured.curve, measured.response
    middle = len(curve.throttle) // 2
    throttle, thrust = curve.throttle[middle], curve.thrust[middle]
    instance = FmuInstance(archive, folder, "started")
    try:
        port = archive.ports["start"]
        first = instance.initialize([*settings, (port.variable, port.value(throttle))], throttle, air, step=step)
        rest = _bank.Bank([instance.make_row()], step).hold(0, throttle, settling_window(response.delay))
    except InstanceError:
        return False
    except _bank.FailureError as failure:
        instance.explain(failure, "")
        return False
    finally:
        instance.close()
    tolerance = max(1e-6 * max(1.0, abs(response.after)), archive.starting.rest_n)
    return all(abs(value - thrust) <= tolerance for value in [first, *rest])
