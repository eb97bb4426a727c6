"""Compares the laws of the literature at the same peak sensitivity and writes docs/laws.md and its picture.

    python docs/laws.py [--out runs/laws] [--runs N] [--workers 2]
    python docs/laws.py --tune [LAW ...]

``--runs`` flies the first N draws of the study; what is flown in the folder is not flown again.  ``--tune`` searches
parameters anew, at a peak sensitivity of 1.7, and prints them: those are the laws' defaults.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from math import degrees, log, nan
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from law_loop import HELD, LawLoop, SetpointFilter, both, tune

from cosim import InputError, Scenario, fly
from cosim.base.protocols import Parameter, RateLoop
from cosim.campaign import open_campaign
from cosim.campaign.analysis.statistics import count_pairs, newcombe
from cosim.campaign.analysis.summary import common_draws, controller_indices, success_fractions
from cosim.campaign.analysis.table import FlightTable, read_flight_table
from cosim.control.laws.axis import Axis
from cosim.engine import load_engine
from cosim.results.report.marks import check_marks, table, write_marks
from cosim.simulation.controllers.controller_file import NOISE_SHARE
from cosim.simulation.controllers.models import make_scenario_belief
from cosim.simulation.controllers.source import find_controller_source
from hexjet_design import design as make
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import Channel, channels
from hexjet_design.loop.limit import Bounds, Limit, find_limit
from hexjet_design.loop.low_order import free_weights, reduce_limit
from studies import DELAY, LATE, lost, run

mpl.use("Agg")
from matplotlib import pyplot as plt

PAGE, PICTURE = Path(__file__).parent / "laws.md", Path(__file__).parent / "pictures" / "laws.png"
# peak sensitivity: of 1.2 to 2.0, what is called robust (Astrom and Hagglund), where the paper's study stands
ROBUST = 1.7
LAWS = {
    "pid": "PID",
    "px4": "PX4",
    "pid-smith": "PID, Smith",
    "pid-filtered-smith": "PID, filtered Smith",
    "pid-state": "PID, state predictor",
    "pid-state-disturbance": "PID, state and disturbance",
    "adrc": "ADRC",
    "indi": "INDI",
    "lqg": "LQG",
    "mpc": "MPC",
    "optimal": "optimal, of low order",
}
# Where parameters are searched, the same for all laws that have one of a name; chosen wide.
BOX = {
    "angle": (0.1, 1.0),
    "p": (0.2, 30.0),
    "i": (0.003, 2.0),
    "d": (0.003, 1.0),
    "predictor": (0.05, 60.0),
    "speed": (0.2, 60.0),
    "observer": (0.05, 60.0),
    "filter": (0.05, 60.0),
    "forward": (1e-4, 1.0),
    "reference": (1e-3, 10.0),
}
# Of the controller at the limit: what the loop of its model keeps, each lag of its answer to a set-point, and what the
# loop with the engine keeps: the noise of INDI, and errors of the delay, in samples, for which the peak stays below 2 M
OF_MODEL, RESPONSE_S = Bounds(1.575, 2.4e-3, 0.4, 7.5), 0.064
LIKE_INDI, TOLERATED = 1.3e-3, 7.5
FIRST, SIMPLEX_ROUNDS, LOST_COST = 0.02, 120, 100.0  # of its simplex
STUDY = "equal-sensitivity"
ACTIVITY = "effort.throttle_1_s"
MARKS = (
    "answer",
    "parameters",
    "loops",
    "limits",
    "horizons",
    "filters",
    "flights",
    "robustness",
    "robustness by delay",
)
ALONE = ("filters", "horizons", "limits", "robustness")
NO_GAIN = 0.005  # of a step error: a filter that takes off less is none
HORIZONS_S = (2.0, 3.0, 5.0, 7.0, 14.0)  # over which errors are integrated; parameters are tuned for 7 s
SECONDS = 20.0  # for which impulses are followed on the page; a design's 7 s for the errors
DOUBLET = Scenario.load("roll-doublet").replace(expect=[])
HOVER = Scenario.load("hover").replace(expect=[], duration_s=8.0)
PUSH: dict[str, Any] = {
    "kind": "torque_command",
    "axis": "roll",
    "shape": "doublet",
    "start_s": 1.0,
    "duration_s": 2.0,
    "amplitude": 0.01,
}
LOAD: dict[str, Any] = {"kind": "payload", "start_s": 0.0, "mass_kg": 0.4, "offset_m": [0.0, 0.0, 0.1]}
FLIGHTS = {
    "doublet": DOUBLET,
    "push": HOVER.replace(disturbance=[PUSH]),
    "loaded": HOVER.replace(disturbance=[PUSH, LOAD]),
    "gust": Scenario.load("gust").replace(expect=[]),
}


@cache
def roll() -> Channel:
    """The roll axis of the Hex-Jet as flown."""
    vehicle, _ = DOUBLET.resolved_vehicle()
    spec = load_engine(DOUBLET.engine, DOUBLET.engine_parameters, DOUBLET.step_s)
    found = make.identify_there(DOUBLET, vehicle, spec, None)
    return channels(DOUBLET, vehicle, spec, Actuator.of(spec.name, make.make_dynamics(found)))["roll"]


def law(name: str, values: Mapping[str, float] | None = None) -> RateLoop:
    """A law with these parameters, or its own.  Raises InputError for one that is out of bounds."""
    source = find_controller_source(name, Path(), f"unknown law {name}")
    assert source is not None
    block: Any = source.make()
    block.prepare(replace(belief(), parameters=source.resolve_values(values or {}, name)))
    found: RateLoop = block
    return found


@cache
def belief() -> Any:
    return make_scenario_belief(DOUBLET, {})


def loop(name: str, values: Mapping[str, float] | None = None, seconds: float = 0.0) -> LawLoop:
    return LawLoop(roll(), law(name, values), belief().vehicle.control.attitude.gain_1_s[0], seconds)


def parameters(name: str) -> Sequence[Parameter]:
    source = find_controller_source(name, Path(), f"unknown law {name}")
    assert source is not None
    return source.parameters


def tuned_optimal() -> tuple[dict[str, float], float]:
    """Parameters of the controller at the limit, of four digits: of the model first, then of the loop with the engine.

    The model is not quite the engine, so the programme is given less than what the loop may have, and a simplex then
    moves the weights that are free until the loop itself has the peak, the noise and the tolerance.
    """
    from scipy.optimize import minimize

    channel, axis = roll(), Axis(belief(), "roll", belief().models["roll"])
    low = reduce_limit(channel, axis.model, OF_MODEL, RESPONSE_S, rounds=0).target
    free = free_weights(axis.model, low)

    def at(x: Any) -> dict[str, float]:
        weights = np.array(low.weights) + np.linalg.norm(low.weights) * free @ np.asarray(x)
        return replace(low, weights=tuple(weights.tolist())).to_values(axis.delay)

    def cost(x: Any) -> float:
        try:
            each = loop("optimal", at(x))
            peaks = [each.with_delay(side * error) for side in (-1.0, 1.0) for error in (TOLERATED / 2.0, TOLERATED)]
            if None in peaks:
                return LOST_COST
            missed = [each.peak_sensitivity / ROBUST, each.noise / LIKE_INDI]
            missed += [peak / (2.0 * ROBUST) for peak in peaks if peak is not None]
            return log(each.load_error) + HELD * sum(max(0.0, part - 1.0) ** 2 for part in missed)
        except (ArithmeticError, InputError):
            return LOST_COST

    x = np.zeros(free.shape[1])
    for _ in range(2):
        simplex = x + FIRST * np.vstack([np.zeros(len(x)), np.eye(len(x))])
        options = {"maxfev": SIMPLEX_ROUNDS, "initial_simplex": simplex}
        x = minimize(cost, x, method="Nelder-Mead", options=options).x
    return {key: float(f"{value:.4g}") for key, value in at(x).items()}, cost(x)


def tuned_anew(name: str) -> tuple[dict[str, float], float]:
    """Parameters of four digits."""
    if name == "optimal":
        return tuned_optimal()
    names = [each.name for each in parameters(name)]

    def at(values: Sequence[float]) -> LawLoop:
        return loop(name, dict(zip(names, values, strict=True)))

    start, room = [each.default for each in parameters(name)], roll().room
    found, value = tune(at, [BOX[each] for each in names], start, ROBUST, NOISE_SHARE * room, room)
    return {key: float(f"{each:.4g}") for key, each in zip(names, found, strict=True)}, value


def _percent(value: float) -> str:
    return f"{100.0 * value:.0f} %"


def given() -> str:
    """What each was tuned with, without units as in the source."""
    rows = []
    for name, title in LAWS.items():
        said = ", ".join(f"`{each.name}` {each.default:.4g}" for each in parameters(name))
        rows.append([title, f"`{name}`", said])
    return table(["law", "`--controller`", "tuned to"], rows, 3).replace("\\`", "`").replace("\\_", "_")


def mean(each: LawLoop, other: LawLoop) -> float:
    """Geometric mean of both errors over those of another."""
    return float(np.exp(0.5 * (both(each) - both(other))))


def within(each: LawLoop) -> tuple[float, float]:
    """Errors of the delay with which the peak stays within twice what it is; less than none there is not."""
    return each.delays_within(2.0 * ROBUST, roll().transport_samples)


@cache
def least(peak: float, noise: float, step_error: float, delay_error: float = 0.0) -> Limit:
    """The loop of the least load error within these bounds, of all linear ones."""
    return find_limit(roll(), Bounds(peak, noise, step_error, delay_error))


def reachable(noise: float, step_error: float, delay_error: float) -> float:
    """The least load error at the page's peak sensitivity; NaN where no controller keeps the bounds."""
    try:
        return least(ROBUST, noise, step_error, delay_error).load_error
    except InputError:
        return float("nan")


