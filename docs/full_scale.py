"""Flies and computes what docs/full-scale.md says: its tables, between their marks, and its picture.

    OPENBLAS_CORETYPE=Haswell python docs/full_scale.py [--out runs/full-scale] [--workers 2] [--only two-engines ecu]

A part that is already in the folder is taken up, so that an interrupted call goes on where it ended.  The kernels are
those that the command hexjet takes: numpy is loaded before they could be chosen.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from math import degrees, exp, isfinite
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from cosim import Scenario, fly
from cosim.base.runtime.threads import one_thread
from cosim.base.storage.files import write_files
from cosim.base.storage.toml import read_toml, toml_text
from cosim.results.report.marks import check_marks, table, write_marks
from cosim.simulation.controllers.controller_file import NOISE_SHARE, Requirements, read_controller
from hexjet_design.controller_table import make_controller_table
from hexjet_design.design import design

AIRCRAFT = "hexjet-p220"
PAGE = Path(__file__).parent / "full-scale.md"
PICTURES = Path(__file__).parent / "pictures"
NAMES = ("hover", "roll-doublet", "pitch-doublet", "yaw-doublet", "gust", "payload-drop", "manual", "climb-and-land")
HEIGHTS = (0.0, 0.3326)  # of the intakes above the centre of gravity, m; the last is the law's
LEANS = (10.0, 30.0)  # deg
GUSTS = (0.0, 32.0)  # m/s, between which a limit is looked for
TO = 1.0  # m/s


@dataclass(frozen=True)
class Case:
    """An engine as it is designed for and flown."""

    name: str
    noise_share: float = NOISE_SHARE


# The turbine's ECU limits the acceleration: noise that reaches the limit makes it hunt.
CASES = (Case("p220"), Case("p220-2025"), Case("turbine-220", 0.01))
TRIED = ("baseline", "smith", "filtered-smith", "state-disturbance")  # alone, and with a lead where one goes with them
PLAIN = "p220 without lead"  # flown beside them
LEAST_PLAIN_HZ = 0.1  # what it is asked for: with more there is none
FLOWN = (PLAIN, *(case.name for case in CASES))
# Two identifications of one engine, each flown with what was designed for it and for the other.
BOTH = ("p220", "p220-2025")
DESIGNS = Path(__file__).parents[1] / "tests" / "designs"

# Limits of an ECU, with the gains that the vehicle ships: what the table calls them, and the engine's parameters.
LIMITS: dict[str, dict[str, float]] = {
    "none, as published": {},
    "48 ms late": {"delay_samples": 12},
    "100 ms late": {"delay_samples": 25},
    "reads every 20 ms": {"command_interval": 5},
    "reads every 100 ms": {"command_interval": 25},
    "resolves 0.1 %": {"command_resolution": 0.001},
    "resolves 1 %": {"command_resolution": 0.01},
    "dead band 0.5 %": {"command_dead_band": 0.005},
    "dead band 1 %": {"command_dead_band": 0.01},
    "dead band 2 %": {"command_dead_band": 0.02},
    "200 % a second": {"command_rate": 2.0},
    "100 % a second": {"command_rate": 1.0},
}
BANDS = (0.005, 0.01, 0.02)  # of those, the dead bands
CYCLE_S = 10.0  # of a hover, its last part, in which a limit cycle stands


def searched(case: Case, out: Path) -> dict[str, Any]:
    """What each of TRIED reaches on roll, as ``hexjet design`` searches for it, and what limits the best."""
    from cosim.engine import load_engine
    from hexjet_design.design import (
        _axis,
        _AxisInputs,
        _scenario,
        identify_there,
        make_dynamics,
    )
    from hexjet_design.loop.actuator import Actuator
    from hexjet_design.loop.channel import channels

    need = Requirements(noise_share=case.noise_share)
    flight, vehicle = _scenario(case.name, AIRCRAFT, ())
    spec = load_engine(case.name, {}, flight.step_s)
    dynamics = Actuator.of(case.name, make_dynamics(identify_there(flight, vehicle, spec, None)))
    channel = channels(flight, vehicle, spec, dynamics)["roll"]
    asked = _AxisInputs(vehicle, spec, TRIED, need, case.name, True, None, lambda text: None)
    roll = _axis(channel, asked, None)
    return {
        "limits_hz": dict(roll.limits),
        "candidates": {name: value if isfinite(value) else None for name, value in roll.candidates.items()},
        "bandwidth_hz": roll.after.bandwidth_hz if roll.after else None,
        "dynamics": channel.actuator.dynamics.describe(),
    }


def plainly(out: Path) -> None:
    """A controller without a lead and without a predictor, into the folder if it is not there."""
    path, need = file_of(PLAIN, out), Requirements(min_bandwidth_hz=LEAST_PLAIN_HZ)
    if not path.is_file():
        made = design("p220", AIRCRAFT, controller="baseline", need=need, lead=False, scheduled=False)
        write_files({path: toml_text(make_controller_table(made))})


def file_of(name: str, out: Path) -> Path:
    """Where the controller is that was designed: those with a lead are kept with the tests."""
    return out / "p220-without-lead.toml" if name == PLAIN else DESIGNS / f"{name}.toml"


def scenario(name: str, designed_for: str, out: Path) -> Scenario:
    """A full-scale scenario with the controller that was designed for an engine, and that engine."""
    file = read_controller(file_of(designed_for, out))
    return Scenario.load(f"full-scale-{name}").replace(
        engine=file.design.engine, controller=file.controller, vehicle=file.vehicle, expect=[]
    )


def flown(name: str, designed_for: str, out: Path) -> dict[str, Any]:
    """One flight."""
    run = fly(scenario(name, designed_for, out))
    throttle = run.log["throttle_1"]
    moved = {"throttle_change": float(np.diff(throttle[throttle.size // 2 :]).std())}
    return {"outcome": run.outcome, "reason": run.reason, **moved, **run.summary.flat_metrics}


def crossed(name: str, designed_for: str, engine: str, out: Path) -> dict[str, Any]:
    """One flight of an engine with the controller that ``tests/designs`` keeps for the one or the other."""
    file = read_controller(DESIGNS / f"{designed_for}.toml")
    flight = Scenario.load(f"full-scale-{name}")
    run = fly(flight.replace(engine=engine, controller=file.controller, vehicle=file.vehicle, expect=[]))
    return {"outcome": run.outcome, "reason": run.reason, **run.summary.flat_metrics}


def limited(engine: str, limit: str, out: Path) -> dict[str, Any]:
    """What a limit of the ECU makes of the roll doublet, and of hover with the sensors' noise and without."""
    changed = {"engine": engine, "engine_parameters": LIMITS[limit], "expect": []}
    doublet = fly(Scenario.load("full-scale-roll-doublet").replace(**changed))
    found: dict[str, Any] = {
        "outcome": doublet.outcome,
        "overshoot": doublet.summary.flat_metrics.get("roll.overshoot_percent"),
        "settling": doublet.summary.flat_metrics.get("roll.settling_time_s"),
    }
    for noise in (True, False):
        run = fly(Scenario.load("full-scale-hover").replace(sensor_noise=noise, **changed))
        last = slice(-round(CYCLE_S / run.scenario.step_s), None)
        roll, throttle = np.degrees(run.log["roll_rad"][last]), run.log["throttle_1"][last]
        power = np.abs(np.fft.rfft((throttle - throttle.mean()) * np.hanning(len(throttle)))) ** 2
        hertz = np.fft.rfftfreq(len(throttle), run.scenario.step_s)
        found["noisy" if noise else "quiet"] = {
            "outcome": run.outcome,
            "roll_rms_deg": float(roll.std()),
            "roll_swing_deg": float(np.ptp(roll)),
            "throttle_amplitude": float(np.sqrt(2.0) * throttle.std()),
            "hz": float(hertz[1:][int(np.argmax(power[1:]))]),
        }
    return found


