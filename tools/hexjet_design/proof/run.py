"""A design is believed when it has been flown: the loop against what was measured, then six degrees of freedom.

Its steps are in docs/control-design.md.  For the second the engine is swept again, to three times the highest crossover
of its loops and to where their gain stays below :data:`ABOVE`.  With ``T = L / (1 + L)`` and ``r`` measured over model,
the loop keeps its number of unstable poles while ``|T (r - 1)| < 1`` (the small gain theorem), and its sensitivity is
``1 / (1 + r L)``.

An FMU cannot be made to answer earlier than it does: the earlier half of the delay's tolerance is left to the linear
loop, unless the engine states a parameter for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import pi

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import EngineError, InputError
from cosim.identify.sweep import Sweep, fly_sweep, suitable_duration
from hexjet_design.design import Design, throttle_for
from hexjet_design.limits import Say
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.dynamics import Dynamics, bounds
from hexjet_design.proof.flights import HOVER, compare_with_shipped, find_allowing, fly_all, lean_of
from hexjet_design.proof.result import Proof, ProofFlight

MAX_SENSITIVITY_RATIO = 1.25  # measured over required sensitivity
UNMET_REQUIREMENTS = "flown with the engine itself it does not keep what it promises"  # reason of a failed proof
NOISE_HINT = "; where noise takes the engine to its limits, less of it may do: noise_share {:.2g}"

Again = Callable[[tuple[tuple[float, float], ...]], Design]


def add_proof(design: Design, say: Say = lambda text: None, again: Again | None = None) -> Design:
    """Check a design with the engine's own response and in flight; any failure makes it unacceptable.

    ``again`` makes another one for an engine that differs from its model by shares at frequencies
    (:attr:`hexjet_design.loop.dynamics.Dynamics.unsure`): where the measured response is too far from the model, one is
    searched for that stands it, once.

    Raises InputError if a flight cannot be set up at all.
    """
    if not design.ok:
        return design
    proof = prove(design, say)
    if not proof.unsure or again is None:
        return replace(design, proof=proof, reason=proof.reason, allowing=proof.allowing)
    say("again, for an engine that differs from its model as measured")
    other = again(proof.unsure)
    if not other.ok:
        return replace(other, proof=proof, reason=f"{proof.reason}; with that in the search, {other.reason}")
    proof = prove(other, say)
    return replace(other, proof=proof, reason=proof.reason, allowing=proof.allowing)


def prove(design: Design, say: Say = lambda text: None) -> Proof:
    """Check a design with the engine's measured response, and fly it.

    Raises InputError if a flight cannot be set up at all.
    """
    proof = Proof("", np.nan, 0.0, 0.0, 0.0, ())
    # A model off by half the response or 29 deg is of no use to a predictor.
    max_misfit = 0.50
    if design.identification is not None:
        dynamics = design.engine_dynamics
        if dynamics.misfit > max_misfit:
            why = (
                f"no model follows the engine: the best one is {100.0 * dynamics.misfit:.0f} % off its response, and "
                f"{100.0 * max_misfit:.0f} % is the most that a design allows"
            )
            return replace(proof, reason=why)
        say("the engine past the crossover")
        proof = _check_loops_with_engine(design, dynamics)
        if proof.reason:
            return proof
    flights = fly_all(design, say)
    bad = [flight for flight in flights if flight.fault]
    reason = ""
    less_noise = 0.125  # of the noise, if it moves a hover
    if bad:
        more = f" (and {len(bad) - 1} of {len(flights)} flights more)" if len(bad) > 1 else ""
        hint = NOISE_HINT.format(less_noise * design.need.noise_share) if _oscillates_by_noise(bad[0]) else ""
        reason = f"{UNMET_REQUIREMENTS}: {bad[0].words}: {bad[0].fault}{more}{hint}"
    compared = compare_with_shipped(design, flights, say)
    allowing = find_allowing(design, flights, say) if bad else {}
    lean = lean_of(design.vehicle)
    return replace(proof, reason=reason, flights=flights, compared=compared, lean_deg=lean, allowing=allowing)


def _oscillates_by_noise(flight: ProofFlight) -> bool:
    """Return whether a hover oscillates in a stable loop although nothing but noise moves it."""
    return flight.is_as_designed and flight.scenario == HOVER and "swings" in flight.fault


def _check_loops_with_engine(design: Design, dynamics: Dynamics) -> Proof:
    step = design.scenario.step_s
    loops = {
        axis: (axis_design.channel, axis_design.after.tuning)
        for axis, axis_design in design.axes.items()
        if axis_design.after is not None
        and not axis_design.channel.is_by_servo
        and axis_design.channel.identified is None
    }
    wide = {axis: ClosedLoop(FrequencyGrid(channel), tuning) for axis, (channel, tuning) in loops.items()}
    crossing = max(_crossover(closed) for closed in wide.values())
    identification = design.identification
    assert identification is not None
    swept = identification.response
    # Largest loop gain where nothing was measured, because the engine may respond with twice the model's gain.
    max_unmeasured_gain = 0.5
    # A lead may keep the gain up far above the crossover.
    reach = max(_crossover(closed, max_unmeasured_gain) for closed in wide.values())
    past_crossover = 3.0  # end of the sweep, in crossovers
    max_hz_steps = 0.4  # Hz times step: highest frequency swept
    end = min(max(past_crossover * crossing, 1.1 * reach, float(swept.hertz[-1])), max_hz_steps / step)
    low = min(float(swept.hertz[-1]), crossing) / 4.0
    size = identification.sweep.amplitude
    try:
        record = fly_sweep(
            design.engine,
            throttle_for(design.engine, design.vehicle),
            Sweep(low, end, size, suitable_duration(low)),
            step,
        )
    except EngineError as error:
        raise InputError(f"sweep of {design.engine.name}: {error}") from error
    hertz: Array = np.asarray(np.fft.rfftfreq(len(record.output), step), np.float64)
    use = (hertz >= low) & (hertz <= end)
    hertz = hertz[use]
    # At rest before and after: no leakage, and each bin is used, so that no narrow mode is averaged away.
    value = (np.fft.rfft(record.output)[use]) / (np.fft.rfft(record.injected)[use])
    good = np.abs(swept.value) > 0.0
    gain = float(np.exp(np.mean(np.log(np.abs(swept.value[good] / dynamics.hold_response(swept.hertz[good]))))))
    ratio = value / (gain * dynamics.hold_response(hertz))
    largest, peak, above, worst = 0.0, 0.0, 0.0, ("", 0.0)
    for axis, (channel, tuning) in loops.items():
        own = ClosedLoop(FrequencyGrid(channel, z=np.exp(2j * pi * hertz * step)), tuning)
        loop = own.open_loop
        off = np.abs(loop / (1.0 + loop) * (ratio - 1.0))
        if float(off.max()) > largest:
            largest, worst = float(off.max()), (axis, float(hertz[int(off.argmax())]))
        peak = max(peak, float(np.max(1.0 / np.abs(1.0 + ratio * loop))))
        beyond = wide[axis].points.theta / (2.0 * pi * step) > end
        if beyond.any():
            above = max(above, float(np.abs(wide[axis].open_loop[beyond]).max()))
    reason = ""
    unsure = bounds(hertz, np.asarray(np.abs(ratio - 1.0)))
    max_share = 0.8  # limit of |T (r - 1)|; below 1 is stable
    if largest > max_share:
        reason = (
            f"{worst[0]}: around {worst[1]:.2g} Hz the engine's own response is so far from its model that the "
            f"loop may be unstable ({largest:.2f} of what the small gain theorem allows, {max_share:g} at most)"
        )
    elif peak > MAX_SENSITIVITY_RATIO * design.need.max_sensitivity:
        reason = f"with the engine's own response peak |S| is {peak:.2f}, {design.need.max_sensitivity:g} was asked for"
    elif above > max_unmeasured_gain:
        reason = f"beyond {end:.3g} Hz, where nothing is measured, the loop's gain is up to {above:.2g}"
    return Proof(reason, end, largest, peak, above, (), unsure if reason else ())


def _crossover(closed: ClosedLoop, gain: float = 1.0) -> float:
    """Return the highest frequency, Hz, at which the loop has this gain."""
    above = np.flatnonzero(np.abs(closed.open_loop) >= gain)
    return float(closed.points.theta[above[-1]] / (2.0 * pi * closed.points.channel.step)) if len(above) else 0.0
