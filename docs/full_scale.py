"""Flies and computes what docs/full-scale.md says, and writes its tables and its picture.

    python docs/full_scale.py [--out runs/full-scale] [--workers 2]

A part that is already in the folder is taken up, so that an interrupted call goes on where it ended.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from math import degrees, exp, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from cosim import Scenario, fly
from cosim.design.file import read_controller, write_controller
from cosim.design.make import WITH_LEAD, design
from cosim.design.tune import NOISE_SHARE, Requirements

AIRCRAFT = "hexjet-p220"
PICTURES = Path(__file__).parent / "pictures"
# The paper's turbojet at 220 N, with the delay as identified and without; the lag is the same in both.
PAPER = "engine_parameters.newton_per_unit=142.66"  # 220 N / 1.5422, the gain at rest
NAMES = ("hover", "roll-doublet", "pitch-doublet", "yaw-doublet", "gust", "payload-drop", "manual", "climb-and-land")
PLAIN = ("baseline", "smith", "filtered-smith", "state-disturbance")
CANDIDATES = (*PLAIN, "baseline" + WITH_LEAD, "state-disturbance" + WITH_LEAD)
LEAST = Requirements().min_bandwidth_hz
HEIGHTS = (0.0, 0.3326)  # of the intakes above the centre of gravity, m; the last is the law's
LEANS = (10.0, 30.0)  # deg
GUSTS = (0.0, 32.0)  # m/s, between which a limit is looked for
TO = 1.0  # m/s


@dataclass(frozen=True)
class Case:
    """An engine as it is designed for and flown."""

    name: str
    engine: str
    settings: tuple[str, ...] = ()
    noise_share: float = NOISE_SHARE
    lead: bool = True
    least_hz: float = LEAST


# The turbine's ECU limits the acceleration: noise that reaches the limit makes it hunt.
CASES = (
    Case("p220", "p220"),
    # at the default there is none
    Case("p220 without lead", "p220", lead=False, least_hz=0.1),
    Case("turbine-220", "turbine-220", noise_share=0.02),
    Case("turbojet", "turbojet", (PAPER,)),
)


def designed(case: Case, out: Path) -> dict[str, Any]:
    """A design, all candidates on roll and the best of them; the controller file beside it where one was found."""
    need = Requirements(noise_share=case.noise_share, min_bandwidth_hz=case.least_hz)
    found = design(case.engine, AIRCRAFT, need=need, settings=case.settings, lead=case.lead)
    roll = found.axes["roll"]
    if found.ok:
        write_controller(found, file_of(case, out))
    return {
        "ok": found.ok,
        "reason": found.reason,
        "allowing": dict(found.allowing),
        "controller": found.controller,
        "limits_hz": dict(roll.limits),
        "candidates": {name: value if isfinite(value) else None for name, value in roll.candidates.items()},
        "lead": roll.after.tuning.lead is not None if roll.after else False,
        "bandwidth_hz": roll.after.bandwidth_hz if roll.after else None,
        "dynamics": roll.channel.actuator.dynamics.words(),
    }


def file_of(case: Case, out: Path) -> Path:
    """Where a design's controller file is."""
    return out / f"{case.name.replace(',', '').replace(' ', '-')}.toml"


def scenario(name: str, case: Case, out: Path) -> Scenario:
    """A full-scale scenario with an engine and the controller that was designed for it."""
    file = read_controller(file_of(case, out))
    parameters = {key.partition(".")[2]: float(value) for key, _, value in (s.partition("=") for s in case.settings)}
    return Scenario.load(f"full-scale-{name}").replace(
        engine=case.engine, engine_parameters=parameters, controller=file.controller, vehicle=file.vehicle, expect=[]
    )


def flown(name: str, case: Case, out: Path) -> dict[str, Any]:
    """One flight."""
    run = fly(scenario(name, case, out))
    return {"outcome": run.outcome, "reason": run.reason, **run.summary.flat_metrics}


def with_intakes(flight: Scenario, height: float) -> Scenario:
    """The same vehicle with its jets higher: the intakes ``height`` [m] above the centre of gravity."""
    raised = {str(jet): {"position_m": {"2": 0.1535 - height}} for jet in range(6)}
    return flight.replace(vehicle={"jets": raised})


