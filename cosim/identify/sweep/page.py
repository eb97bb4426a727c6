"""What an identification leaves in a folder, and the figure of its page.

In it: measured, fitted and stated, how far off, and the coherence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.storage.toml import toml_text
from cosim.identify.files import write_identification
from cosim.identify.page import WITH_BOUNDS, judged_page
from cosim.identify.sweep.result import Identification, equations, fit_rows, rate_response
from cosim.results.report.cards import Card, Page
from cosim.results.report.plot import BLUE, GREEN, GREY, HOVER, MAGENTA, ORANGE, Figure, axis_name, panels, trace

BOUNDS_NOTE = (  # note on the parameters' intervals
    "The first model is the one that is written, where one is. Its bounds are those of the linearised least squares, "
    "with what the form leaves over taken for independent errors: where the form does not fit, they say how well the "
    "number is pinned down, and not that the form is right."
)

_COLOURS = (BLUE, GREEN, MAGENTA)  # colours of the models
_DOMAINS = ((0.76, 1.0), (0.5, 0.73), (0.32, 0.47), (0.14, 0.29), (0.0, 0.11))  # vertical ranges of the panels
_TITLES = ("Magnitude [dB]", "Phase [deg]", "Off by [dB]", "Off by [deg]", "Coherence")  # titles of the panels


def write(identification: Identification, folder: Path) -> dict[str, Path]:
    """Write ``identification.json``, ``response.csv``, ``report.html`` and, for an axis, ``model.toml``.

    Where the fit is refused there is no ``model.toml``, and one that an earlier call left in the folder is removed.
    Raises InputError for somebody else's files of these names, FlightError if a file cannot be written.
    """
    is_axis, texts = identification.kind == "axis", {"response": _format_csv(identification)}
    if is_axis and not identification.refused:
        texts["model"] = toml_text(identification.model_table())
    removed = ("model.toml",) if is_axis and "model" not in texts else ()
    return write_identification(folder, identification.to_dict(), make_page(identification), texts, removed=removed)


def _format_csv(identification: Identification) -> str:
    response = identification.response
    columns: Mapping[str, Array] = {
        "frequency_hz": response.hertz,
        "magnitude_db": response.magnitude_db,
        "phase_deg": response.phase_deg,
        "coherence": response.coherence,
        "relative_spread": response.spread,
    }
    lines = [",".join(columns)]
    lines += [",".join(f"{value:.9g}" for value in row) for row in zip(*columns.values(), strict=True)]
    return "\n".join(lines) + "\n"


def make_page(identification: Identification) -> Page:
    sweep, is_axis = identification.sweep, identification.kind == "axis"
    columns = [WITH_BOUNDS, *(fit.label for fit in identification.fits)]
    equation = "" if identification.refused else "G(z) = " + "\n       ".join(equations(identification))
    unit = f"{identification.output_unit} per {identification.command_unit}"
    cards = [
        Card("Frequency response", text=f"{identification.channel}, in {unit}.", figure="response"),
        Card("Models", columns, fit_rows(identification), BOUNDS_NOTE, code=equation),
    ]
    swept = (
        f"Swept from {sweep.from_hz:.3g} to {sweep.to_hz:.3g} Hz in {sweep.duration_s:g} s, amplitude "
        f"{sweep.amplitude:.3g} {identification.command_unit}; "
        f"sampled every {1e3 * identification.response.step:g} ms."
    )
    page = Page(
        "identification by a sweep",
        f"{identification.subject}: {identification.channel}" + (f", engine {identification.engine}" * is_axis),
        cards,
        {"response": response_figure(identification)},
        summary=[swept],
        problems=[f"no model: {reason}" for reason in identification.refused],
        notes=identification.notes,
        source=identification.source,
    )
    return judged_page(identification.judgement, page)


def response_figure(identification: Identification, points: int = 300, coherence_row: int = 4) -> Figure:
    """Return the figure of measured and modelled responses over frequency, logarithmic."""
    response = identification.response
    hertz = np.geomspace(response.hertz[0], response.hertz[-1], points)
    data = _make_bode_traces("measured", ORANGE, "markers", response.hertz, response.magnitude_db, response.phase_deg)
    data.append(_make_trace("coherence", GREY, "lines+markers", response.hertz, response.coherence, coherence_row))
    for number, fit in enumerate(identification.fits):
        data += _model_curves(
            fit.label, _COLOURS[number % len(_COLOURS)], fit.model.response, hertz, identification, "solid"
        )
    if identification.reference is not None:
        data += _model_curves(
            "stated model", GREY, partial(rate_response, identification.reference), hertz, identification, "dash"
        )
    layout = panels(860, "frequency [Hz]", _TITLES, log=True, domains=_DOMAINS) | HOVER | {"hoversubplots": "axis"}
    layout["xaxis"]["hoverformat"] = ".3~g"
    layout[axis_name("yaxis", coherence_row)]["range"] = [0.0, 1.05]
    return {"data": data, "layout": layout}


def _model_curves(
    label: str, colour: str, model: Callable[[Array], Complex], hertz: Array, identification: Identification, dash: str
) -> list[Figure]:
    """Return traces of a model, its phase on the measured turn, and of model over measured."""
    value = model(hertz)
    phase = np.degrees(np.unwrap(np.angle(value)))
    turns = np.round((identification.response.phase_deg[0] - phase[0]) / 360.0)
    curves = _make_bode_traces(label, colour, "lines", hertz, 20.0 * np.log10(np.abs(value)), phase + 360.0 * turns)
    at = identification.response.hertz
    ratio = model(at) / identification.response.value
    curves.append(_make_trace(label, colour, "lines", at, 20.0 * np.log10(np.abs(ratio)), 2))
    curves.append(_make_trace(label, colour, "lines", at, np.degrees(np.angle(ratio)), 3))
    for curve in curves:
        curve["line"]["dash"] = dash
    return curves


def _make_bode_traces(label: str, colour: str, mode: str, hertz: Array, magnitude: Array, phase: Array) -> list[Figure]:
    return [_make_trace(label, colour, mode, hertz, magnitude, 0), _make_trace(label, colour, mode, hertz, phase, 1)]


def _make_trace(label: str, colour: str, mode: str, hertz: Array, values: Array, panel: int) -> Figure:
    says = f"{label}: %{{y:.4~g}}<extra></extra>"
    marker = {"size": 6, "color": colour}
    return trace(label, colour, hertz, values, panel, mode=mode, marker=marker, hovertemplate=says)
