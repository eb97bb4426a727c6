"""Draws the rooms of the package and what imports what, from the imports: ``python docs/rooms.py``.

A room is a folder of ``cosim/``, or a file such as ``flight.py``; it stands one floor above the highest that it
imports.  An arrow that follows from others is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import grimp
import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).parents[1]
PICTURE = Path(__file__).parent / "pictures" / "rooms.png"
PURPOSES = {
    "base": "records, frames, files, errors",
    "spec": "what files say",
    "control": "the flight computer",
    "engine": "FMUs",
    "vehicle": "what flies",
    "simulation": "one flight, step by step",
    "results": "log, metrics, run, page",
    "flight": "fly(): a scenario to a run",
    "stepper": "a flight that a program steps",
    "identify": "from a sweep to a model",
    "groundstation": "MAVLink, local page",
    "aircraft_check": "a vehicle looked over",
    "campaign": "many flights",
    "shelf": "the folder of runs as a page",
    "api": "what from cosim import gives",
    "cli": "one file a command",
}
# Public modules, which only hand names on.
PUBLIC = {"blocks", "commands", "files", "gym", "laws", "logs", "loops", "pages", "studies"}
BLUE, GREY, INK = "#2a78d6", "#8a939b", "#1c2733"


def rooms() -> dict[str, set[str]]:
    """Return the packages that each package imports, anywhere in its text."""
    graph = grimp.build_graph("cosim")
    names = {module.split(".")[1] for module in graph.modules if "." in module} - PUBLIC
    found: dict[str, set[str]] = {name: set() for name in names}
    inner = {module for module in graph.modules if module.partition(".")[2].partition(".")[0] in names}
    for module in inner:
        for other in graph.find_modules_directly_imported_by(module) & inner:
            found[module.split(".")[1]].add(other.split(".")[1])
    return {name: others - {name} for name, others in found.items()}


def floors(imports: Mapping[str, set[str]]) -> dict[str, int]:
    """Return the floor of each package, the lowest 0.  Raises ValueError if packages import in a circle."""
    found: dict[str, int] = {}
    while len(found) < len(imports):
        ready = {name for name, others in imports.items() if name not in found and others <= found.keys()}
        if not ready:
            raise ValueError(f"a circle among {', '.join(sorted(imports.keys() - found.keys()))}")
        found |= {name: max((found[other] + 1 for other in imports[name]), default=0) for name in ready}
    return found


def needed(imports: Mapping[str, set[str]]) -> list[tuple[str, str]]:
    """Return the imports without those that follow from others."""

    def reach(name: str) -> set[str]:
        return set().union(*({other} | reach(other) for other in imports[name]))

    return sorted(
        (name, other)
        for name, others in imports.items()
        for other in others
        if not any(other in reach(between) for between in others - {other})
    )


def draw() -> None:
    """Draw the packages and their imports."""
    imports = rooms()
    level = floors(imports)
    rows: dict[int, list[str]] = {}
    for name in sorted(level):
        rows.setdefault(level[name], []).append(name)
    place = {
        name: (2.6 * (n - (len(row) - 1) / 2), 1.0 * floor) for floor, row in rows.items() for n, name in enumerate(row)
    }
    figure, axes = plt.subplots(figsize=(9, 0.95 * len(rows) + 0.6), constrained_layout=True)
    for name, other in needed(imports):
        (x, y), (u, v) = place[name], place[other]
        bend = 0.0 if v == y - 1 else 0.18 if x >= u else -0.18
        axes.annotate(
            "",
            (u, v + 0.29),
            (x, y - 0.29),
            arrowprops={"arrowstyle": "-|>", "color": GREY, "lw": 1.0, "connectionstyle": f"arc3,rad={bend}"},
            zorder=0,
        )
    for name, (x, y) in place.items():
        files = [path for path in _files(name) if path.name != "_messages.py"]
        lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files)
        axes.add_patch(
            FancyBboxPatch(
                (x - 1.1, y - 0.27), 2.2, 0.54, boxstyle="round,pad=0,rounding_size=0.06", fc="#f3f7fc", ec=BLUE
            )
        )
        axes.text(x, y + 0.09, name, ha="center", va="center", fontsize=10, color=INK, weight="bold")
        count = f"{len(files)} files" if len(files) > 1 else "1 file"
        axes.text(
            x,
            y - 0.12,
            f"{PURPOSES.get(name, '')}\n{count}, {lines:,} lines",
            ha="center",
            va="center",
            fontsize=6,
            color=INK,
        )
    wide = max(abs(x) for x, _ in place.values()) + 1.3
    axes.set(xlim=(-wide, wide), ylim=(-0.4, max(level.values()) + 0.4))
    axes.axis("off")
    figure.savefig(PICTURE, dpi=130, metadata={"Software": None})


def _files(room: str) -> list[Path]:
    folder = ROOT / "cosim" / room
    return sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]


if __name__ == "__main__":
    draw()
    print(PICTURE)
