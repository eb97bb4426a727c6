"""Flies other people's autopilots, as programs that you name, and writes docs/autopilots.md and its data page.

    python docs/autopilots.py --px4 px4_sitl_default/bin/px4 --ardupilot build/sitl/bin/arducopter --betaflight
        [--px4-inside PROGRAM] [--betaflight-inside PROGRAM] [--ardupilot-inside PROGRAM] [--px4-campaign FOLDER]
        [--only TEXT] [--instance N] [--out runs/autopilots]

``--X-inside``: the same autopilot built with an exported predictor in the place of its rate loop.  Of an autopilot that
is not named, the table stays as it is.  What is in the folder is taken up and not flown again: after a change of the
program take another folder.  Each flight is flown a second time from its record, without the autopilot, and compared
bit for bit.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import degrees
from pathlib import Path
from shutil import rmtree
from statistics import median
from typing import Any

import numpy as np
from designed_and_flown import about_ends, agrees, as_measured, predict, still_doublet

from cosim import fly
from cosim.campaign import open_campaign
from cosim.cli.main import main as hexjet
from cosim.results.log.digest import log_digest
from cosim.results.report.marks import check_marks, table, write_marks
from cosim.results.run import open_run
from cosim.results.wording import metric
from hexjet_sitl.prepare import find_program

PAGE = Path(__file__).parent / "autopilots.md"
STOPPED = 128  # statuses above it are a signal's
NAMES = {"px4": "PX4", "ardupilot": "ArduPilot", "betaflight": "Betaflight"}
HOVER, ROLL, YAW, LAND, OUT = FLIGHTS = ("hover", "roll doublet", "yaw doublet", "climb and land", "flame-out")
OWN = dict(zip(FLIGHTS, ("hover", "roll-doublet", "yaw-doublet", "climb-and-land", "fault-flame-out"), strict=True))
DOUBLETS = {ROLL: "roll", YAW: "yaw"}
FULL_SCALE = {name: f"full-scale-{of}" for name, of in OWN.items() if name != OUT}
OCTOJET = {name: f"octojet-{OWN[name]}" for name in (HOVER, ROLL, LAND)}
# nothing holds the place in the modes that are flown by attitude, which the limit on drift does not know of
ALWAYS = ("--set", "limits.drift_m=false", "--set", "expect=[]")
# ArduPilot's main loop flies until a switch is raised, as its README with the exported files says
SWITCH = ("--param", "CC_TYPE=3", "--param", "CC_AXIS_MASK=7", "--param", "RC8_OPTION=109", "--channel", "8=2000@0.1")
STOCK, VEHICLE, DESIGNED, INSIDE = "stock", "vehicle", "designed", "smith, inside it"


@dataclass(frozen=True)
class Craft:
    """A vehicle with its engines, and what flies it."""

    name: str
    engines: str  # in words
    flights: Mapping[str, str]
    gains: Sequence[str] = (STOCK, VEHICLE, DESIGNED)
    options: Sequence[str] = ()  # of every flight and of the design

    @property
    def key(self) -> str:
        return f"{self.name}-{self.engines}".replace(" ", "-")


HEXJET = Craft("hexjet", "at once", OWN, options=("--engine", "edf"))
HEXJET_LATE = Craft("hexjet", "0.1 s late", OWN, options=("--engine", "edf-as-flown"))
QUADROTOR = Craft("quadrotor", "at once", OWN, options=("--engine", "motor"))
QUADROTOR_LATE = Craft(
    "quadrotor", "0.1 s late", OWN, options=("--engine", "motor", "--set", "engine_parameters.delay_samples=40")
)
COMPARED = ["autopilot", "vehicle", "engines", "axis", "design", "flown", "design, still", "flown, still", "agree"]
LATE = (STOCK, VEHICLE, DESIGNED, INSIDE)


def at_400_hz(craft: Craft) -> Craft:
    """The same at ArduCopter's own rate."""
    return replace(craft, options=(*craft.options, "--set", "step_s=0.0025"))


