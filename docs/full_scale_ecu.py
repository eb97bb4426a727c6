"""Flies what docs/full-scale.md says of an ECU as a real one is: delay, ramps, 10 Hz, six that differ, what would help.

    OPENBLAS_CORETYPE=Haswell python docs/full_scale_ecu.py [--out runs/full-scale-ecu] [--workers 2]
    OPENBLAS_CORETYPE=Haswell python docs/full_scale_ecu.py --tune 120      the search for the gains tuned in flight

A flight that is already in the folder is taken up, so that an interrupted call goes on where it ended.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from math import degrees
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from cosim import Scenario, fly
from cosim.base.runtime.threads import one_thread
from cosim.base.storage.files import write_files
from cosim.base.storage.paths import data_folder
from cosim.base.storage.toml import toml_text
from cosim.engine import load_engine
from cosim.engine.fmu.uncertainty import CUT
from cosim.results.report.marks import check_marks, table, write_marks
from cosim.simulation.controllers.controller_file import read_controller
from cosim.spec.vehicle import load_vehicle

AIRCRAFT, REAL, STEP = "hexjet-p220", "jetcat-p300", 0.004
PAGE = Path(__file__).parent / "full-scale.md"
DATA = PAGE.parent / "tables" / "full-scale-ecu.md"
DESIGNS = Path(__file__).parents[1] / "tests" / "designs"
LATE, DIFFER, CHANGES, OUT = "real ecu", "real ecu, six that differ", "real ecu, the vehicle", "real ecu, one out"
PARTS = (LATE, DIFFER, CHANGES, OUT)
NAMES = ("hover", "roll-doublet", "gust")
LEAN_DEG = 10.0  # most that a gust may lean a vehicle that "flies"
SWING_DEG = 2.0  # peak to peak, in the last ten seconds of its hover
LAST = 2500  # steps of those
DELAYS_S = (0.0, 0.1, 0.2, 0.4)

# Of the speed a second, read off the recorded slopes about 60 to 80 krpm: 10 to 14 krpm/s up, 8 to 9 down.
RAMPS = {"acceleration": 0.2, "deceleration": 0.12}
HEAVIER = "jetcat-p300, heavier rotor"  # the ten steps fitted with 2.0e-4 kg m², which the pump's volts speak for
FITTED: Mapping[str, tuple[str, dict[str, float]]] = {
    REAL: (REAL, {}),
    HEAVIER: (
        REAL,
        {"rotor_inertia": 2e-4, "fuel_integral": 0.01987, "fuel_integral_exponent": 2.487, "fuel_response": 0.001168}
        | {"fuel_ramp": 0.001345, "fuel_fall": 0.1844, "pump_time_constant": 0.0936, "delay_samples": 20},
    ),
}
ENGINES: Mapping[str, tuple[str, dict[str, float]]] = {
    "p220": ("p220", {}),
    "p220-2025": ("p220-2025", {}),
    "turbine-220, ramps as recorded": ("turbine-220", RAMPS),
    **FITTED,
}
TUNED, VANES = "tuned in flight", "with vanes"
SHIPPED, TURBINE, DESIGNED = "as shipped", "turbine-220's", "designed for it"
GAINS = (SHIPPED, TURBINE, DESIGNED, TUNED, VANES)
VANES_SHUT = "with vanes, opposite shut off"
DESIGN = PAGE.parent / "full_scale_jetcat.toml"
OWN = {TURBINE: DESIGNS / "turbine-220.toml", DESIGNED: DESIGN}
SEARCHED = {"k": (0.35, 1.6), "p": (0.005, 0.03), "i/p": (0.03, 0.5), "d/p": (0.005, 0.2), "pole": (4.0, 16.0)}
FOUND = (0.574, 0.0133, 0.34, 0.00618, 10.8)  # by --tune 120
LAGS = {"natural_rad_s": 1.51, "damping": 1.222}  # of the real one as fitted, 1.28 and 0.34 s: hexjet design's own
DRAWS = 3
SIX = {number: {"command_interval": steps} for number, steps in zip("123456", (23, 24, 25, 25, 26, 27), strict=True)}


def tuned(values: Sequence[float] = FOUND) -> dict[str, Any]:
    """Gains of roll, named as SEARCHED, without a predictor; all others are those of turbine-220's design."""
    gain, p, i, d, pole = values
    changed: dict[str, Any] = read_controller(OWN[TURBINE]).vehicle
    control = changed["control"]
    control["attitude"]["gain_1_s"][0] = gain
    control["rate"]["roll"] |= {"p": p, "i": p * i, "d": p * d}
    control["lead"]["roll"] = {**LAGS, "pole_rad_s": pole}
    return {**changed, "control": {**control, "schedule": False}}


