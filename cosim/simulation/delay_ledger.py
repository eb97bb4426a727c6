"""The delay ledger: every sample of delay between the command of an axis and its measured rate, and who owns it.

Each row states the delay of its element at low frequency, in control steps: the limit of ``-phase / omega`` as the
frequency goes to 0, with the integration from moment to rate taken as ideal (-90 deg throughout).  In that limit
transport delays and lags add up, so the sum can be measured: after a step of command at step 0 the rate grows along
``K T (k + 1/2 - D)``, and ``D`` is the sum.

The rows follow what turns the vehicle in hover (:func:`cosim.simulation.axis_chain.compute_axis_fractions`): thrusts
with their engines, or servos with their banks or hinges.  Where different ones of a kind share an axis, a row states
their mean, weighted by their shares: in that limit this is the delay of the axis, while the slowest alone would state
more than can be measured.

What thrusts give beside servos, or servos beside thrusts, is not in the sum up to :data:`MINOR_SHARE` of the axis:
 with a share ``w`` of it the phase is within ``asin(w / (1 - w))``, 3 deg, of the sum at every frequency.
Where both give more the delay of the axis is another one at every frequency, and there is no sum.

The angular momentum of rotors that hinges turn, or that change their speed with the thrust, acts by the rate of the
command and takes delay away.  The reaction of what hinges and banks turn acts by its acceleration, and has no part.

An engine that states no pole has its lag measured: one of the library with a small step either way around the throttle
that it hovers with, any other with one around half throttle when it is loaded
(:class:`cosim.engine.response.SmallStep`).  The rows say so; a stated delay goes
before the measured one, of which what is left counts as lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cosim.base.constants import GRAVITY
from cosim.base.protocols import Allocator
from cosim.base.signals import AXES, ZERO3
from cosim.control.allocation.effectiveness import EffectivenessAllocator
from cosim.engine import EngineSpec
from cosim.simulation.axis_chain import (
    AxisFractions,
    compute_axis_fractions,
    filter_pole,
    list_servos,
    rotor_momentum_lead,
)
from cosim.simulation.engine_reference import SmallStepResponse, measure_small_steps
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Hinge, Surface, Vehicle

MINOR_SHARE = 0.05  # share of an axis listed, not summed up
MEASURED = ", measured with a small step around half throttle"  # how an engine's delay was measured
MEASURED_AT_HOVER = ", measured with small steps around the throttle of hover"  # how an engine's delay was measured


@dataclass(frozen=True)
class LedgerRow:
    """One delay or lag in the chain from command to measured rate of an axis."""

    element: str
    owner: str
    kind: str  # transport, lag, lead, hold or mixed
    samples: float | None  # None: unknown
    axis: str = "roll"


def make_delay_ledger(
    scenario: Scenario, vehicle: Vehicle, engines: Sequence[EngineSpec], allocator: Allocator, on_wing: bool = False
) -> list[LedgerRow]:
    """Return the rows of roll, pitch and yaw, each in the order in which the signal passes them.

    ``engines``: one per station; ``on_wing``: the flight is commanded ahead, onto its wing.
    """
    if on_wing:
        why = "flown on its wing: surfaces turn it the more, the faster it flies"
        return [LedgerRow(why, "surfaces", "mixed", None, axis) for axis in AXES]
    hover = _Hover(scenario, vehicle, engines, allocator)
    return [row for axis in AXES for row in hover.rows(axis)]


def select_axis(rows: Sequence[LedgerRow], axis: str) -> list[LedgerRow]:
    return [row for row in rows if row.axis == axis]


def sum_samples(rows: Sequence[LedgerRow], axis: str = "roll") -> float | None:
    """Return the sum of an axis's delays in control steps; None if any element is unknown."""
    samples = [row.samples for row in select_axis(rows, axis)]
    return None if any(value is None for value in samples) else sum(value for value in samples if value is not None)


def sum_transport_samples(rows: Sequence[LedgerRow], axis: str) -> float | None:
    """Return how much of an axis's delay is transport, control steps; None if any of it is unknown."""
    late = [row.samples for row in select_axis(rows, axis) if row.kind in ("transport", "mixed")]
    return None if any(value is None for value in late) else sum(value for value in late if value is not None)


def explain_unknown(rows: Sequence[LedgerRow], axis: str) -> str:
    """Return why an axis has no sum of delays; empty: it has one."""
    unknown = [row for row in select_axis(rows, axis) if row.samples is None]
    return "; ".join(row.element if row.kind == "mixed" else f"{row.element}: not known" for row in unknown)


