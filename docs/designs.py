"""Writes what the designs in tests/designs state, and flights while fuel burns, into the pages that quote them.

    python docs/designs.py [--no-flights]
    python docs/designs.py --anew [FOLDER] [--only NAME ...]
    python docs/designs.py --prove [--only NAME ...]

The tables of margins and of proofs come from the files alone; a test compares them with the pages.  ``--anew`` begins
every design from nothing, with the commands of :data:`COMMANDS` (half an hour of a processor), writes the files into
FOLDER, where those that are there already are taken up, and states on the page which of them are what ships; with
``--only`` it makes some files and writes no page.  ``--prove`` leaves the gains of a file as they are, makes its proof
once more, and writes what came of it into the file (some minutes of a processor).
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import Any

from cosim import Scenario, fly
from cosim.base.storage.files import write_files
from cosim.base.storage.toml import toml_text
from cosim.engine import load_engine
from cosim.results.report.marks import table, write_marks
from cosim.simulation.controllers.controller_file import ProofRecord, apply_controller, read_controller
from cosim.spec.vehicle import load_vehicle
from hexjet_design import design as make
from hexjet_design.controller_table import make_controller_table, make_proof_record
from hexjet_design.design import Design
from hexjet_design.levels import DESIGNED, THRUST_AXES, tunings_at
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import channels
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.criteria import FINE
from hexjet_design.proof.comparison import WORSE
from hexjet_design.proof.run import NOT_KEPT, prove

ROOT = Path(__file__).parent.parent
DESIGNS = ROOT / "tests" / "designs"
SHIPPED = {"hexjet-p220": "p220", "hexjet-100": "turbine-100"}
COLUMNS = (
    "peak sensitivity",
    "gain up",
    "gain down",
    "phase",
    "delay",
    "bandwidth",
    "overshoot",
    "settled",
    "tolerances times",
)
FUEL = (1.0, 0.5, 0.05)
PROOF = b"\n[design.proof]\n"  # begins the last tables of a file
LATE = "--noise-share 0.02 --no-proof"  # which these two do not pass: the page says so
LESS = "--noise-share 0.01"
COMMANDS = {  # what hexjet design is given, from nothing; a second line begins at the file of the first
    "edf": ("--engine edf",),
    "edf-as-flown": ("--engine edf-as-flown",),
    "motor": ("--engine motor --aircraft quadrotor",),
    "p220": ("--engine p220 --aircraft hexjet-p220",),
    "p220-2025": ("--engine p220-2025 --aircraft hexjet-p220",),
    "turbine-20": (f"--engine turbine-20 --controller state-disturbance {LESS}",),
    "turbine-100": (f"--engine turbine-100 --aircraft hexjet-100 {LATE}", f"{LESS} --no-proof --start FIRST"),
    "turbine-220": (f"--engine turbine-220 --aircraft hexjet-p220 {LATE}", f"{LESS} --no-proof --start FIRST"),
    "turbojet": ("--engine turbojet",),
}
SHARE = {"turbine-20": 0.01, "turbine-100": 0.01, "turbine-220": 0.01}  # of the bound on noise, where not the default


def stored(name: str) -> dict[str, Any]:
    """A design's part of its controller file."""
    found: dict[str, Any] = tomllib.loads((DESIGNS / f"{name}.toml").read_text(encoding="utf-8"))
    return found


def cells(made: Mapping[str, Any]) -> list[str]:
    """The margins of one axis, as :data:`COLUMNS`."""

    def db(key: str) -> str:
        return f"{made[key]:+.1f} dB" if key in made else "-"

    return [
        f"{made['peak_sensitivity']:.2f}",
        db("gain_margin_db"),
        db("gain_margin_down_db"),
        f"{made['phase_margin_deg']:.1f}°",
        f"{1e3 * made['delay_margin_s']:.0f} ms",
        f"{made['bandwidth_hz']:.2f} Hz",
        f"{100.0 * made['overshoot']:.1f} %",
        f"{made['settling_s']:.2f} s",
        f"{made['tolerated']:.2f}",
    ]