def largest_gust(case: Case, height: float, limit_deg: float, out: Path) -> float:
    """The fastest side gust [m/s] in calm air at which the vehicle leans less than ``limit_deg``, by bisection."""
    calm = with_intakes(scenario("gust", case, out), height).replace(
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


def study(out: Path, workers: int) -> dict[str, Any]:
    """Everything, from the folder where it is there."""
    out.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(workers) as pool:

        def all_of(what: str, work: Callable[..., Any], jobs: dict[str, Sequence[Any]]) -> dict[str, Any]:
            file = out / f"{what}.json"
            found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
            todo = {name: pool.submit(work, *job, out) for name, job in jobs.items() if name not in found}
            for name, future in todo.items():
                found[name] = future.result()
                file.write_text(json.dumps(found, indent=1), encoding="utf-8")
                print(f"{what}: {name}", flush=True)
            return found

        designs = all_of("designs", designed, {case.name: (case,) for case in CASES})
        held = [case for case in CASES if designs[case.name]["ok"]]
        flights = all_of("flights", flown, {f"{case.name}|{name}": (name, case) for case in held for name in NAMES})
        limits = {f"{c.name}|{h}|{a}": (c, h, a) for c in held for h in HEIGHTS for a in LEANS}
        gusts = all_of("gusts", largest_gust, limits)
    return {"designs": designs, "flights": flights, "gusts": gusts}


def tables(found: dict[str, Any]) -> str:
    """The page's tables."""
    designs, flights, gusts = found["designs"], found["flights"], found["gusts"]
    held = [case for case in CASES if designs[case.name]["ok"]]
    rows = [["engine", "answers with", "bandwidth", "without delay", "without lag", *CANDIDATES]]
    for case in CASES:
        each = designs[case.name]
        known = {name: value for name, value in each["candidates"].items() if value is not None}
        best = min(known.values(), default=0.0)
        # the objective counts a bandwidth twice
        reached = [f"{100.0 * exp(0.5 * (best - known[n])):.0f} %" if n in known else "none" for n in CANDIDATES]
        hertz = (each["bandwidth_hz"], each["limits_hz"].get("delay"), each["limits_hz"].get("lag"))
        rows.append(
            [case.name, each["dynamics"], *(f"{value:.2f} Hz" if value else "none" for value in hertz), *reached]
        )
    text = [_table(rows)]
    rows = [
        [
            "flight",
            *(
                f"{case.name}, {designs[case.name]['controller']}{WITH_LEAD if designs[case.name]['lead'] else ''}"
                for case in held
            ),
        ]
    ]
    for name in NAMES:
        cells = [flights[f"{case.name}|{name}"] for case in held]
        leans = (f"{degrees(c['roll.max_abs_error_rad']):.1f}°" for c in cells)
        rows.append(
            [
                name,
                *(lean if c["outcome"] == "completed" else c["outcome"] for lean, c in zip(leans, cells, strict=True)),
            ]
        )
    text.append(_table(rows))
    rows = [["intakes above the centre of gravity", *(case.name for case in held)]]
    for height in HEIGHTS:
        limits = [" / ".join(f"{gusts[f'{case.name}|{height}|{lean}']:.1f}" for lean in LEANS) for case in held]
        rows.append([f"{1e3 * height:.0f} mm", *limits])
    text.append(_table(rows))
    return "\n\n".join(text)


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *body = (f"| {' | '.join(row)} |" for row in rows)
    return "\n".join([head, "| --- " * len(rows[0]) + "|", *body])


def picture(out: Path) -> None:
    """The roll doublet and the gust on the P220 with and without the lead, and the throttles that it takes."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 3, figsize=(13, 3.6), constrained_layout=True)
    case = CASES[0]
    for panel, name in ((panels[0], "roll-doublet"), (panels[1], "gust")):
        flight = scenario(name, case, out)
        for label, each in (("with lead", flight), ("without", scenario(name, CASES[1], out))):
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
    """Everything into the folder, the tables to standard output."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/full-scale"))
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    found = study(given.out, given.workers)
    picture(given.out)
    print(tables(found))


if __name__ == "__main__":
    main()