BIG = (VEHICLE, DESIGNED)
P220 = Craft("hexjet-p220", "p220", FULL_SCALE, BIG, ("--engine", "p220"))
HEXJET_100 = Craft("hexjet-100", "turbine-100", {name: OWN[name] for name in (HOVER, ROLL)}, BIG)
EIGHT = Craft("octojet", "turbine-100", OCTOJET, BIG)
CRAFTS: Mapping[str, Sequence[Craft]] = {
    "px4": (
        HEXJET,
        replace(HEXJET_LATE, gains=LATE),
        QUADROTOR,
        QUADROTOR_LATE,
        P220,
        HEXJET_100,
        EIGHT,
    ),
    "ardupilot": (
        HEXJET,
        replace(HEXJET_LATE, gains=(STOCK, VEHICLE, DESIGNED, INSIDE)),
        at_400_hz(QUADROTOR),
        at_400_hz(QUADROTOR_LATE),
        P220,
        HEXJET_100,
        EIGHT,
    ),
    "betaflight": (HEXJET, replace(HEXJET_LATE, gains=LATE)),
}


def run(arguments: Sequence[str]) -> None:
    """A command of hexjet, whatever comes of it.  Raises SystemExit for one that was interrupted."""
    try:
        hexjet(list(arguments))
    except SystemExit as end:
        if isinstance(end.code, int) and end.code > STOPPED:
            raise


def design_of(autopilot: str, craft: Craft, out: Path) -> Path:
    """Where the file of ``hexjet design --for`` an autopilot is; beside its page there is none where none was found."""
    return out / "designs" / f"{autopilot}-{craft.key}.toml"


def promises(autopilot: str, craft: Craft, there: Mapping[str, Path], out: Path) -> dict[str, str]:
    """What the design says of each doublet that was flown, by the flight."""
    file, said = design_of(autopilot, craft, out), {}
    for flight, axis in DOUBLETS.items():
        if flight in there and file.is_file():
            flown_run = open_run(there[flight])
            designed = as_measured(flown_run, axis, predict(autopilot, file, flown_run, axis))
            said[flight] = f" (design: {in_words(designed)})"
    return said


def still_flights(autopilot: str, program: str, given: argparse.Namespace) -> list[list[str]]:
    """Rows of doublets, designed and flown: as large as in the table, and still: longer, smaller, sensors at rest."""
    lines = []
    extra = () if autopilot == "betaflight" else ("--instance", str(given.instance))
    for craft in CRAFTS[autopilot]:
        file = design_of(autopilot, craft, given.out)
        for flight, axis in DOUBLETS.items():
            large = given.out / autopilot / f"{craft.key}-{DESIGNED}-{flight}".replace(" ", "-")
            if not (file.is_file() and (large / "summary.json").is_file()):
                continue
            folder = large.with_name(f"{large.name}-still")
            if not (folder / "summary.json").is_file():
                settling = tomllib.loads(file.read_text())["design"]["axes"][axis]["settling_s"]
                changed = still_doublet(open_run(large), axis, settling, autopilot == "ardupilot")
                flown(autopilot, program, ("--gains", str(file), *changed, *extra), craft, flight, folder)
            cells, both = [], []
            for each, measure in ((large, as_measured), (folder, about_ends)):
                of = open_run(each)
                designed, flew = (
                    measure(of, axis, angle)
                    for angle in (predict(autopilot, file, of, axis), np.asarray(of.log[f"{axis}_rad"]))
                )
                both.append(agrees(designed, flew))
                cells += [in_words(designed), in_words(flew)]
            said = {(True, True): "both", (False, True): "still", (True, False): "large"}.get(tuple(both), "none")
            lines.append([NAMES[autopilot], craft.name, craft.engines, axis, *cells, said])
    return lines


def in_words(of: tuple[float, float | None]) -> str:
    """Overshoot and settling in a cell."""
    overshoot, settling = of
    return f"{overshoot:.0f} %, " + ("not settled" if settling is None else f"{settling:.2f} s")


def found_none(file: Path) -> bool:
    """Whether a design was looked for, and no gains keep the requirements."""
    return file.with_suffix(".html").is_file() and not file.is_file()