def margins(name: str) -> str:
    """All axes of one design."""
    return table(("axis", *COLUMNS), [[axis, *cells(made)] for axis, made in stored(name)["design"]["axes"].items()])


def designs() -> str:
    """Roll of every design."""
    rows = []
    for path in sorted(DESIGNS.glob("*.toml")):
        file = stored(path.stem)
        made = file["design"]
        lead = " + lead" if file["vehicle"]["control"].get("lead", {}).get("roll") else ""
        follows = ", scheduled" if file["vehicle"]["control"].get("schedule") else ""
        bound = f", --noise-share {SHARE[path.stem]:g}" if path.stem in SHARE else ""
        rows.append([f"{made['engine']}, {made['aircraft']}", f"{file['controller']}{lead}{follows}{bound}",
                     *cells(made["axes"]["roll"])])  # fmt: skip
    return table(("engine, aircraft", "controller", *COLUMNS), rows, 2)


def proofs(names: Iterable[str] = COMMANDS) -> str:
    """Return the proofs of designs beside the gains that their vehicles ship."""
    rows = []
    for name in sorted(names):
        proof = ProofRecord.model_validate(stored(name)["design"]["proof"])
        lost = ", ".join(f"{each.flight} {each.shipped_lost}" for each in proof.flown if each.shipped_lost)
        worse = "; ".join(line.removeprefix(f"{WORSE}: ") for line in proof.worse) or "nothing"
        rows.append(
            [
                name,
                f"FAILED: {proof.failed.removeprefix(f'{NOT_KEPT}: ')}" if proof.failed else "passed",
                f"{proof.flights}, to {proof.lean_deg:g}°",
                f"do not fly: {lost}" if lost else "fly",
                "-" if all(each.shipped_lost for each in proof.flown) else worse,
            ]
        )
    return table(("file", "proof", "flights", "gains that ship", "worse as designed"), rows, 5)


def begin_anew(folder: Path, names: Iterable[str] = COMMANDS) -> None:
    """Designs from nothing, into ``folder``; with one thread of OpenBLAS, on whose number the bits hang."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        lines, made, first = COMMANDS[name], folder / f"{name}.toml", folder / f"{name}.first.toml"
        for number, line in enumerate(lines):
            out = made if number == len(lines) - 1 else first
            if made.exists() or out.exists():
                continue
            words = lines[0].split(" --noise")[0].split() if number else []
            given = [*words, *(str(first) if word == "FIRST" else word for word in line.split())]
            command = [str(Path(sys.executable).with_name("hexjet")), "design", *given, "--out", str(out)]
            done = subprocess.run(command, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"}, stdout=subprocess.DEVNULL)
            print(f"{name}: {line}: status {done.returncode}", flush=True)


def as_designed(name: str) -> Design:
    """Return the gains of a file as a design: identified today, and not searched for.

    Raises ValueError where the controller file of that design would be another one.
    """
    path = DESIGNS / f"{name}.toml"
    file = read_controller(path)
    made = file.design
    scenario, vehicle = make._scenario(made.engine, made.aircraft, ())
    spec = load_engine(scenario.engine, scenario.engine_parameters, scenario.step_s)
    found = make.identify_there(scenario, vehicle, spec, None)
    plants = channels(scenario, vehicle, spec, Actuator.of(spec.name, make.make_dynamics(found)))
    begin = make._read_start(path, plants, scenario.aircraft, vehicle, spec)
    axes = {}
    for axis, plant in plants.items():
        need = make.axis_requirements(axis, made.requirements)
        before = make.assess(plant, make.shipped_tuning(plant, vehicle, spec), need)
        axes[axis] = make.AxisDesign(plant, before, {}, make.assess(plant, begin[axis][1.0], need), {}, {})
    plan = load_vehicle(made.aircraft, file.vehicle)[0].control.schedule or None
    design = make.Design(spec, vehicle, scenario, made.requirements, found, made.model, axes, [], plan, "", {})
    again = tomllib.loads(toml_text(make_controller_table(design)))
    if (again["controller"], again["vehicle"]) != (file.controller, file.vehicle):
        raise ValueError(f"{name}: as it is read, it is not the design that the file holds")
    return design


def prove_again(name: str) -> None:
    """Prove a file's gains as they are, and write into the file what came of it."""
    path = DESIGNS / f"{name}.toml"
    proof = prove(as_designed(name), lambda text: print(f"{name}: {text}", flush=True))
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    table["design"]["proof"] = make_proof_record(proof).model_dump(mode="json", exclude_none=True)
    write_files({path: toml_text(table)})
    print(f"{name}: {proof.reason or 'passed'}", flush=True)