def beside(each: LawLoop) -> list[str]:
    """Cells: the least load error at the law's own peak, noise and step error, the law's by it; both as tolerant."""
    low, high = within(each)
    kept = (each.peak_sensitivity, each.noise, each.step_error)
    best, tolerant = least(*kept), least(*kept, min(-low, high))
    return [
        f"{best.load_error:.1f}",
        f"{each.load_error / best.load_error:.2f}",
        f"{tolerant.load_error:.1f}",
        f"{each.load_error / tolerant.load_error:.2f}",
    ]


def limits(found: Mapping[str, LawLoop]) -> str:
    """Every law beside the best of all linear controllers."""
    rows = []
    for name, each in found.items():
        low, high = within(each)
        rows.append(
            [LAWS[name], f"{each.load_error:.1f}", *beside(each)[:2], f"{min(-low, high):.2f}", *beside(each)[2:]]
        )
    head = ("law", "load", "least", "times the least", "delay error held", "least, as tolerant", "times that")
    return table(head, rows)


def loops(found: Mapping[str, LawLoop]) -> str:
    """Computed, each from the law itself in the loop."""
    rows = []
    for name, each in found.items():
        low, high = each.gain_margins
        less, more = within(each)
        far = loop(name, None, SECONDS)
        rows.append(
            [
                LAWS[name],
                f"{far.peak_sensitivity:.2f}",
                f"{each.step_error:.3f}",
                f"{each.load_error:.1f}",
                f"{each.load_left:.1f}".replace("-0.0", "0.0"),
                f"{mean(each, found['pid']):.2f}",
                _percent(each.overshoot),
                f"{low:.2f} to {high:.2f}",
                f"{less:+.2f}" if less > -roll().transport_samples else "all",
                f"{more:+.2f}",
                f"{each.delay_margins[1]:+.1f}",
                f"{1e3 * each.noise:.2f}",
            ]
        )
    head = (
        "law",
        "peak of S",
        "step",
        "load",
        "left",
        "mean",
        "overshoot",
        "gain",
        "less delay",
        "more delay",
        "unstable at",
        "noise",
    )
    return table(head, rows)