def designed(autopilot: str, craft: Craft, out: Path) -> Path | None:
    """The file of the design, looked for if that was not done yet; None: no gains keep the requirements."""
    file = design_of(autopilot, craft, out)
    if not file.is_file() and not found_none(file):
        run(["design", "--for", autopilot, "--aircraft", craft.name, *craft.options, "--no-proof", "--out", str(file)])
    return file if file.is_file() else None


def gains_of(autopilot: str, gains: str, craft: Craft, out: Path) -> Sequence[str] | None:
    """Options that say what flies it; None: there is no such design."""
    if gains in (VEHICLE, INSIDE):
        return ("--gains", "vehicle", *(SWITCH if (autopilot, gains) == ("ardupilot", INSIDE) else ()))
    if gains == STOCK:
        return ("--gains", "stock")
    file = designed(autopilot, craft, out)
    return None if file is None else ("--gains", str(file))


def flown(autopilot: str, program: str, options: Sequence[str], craft: Craft, flight: str, folder: Path) -> None:
    """One flight into its folder, and whether its repetition without the autopilot is the same."""
    if folder.is_dir():  # of a call that was interrupted
        rmtree(folder)
    named = ["--binary", program] if program else []
    what = ["--aircraft", craft.name, "--scenario", craft.flights[flight], *craft.options]
    run(["sitl", autopilot, *named, *what, *ALWAYS, *options, "--out", str(folder)])
    if not (folder / "summary.json").is_file():
        return
    first, again = open_run(folder).log, fly(folder / "scenario.toml", report=False).log
    (folder / "repeated.json").write_text(json.dumps(log_digest(first) == log_digest(again)))


def cell(folder: Path, flight: str) -> str:
    """What came of a flight, in few words."""
    if not (folder / "summary.json").is_file():
        return "did not start"
    summary = open_run(folder).summary
    if summary.outcome in ("diverged", "crashed"):
        return f"lost at {summary.duration_s:.1f} s"
    if summary.outcome != "completed":
        return f"failed at {summary.duration_s:.1f} s"
    axes, flat = summary.metrics, summary.flat_metrics
    leans = max(degrees(axes[axis].max_abs_error_rad or 0.0) for axis in ("roll", "pitch"))
    if flight in (ROLL, YAW):
        axis = axes["roll" if flight == ROLL else "yaw"]
        settled = "not settled" if axis.settling_time_s is None else f"{axis.settling_time_s:.2f} s"
        swing = degrees(axis.oscillation_rad or 0.0)
        said = f"{axis.overshoot_percent or 0.0:.0f} %, {settled}" + (f", swings ±{swing:.1f}°" if swing >= 1.0 else "")
    elif flight == LAND:
        landed = summary.touchdown_m_s
        said = "did not land" if landed is None else f"{landed:.2f} m/s, drift {flat['position.drift_m'] or 0.0:.1f} m"
    else:
        height, yaw = flat["altitude.max_abs_error_m"] or 0.0, degrees(axes["yaw"].max_abs_error_rad or 0.0)
        drift = flat["position.drift_m"] or 0.0
        said = f"drift {drift:.1f} m, height {height:.2f} m, lean {leans:.1f}°, heading {yaw:.1f}°"
    beyond = [
        metric(name).label
        for name in summary.beyond
        if not (name.endswith("settling_time_s") and "not settled" in said)
    ]
    return said + (f"; beyond limits: {', '.join(beyond)}" if beyond else "")