def badness(found: Mapping[str, Any]) -> float:
    """What a search makes small: the swing, overshoot and time to settle, and the lean, each by what is still good."""
    if found["hover"]["outcome"] != "completed":
        return 100.0 - float(found["hover"]["at_s"])
    doublet, gust = found["roll-doublet"], found["gust"]
    bad = found["hover"]["swing_deg"] / SWING_DEG
    if doublet["outcome"] == "completed":
        bad += max(doublet["overshoot"], 0.0) / 20.0
        bad += 3.0 if doublet["settling"] is None else doublet["settling"] / 4.5
    else:
        bad += 5.0
    return float(bad + (gust["lean_deg"] / LEAN_DEG if gust["outcome"] == "completed" else 5.0))


def search(count: int) -> None:
    """Print gains of roll that a random search tries with both fits and with six clocks, each better than the last."""
    random, (low, high) = np.random.default_rng(1), np.log(np.array(list(SEARCHED.values()))).T
    trials = [(*fit, {}) for fit in FITTED.values()] + [(REAL, {}, CASES["10 Hz, each by its own clock"])]
    best: list[tuple[float, list[float]]] = []
    for n in range(count):
        if n < count // 2 or not best:
            point = np.exp(random.uniform(low, high))
        else:
            about = np.log(best[random.integers(min(4, len(best)))][1])
            point = np.exp(np.clip(about + 0.2 * random.standard_normal(len(low)), low, high))
        values, bad, words = [float(f"{value:.3g}") for value in point], 0.0, []
        for engine, parameters, mismatch in trials:
            found = tried(engine, parameters, {"controller": "baseline", "vehicle": tuned(values)}, mismatch)
            bad, words = bad + badness(found), [*words, said(found)]
            if bad > 20.0:
                break
        best = sorted([*best, (bad, values)])
        if best[0][1] == values:
            print(f"{n}: {bad:.2f} {dict(zip(SEARCHED, values, strict=True))} {' | '.join(words)}", flush=True)
    if tuple(best[0][1]) != FOUND:
        print(f"other gains than FOUND, {FOUND}")


def longer(factor: float, grows: bool) -> dict[str, Any]:
    """The same loop of roll with the engines ``factor`` times as far out; ``grows``: their mass turns with them."""
    changed, (vehicle, _) = tuned(), load_vehicle(AIRCRAFT)
    lever, inertia = abs(vehicle.jets[0].position_m[1]), list(vehicle.inertia_kg_m2)
    more = 6.0 * 1.85 * lever**2 * (factor**2 - 1.0) if grows else 0.0  # kg of an engine: the aircraft's README
    jets = {str(n): {"position_m": {"1": factor * jet.position_m[1]}} for n, jet in enumerate(vehicle.jets)}
    gain = factor * inertia[0] / (inertia[0] + more)
    roll = changed["control"]["rate"]["roll"]
    changed["control"]["rate"]["roll"] = {**roll, "p": roll["p"] / gain, "i": roll["i"] / gain}
    return {**changed, "jets": jets, "inertia_kg_m2": {"0": inertia[0] + more, "2": inertia[2] + more}}