def horizons() -> str:
    """The mean of both errors over PID's, and its rank, by the time over which errors are integrated."""
    errors = {name: [loop(name, None, SECONDS).errors_within(end) for end in HORIZONS_S] for name in LAWS}
    means = {
        name: [(step * load / (a * b)) ** 0.5 for (step, load), (a, b) in zip(mine, errors["pid"], strict=True)]
        for name, mine in errors.items()
    }
    ranks = [sorted(LAWS, key=lambda name: means[name][k]) for k in range(len(HORIZONS_S))]
    rows = [
        [LAWS[name], *(f"{value:.2f} ({1 + ranks[k].index(name)})" for k, value in enumerate(mine))]
        for name, mine in means.items()
    ]
    return table(["law", *(f"{end:g} s" for end in HORIZONS_S)], rows)


def filters(found: Mapping[str, LawLoop]) -> str:
    """What a filter of the set-point, of first order, makes of each law's answer to one; all else stays."""
    filtered = {name: SetpointFilter.best(each, roll().room) for name, each in found.items()}
    pid = found["pid"]
    means = {
        name: ((each.step_error * found[name].load_error) / (pid.step_error * pid.load_error)) ** 0.5
        for name, each in filtered.items()
    }
    order = sorted(means, key=lambda name: means[name])
    rows = []
    for name, each in filtered.items():
        gains = each.step_error < (1.0 - NO_GAIN) * found[name].step_error
        times = [f"{1e3 * each.lead_s:.0f}", f"{1e3 * each.lag_s:.0f}"] if gains else ["none", "none"]
        errors = [f"{found[name].step_error:.3f}", f"{each.step_error:.3f}"]
        rows.append([LAWS[name], *errors, *times, f"{means[name]:.2f} ({1 + order.index(name)})"])
    return table(("law", "step", "with a filter", "lead [ms]", "lag [ms]", "mean"), rows)