def rows(
    autopilot: str, programs: Mapping[str, str | None], given: argparse.Namespace
) -> tuple[list[list[str]], list[Path]]:
    """The table's rows, flown as far as they are not there; and the folders of all flights."""
    lines: list[list[str]] = []
    folders: list[Path] = []
    for craft in CRAFTS[autopilot]:
        for gains in craft.gains:
            program = programs["inside" if gains == INSIDE else "plain"]
            if program is None:
                continue
            places = {
                flight: given.out / autopilot / f"{craft.key}-{gains}-{flight}".replace(" ", "-").replace(",", "")
                for flight in FLIGHTS
            }
            wanted = given.only is None or given.only in f"{craft.key}-{gains}"
            if wanted and (options := gains_of(autopilot, gains, craft, given.out)) is not None:
                extra = () if autopilot == "betaflight" else ("--instance", str(given.instance))
                for flight in craft.flights:
                    if not (places[flight] / "summary.json").is_file():
                        flown(autopilot, program, (*options, *extra), craft, flight, places[flight])
            there = {flight: folder for flight, folder in places.items() if folder.is_dir()}
            none = gains == DESIGNED and found_none(design_of(autopilot, craft, given.out))
            absent = dict.fromkeys(craft.flights, "no design") if none else {}
            if there or none:
                promised = promises(autopilot, craft, there, given.out) if gains == DESIGNED else {}
                cells = [
                    cell(there[flight], flight) + promised.get(flight, "")
                    if flight in there
                    else absent.get(flight, "")
                    for flight in FLIGHTS
                ]
                lines.append([craft.name, craft.engines, gains, *cells, pace(there.values())])
                folders += there.values()
    return lines, folders


def pace(folders: Iterable[Path]) -> str:
    """The median of how many times faster than real time flights went; nothing of those that did not start."""
    summaries = [json.loads(file.read_text()) for folder in folders if (file := folder / "summary.json").is_file()]
    return f"{median(summary['realtime_factor'] or 0.0 for summary in summaries):.0f}" if summaries else ""


def part(autopilot: str, lines: Sequence[Sequence[str]], folders: Sequence[Path]) -> str:
    """The table, and under it what flew, when, and whether it can be repeated."""
    records: list[Any] = [
        json.loads((folder / "lockstep.json").read_text()) for folder in folders if (folder / "lockstep.json").is_file()
    ]
    versions = sorted({record.get("version") or "version not known" for record in records})
    same = [
        json.loads((folder / "repeated.json").read_text()) for folder in folders if (folder / "repeated.json").is_file()
    ]
    day = max((datetime.fromtimestamp(folder.stat().st_mtime, UTC) for folder in folders), default=datetime.now(UTC))
    missing = sum(record["frames"] - record["boot"] - record["answers"] for record in records)
    text = table(["vehicle", "engines", "gains", *FLIGHTS, "× real time"], lines, left=8)
    return (
        f"{text}\n{NAMES[autopilot]} {', '.join(versions)}, {day:%d %B %Y}: {len(folders)} flights, "
        f"{sum(record['frames'] for record in records):,} states told, {missing} answers missing; flown again without "
        f"it, {sum(same)} of {len(same)} the same to the last bit.\n"
    )


def place_held(autopilot: str, program: str, out: Path, instance: int) -> str:
    """What an autopilot's own position control makes of a minute of hover."""
    quadrotor, late = CRAFTS[autopilot][2], CRAFTS[autopilot][1]
    said = []
    for craft, gains in ((quadrotor, VEHICLE), (late, DESIGNED)):
        folder = out / autopilot / f"hold-{craft.name}"
        if not (folder / "summary.json").is_file():
            options = gains_of(autopilot, gains, craft, out) or ()
            what = ("--aircraft", craft.name, *craft.options, "--hold", "2", "--set", "duration_s=62", *options)
            run(["sitl", autopilot, "--binary", program, *what, "--instance", str(instance), "--out", str(folder)])
        flat = open_run(folder).summary.flat_metrics
        away, height = flat["position.drift_m"] or 0.0, flat["altitude.max_abs_error_m"] or 0.0
        said.append(f"within {away:.2f} m of its start, and its height within {height:.2f} m")
    return (
        f"With `--hold 2` {NAMES[autopilot]} kept the quadrotor {said[0]}, for a minute; the Hex-Jet with engines "
        f"0.1 s late, by designed gains, {said[1]}.\n"
    )