class _Hover:
    """Vehicle in hover, for whose axes ledger rows are made."""

    def __init__(
        self, scenario: Scenario, vehicle: Vehicle, engines: Sequence[EngineSpec], allocator: Allocator
    ) -> None:
        self._scenario, self._vehicle, self._engines, self._allocator = scenario, vehicle, engines, allocator
        self._step = scenario.step_s
        self._thrusts = [vehicle.mass_kg * GRAVITY / len(engines)] * len(engines)
        if isinstance(allocator, EffectivenessAllocator):
            self._thrusts = allocator.solve_hover(ZERO3)[0][: len(engines)]

    def rows(self, axis: str) -> list[LedgerRow]:
        """Return the rows of an axis, in the order in which the signal passes them."""
        turned = compute_axis_fractions(self._vehicle, self._allocator, AXES.index(axis))
        held = [("command held over the step", "control step", "hold", 0.5)]
        if axis == "roll":
            added = float(self._scenario.added_delay_samples)
            held.append(("delay added to the roll output", "added_delay_samples", "transport", added))
        late = ("from the step's beginning", 0.0) if self._scenario.substeps > 1 else ("half a JSBSim run late", 0.5)
        gyro = self._vehicle.sensors.gyro
        pole = filter_pole(gyro.filter_s, self._step)
        airframe_and_gyro = [
            (f"force acts {late[0]}", "JSBSim", "transport", late[1]),
            ("gyro low-pass a/(1 - a)", "sensors.gyro.filter_s", "lag", pole / (1.0 - pole)),
            ("gyro latency", "sensors.gyro.latency_samples", "transport", float(gyro.latency_samples)),
        ]
        return [LedgerRow(*row, axis) for row in (*held, *self._actuator_rows(axis, turned), *airframe_and_gyro)]

    def _actuator_rows(self, axis: str, turned: AxisFractions) -> list[tuple[str, str, str, float | None]]:
        """Return element, owner, kind and samples of the rows for an axis's actuators."""
        by_thrust, by_servo = sum(turned.thrusts), sum(turned.servos)
        if not by_thrust and not by_servo:
            return [(f"nothing turns it in {axis}", "allocation", "mixed", None)]
        rotors = self._rotor_rows(axis, turned)
        if by_servo <= MINOR_SHARE:
            rows = [*self._make_engine_rows(turned.thrusts), *rotors]
            return [*rows, *_make_minor_rows("servos give", by_servo, "tilt servos")]
        if by_thrust <= MINOR_SHARE:
            rows = [*self._servo_rows(turned.servos), *rotors]
            return [*rows, *_make_minor_rows("engines give", by_thrust, _name_owner(self._engines))]
        why = (
            f"no one delay: servos give {100.0 * by_servo:.0f} % of the moment, by themselves "
            f"{_format_total(self._servo_rows(turned.servos))} samples late, engines {100.0 * by_thrust:.0f} %, "
            f"{_format_total(self._make_engine_rows(turned.thrusts))} late: the lag of their sum depends on frequency"
        )
        return [(why, "allocation", "mixed", None)]

    def _make_engine_rows(self, shares: Sequence[float]) -> list[tuple[str, str, str, float | None]]:
        engines, step, later = self._engines, self._step, self._scenario.mismatch.delay_samples
        owner = _name_owner(engines)
        owner += ": mean by their shares of the moment" if owner.startswith("engines ") else ""
        known = [self._small_step_response(jet) for jet in range(len(engines))]
        how = MEASURED if any(engine.pole is None and engine.small_step is not None for engine in engines) else ""
        how = how or (MEASURED_AT_HOVER if any(known) else "")
        delays = [_transport_delay(engine, step) for engine in engines]
        lags = [_engine_lag(engine, step, around) for engine, around in zip(engines, known, strict=True)]
        unknown = [("engines later than known", "mismatch.delay_samples", "transport", float(later))]
        at_pole = ", 1/(1 - a) at one internal step a control step"
        return [
            *(unknown if later else []),
            (f"transport delay{how if how == MEASURED else ''}", owner, "transport", _weighted_mean(delays, shares)),
            (f"spool lag{how or at_pole}", owner, "lag", _weighted_mean(lags, shares)),
            ("thrust of the step's end acts over all of it", "engines, then airframe", "exchange", -1.0),
        ]

    def _servo_rows(self, shares: Sequence[float], listed: float = 0.01) -> list[tuple[str, str, str, float | None]]:
        """Return the rows of servo lag and exchange, naming hinges that give at least ``listed`` of the axis."""
        servos = list_servos(self._vehicle)
        poles = [filter_pole(servo.lag_s, self._step) for servo in servos]
        lag = _weighted_mean([1.0 / (1.0 - pole) for pole in poles], shares)
        moving = [servo for servo, share in zip(servos, shares, strict=True) if abs(share) >= listed]
        names = [servo.name for servo in moving if isinstance(servo, (Hinge, Surface))]
        owner = f"lag_s of {', '.join(names)}" if names else "servo.lag_s"
        mean = ", mean by their shares of the moment" if len({servo.lag_s for servo in moving}) > 1 else ""
        element = f"servo lag, 1/(1 - a) while no rate limit is reached{mean}"
        return [
            (element, owner, "lag", lag),
            ("angle of the step's end acts over all of it", "servos, then airframe", "exchange", -1.0),
        ]

    def _rotor_rows(self, axis: str, turned: AxisFractions) -> list[tuple[str, str, str, float | None]]:
        """Return the row of the rotors' momentum lead, if it acts about the axis."""
        early = rotor_momentum_lead(self._vehicle, self._engines, self._thrusts, turned.moves, self._step)[
            AXES.index(axis)
        ]
        if abs(early) < 1e-6:
            return []
        return [("rotors, turned or sped up, act by the rate of the command", "rotors", "lead", -early)]

    def _small_step_response(self, jet: int) -> SmallStepResponse | None:
        """Return the response about trim of a library engine that states no pole; None for any other engine."""
        engine = self._engines[jet]
        if engine.pole is not None or not engine.library:
            return None
        curve = engine.rising_curve
        throttle = float(np.interp(self._thrusts[jet], curve.thrust, curve.throttle))
        return measure_small_steps(engine, throttle, self._step)


