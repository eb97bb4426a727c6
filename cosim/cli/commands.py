"""The commands of this package: each is a function, and what the command line adds to it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cosim.cli.console import echo, note, show_result
from cosim.cli.declare import Command

if TYPE_CHECKING:
    from cosim.api.identify import IdentifyResult


def _stem(path: str) -> str:
    """Return the last part of a name or a path, without file ending."""
    return Path(path).absolute().stem if path.endswith((".fmu", ".toml")) else Path(path).absolute().name


def _print_paths(paths: Iterable[Path] | Path) -> None:
    for path in (paths,) if isinstance(paths, Path) else paths:
        echo(str(path))


def _show_aircraft(path: Path) -> None:
    """Print a new aircraft's file and the next commands, and note that its models are copies."""
    from cosim.spec.vehicle import load_vehicle

    folder = path.parent if path.parent.is_absolute() else f"./{path.parent}"
    echo(f"{path}\nhexjet aircraft check {folder}\nhexjet fly hover --aircraft {folder}")
    vehicle = load_vehicle(str(folder))[0]
    if vehicle.identified:
        note(
            f"{vehicle.title}: its identified models are those of that aircraft: they hold until inertia, jets, "
            f"sensors or engine change; hexjet aircraft check {folder} compares them"
        )


def _show_project(folder: Path) -> None:
    """Print the next commands for a new project."""
    echo(f"{folder}\ncd {folder}\nhexjet fly flight.toml\nhexjet sweep study.toml\npython compare.py")


def _show_mapping(result: Any, verbose: bool) -> None:
    """Print a draft mapping's assigned and open ports, and the next command."""
    show_result(result, verbose)
    mapping = result.files["mapping"]
    echo(f"next: hexjet engine check {mapping}" if result.is_complete else f"next: state in {mapping} what is open")


def open_runs(folder: Path = Path("runs"), *, browser: bool = True) -> Path:
    """List the runs of a folder on a page, ``index.html`` in it, to search and to sort by any metric.

    Campaigns, searches and logs of other flight controllers (.ulg, .bin, .bbl, .bfl, .cfusdlog) are listed too.

    Parameters
    ----------
    folder : Path
        The folder of the runs.
    browser : bool
        Open the page, or only write it.
    """
    from cosim.shelf.index import write_index

    page = write_index(folder)
    if browser:
        import webbrowser

        webbrowser.open(page.resolve().as_uri())
    return page


def identify_axis(axis: Literal["roll", "pitch", "yaw"], **choices: Any) -> IdentifyResult:
    """Identify an axis in flight, torque command to measured rate.

    A chirp is added while the vehicle holds still; a pole, lags and a delay are fitted to the response.

    Parameters
    ----------
    axis : str
        About which it turns.
    """
    from cosim.api.identify import identify

    return identify(axis, **choices)