def campaign_flown(folder: Path) -> str:
    """What a campaign of ``hexjet sweep`` over an autopilot came to, and at which pace."""
    campaign = open_campaign(folder)
    columns = campaign.columns
    count, name = len(columns["flight"]), columns["autopilot"][0]
    spent = [float(value) for value in columns["wall_s"]]
    told, missing = (sum(map(int, filter(None, columns[f"autopilot_{what}"]))) for what in ("frames", "missing"))
    pace = told * campaign.study.base().step_s / sum(spent)
    kept = f"{sum(columns['success'])} of {count} flights within the limits"
    day = datetime.fromtimestamp((folder / "study.toml").stat().st_mtime, UTC)
    return (
        f"{NAMES[name]}, {day:%d %B %Y}: {kept}, over {' and '.join(varied(columns))}; {told:,} states told, {missing} "
        f"answers missing. Each worker flew {pace:.1f} times as fast as real time, the time before the flight "
        "included, on a machine with other programs.\n"
    )


def varied(columns: Mapping[str, Sequence[Any]]) -> list[str]:
    """The keys that a campaign varies: they stand between a row's seed and its outcome."""
    names = list(columns)
    return [f"`{name}`" for name in names[names.index("seed") + 1 : names.index("outcome")]]


def log_at_home(inside: str, out: Path, instance: int) -> str:
    """What ``identify log`` and ``replay`` make of PX4's own log of a doublet, the predictor inside it."""
    folder, found, again = (out / "px4" / name for name in ("home", "home-identified", "home-replayed"))
    if not (folder / "summary.json").is_file():
        options = ("--scenario", "roll-doublet", "--set", "expect=[]", "--instance", str(instance))
        run(["sitl", "px4", "--binary", inside, *options, "--out", str(folder)])
    (log,) = folder.rglob("*.ulg")
    if not found.is_dir():
        run(["identify", "log", str(log), "--axis", "roll", "--from", "30", "--out", str(found)])
    if not again.is_dir():
        engine = ("--aircraft", "hexjet", "--engine", "edf-as-flown")
        run(["replay", str(log), *engine, "--from", "30.2", "--out", str(again)])
    summary = open_run(folder).summary
    flew = next(row.samples for row in summary.delay_ledger if row.element == "transport delay")
    told = json.loads((found / "identification.json").read_text())
    low, high = (1e3 * bound for bound in told["delay_bounds_95_s"])
    replayed = json.loads((again / "replay.json").read_text())
    within = next(each["within"] for each in replayed["channels"] if each["name"] == "rate_p")
    return (
        f"PX4's own log of the doublet tells a delay of {1e3 * told['delay_s']:.0f} ms ({low:.0f} to {high:.0f}); "
        f"{1e3 * summary.step_s * (flew or 0.0):.0f} ms flew. `hexjet replay` calls the flight {replayed['verdict']}, "
        f"{100.0 * within:.1f} % of its roll rate within what the model with its uncertainty has.\n"
    )


def main() -> None:
    """Fly what is named, and write its tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    for name in NAMES:
        parser.add_argument(f"--{name}", metavar="PROGRAM", nargs="?", const="")
        parser.add_argument(f"--{name}-inside", metavar="PROGRAM")
        parser.add_argument(f"--{name}-campaign", metavar="FOLDER", type=Path, help="of hexjet sweep, flown before")
    parser.add_argument("--only", metavar="TEXT", help="fly vehicles, engines and gains that have this in their name")
    parser.add_argument("--instance", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/autopilots"))
    given = parser.parse_args()
    named = [name for name in NAMES if getattr(given, name) is not None]
    check_marks(PAGE, [f"flown: {name}" for name in named])
    for name in named:
        stated = getattr(given, name)
        program = find_program(name, Path(stated) if stated else None)
        programs = {"plain": str(program or ""), "inside": getattr(given, f"{name}_inside")}
        lines, folders = rows(name, programs, given)
        parts = {f"flown: {name}": part(name, lines, folders)}
        parts[f"{name}: designed and flown"] = table(COMPARED, still_flights(name, programs["plain"], given), left=7)
        if name != "betaflight":
            parts[f"{name}: its place"] = place_held(name, programs["plain"], given.out, given.instance)
        if name == "px4" and programs["inside"]:
            parts["px4: its log"] = log_at_home(programs["inside"], given.out, given.instance)
        if (folder := getattr(given, f"{name}_campaign")) is not None:
            parts[f"{name}: its campaign"] = campaign_flown(folder)
        write_marks(PAGE, parts)


if __name__ == "__main__":
    main()
