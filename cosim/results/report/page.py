"""Pages that open offline: a template, its figures or flights and the libraries that draw them, in one HTML file.

The only module that touches Plotly: its JavaScript, which goes into the page, and ``plotly``'s figure, for a notebook.
Whoever has something to show keeps its template, and extends ``base.html`` here.
"""

from __future__ import annotations

import base64
import json
import zlib
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.errors import FlightError, InputError
from cosim.base.files import one_line, replacing

TEMPLATES = Path(__file__).resolve().parent / "templates"
ASSETS = Path(__file__).resolve().parent / "assets"


class Flights(NamedTuple):
    """What strips and replay of a page draw: see ``signals_data``."""

    name: str  # of files that are saved from it
    runs: list[tuple[dict[str, Any], dict[str, str]]]
    figures: dict[str, Any]


def render(template: Path, path: Path, figures: dict[str, Any], flights: Flights | None = None, **values: Any) -> None:
    """Write the page of ``template``, a file beside others that it may include, with ``values``, ``figures`` (dicts
    of Plotly's schema) and ``flights``.  Raises FlightError if the file cannot be written.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader([template.parent, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template(template.name).render(
        figures={name: figure_json(figure) for name, figure in figures.items()},
        plotly_js=plotly_js() if figures else "",
        flights=flight_parts(flights) if flights is not None else None,
        **values,
    )
    try:
        with replacing(path) as temporary:
            temporary.write_text(page, encoding="utf-8")
    except OSError as error:
        raise FlightError(f"{path}: {one_line(error)}") from error


def plotly_js() -> str:
    """Plotly's library, as far as pages need it: figures with two axes."""
    return (ASSETS / "vendor" / "plotly-cartesian.min.js").read_text(encoding="utf-8")


def flight_parts(flights: Flights) -> dict[str, Any]:
    """What the page's script elements for ``flights`` hold; the library of three dimensions deflated, as the data."""
    told = {"name": flights.name, "runs": [said for said, _ in flights.runs], "figures": flights.figures}
    scripts = ("vendor/uPlot.iife.min.js", "strips.js", "replay.js")
    uplot, strips, replay = ((ASSETS / name).read_text(encoding="utf-8") for name in scripts)
    return {
        "told": figure_json(told),
        "data": [(f"data-{n}-{name}", text) for n, (_, data) in enumerate(flights.runs) for name, text in data.items()],
        "style": "".join(
            (ASSETS / name).read_text(encoding="utf-8") for name in ("vendor/uPlot.min.css", "strips.css")
        ),
        "scripts": [uplot, strips, replay],
        "three": deflated(ASSETS / "vendor" / "three.iife.min.js"),
    }


@cache
def deflated(path: Path) -> str:
    """A file of the package, deflated, as base64."""
    return base64.b64encode(zlib.compress(path.read_bytes(), 9)).decode()


def drawn(figure: dict[str, Any]) -> Any:
    """A figure as Plotly's own, which a notebook draws.  Raises InputError where Plotly is not installed."""
    try:
        from plotly.graph_objects import Figure
    except ImportError:
        raise InputError("a plot needs plotly, which is not installed: pip install 'hexjet-cosim[notebook]'") from None
    return Figure(figure)


def figure_json(figure: dict[str, Any]) -> str:
    """A figure as JSON that may stand in a script element; arrays in Plotly's base64 form, bit for bit."""
    text = json.dumps(figure, default=_array_json, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _array_json(value: Any) -> dict[str, str]:
    if not isinstance(value, np.ndarray):
        raise TypeError(f"{type(value).__name__} in a figure")
    codes = {np.dtype(np.float32): "f4", np.dtype(np.float64): "f8"}
    return {"dtype": codes[value.dtype], "bdata": base64.b64encode(value.tobytes()).decode()}