def with_intakes(flight: Scenario, height: float) -> Scenario:
    """The same vehicle with its jets higher: the intakes ``height`` [m] above the centre of gravity."""
    raised = {str(jet): {"position_m": {"2": 0.1535 - height}} for jet in range(6)}
    return flight.replace(vehicle={"jets": raised})


def largest_gust(designed_for: str, height: float, limit_deg: float, out: Path) -> float:
    """The fastest side gust [m/s] in calm air at which the vehicle leans less than ``limit_deg``, by bisection."""
    calm = with_intakes(scenario("gust", designed_for, out), height).replace(
        duration_s=14.0,
        environment={"wind_ned_m_s": [0.0, 0.0, 0.0], "turbulence_severity": 0, "turbulence_wind_m_s": 0.0},
    )

    def holds(speed: float) -> bool:
        gust = calm.disturbance[0].model_dump(mode="json") | {"velocity_ned_m_s": [0.0, speed, 0.0]}
        run = fly(calm.replace(disturbance=[gust]))
        return run.outcome == "completed" and degrees(run.metrics["roll"].max_abs_error_rad) < limit_deg

    low, high = GUSTS
    if holds(high):
        return high
    while high - low > TO:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def dead_band(amplitude: float, samples: int = 4000) -> complex:
    """Describing function of a dead band of 1 for a sine of this amplitude: fundamental out over sine in.

    What is kept stands on whole steps of the band, about the sine's middle.
    """
    steps = int(2.0 * amplitude)
    low, high = -0.5 * steps, 0.5 * steps
    angle = np.linspace(0.0, 2.0 * np.pi, samples, endpoint=False)
    held, out = low, np.empty(samples)
    for _ in range(2):  # the first turn is the transient
        for k, u in enumerate(amplitude * np.sin(angle)):
            while u >= held + 1.0 - 1e-12 and held < high:
                held += 1.0
            while u <= held - 1.0 + 1e-12 and held > low:
                held -= 1.0
            out[k] = held
    return complex(2j / samples * np.sum(out * np.exp(-1j * angle)) / amplitude)