def flown() -> str:
    """The paper's experiments on the Hex-Jet."""
    runs = {name: {key: fly(scenario.replace(controller=name)) for key, scenario in FLIGHTS.items()} for name in LAWS}
    rows = []
    for name, flights in runs.items():
        cells = []
        doublet = flights["doublet"].metrics["roll"]
        settled = doublet.settling_time_s
        cells += [f"{doublet.rmse_rad:.4f}", f"{degrees(doublet.max_abs_error_rad):.1f}°"]
        cells += [f"{doublet.overshoot_percent:.0f} %", "never" if settled is None else f"{settled:.2f} s"]
        for key in ("push", "loaded"):
            each = flights[key].metrics["roll"]
            cells += [f"{degrees(each.rmse_rad):.2f}°", f"{degrees(each.max_abs_error_rad):.1f}°"]
        gust = flights["gust"].metrics["roll"]
        cells += [f"{degrees(gust.rmse_rad):.2f}°", f"{degrees(gust.max_abs_error_rad):.1f}°"]
        cells.append(f"{flights['doublet'].summary.effort.throttle_1_s:.3f}")
        if any(each.outcome != "completed" for each in flights.values()):
            cells.append(
                ", ".join(f"{key}: {each.outcome}" for key, each in flights.items() if each.outcome != "completed")
            )
        else:
            cells.append("all completed")
        rows.append([LAWS[name], *cells])
    head = ("law", "doublet, RMSE [rad]", "largest", "overshoot", "settles", "push, RMSE", "largest",
            "push with load, RMSE", "largest", "gust, RMSE", "largest", "throttle [1/s]", "flights")  # fmt: skip
    said = (
        f"The push is a doublet of {100.0 * PUSH['amplitude']:g} % of the engines' range in {PUSH['duration_s']:g} s, "
        f"the load {LOAD['mass_kg']:g} kg hung {100.0 * LOAD['offset_m'][2]:g} cm below the centre of gravity.\n\n"
    )
    return said + table(head, rows)


def robust(found: FlightTable) -> str:
    """How often each succeeds, also draw by draw beside PID, how many flights it loses, and what the throttles do."""
    activity, pid = found.values[ACTIVITY], found.controllers.index("pid")
    rows = []
    for place, share in zip(controller_indices(found), success_fractions(found), strict=True):
        low, high = share.wilson
        mine = found.rows_of(place)
        gone = np.count_nonzero(lost(found) & mine)
        middle, most = np.nanmedian(activity[mine]), np.nanmax(activity[mine])
        cells = [_percent(share.value or 0.0), f"{100.0 * low:.0f} to {_percent(high)}", _beside(found, pid, place)]
        rows.append([LAWS[found.controllers[place]], *cells, f"{gone}", f"{middle:.2f}", f"{most:.2f}"])
    draws = success_fractions(found)[0].of
    head = ["law", "succeeds", "95 %", "points beside PID", "lost", "throttle [1/s], median", "most"]
    return f"{draws:,} draws, each flown with all {len(LAWS)} laws.\n\n" + table(head, rows)


def _beside(found: FlightTable, first: int, second: int) -> str:
    """The difference of success on the same draws, with its interval."""
    if first == second:
        return "-"
    rows, others = common_draws(found, first, second)
    pairs = count_pairs(found.success[rows], found.success[others])
    low, high = newcombe(pairs) or (nan, nan)
    return f"{100.0 * (pairs.difference or 0.0):+.1f} ({100.0 * low:+.1f} to {100.0 * high:+.1f})"