def _make_minor_rows(who: str, share: float, owner: str) -> list[tuple[str, str, str, float | None]]:
    if share < 5e-4:
        return []
    return [(f"{who} {100.0 * share:.1f} % of the moment beside it: not in the sum", owner, "beside", 0.0)]


def _format_total(rows: Sequence[tuple[str, str, str, float | None]]) -> str:
    samples = [row[3] for row in rows]
    return "?" if None in samples else f"{sum(value for value in samples if value is not None):.1f}"


def _name_owner(engines: Sequence[EngineSpec]) -> str:
    names = list(dict.fromkeys(engine.name for engine in engines))
    return f"engine {names[0]}" if len(names) == 1 else f"engines {', '.join(names)}"


def _weighted_mean(values: Sequence[float | None], weights: Sequence[float]) -> float | None:
    """Return the weighted mean of values; None if one with a non-zero weight is unknown.

    Equal values are returned as they are, without rounding.
    """
    pairs = [(value, weight) for value, weight in zip(values, weights, strict=True) if weight]
    known = [value for value, _ in pairs if value is not None]
    if len(known) < len(pairs):
        return None
    if len(set(known)) == 1:
        return known[0]
    return sum(value * weight for value, (_, weight) in zip(known, pairs, strict=True)) / sum(w for _, w in pairs)


def _transport_delay(engine: EngineSpec, step: float) -> float | None:
    """Return an engine's transport delay in control steps, as stated or measured."""
    if engine.transport_delay is not None:
        return engine.transport_delay / step
    return None if engine.small_step is None else float(engine.small_step.delay)


def _engine_lag(engine: EngineSpec, step: float, around: SmallStepResponse | None) -> float | None:
    """Return an engine's lag less the exchange's part of it, in control steps.

    With ``m`` internal steps of pole ``a`` in a control step and a delay of ``d`` of them, ``q = d // m``: engine and
    exchange together delay by ``q + a^(m (q + 1) - d) / (1 - a^m)`` control steps; for ``m = 1`` this is
    ``d + 1 / (1 - a) - 1``.
    """
    if engine.pole is None or engine.internal_step is None or engine.delay_samples is None:
        delay = _transport_delay(engine, step)
        late = around.delay if around is not None else (None if engine.small_step is None else engine.small_step.late)
        return None if late is None or delay is None else late - delay + 1.0
    m = round(step / engine.internal_step)
    q = engine.delay_samples // m
    both = q + engine.pole ** (m * (q + 1) - engine.delay_samples) / (1.0 - engine.pole**m)
    return both + 1.0 - engine.delay_samples / m