def searched(path: Path) -> bytes:
    """Return the numbers of a file that are searched for.

    The proof is none of them, nor is the line of the digest of the engine's archive.
    """
    text = path.read_bytes().partition(PROOF)[0]
    return b"".join(line for line in text.splitlines(True) if not line.startswith(b"engine_sha256"))


def ships(name: str) -> str:
    """First digits of the SHA-256 of what ships."""
    return hashlib.sha256(searched(DESIGNS / f"{name}.toml")).hexdigest()[:12]


def anew(folder: Path) -> str:
    """What the commands make of every design beside what ships."""
    rows = []
    for name, lines in COMMANDS.items():
        made = folder / f"{name}.toml"
        if not made.exists():
            told = "nothing"
        elif searched(made) == searched(DESIGNS / f"{name}.toml"):
            told = "what ships, to the bit"
        else:
            told = "another design"
        rows.append([name, ships(name), "; then ".join(lines), told])
    return table(("file", "SHA-256", "hexjet design, from nothing", "makes"), rows, 4)


def levels(name: str) -> str:
    """Roll and height of one design while fuel burns: peak sensitivity held, and what the schedule makes of it."""
    rows = []
    for level in stored(name)["design"]["levels"]:
        for axis in ("roll", "altitude"):
            held = f"{level['held'][axis]:.2f}" if axis in level["held"] else "unstable"
            where = f"{100.0 * level['fuel']:.0f} %, {level['mass_kg']:.1f} kg" + (
                "" if level["designed"] else " (between)"
            )
            rows.append([where, axis, held, *cells(level["axes"][axis])])
    return table(("fuel", "axis", "held at a full tank's", *COLUMNS), rows, 2)


def heavier(name: str) -> str:
    """Roll's peak sensitivity as designed and with 25 % more inertia, gains of a full tank held and scheduled."""
    path = DESIGNS / f"{name}.toml"
    made = read_controller(path).design
    scenario, vehicle = make._scenario(made.engine, made.aircraft, ())
    spec = load_engine(scenario.engine, scenario.engine_parameters, scenario.step_s)
    actuator = Actuator.of(spec.name, make.make_dynamics(make.identify_there(scenario, vehicle, spec, None)))
    begin = make._read_start(path, channels(scenario, vehicle, spec, actuator), scenario.aircraft, vehicle, spec)
    plan = load_vehicle(made.aircraft, read_controller(path).vehicle)[0].control.schedule
    assert plan
    full = {axis: begin[axis][1.0] for axis in THRUST_AXES}
    rows = []
    for level in make._levels(scenario, vehicle, spec, actuator, None, (), lambda text: None):
        if level.fuel not in DESIGNED:
            continue
        row = [f"{100.0 * level.fuel:.0f} %"]
        for tuning in (full["roll"], tunings_at(plan, full, level.thrust_fraction, scenario.step_s)["roll"]):
            for inertia in (1.0, 1.25):
                roll = level.channels["roll"]
                closed = ClosedLoop(FrequencyGrid(replace(roll, gain=roll.gain / inertia), close=FINE), tuning)
                row.append("unstable" if closed.unstable_poles else f"{closed.peak_sensitivity:.2f}")
        rows.append(row)
    return table(("fuel", "held", "25 % more inertia", "scheduled", "25 % more inertia"), rows)