def by_delay(found: FlightTable) -> str:
    """Successes by the true delay."""
    (late,) = [key.numbers for key in found.keys if key.path == DELAY]
    classes = [np.greater(late, low) & np.less_equal(late, high) for low, high in pairwise(LATE)]
    titles = [f"{low + 1:.0f} to {high:.0f} samples" for low, high in pairwise(LATE)]
    rows = []
    for place, name in enumerate(found.controllers):
        mine = found.rows_of(place)
        rows.append([LAWS[name], *(f"{np.count_nonzero(found.success & each & mine)} of "
                                   f"{np.count_nonzero(each & mine)}" for each in classes)])  # fmt: skip
    return table(["law", *titles], rows)


def answer(found: Mapping[str, LawLoop], study: FlightTable) -> str:
    """The first paragraph's figures."""
    means = {name: mean(each, found["pid"]) for name, each in found.items()}
    order = sorted(means, key=lambda name: means[name])
    first = order[0]
    places_of = {name: 1 + place for place, name in enumerate(order)}
    smith, pid = found["pid-smith"], found["pid"]
    step = min(found, key=lambda name: found[name].step_error)
    load = min(found, key=lambda name: found[name].load_error)
    less, more = smith.step_error / pid.step_error - 1.0, smith.load_error / pid.load_error
    late = {name: within(found[name]) for name in ("pid", "pid-smith", first)}
    won = {
        study.controllers[k]: one.value or 0.0
        for k, one in zip(controller_indices(study), success_fractions(study), strict=True)
    }
    best = sorted(won, key=lambda name: -won[name])
    lines = (
        f"Of {len(LAWS)} laws at a peak sensitivity of {ROBUST:g} Smith's is number {places_of['pid-smith']} and",
        f"PID alone number {places_of['pid']} by the mean of both errors over 7 s, Smith's",
        f"{means['pid-smith']:.2f} times",
        f"PID's; first is {LAWS[first]} ({means[first]:.2f}), then {LAWS[order[1]]} ({means[order[1]]:.2f}). After a",
        f"step Smith's integrated error is {smith.step_error:.2f} rad s per rad, {_percent(abs(less))} "
        f"{'below' if less < 0.0 else 'above'} PID's",
        f"{pid.step_error:.2f} (least: {LAWS[step]}, {found[step].step_error:.2f}); after a load it is",
        f"{more:.1f} times PID's, and {smith.load_error / found[load].load_error:.1f} times that of {LAWS[load]},",
        f"the least. The peak doubles where the engines answer {-late['pid-smith'][0]:.1f} samples earlier or",
        f"{late['pid-smith'][1]:.1f} later than Smith's model says; for PID alone {late['pid'][1]:.1f} later, for",
        f"{LAWS[first]} {-late[first][0]:.1f} earlier or {late[first][1]:.1f} later. With everything wrong at once, in",
        f"{success_fractions(study)[0].of} draws, "
        f"Smith succeeds in {_percent(won['pid-smith'])}, PID in {_percent(won['pid'])},",
        f"all laws in {_percent(won[best[-1]])} to {_percent(won[best[0]])}.",
    )
    return " ".join(lines) + "\n"


COLOURS = (
    "#4c5864",
    "#8a939b",
    "#b3402a",
    "#e8891c",
    "#d9b310",
    "#7a4fa3",
    "#2a78d6",
    "#1a9e8f",
    "#3f8f3a",
    "#c23b80",
    "#1c2329",
)


NEAR = {  # where a name stands beside its point
    "adrc": ((-6, 3), "right"),
    "lqg": ((6, 4), "left"),
    "mpc": ((6, -9), "left"),
    "pid": ((-6, -3), "right"),
    "pid-smith": ((-6, 3), "right"),
    "pid-filtered-smith": ((4, -12), "right"),
    "pid-state-disturbance": ((6, 5), "right"),
    "indi": ((7, 5), "left"),
    "optimal": ((-7, 4), "right"),
}