aircraft_check = Command(
    "aircraft check",
    "cosim.api.checks:check_aircraft",
    "./mine",
    options={"engine": "--engine"},
    folder=lambda arguments: f"check-{_stem(arguments['aircraft'])}",
    succeeded=lambda result: result.is_fit,
    ends="Status 1: something is not as it must be.",
)
aircraft_new = Command(
    "aircraft new",
    "cosim.spec.new_aircraft:new_aircraft",
    "mine",
    options={"base": "--from"},
    metavars={"name": "NAME", "base": "NAME"},
    runs_code=False,
    show=_show_aircraft,
    data=None,
)
compare = Command(
    "compare",
    "cosim.api.compare:compare",
    "runs/roll-doublet-smith-001 runs/roll-doublet-baseline-001",
    metavars={"flights": "FLIGHT", "flight": "N", "signal": "PATTERN", "shift": "LETTER=SECONDS",
              "out": "DIR|FILE.html"},
    writes=(".html",),
    folder=lambda arguments: "comparison" if arguments["page"] else None,
    notes="warning",
    ends="What is flown runs code; what was flown is only looked at.  Status 0, whatever differs; 2: wrong input.",
)  # fmt: skip
export = Command(
    "export",
    "cosim.api.export:export",
    "runs/roll-doublet-smith-001 --to mcap --out flight.mcap",
    options={"to": "--to"},
    metavars={"run": "DIR", "to": "FORMAT", "out": "FILE|DIR"},
    writes=(".csv", ".mat", ".mcap", ".parquet", ".ulg", ".ulog"),
    runs_code=False,
    show=_print_paths,
    data=None,
)
fly = Command(
    "fly",
    "cosim.cli.calls.fly:fly",
    "roll-doublet --controller baseline --set vehicle.mass_kg=6.0",
    like="cosim.api.flights:fly",
    hidden=("report",),
    options={"realtime_factor": "--rtf"},
    metavars={"engine": "[N=]NAME|FILE", "mavlink": "URL", "flightgear": "[HOST:]PORT", "model": "FILE.toml"},
    succeeded=lambda result: result.repeated.same if hasattr(result, "repeated") else result.run.summary.succeeded,
    notes="warning",
    ends="Status 0: as planned; or completed within its limits, nothing checked, where the scenario expects nothing of "
    "what flew; or with --flight the same as in the campaign, bit for bit.  1: the flight failed, went beyond its "
    "limits or did not come to what the scenario expects or requires, or is not the same.  2: wrong input.",
)
engine_build = Command(
    "engine build", "cosim.engine.source:build_engines", "turbojet", runs_code=False, show=_print_paths, data=None
)
engine_check = Command(
    "engine check",
    "cosim.cli.calls.engine:check",
    "their.fmu --step 0.004",
    like="cosim.api.checks:check_engine",
    folder=lambda arguments: f"check-{_stem(arguments['engine'])}",
    succeeded=lambda result: result.is_fit,
    ends="Status 0: fit; 1: unfit; 2: not usable.",
)
engine_identify = Command(
    "engine identify",
    "cosim.api.identify:identify",
    "turbojet --set delay_samples=40",
    given={"subject": "engine"},
    hidden=("aircraft", "controller", "substeps", "seed"),
    metavars={"hold": "NAME=VALUE", "settings": "PARAMETER=VALUE"},
    folder=lambda arguments: f"identify-{_stem(arguments['engine'])}",
    succeeded=lambda result: result.found,
)
engine_map = Command(
    "engine map",
    "cosim.api.checks:map_engine",
    "their.fmu --out mine.toml",
    metavars={"fmu": "FILE.fmu", "out": "FILE.toml|DIR"},
    writes=(".toml",),
    succeeded=lambda result: result.is_complete,
    runs_code=False,
    show=_show_mapping,
    ends="Status 1: something is open that an engine needs.",
)
gcs = Command(
    "gcs",
    "cosim.cli.calls.gcs:gcs",
    "--engine edf-as-flown --place 22.35,113.59 --web",
    like="cosim.api.flights:fly",
    hidden=("flightgear", "report", "shared_assets"),
    options={"scenario": "--scenario", "realtime_factor": "--rtf", "parameters": "--parameters --params",
             "log_limit_mb": "--log-limit"},
    metavars={"engine": "[N=]NAME|FILE", "place": "LAT,LON", "mavlink": "URL", "sign_key": "FILE", "web": "[PORT]",
              "parameters": "FILE.toml", "model": "FILE.toml"},
    bare={"web": "8765"},
    ends="Status, of the last flight: 0 completed within its limits; 1 it failed or went beyond them; 2 wrong input.",
    succeeded=lambda result: result.runs[-1].summary.succeeded,
    show=lambda result: None,  # the command prints while it runs
)  # fmt: skip
identify = Command(
    "identify",
    "cosim.cli.commands:identify_axis",
    "roll --engine edf --out roll-model",
    like="cosim.api.identify:identify",
    options={"engine": "--engine"},
    hidden=("subject", "throttle", "step_s"),
    metavars={"hold": "NAME=VALUE"},
    folder=lambda arguments: f"identify-{arguments['axis']}",
    succeeded=lambda result: result.found,
)
new = Command(
    "new", "cosim.spec.new_project:new_project", "mine", metavars={"name": "NAME", "out": "DIR"}, runs_code=False,
    show=_show_project, data=None,
)  # fmt: skip
open = Command(
    "open", "cosim.cli.commands:open_runs", "runs", metavars={"folder": "DIR"}, runs_code=False, show=_print_paths,
    data=None,
)  # fmt: skip
sweep = Command(
    "sweep",
    "cosim.cli.calls.studies:sweep",
    "roll-doublet --vary vehicle.mass_kg=5:6.5 --runs 100",
    like="cosim.api.studies:sweep",
    options={"design": "--sampling --design"},
    metavars={"name": "SCENARIO|STUDY|DIR", "vary": "KEY=...", "correlate": "KEY,KEY=R", "success": "METRIC<=X|FORMULA",
              "until": "P%@C%", "cluster": "ADDRESS|local", "keys": "[PATTERN]"},
    bare={"keys": "*"},
    ends="Leaves one Parquet data set with a row a flight, and a page.  Status 0: all are flown, whatever became of "
    "them; 1: it was stopped before; 2: wrong input.",
)  # fmt: skip
show = Command(
    "show",
    "cosim.cli.calls.show:show",
    "hexjet-p220",
    like="cosim.api.show:show",
    options={"kind": "--kind"},
    runs_code=False,
    data=lambda result: result.to_list() if hasattr(result, "to_list") else result.to_dict(),
)
