"""Pages that open offline: a template, its figures and the library that draws them, in one HTML file.

The only module that touches ``plotly``: its JavaScript, which goes into the page, and its figure, for a notebook.
Whoever has something to show keeps its template, and extends ``base.html`` here.
"""

from __future__ import annotations

import base64
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.errors import FlightError
from cosim.base.files import one_line, replacing

TEMPLATES = Path(__file__).resolve().parent / "templates"


def render(template: Path, path: Path, figures: dict[str, Any], **values: Any) -> None:
    """Write the page of ``template``, a file beside others that it may include, with ``values`` and ``figures`` (dicts
    of Plotly's schema).  Raises FlightError if the file cannot be written.
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
        plotly_js=(files("plotly") / "package_data" / "plotly.min.js").read_text(encoding="utf-8"),
        **values,
    )
    try:
        with replacing(path) as temporary:
            temporary.write_text(page, encoding="utf-8")
    except OSError as error:
        raise FlightError(f"{path}: {one_line(error)}") from error


def drawn(figure: dict[str, Any]) -> Any:
    """A figure as Plotly's own, which a notebook draws."""
    from plotly.graph_objects import Figure

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