def draw(found: Mapping[str, LawLoop]) -> None:
    """Peak sensitivity over the error of the delay, and the errors against each other."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.6), constrained_layout=True)
    errors = np.arange(-20.0, 30.1, 0.5)
    for (name, each), colour in zip(found.items(), COLOURS, strict=True):
        values = [each.with_delay(float(error)) for error in errors]
        style = "-" if name.startswith("pid") or name == "px4" else "--"
        left.plot(errors, [np.nan if v is None else v for v in values], style, color=colour, label=LAWS[name], lw=1.6)
        right.plot(each.step_error, each.load_error, "o" if style == "-" else "D", color=colour)
        (x, y), side = NEAR.get(name, ((6, 3), "left"))
        at = (each.step_error, each.load_error)
        right.annotate(LAWS[name], at, (x, y), textcoords="offset points", fontsize=8, ha=side)
    left.set(
        xlabel="delay of the plant beyond the model's [samples of 4 ms]",
        ylabel="peak of |S|",
        xlim=(-21.0, 50.0),
        ylim=(1.0, 6.0),
    )
    left.set_title("What an error of the delay does to a peak of 1.7", fontsize=9)
    left.axhline(ROBUST, color="#c8ced4", lw=0.8, zorder=0)
    left.legend(fontsize=7, ncols=1, loc="lower right")
    for name, tolerated, style in (("pid", 0.0, ":"), ("indi", TOLERATED, "-"), ("indi", 0.0, "--")):
        noise = found[name].noise
        steps = np.array([0.14, 0.18, 0.25, 0.35, 0.5, 0.75])
        curve = [reachable(noise, float(step), tolerated) for step in steps]
        label = f"the limit, with {LAWS[name]}'s noise" + f" and ±{tolerated:g} samples" * bool(tolerated)
        right.plot(steps, curve, style, color="#1c2329", lw=1.2, label=label)
    right.legend(fontsize=7, loc="lower right")
    right.set(xlabel="integrated error after a step [rad s per rad]", ylabel="after a load [rad s per unit of command]")
    right.set_yscale("log")
    right.set_yticks([10.0, 20.0, 50.0, 100.0], ["10", "20", "50", "100"])
    right.minorticks_off()
    right.set_title("All at a peak sensitivity of 1.7: left and below is better", fontsize=9)
    right.margins(x=0.18)
    right.set_ylim(5.5, 130.0)  # below the limit there is room for what the lines are
    figure.savefig(PICTURE, dpi=130)


def flown_study(found: Mapping[str, LawLoop], out: Path, runs: int | None, workers: int) -> dict[str, str]:
    """The parts of the page that the study's flights are behind; what is not flown yet is flown."""
    folder = out / (STUDY if runs is None else f"{STUDY}-{runs}")
    run(f"hexjet sweep {STUDY}" + (f" --runs {runs}" if runs else ""), folder, workers)
    study = read_flight_table(open_campaign(folder))
    return {"robustness": robust(study), "robustness by delay": by_delay(study), "answer": answer(found, study)}


def main() -> None:
    """The page, or parameters anew."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/laws"))
    parser.add_argument("--runs", type=int, help="draws; none: all of the study")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", choices=ALONE, help="this table alone, limits with the picture")
    parser.add_argument("--tune", nargs="*", metavar="LAW", help="none: all")
    asked = parser.parse_args()
    if asked.tune is not None:
        for name in asked.tune or LAWS:
            try:
                values, value = tuned_anew(name)
            except InputError as error:
                parser.error(str(error))
            print(f"{name}: {value:+.4f} {values} peak {loop(name, values, SECONDS).peak_sensitivity:.4f}", flush=True)
        return
    check_marks(PAGE, MARKS)
    if asked.only == "horizons":
        write_marks(PAGE, {"horizons": horizons()})
        return
    found = {name: loop(name) for name in LAWS}
    if asked.only == "filters":
        write_marks(PAGE, {"filters": filters(found)})
        return
    if asked.only == "robustness":
        write_marks(PAGE, flown_study(found, asked.out, asked.runs, asked.workers))
        return
    draw(found)
    if asked.only == "limits":
        write_marks(PAGE, {"limits": limits(found)})
        return
    parts = {
        "parameters": given(),
        "loops": loops(found),
        "limits": limits(found),
        "horizons": horizons(),
        "filters": filters(found),
        "flights": flown(),
    }
    write_marks(PAGE, parts)
    write_marks(PAGE, flown_study(found, asked.out, asked.runs, asked.workers))


if __name__ == "__main__":
    main()