def flown(name: str) -> str:
    """Doublet and gust with part of the fuel, gains of a full tank held and scheduled."""
    rows = []
    for fuel in FUEL:
        for label, settings in (("held", ["vehicle.control.schedule=false"]), ("scheduled", [])):
            given = [f'engine="{name}"', f"initial.fuel={fuel}", *settings]
            path = DESIGNS / f"{name}.toml"
            aircraft = read_controller(path).design.aircraft
            doublet = fly(apply_controller("full-scale-roll-doublet", path, given, aircraft))
            gust = fly(apply_controller("full-scale-gust", path, given, aircraft))
            roll = doublet.metrics["roll"]
            if doublet.outcome == "completed":
                settled = f"{roll.settling_time_s:.1f} s" if roll.settling_time_s is not None else "not in 4.5 s"
                answer = [f"{roll.overshoot_percent:.0f} %", settled]
            else:
                answer = [doublet.outcome, "-"]
            leaves = (
                f"{degrees(gust.metrics['roll'].max_abs_error_rad):.1f}°"
                if gust.outcome == "completed"
                else gust.outcome
            )
            rows.append([f"{100.0 * fuel:.0f} %", label, *answer, leaves])
    return table(("fuel", "gains", "doublet: overshoot", "settled", "gust: roll leaves its set-point by"), rows, 2)


def late() -> str:
    """The P220 as shipped with an ECU that answers 0.1 s late."""
    rows = []
    for samples in (0, 12, 25):
        parameters = {"delay_samples": float(samples)} if samples else {}
        doublet = Scenario.load("full-scale-roll-doublet")
        run = fly(doublet.replace(engine="p220", engine_parameters=parameters, expect=[]))
        roll = run.metrics["roll"]
        settled = f"{roll.settling_time_s:.1f} s" if roll.settling_time_s is not None else "not in 4.5 s"
        done = run.outcome == "completed"
        rows.append(
            [f"{4 * samples} ms", *([f"{roll.overshoot_percent:.0f} %", settled] if done else [run.outcome, "-"])]
        )
    return table(("delay of the ECU", "overshoot", "settled"), rows)


def main() -> None:
    """Write the tables into the pages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-flights", action="store_true")
    parser.add_argument("--anew", type=Path, nargs="?", const=ROOT / "runs" / "designs", metavar="FOLDER")
    parser.add_argument("--prove", action="store_true")
    parser.add_argument("--only", nargs="+", choices=COMMANDS, metavar="NAME")
    given = parser.parse_args()
    if given.only and not (given.anew or given.prove):
        parser.error("--only goes with --anew and --prove")
    if given.prove:
        for name in given.only or COMMANDS:
            prove_again(name)
        return
    if given.anew:
        begin_anew(given.anew, given.only or COMMANDS)
        if given.only:
            return
        write_marks(ROOT / "docs" / "control-design.md", {"designs anew": anew(given.anew)})
        return
    flights = not given.no_flights
    for aircraft, name in SHIPPED.items():
        parts = {"margins": margins(name), "fuel": levels(name)}
        if aircraft == "hexjet-100":
            parts["proof"] = proofs([name])
        if aircraft == "hexjet-p220":
            parts["more inertia"] = heavier(name)
        if flights:
            parts["flights with part of the fuel"] = flown(name)
            if aircraft == "hexjet-p220":
                parts["a late ECU"] = late()
        write_marks(ROOT / "aircraft" / aircraft / "README.md", parts)
    write_marks(ROOT / "docs" / "control-design.md", {"designs": designs(), "designs proved": proofs()})
    parts = {"fuel p220-2025": levels("p220-2025")}
    if flights:
        parts["flights p220-2025"] = flown("p220-2025")
    write_marks(ROOT / "docs" / "full-scale.md", parts)


if __name__ == "__main__":
    main()