def turned_aside(
    out: Path, range_rad: float, nozzle_m: float = 0.1535, lag_s: float = 0.02, shuts_opposite: bool = False
) -> Path:
    """The vehicle with its thrust turned sideways ``nozzle_m`` below the engines' middles: a vane in each nozzle.

    Roll is then for what turns.  Gains as of the trijet, whose vanes they are, slowed for the banks' servo.
    """
    name = f"vanes-{1e3 * range_rad:.0f}-{1e3 * nozzle_m:.0f}-{1e3 * lag_s:.0f}" + "-shut" * shuts_opposite
    path = out / name / "vehicle.toml"
    vehicle, _ = load_vehicle(AIRCRAFT)
    stated = vehicle.model_dump(mode="json", exclude_none=True)
    servo, control = stated.pop("servo"), stated["control"]
    banks: dict[str, list[int]] = {"right": [], "left": []}
    hinges: list[dict[str, Any]] = []
    for number, jet in enumerate(stated["jets"], 1):
        banks[jet.pop("servo")].append(number)
        x, y, z = jet["position_m"]
        jet |= {"position_m": [x, y, z + nozzle_m], "effort": 20.0}
        hinges.append(
            {"name": f"vane_{number}", "position_m": jet["position_m"], "axis": [1.0, 0.0, 0.0], "deflects": [number]}
            | {"lag_s": lag_s, "rate_limit_rad_s": 5.0, "range_rad": range_rad}
        )
    turn = {"lag_s": servo["lag_s"], "rate_limit_rad_s": servo["rate_limit_rad_s"], "range_rad": servo["range_rad"]}
    for side, jets in banks.items():
        middle = [0.0, stated["jets"][jets[0] - 1]["position_m"][1], vehicle.jets[0].position_m[2]]
        bank = {"name": f"bank_{side}", "position_m": middle, "axis": [0.0, -1.0, 0.0], "carries": jets}
        hinges.insert(0, bank | turn | {"inertia_kg_m2": servo["bank_inertia_kg_m2"]})
    slow = read_controller(OWN[TURBINE]).vehicle["control"]
    for axis, gain in (("roll", 6.0), ("pitch", 5.0), ("yaw", 4.0)):
        control["rate"][axis] |= {"p": gain, "i": 0.5 * gain, "d": 0.0, "integral_limit": 5.0}
    control["attitude"]["gain_1_s"] = [2.0, 2.0, 1.5]
    control["altitude"] |= slow["altitude"]
    control["lead"] = {"altitude": slow["lead"]["altitude"]}
    control["allocation"]["method"] = "effectiveness"
    control["monitor"] |= {"shut_opposite": shuts_opposite, "catch": False}
    control.pop("schedule", None)
    stated |= {"name": f"{AIRCRAFT}-aside", "title": "Hex-Jet, full scale, thrust turned sideways"}
    stated["airflow"]["intake_m"] += nozzle_m
    stated["airflow"]["exhaust_m"] += nozzle_m
    stated["model"] = str(data_folder("aircraft") / "hexjet" / "hexjet.xml")
    write_files({path: toml_text(stated | {"hinges": hinges, "identified": {}})})
    return path


def gains(name: str, out: Path, engine: str = REAL) -> dict[str, Any]:
    """What a column changes of a scenario."""
    if name == SHIPPED:
        return {"controller": "baseline"}
    if name == TUNED:
        return {"controller": "baseline", "vehicle": tuned()}
    if name in (VANES, VANES_SHUT):
        aircraft = turned_aside(out, 0.26, shuts_opposite=name == VANES_SHUT)
        return {"controller": "baseline", "aircraft": str(aircraft.resolve())}
    file = read_controller(OWN[name])
    # a predictor has an identified model of its own engine alone
    return {"controller": file.controller if engine == file.design.engine else "baseline", "vehicle": file.vehicle}


def six(seed: int) -> dict[str, dict[str, float]]:
    """Six engines of one kind that differ as the real one's ``[uncertainty]`` has it, none known to a controller."""
    spec = load_engine(REAL, {}, STEP)
    known, own, random = spec.uncertainty, spec.parameters, np.random.default_rng(seed)
    assert known is not None
    least = {variable.name: variable.min or 0.0 for variable in spec.archive.parameters}
    drawn = {}
    factor = np.array(known.factor)
    for number in SIX:
        normal = np.clip(factor @ random.standard_normal(len(factor)), -CUT, CUT)
        each = {
            name: own[name] + off * share
            for name, off, share in zip(known.parameters, known.deviation, normal.tolist(), strict=True)
        }
        each["delay_samples"] = round(each["delay_samples"])
        drawn[number] = {parameter: max(value, least[parameter]) for parameter, value in each.items()}
    return drawn


def tried(
    engine: str, parameters: Mapping[str, float], changed: Mapping[str, Any], mismatch: Mapping[str, Any]
) -> dict[str, Any]:
    """Hover; then the roll doublet and the gust of what stayed up."""
    found: dict[str, Any] = {}
    for name in NAMES:
        flight = Scenario.load(f"full-scale-{name}").replace(
            engine=engine, engine_parameters=dict(parameters), mismatch=dict(mismatch), expect=[], **changed
        )
        run = fly(flight)
        metrics = run.summary.flat_metrics
        found[name] = {
            "outcome": run.outcome,
            "at_s": float(run.log["time_s"][-1]),
            "swing_deg": float(np.degrees(np.ptp(run.log["roll_rad"][-LAST:]))),
            "lean_deg": degrees(metrics["roll.max_abs_error_rad"] or 0.0),
            "overshoot": metrics.get("roll.overshoot_percent"),
            "settling": metrics.get("roll.settling_time_s"),
        }
        if name == "hover" and run.outcome != "completed":
            break
    return found


