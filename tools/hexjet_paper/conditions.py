"""Searches for what would make printed numbers true where the printed model does not give them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hexjet_paper import numbers
from hexjet_paper.claims import growth_percent
from hexjet_paper.experiments import Experiment, Fidelity, flight_payload_gain, hexjet_axis, linear, quadrotor_axis
from hexjet_paper.frozen import Calibration
from hexjet_paper.linear import STATE_AS_PRINTED, Plant, doublet, simulate
from hexjet_paper.loops import LoopMap, Margins, margins, open_loop, predictor_response, unstable_poles
from hexjet_paper.numbers import Record


class Condition(Record):
    """A condition that was searched for, under which printed numbers follow, with its values."""

    key: str
    question: str
    answer: str
    values: dict[str, float]


def conditions(calibration: Calibration) -> list[Condition]:
    """Search for conditions under which the model gives printed numbers that it misses otherwise."""
    return [
        _search_plant_error(calibration, "smith", "Smith"),
        _search_plant_error(calibration, "state", "the state predictor, G_n(z) realised"),
        _search_plant_error(calibration, STATE_AS_PRINTED, "the state predictor as printed"),
        *_search_observer_range(calibration),
        _search_doublet_length(calibration),
        _search_payload_condition(calibration),
        _run_flight_payload(calibration),
        _search_unstable_delay(calibration),
    ]


def _search_plant_error(calibration: Calibration, controller: str, called: str) -> Condition:
    """Search for a gain and a delay error that give a predictor's three printed margins."""
    from scipy.optimize import minimize

    loop = quadrotor_axis(calibration, controller, 5)
    predictor = predictor_response(loop.controller, loop.model, loop.tuning)
    paper = "smith" if controller == "smith" else "state"
    printed = {name: numbers.value(f"frequency.{paper}.{name}") for name in ("cutoff", "phase_margin", "gain_margin")}

    def margins_at(gain: float, extra: float) -> Margins:
        plant = Plant(loop.plant.model, gain=gain, extra_samples=extra)
        return margins(open_loop(replace(loop, plant=plant), predictor), loop.step, low=0.3, points=400)

    def cost(x: tuple[float, float]) -> float:
        gain, extra = float(x[0]), float(x[1]) * 10.0
        if not (0.3 < gain < 2.0 and 0.0 <= extra < 15.0):
            return 1e3
        response = margins_at(gain, extra)
        pairs = (
            (response.cutoff, "cutoff"),
            (response.phase_margin, "phase_margin"),
            (response.gain_margin, "gain_margin"),
        )
        return sum(((value or 0.0) / printed[name] - 1.0) ** 2 for value, name in pairs)

    starts = [(g, h) for g in (0.6, 0.75, 0.9, 1.05) for h in (0.05, 0.35, 0.7)]
    options = {"xatol": 1e-3, "fatol": 1e-5, "maxiter": 60}
    best = minimize(cost, min(starts, key=cost), method="Nelder-Mead", options=options)
    gain, extra = float(best.x[0]), float(best.x[1]) * 10.0
    response = margins_at(gain, extra)
    met = best.fun < 3 * 0.1**2
    detail = (
        f"a plant of {gain:.2f} times the modelled gain and {extra:.1f} samples more delay gives "
        f"{response.cutoff or 0:.2f} Hz, {response.phase_margin or 0:.1f} deg, {response.gain_margin or 0:.2f} dB "
        f"(paper {printed['cutoff']:g} Hz, {printed['phase_margin']:g} deg, {printed['gain_margin']:g} dB)"
    )
    return Condition(
        key=f"margins.{controller}",
        question=f"which model error would give the printed margins of {called}?",
        answer=detail if met else f"none of gain and delay does; closest, {detail}",
        values={"gain": gain, "extra_samples": extra, "residual": float(best.fun)},
    )


def _search_observer_range(calibration: Calibration) -> Iterator[Condition]:
    """Search for the double-integrator observer's bandwidths with a stable loop, for 5, 10 and 25 samples of delay."""
    bandwidths = np.geomspace(20.0, 2000.0, 41)
    for controller, called in (("state", "G_n(z) realised"), (STATE_AS_PRINTED, "the matrices as printed")):
        spans, values = [], {}
        for delay in (5, 10, 25):
            stable = []
            for bandwidth in bandwidths:
                loop = quadrotor_axis(calibration.model_copy(update={"observer_rad_s": bandwidth}), controller, delay)
                if not LoopMap(loop, 1000).unstable_poles(1.0, delay):
                    stable.append(float(bandwidth))
            values[f"stable_from_{delay}"] = stable[0] if stable else float("nan")
            values[f"stable_to_{delay}"] = stable[-1] if stable else float("nan")
            spans.append(f"{delay} samples: {f'{stable[0]:.0f} to {stable[-1]:.0f} rad/s' if stable else 'nowhere'}")
        yield Condition(
            key=f"observer.{controller}",
            question=f"at which observer bandwidths between 20 and 2000 rad/s is the state predictor stable, {called}?",
            answer="; ".join(spans),
            values={key: value for key, value in values.items() if np.isfinite(value)},
        )