def predicted(engine: str, out: Path) -> dict[str, Any]:
    """Amplitude in dead bands and frequency [Hz] of the limit cycle: where the roll loop times that function is -1."""
    from cosim.engine import load_engine
    from hexjet_design.assessment import shipped_tuning
    from hexjet_design.design import _scenario, identify_there, make_dynamics
    from hexjet_design.loop.actuator import Actuator
    from hexjet_design.loop.channel import channels
    from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid

    flight, vehicle = _scenario(engine, AIRCRAFT, ())
    spec = load_engine(engine, {}, flight.step_s)
    dynamics = Actuator.of(engine, make_dynamics(identify_there(flight, vehicle, spec, None)))
    channel = channels(flight, vehicle, spec, dynamics)["roll"]
    points = FrequencyGrid(channel)
    loop = ClosedLoop(points, shipped_tuning(channel, vehicle, spec)).open_loop
    hertz = np.angle(points.z) / flight.step_s / 2.0 / np.pi
    inside = (hertz > 0.2) & (hertz < 3.0)
    misses = []
    for amplitude in np.arange(0.51, 1.5, 0.01):
        away = np.abs(1.0 + dead_band(float(amplitude)) * loop[inside])
        k = int(np.argmin(away))
        misses.append((float(away[k]), float(amplitude), float(hertz[inside][k])))
    miss, amplitude, frequency = min(misses)
    return {"miss": miss, "amplitude": amplitude, "hz": frequency}


def study(out: Path, workers: int, only: Sequence[str] = ()) -> dict[str, Any]:
    """Everything, or those of the tables, from the folder where it is there."""
    out.mkdir(parents=True, exist_ok=True)
    one_thread()  # each process: a search takes ten times as long with more
    os.environ["PYTHONSAFEPATH"] = "1"  # nor does it see the current folder's modules
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:

        def all_of(what: str, work: Callable[..., Any], jobs: dict[str, Sequence[Any]]) -> dict[str, Any]:
            file = out / f"{what}.json"
            found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
            todo = {name: pool.submit(work, *job, out) for name, job in jobs.items() if name not in found}
            for name, future in todo.items():
                found[name] = future.result()
                file.write_text(json.dumps(found, indent=1), encoding="utf-8")
                print(f"{what}: {name}", flush=True)
            return found

        wanted = only or PARTS
        found: dict[str, Any] = {}
        if "gains" in wanted:
            found["searched"] = all_of("searched", searched, {case.name: (case,) for case in CASES})
        if "two-engines" in wanted:
            jobs = {f"{name}|{a}|{b}": (name, a, b) for name in NAMES for a in BOTH for b in BOTH}
            found["crossed"] = all_of("crossed", crossed, jobs)
        if "ecu" in wanted:
            found["limited"] = all_of("limited", limited, {f"{e}|{n}": (e, n) for e in BOTH for n in LIMITS})
            found["predicted"] = all_of("predicted", predicted, {engine: (engine,) for engine in BOTH})
        if "flights" in wanted:
            plainly(out)
            found["flights"] = all_of("flights", flown, {f"{c}|{name}": (name, c) for c in FLOWN for name in NAMES})
            limits = {f"{c}|{h}|{a}": (c, h, a) for c in FLOWN for h in HEIGHTS for a in LEANS}
            found["gusts"] = all_of("gusts", largest_gust, limits)
    return found


