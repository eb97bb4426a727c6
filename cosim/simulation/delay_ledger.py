"""The delay ledger: every sample of delay between a roll command and the measured roll rate, and who owns it.

Each row states the delay of its element at low frequency, in control steps: the limit of ``-phase / omega`` as the
frequency goes to 0, with the integration from moment to rate taken as ideal (-90 deg throughout).  In that limit
transport delays and lags add up, so the sum can be measured: after a step of roll command at step 0 the rate grows
along ``K T (k + 1/2 - D)``, and ``D`` is the sum.

Where different engines stand at different stations, each row of theirs states the mean over the stations, weighted by
their share of the roll moment: in that limit this is the delay of the vehicle's roll, while the slowest engine alone
would state more than can be measured.  All stations give the same thrust for the same command, so the shares are the
levers.

An engine that states neither delay nor pole has both measured, with a small step of its throttle around the middle
(:class:`cosim.engine.measure.Small`), and the rows say so; the mapping file's ``[ledger] delay_s`` goes before the
measured delay, of which what is left counts as lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp

from cosim.engine import EngineSpec
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle

MEASURED = ", measured with a small step around half throttle"


@dataclass(frozen=True)
class LedgerRow:
    """One element of the chain."""

    element: str
    owner: str
    kind: str  # "transport", "lag", "hold" or "exchange"
    samples: float | None  # None where the engine does not say


def delay_ledger(scenario: Scenario, vehicle: Vehicle, engines: Sequence[EngineSpec]) -> list[LedgerRow]:
    """The rows in the order in which the signal passes them; ``engines``: one per station."""
    gyro = vehicle.sensors.gyro
    owner, levers = _owner(engines), [abs(jet.position_m[1]) for jet in vehicle.jets]
    delays = [_delay(engine, scenario.step_s) for engine in engines]
    how = MEASURED if any(engine.pole is None and engine.small is not None for engine in engines) else ""
    lags = [_lag(engine, scenario.step_s) for engine in engines]
    pole = exp(-scenario.step_s / gyro.filter_s) if gyro.filter_s > 0.0 else 0.0
    later = scenario.mismatch.delay_samples
    unknown = [LedgerRow("engines later than known", "mismatch.delay_samples", "transport", float(later))]
    return [
        LedgerRow("command held over the step", "control step", "hold", 0.5),
        LedgerRow(
            "delay added to the roll output", "added_delay_samples", "transport", float(scenario.added_delay_samples)
        ),
        *(unknown if later else []),
        LedgerRow(f"transport delay{how}", owner, "transport", _mean(delays, levers)),
        LedgerRow(
            f"spool lag{how or ', 1/(1 - a) at one internal step a control step'}", owner, "lag", _mean(lags, levers)
        ),
        *_loops(engines),
        LedgerRow("thrust of the step's end acts over all of it", "engines, then airframe", "exchange", -1.0),
        LedgerRow("force acts from the step's beginning", "JSBSim", "transport", 0.0)
        if scenario.substeps > 1
        else LedgerRow("force acts half a JSBSim run late", "JSBSim", "transport", 0.5),
        LedgerRow("gyro low-pass a/(1 - a)", "sensors.gyro.filter_s", "lag", pole / (1.0 - pole)),
        LedgerRow("gyro latency", "sensors.gyro.latency_samples", "transport", float(gyro.latency_samples)),
    ]


def total_samples(rows: list[LedgerRow]) -> float | None:
    """The sum in control steps; None if any element is unknown."""
    samples = [row.samples for row in rows]
    return None if any(value is None for value in samples) else sum(value for value in samples if value is not None)


def _loops(engines: Sequence[EngineSpec]) -> list[LedgerRow]:
    """What a system of FMUs exchanges a step late inside itself: part of its own answer, and nothing on top of that."""
    return [
        LedgerRow(f"{text}, a step late in a loop: within the engine's own", f"engine {name}", "exchange", 0.0)
        for name, late in {spec.name: spec.archive.system.late for spec in engines if spec.archive.system}.items()
        for text in late
    ]


def _owner(engines: Sequence[EngineSpec]) -> str:
    names = list(dict.fromkeys(engine.name for engine in engines))
    return f"engine {names[0]}" if len(names) == 1 else f"engines {', '.join(names)}: mean by roll lever"


def _mean(values: Sequence[float | None], weights: Sequence[float]) -> float | None:
    """The weighted mean, of equal values that value itself; None if one is unknown."""
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return None
    if len(set(known)) == 1:
        return known[0]
    return sum(value * weight for value, weight in zip(known, weights, strict=True)) / sum(weights)


def _delay(engine: EngineSpec, step: float) -> float | None:
    """Transport delay in control steps, as stated or measured."""
    if engine.delay is not None:
        return engine.delay / step
    return None if engine.small is None else float(engine.small.delay)


def _lag(engine: EngineSpec, step: float) -> float | None:
    """What the engine's lag adds to its transport delay and takes back from the exchange, control steps.

    With ``m`` internal steps of pole ``a`` in a control step and a delay of ``d`` of them, ``q = d // m``: engine and
    exchange together delay by ``q + a^(m (q + 1) - d) / (1 - a^m)`` control steps; for ``m = 1`` this is
    ``d + 1 / (1 - a) - 1``.
    """
    if engine.pole is None or engine.internal_step is None or engine.delay_samples is None:
        delay = _delay(engine, step)
        return None if engine.small is None or delay is None else engine.small.late - delay + 1.0
    m = round(step / engine.internal_step)
    q = engine.delay_samples // m
    both = q + engine.pole ** (m * (q + 1) - engine.delay_samples) / (1.0 - engine.pole**m)
    return both + 1.0 - engine.delay_samples / m