def lost_engine(jet: int, changed: Mapping[str, Any]) -> dict[str, Any]:
    """Hover of the real engine as fitted, in which one of six loses its flame after a second."""
    out = {"kind": "flame_out", "jet": jet, "start_s": 1.0}
    run = fly(Scenario.load("full-scale-hover").replace(engine=REAL, expect=[], fault=[out], **changed))
    log = run.log
    north, east, height = (np.asarray(log[name]) for name in ("north_m", "east_m", "altitude_m"))
    lean = np.degrees(np.hypot(log["roll_rad"], log["pitch_rad"]))
    return {
        "outcome": run.outcome,
        "lean_deg": float(lean.max()),
        "end_deg": float(lean[-LAST:].max()) if len(lean) > LAST else 90.0,
        "fallen_m": float(height[0] - height.min()),
        "drift_m": float(np.hypot(north - north[0], east - east[0]).max()),
    }


def said_of_loss(found: Mapping[str, Any]) -> str:
    """A cell: greatest lean, height lost and drift, where it is level again at the end."""
    if found["outcome"] != "completed" or found["end_deg"] > LEAN_DEG:
        return f"lost: {found['lean_deg']:.0f}°"
    return f"held: {found['lean_deg']:.0f}°, {found['fallen_m']:.1f} m, {found['drift_m']:.0f} m"


def flies(found: Mapping[str, Any]) -> bool:
    """Whether all three ended, the hover still, the doublet settled, the gust within the lean."""
    if any(found.get(name, {}).get("outcome") != "completed" for name in NAMES):
        return False
    return (
        found["hover"]["swing_deg"] <= SWING_DEG
        and found["roll-doublet"]["settling"] is not None
        and found["gust"]["lean_deg"] <= LEAN_DEG
    )


def said(found: Mapping[str, Any]) -> str:
    """A cell: whether it flies, and the three flights."""
    if found["hover"]["outcome"] != "completed":
        return f"lost in hover at {found['hover']['at_s']:.1f} s"
    doublet, gust = found["roll-doublet"], found["gust"]
    settles = "never settles" if doublet["settling"] is None else f"{doublet['settling']:.1f} s"
    cells = [
        f"{found['hover']['swing_deg']:.1f}°",
        f"{doublet['overshoot']:.0f} %, {settles}" if doublet["outcome"] == "completed" else "lost",
        f"{gust['lean_deg']:.1f}°" if gust["outcome"] == "completed" else f"lost at {gust['at_s']:.1f} s",
    ]
    return ("flies: " if flies(found) else "") + "; ".join(cells)


def least(out: Path, nozzle_m: float, lag_s: float, label: str) -> float | None:
    """The smallest range [deg], to a degree, with which a fit of the real one flies, read at 10 Hz by six clocks."""

    def holds(deg: float) -> bool:
        aircraft = str(turned_aside(out, float(np.radians(deg)), nozzle_m, lag_s).resolve())
        return flies(tried(*FITTED[label], {"controller": "baseline", "aircraft": aircraft}, {"stations": SIX}))

    low, high = 0.0, 15.0
    if not holds(high):
        return None
    while high - low > 1.0:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def cell(job: Sequence[Any], out: Path) -> Any:
    """One cell, of what kind its first entry says."""
    kind, *rest = job
    if kind == "delay":
        label, delay_s, name = rest
        engine, parameters = FITTED[label] if delay_s is None else ENGINES[label]
        late = {} if delay_s is None else {"delay_samples": round(delay_s / STEP)}
        return tried(engine, {**parameters, **late}, gains(name, out, engine), {})
    if kind == "six":
        case, name = rest
        return tried(REAL, {}, gains(name, out), CASES[case])
    if kind == "out":
        jet, name = rest
        return lost_engine(jet, gains(name, out))
    if kind == "lever":
        factor, grows, label = rest
        return tried(*FITTED[label], {"controller": "baseline", "vehicle": longer(factor, grows)}, {})
    return least(out, *rest)