def _search_doublet_length(calibration: Calibration) -> Condition:
    """Search for the doublet and record lengths that give Smith's printed errors at the vehicle's gains."""
    loop = hexjet_axis(calibration, "smith", "vehicle", noisy=False)
    amplitude, most = np.radians(numbers.value("hexjet.amplitude")), numbers.value("hexjet-doublet.smith.max")
    rmse = numbers.value("hexjet-doublet.smith.rmse")
    lengths = []
    for width in np.arange(0.4, 3.01, 0.1):
        record = simulate(
            loop, round(20.0 / loop.step), setpoint=doublet(float(amplitude), 1.0, float(width), loop.step)
        )
        error = np.array(record.setpoint) - np.array(record.angle)
        lengths.append((float(np.max(np.abs(error))), float(width), float(np.sum(error**2) * loop.step / rmse**2)))
    largest, width, length = min(lengths, key=lambda item: abs(item[0] - most))
    return Condition(
        key="hexjet-record",
        question="which doublet and record would give Smith's printed errors on the Hex-Jet, at the vehicle's gains?",
        answer=f"{width:.1f} s either way give a largest error of {largest:.4f} rad (paper {most:g} rad); "
        f"over a record of {length:.1f} s the RMSE is then {rmse:g} rad as printed",
        values={"each_s": width, "max_rad": largest, "record_s": length},
    )


def _rmse_with_and_without(run: Fidelity, controller: str) -> tuple[float, float]:
    """Return the roll rate's RMSE [rad/s] under the disturbance, with the payload and without it (5 samples)."""
    loaded, empty = (run(Experiment("disturbance", controller, 5, payload=p)).metrics.rmse for p in (True, False))
    return loaded, empty


def _search_payload_condition(calibration: Calibration) -> Condition:
    """Search for disturbances and payloads under which the state predictor's error grows more than Smith's."""
    lengths, gains = np.arange(0.05, 0.201, 0.0125), (0.8, 0.9, 1.1, 1.2, 1.3)
    lines, values = [], {}
    for gain in gains:
        holds = []
        for length in lengths:
            trial = calibration.model_copy(update={"disturbance_each_s": float(length), "payload_gain": gain})
            run = linear(trial, noisy=False, is_whole=False)
            growth = {
                c: growth_percent(
                    *(run(Experiment("disturbance", c, 5, payload=p)).metrics.rmse for p in (True, False))
                )
                for c in ("smith", STATE_AS_PRINTED)
            }
            if growth[STATE_AS_PRINTED] > growth["smith"]:
                holds.append(float(length))
        values[f"share_at_{gain}"] = len(holds) / len(lengths)
        spans = f"{min(holds):.3f} to {max(holds):.3f} s" if holds else "no length"
        lines.append(f"gain x {gain:g}: {spans} ({len(holds)} of {len(lengths)})")
    return Condition(
        key="payload-growth",
        question="for which lengths of the disturbance (0.05 to 0.2 s either way) and payloads does the state "
        "predictor, as printed, lose more than Smith?",
        answer="; ".join(lines),
        values=values,
    )


def _run_flight_payload(calibration: Calibration) -> Condition:
    """Judge the payload's claims on the linear plant with the gain that the payload has in flight."""
    gain = flight_payload_gain()
    trial = calibration.model_copy(update={"payload_gain": gain})
    run = linear(trial)
    state = run(Experiment("step", "state", 10, payload=True)).metrics.stable
    growth = {c: growth_percent(*_rmse_with_and_without(run, c)) for c in ("smith", STATE_AS_PRINTED)}
    printed = numbers.value("disturbance-5-payload.state.rmse")
    paper = growth_percent(printed, numbers.value("disturbance-5.state.rmse"))
    return Condition(
        key="payload-sign",
        question="what becomes of the payload's claims on the linear plant with the gain that the same mass has in six "
        "degrees of freedom?",
        answer=f"fitted {growth_percent(calibration.payload_gain, 1.0):+.0f} %, in six degrees of freedom "
        f"{growth_percent(gain, 1.0):+.0f} % (inertia alone). With the latter the state predictor with payload and 10 "
        f"samples is {'stable' if state else 'unstable'}; with 5 samples the disturbance's RMSE grows by "
        f"{growth['smith']:+.1f} % with Smith and {growth[STATE_AS_PRINTED]:+.1f} % with the printed matrices "
        f"(paper {paper:+.1f} % with the state predictor)",
        values={
            "fitted_gain": calibration.payload_gain,
            "flown_gain": gain,
            "state_stable": float(state),
            "smith_growth_percent": growth["smith"],
            "state_growth_percent": growth[STATE_AS_PRINTED],
            "paper_growth_percent": paper,
        },
    )


def _search_unstable_delay(calibration: Calibration) -> Condition:
    """Search for the delay that destabilises the quadrotor's baseline, with and without attitude loop."""

    def find_first_unstable(attitude_gain: float) -> int:
        for delay in range(1, 60):
            if unstable_poles(replace(quadrotor_axis(calibration, "baseline", delay), attitude_gain=attitude_gain)):
                return delay
        return 60

    alone, closed = find_first_unstable(0.0), find_first_unstable(calibration.attitude_gain_1_s)
    return Condition(
        key="baseline-delay",
        question="with how many samples does the quadrotor's baseline lose stability?",
        answer=f"the rate loop alone with {alone}, with the attitude loop closed round it with {closed}; the paper: "
        "with 10 at the latest, in an experiment on the rate",
        values={"rate_loop": float(alone), "with_attitude_loop": float(closed)},
    )