def lean(cell: dict[str, Any]) -> str:
    """The greatest deviation of roll, or how the flight ended."""
    return f"{degrees(cell['roll.max_abs_error_rad']):.1f}°" if cell["outcome"] == "completed" else "lost"


def doublet(cells: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Overshoot and settling of the roll doublet, a row each."""
    rows = []
    for title, key, form in (
        ("roll doublet: overshoot", "roll.overshoot_percent", "{:.1f} %"),
        ("roll doublet: settles in", "roll.settling_time_s", "{:.2f} s"),
    ):
        said = [form.format(c[key]) if c["outcome"] == "completed" and c.get(key) is not None else "-" for c in cells]
        rows.append([title, *said])
    return rows


def two_engines(found: dict[str, Any]) -> str:
    """Each engine with either design."""
    cells = found["crossed"]
    pairs = [(a, b) for a in BOTH for b in BOTH]
    rows = [[name, *(lean(cells[f"{name}|{a}|{b}"]) for a, b in pairs)] for name in NAMES]
    rows += doublet([cells[f"roll-doublet|{a}|{b}"] for a, b in pairs])
    made = {a: read_toml(DESIGNS / f"{a}.toml")["design"]["axes"]["roll"]["bandwidth_hz"] for a in BOTH}
    rows.append(["bandwidth of roll as designed", *(f"{made[a]:.2f} Hz" if a == b else "-" for a, b in pairs)])
    return table(["flight", *(f"{a} gains on {b}" for a, b in pairs)], rows)


def ecu(found: dict[str, Any]) -> str:
    """What the limits cost, for both engines."""
    columns = [
        "ECU",
        *(f"{e}: {what}" for e in BOTH for what in ("doublet's overshoot", "settles in", "hover", "without noise")),
    ]
    rows = []
    for limit in LIMITS:
        cells = [limit]
        for engine in BOTH:
            each = found["limited"][f"{engine}|{limit}"]
            flew = each["outcome"] == "completed"
            cells.append(f"{each['overshoot']:.0f} %" if flew else "lost")
            cells.append("-" if not flew else f"{each['settling']:.1f} s" if each["settling"] is not None else "never")
            for kind in ("noisy", "quiet"):
                hover = each[kind]
                cells.append(f"{hover['roll_swing_deg']:.2f}°" if hover["outcome"] == "completed" else "lost")
        rows.append(cells)
    return table(columns, rows)


def cycles(found: dict[str, Any]) -> str:
    """The limit cycle of a dead band, by its describing function and as flown."""
    rows = []
    for engine in BOTH:
        each = found["predicted"][engine]
        rows.append([engine, "describing function", f"{each['amplitude']:.2f}", f"{each['hz']:.2f} Hz"])
        for band in BANDS:
            flown = found["limited"][f"{engine}|dead band {100 * band:g} %"]["quiet"]
            rows.append(
                [
                    engine,
                    f"flown, {100 * band:g} %",
                    f"{flown['throttle_amplitude'] / band:.2f}",
                    f"{flown['hz']:.2f} Hz",
                ]
            )
    return table(["engine", "", "amplitude of the throttle, in dead bands", "frequency"], rows, left=2)


def gains(found: dict[str, Any]) -> str:
    """What each part of a controller gains."""
    names = list(dict.fromkeys(name for each in found["searched"].values() for name in each["candidates"]))
    rows = []
    for case in CASES:
        each = found["searched"][case.name]
        known = {name: value for name, value in each["candidates"].items() if value is not None}
        best = min(known.values(), default=0.0)
        # the objective counts a bandwidth twice
        reached = [f"{100.0 * exp(0.5 * (best - known[n])):.0f} %" if n in known else "none" for n in names]
        hertz = (each["bandwidth_hz"], each["limits_hz"].get("delay"), each["limits_hz"].get("lag"))
        rows.append(
            [case.name, each["dynamics"], *(f"{value:.2f} Hz" if value else "none" for value in hertz), *reached]
        )
    return table(["engine", "answers with", "bandwidth", "without delay", "without lag", *names], rows)


def flights(found: dict[str, Any]) -> str:
    """The greatest deviation of roll, and the fastest gust that each stands."""
    flown_, gusts = found["flights"], found["gusts"]
    rows = [[name, *(lean(flown_[f"{each}|{name}"]) for each in FLOWN)] for name in NAMES]
    rows += doublet([flown_[f"{each}|roll-doublet"] for each in FLOWN])
    hover = [flown_[f"{each}|hover"] for each in FLOWN]
    noise = [f"{100.0 * each['throttle_change']:.1f} %" if each["outcome"] == "completed" else "-" for each in hover]
    rows.append(["hover: noise moves the throttle from sample to sample by", *noise])
    drops = [flown_[f"{each}|payload-drop"] for each in FLOWN]
    off = [f"{each['altitude.max_abs_error_m']:.1f} m" if each["outcome"] == "completed" else "-" for each in drops]
    rows.append(["payload-drop: height off by", *off])
    for height in HEIGHTS:
        for lean_deg in LEANS:
            limits = [f"{gusts[f'{each}|{height}|{lean_deg}']:.0f} m/s" for each in FLOWN]
            rows.append([f"side gust within {lean_deg:.0f}°, intakes {1e3 * height:.0f} mm up", *limits])
    return table(["flight", *FLOWN], rows)


PARTS = ("gains", "flights", "two-engines", "ecu")


def written(found: dict[str, Any], only: Sequence[str]) -> dict[str, str]:
    """The page's parts."""
    parts = {}
    wanted = only or PARTS
    if "gains" in wanted:
        parts["gains"] = gains(found)
    if "flights" in wanted:
        parts["flights"] = flights(found)
    if "two-engines" in wanted:
        parts["two-engines"] = two_engines(found)
    if "ecu" in wanted:
        parts |= {"ecu": ecu(found), "limit-cycles": cycles(found)}
    return parts


def picture(out: Path) -> None:
    """The roll doublet and the gust on the P220 with and without the lead, and the throttles that it takes."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 3, figsize=(13, 3.6), constrained_layout=True)
    plainly(out)
    for panel, name in ((panels[0], "roll-doublet"), (panels[1], "gust")):
        flight = scenario(name, CASES[0].name, out)
        for label, each in (("with lead", flight), ("without", scenario(name, PLAIN, out))):
            log = fly(each).log
            panel.plot(log["time_s"], np.degrees(log["roll_rad"]), label=label, lw=1.3)
            if name == "roll-doublet" and each is flight:
                panels[2].plot(log["time_s"], log["throttle_1"], lw=0.5, color="#8a939b", label="throttle")
                panels[2].plot(log["time_s"], log["thrust_1_N"] / 220.0, lw=1.3, label="thrust / 220 N")
        panel.plot(log["time_s"], np.degrees(log["roll_setpoint_rad"]), "--", color="#8a939b", lw=1)
        panel.set(title=name.replace("-", " "), ylabel="roll [deg]")
    panels[2].set(title="an engine on the left, with lead", ylabel="of full", ylim=(0, 1))
    for panel in panels:
        panel.set(xlabel="time [s]")
        panel.legend(fontsize=8, frameon=False)
        panel.grid(alpha=0.3)
        panel.spines[["top", "right"]].set_visible(False)
    figure.savefig(PICTURES / "full-scale.png", dpi=90, metadata={"Software": None})


def main() -> None:
    """Everything into the folder, and the tables into the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/full-scale"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=[], help="parts of the page")
    given = parser.parse_args()
    only = tuple(given.only)
    check_marks(PAGE, [*(only or PARTS), *(["limit-cycles"] if "ecu" in (only or PARTS) else [])])
    found = study(given.out, given.workers, only)
    if not only:
        picture(given.out)
    write_marks(PAGE, written(found, only))


if __name__ == "__main__":
    main()