def merged(*tables: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Parameters of six stations, the later over the earlier."""
    return {number: {key: value for each in tables for key, value in each[number].items()} for number in SIX}


CASES: dict[str, dict[str, Any]] = {
    "as fitted": {},
    "reads at 10 Hz, all at once": {"engine_parameters": {"command_interval": 25}},
    "10 Hz, each by its own clock": {"stations": SIX},
    **{f"six that differ, 10 Hz, own clocks, draw {n}": {"stations": merged(six(n), SIX)} for n in range(1, DRAWS + 1)},
}
COLUMNS = (DESIGNED, TUNED, VANES)
LEVERS = ((1.0, False), (1.5, False), (3.0, False), (1.5, True), (2.0, True))
ASIDE = {
    "vanes by their range, 20 ms": (0.1535, 0.02),
    "engines that tilt sideways by theirs, 50 ms": (0.0, 0.05),
}


LOSSES = (SHIPPED, TUNED, VANES, VANES_SHUT)


def page_of(part: str) -> Path:
    """The page of a part: the longest stands by itself."""
    return DATA if part == LATE else PAGE


def jobs(part: str) -> list[Sequence[Any]]:
    """The cells of a part of the page."""
    if part == LATE:
        late = [("delay", label, delay, name) for label in ENGINES for delay in DELAYS_S for name in GAINS]
        return [*late, *(("delay", label, None, name) for label in FITTED for name in GAINS)]
    if part == DIFFER:
        return [("six", case, name) for case in CASES for name in COLUMNS]
    if part == OUT:
        return [("out", int(jet), name) for jet in SIX for name in LOSSES]
    changes = [*(("lever", *each) for each in LEVERS), *(("least", *each) for each in ASIDE.values())]
    return [(*each, label) for each in changes for label in FITTED]


def written(found: Mapping[str, Any], part: str) -> str:
    """One part of the page."""

    def of(*job: Any) -> Any:
        return found[json.dumps(job)]

    if part == LATE:
        late = [
            [label, f"{delay:.1f} s", *(said(of("delay", label, delay, name)) for name in GAINS)]
            for label in ENGINES
            for delay in DELAYS_S
        ]
        for label, (engine, parameters) in FITTED.items():
            fitted = load_engine(engine, parameters, STEP).parameters["delay_samples"] * STEP
            late.append(
                [label, f"{fitted:.2f} s, as fitted", *(said(of("delay", label, None, name)) for name in GAINS)]
            )
        rule = f"*Flies*: hover within {SWING_DEG:g}° peak to peak, the doublet settles, the gust leans it by "
        return f"{rule}{LEAN_DEG:g}° at most.\n\n" + table(["engine", "ECU late by", *GAINS], late, left=2)
    if part == DIFFER:
        return table([REAL, *COLUMNS], [[case, *(said(of("six", case, name)) for name in COLUMNS)] for case in CASES])
    if part == OUT:
        rows = [[f"jet {jet}", *(said_of_loss(of("out", int(jet), name)) for name in LOSSES)] for jet in SIX]
        return table([f"{REAL}, out", *LOSSES], rows)
    return changes_table(of)


def changes_table(of: Callable[..., Any]) -> str:
    """What would have to change of the vehicle; ``of`` returns a cell."""
    vehicle, _ = load_vehicle(AIRCRAFT)
    lever = abs(vehicle.jets[0].position_m[1])
    changes = []
    for factor, grows in LEVERS:
        inertia = longer(factor, grows)["inertia_kg_m2"]["0"]
        what = "as it is" if factor == 1.0 else f"roll levers times {factor:g}, {lever:.2f} to {factor * lever:.2f} m"
        cells = [said(of("lever", factor, grows, label)) for label in FITTED]
        changes.append([f"{what}; inertia {inertia:.1f} kg m²", *cells])
    for what, each in ASIDE.items():
        ranges = [of("least", *each, label) for label in FITTED]
        changes.append([what, *("none to 15°" if deg is None else f"flies from {deg:.1f}° on" for deg in ranges)])
    return table(["change of the vehicle", *FITTED], changes)


def study(out: Path, workers: int, parts: Sequence[str]) -> dict[str, Any]:
    """Every cell of these parts, from the folder where it is there."""
    out.mkdir(parents=True, exist_ok=True)
    one_thread()
    os.environ["PYTHONSAFEPATH"] = "1"  # no process sees the current folder's modules
    turned_aside(out, 0.26)
    turned_aside(out, 0.26, shuts_opposite=True)
    file = out / "cells.json"
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        wanted = {json.dumps(job): job for part in parts for job in jobs(part)}
        todo = {name: pool.submit(cell, job, out) for name, job in wanted.items() if name not in found}
        names = {future: name for name, future in todo.items()}
        for future in as_completed(names):
            name = names[future]
            found[name] = future.result()
            file.write_text(json.dumps(found, indent=1), encoding="utf-8")
            print(name, flush=True)
    return found


def main() -> None:
    """Everything into the folder, and the tables into the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/full-scale-ecu"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", choices=PARTS, action="append", help="a part of the page; may stand several times")
    parser.add_argument("--tune", type=int, metavar="COUNT", help="instead: search the gains tuned in flight")
    given = parser.parse_args()
    if given.tune:
        one_thread()
        return search(given.tune)
    parts = given.only or PARTS
    for part in parts:
        check_marks(page_of(part), [part])
    found = study(given.out, given.workers, parts)
    for part in parts:
        write_marks(page_of(part), {part: written(found, part)})


if __name__ == "__main__":
    main()
