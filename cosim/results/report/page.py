"""Pages that open offline: a template, its figures or flights and the libraries that draw them, in one HTML file.

Flights over time are drawn by ``assets/strips.js`` with uPlot; every other figure, a dict of the part of Plotly's
schema that ``assets/figures.js`` knows, by that as SVG.  ``plotly`` itself draws figures in notebooks alone.  A page is
a list of cards (:mod:`cosim.results.report.cards`); the flight's own has a template of its own.
"""

from __future__ import annotations

import base64
import json
import os
import sys
import zlib
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import one_line, write_whole

TEMPLATES = Path(__file__).resolve().parent / "templates"
ASSETS = Path(__file__).resolve().parent / "assets"
# Cache of compiled Jinja templates: compiling the flight's takes 0.15 s, more than the rest of its page.
TEMPLATE_CACHE = Path(__file__).resolve().parent / "__pycache__"
STYLES = ("vendor/uPlot.min.css", "strips.css")
SCENE = "scene.js"  # script of the 3D scene
SCRIPTS = ("vendor/uPlot.iife.min.js", "signals.js", "strips.js", "strip_files.js", "workbench.js", SCENE, "replay.js")
THREE = "vendor/three.iife.min.js"  # three.js, which draws the 3D scene
FIGURES = ("figure_axes.js", "figure_marks.js", "figures.js")  # scripts that draw figures
FIGURE_STYLE = "figures.css"  # style sheet of figures
# Licences of third-party scripts, by the file that a page embeds: each must go with every copy of it.
NOTICES = {"vendor/uPlot.iife.min.js": ("uPlot",), THREE: ("three",)}
SHARED_PREFIX = "assets-"  # of the folder that pages share


class Flights(NamedTuple):
    """Data that the strips and the replay of a page draw: see ``signals_data``."""

    name: str  # of files saved from the page
    runs: list[tuple[dict[str, Any], dict[str, str]]]
    figures: dict[str, Any]


def render(
    template: Path,
    path: Path,
    figures: dict[str, Any],
    flights: Flights | None = None,
    shared: Path | None = None,
    **values: Any,
) -> None:
    """Write the page of ``template`` with ``values``, ``figures`` and ``flights``.

    ``template`` may include files beside it, and ``figures`` are dicts of Plotly's schema.  Raises FlightError if the
    file cannot be written.

    ``shared``: the folder that gets what draws ``flights``, once for all pages; None: it is in the page.
    """
    from jinja2 import Environment, FileSystemBytecodeCache, FileSystemLoader, StrictUndefined

    is_kept = TEMPLATE_CACHE.is_dir() and os.access(TEMPLATE_CACHE, os.W_OK) and not sys.dont_write_bytecode
    environment = Environment(
        loader=FileSystemLoader([template.parent, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        bytecode_cache=FileSystemBytecodeCache(str(TEMPLATE_CACHE)) if is_kept else None,
    )
    page = environment.get_template(template.name).generate(
        figures={name: figure_json(figure) for name, figure in figures.items()},
        drawing=(_read_asset(FIGURE_STYLE), "".join(map(_read_asset, FIGURES))) if figures else None,
        notices=notices(*((*SCRIPTS, THREE) if flights is not None else ())),
        flights=flight_parts(flights, path, shared) if flights is not None else None,
        **values,
    )
    write_whole(path, page, FlightError)


def notices(*held: str) -> str:
    """Return the licences of third-party code on a page, as text of an HTML comment."""
    parts = [part for name in held for part in NOTICES.get(name, ())]
    texts = [f"{part}: {_read_asset(licence_file(part)).strip()}" for part in parts]
    text = "\n\n".join(["This page holds work of others, under these licences.", *texts])
    return text.replace("--", "- -") if texts else ""


def licence_file(part: str) -> str:
    """Return the path, among the assets, of the licence of a third-party part."""
    return f"vendor/{part}-LICENSE.txt"


def flight_parts(flights: Flights, path: Path, shared: Path | None) -> dict[str, Any]:
    """Return the contents of the page's script elements for ``flights``; three.js is deflated, as the data."""
    told = {"name": flights.name, "runs": [said for said, _ in flights.runs], "figures": flights.figures}
    data = [(f"data-{n}-{name}", text) for n, (_, data) in enumerate(flights.runs) for name, text in data.items()]
    thinned = [described["thinned"] for described, _ in flights.runs if described.get("thinned")]
    parts: dict[str, Any] = {"thinned": thinned, "told": figure_json(told), "data": data, "shared": None}
    if shared is not None:
        folder = shared_assets(shared)
        place = Path(os.path.relpath(folder, path.resolve().parent)).as_posix()
        styles, scripts = ([f"{place}/{Path(name).name}" for name in names] for names in (STYLES, SCRIPTS))
        links = {"place": place, "styles": styles, "scripts": scripts, "three": f"{place}/{Path(THREE).name}"}
        return parts | {"shared": links}
    style, *scripts = ("".join(map(_read_asset, names)) for names in (STYLES, *((name,) for name in SCRIPTS)))
    return parts | {"style": style, "scripts": scripts, "three": deflate(ASSETS / THREE)}


def shared_assets(folder: Path) -> Path:
    """Return the folder, named by a hash, of the files that pages in ``folder`` share; write missing ones.

    Raises FlightError if that is not possible.
    """
    licences = [licence_file(part) for name in (*SCRIPTS, THREE) for part in NOTICES.get(name, ())]
    held = {Path(name).name: (ASSETS / name).read_bytes() for name in (*STYLES, *SCRIPTS, THREE, *licences)}
    name = sha256(b"".join(key.encode() + value for key, value in held.items())).hexdigest()[:12]
    place = folder.resolve() / f"{SHARED_PREFIX}{name}"
    try:
        place.mkdir(parents=True, exist_ok=True)
        for key, value in held.items():
            if not (place / key).is_file():
                write_whole(place / key, value)
    except OSError as error:
        raise FlightError(f"{place}: {one_line(error)}") from error
    return place


def _read_asset(name: str) -> str:
    return (ASSETS / name).read_text(encoding="utf-8")


@cache
def deflate(path: Path) -> str:
    """Return a file of the package, deflated, as base64."""
    return base64.b64encode(zlib.compress(path.read_bytes(), 6)).decode()


def as_plotly(figure: dict[str, Any]) -> Any:
    """Return a figure as an object of Plotly, which a notebook draws.  Raises InputError where Plotly is missing."""
    try:
        from plotly.graph_objects import Figure
    except ImportError:
        raise InputError("a plot needs plotly, which is not installed: pip install plotly") from None
    return Figure(figure)


def figure_json(figure: dict[str, Any]) -> str:
    """Return a figure as JSON that may stand in a script element; arrays in Plotly's base64 form, bit for bit."""
    text = json.dumps(figure, default=_encode_array, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _encode_array(value: Any) -> dict[str, str]:
    if not isinstance(value, np.ndarray):
        raise TypeError(f"{type(value).__name__} in a figure")
    codes = {np.dtype(np.float32): "f4", np.dtype(np.float64): "f8"}
    return {"dtype": codes[value.dtype], "bdata": base64.b64encode(value.tobytes()).decode()}
