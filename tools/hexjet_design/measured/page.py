"""What measured margins leave in a folder: numbers, curves and a page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import isfinite
from pathlib import Path

import numpy as np

from cosim.base.storage.files import write_files
from cosim.engine.fmu.uncertainty import ParameterRange
from cosim.pages import BLUE, GREY, ORANGE, Card, Page, beneath, marked, panels, sentence, trace
from hexjet_design.figures import Curve, Figure, bode, nyquist
from hexjet_design.measured.axis_margins import AxisMargins
from hexjet_design.measured.engine_range import EngineRange
from hexjet_design.measured.judgement import COLUMNS as JUDGED_COLUMNS
from hexjet_design.measured.judgement import judgement_line
from hexjet_design.measured.margins import MeasuredMargins

METHOD_NOTE = (  # note on the method
    "The loop is broken between the controller and its actuators, all other loops closed, while the vehicle holds "
    "still and burns no fuel. Off: measured less computed, of gains that of their factors. Bounds: 95 %, from the "
    "periods' spread."
)
COLUMNS = ("quantity", "measured", "95 % bounds", "computed", "off")  # heads of the table of margins
RANGE_LABEL = "over the engine's uncertainty, 95 %"  # label of the uncertain range
ENGINE_COLUMNS = ("parameter", "nominal", "95 % range", "deviation between engines")  # heads of the table of parameters
QUANTITIES = (  # quantity, its name, its format
    ("gain_db", "gain up", "{:+.2f} dB"),
    ("gain_down_db", "gain down", "{:+.2f} dB"),
    ("phase_deg", "phase, lag", "{:.1f} deg"),
    ("phase_lead_deg", "phase, lead", "{:.1f} deg"),
    ("delay_s", "delay, more", "{:.4f} s"),
    ("delay_less_s", "delay, less", "{:.4f} s"),
    ("peak_sensitivity", "peak |S|", "{:.3f}"),
    ("crossover_hz", "crossover", "{:.3f} Hz"),
)


def columns(measured: AxisMargins) -> tuple[str, ...]:
    """Return the headings of an axis's table: :data:`COLUMNS`, and the engine's range if known."""
    return COLUMNS if measured.over_engine is None else (*COLUMNS, RANGE_LABEL)


def rows(measured: AxisMargins) -> list[list[str]]:
    """Return the rows of an axis's table, a measured quantity each, under the headings of :func:`columns`."""
    lines = []
    for name, title, form in QUANTITIES:
        estimate = measured.response.margins.get(name)
        computed = None if measured.computed is None else getattr(measured.computed.margins, name)
        value, bounds = _explain_missing(name, measured), ""
        if estimate is not None:
            value = form.format(estimate.value)
            low, high = form.split(" ")[0].format(estimate.low), form.format(estimate.high)
            bounds = f"{low} to {high}" if isfinite(estimate.low) else "-"
        difference = measured.off(name)
        off = "" if difference is None else f"{100.0 * difference:+.1f} %"
        other = "none" if computed is None else form.format(computed)
        line = [title, value, bounds, "-" if measured.computed is None else other, off]
        lines.append(line if measured.over_engine is None else [*line, _format_range(name, form, measured.over_engine)])
    return lines


def judged_rows(margins: MeasuredMargins) -> list[list[str]]:
    """Return a table row for each margin beside its limit, under the headings :data:`JUDGED_COLUMNS`."""
    return [row.cells() for row in margins.judged]


def answer(measured: AxisMargins) -> str:
    """Return the measured margins of an axis in one sentence."""
    found = measured.response.margins
    parts = [f"{title} {form.format(found[name].value)}" for name, title, form in QUANTITIES if name in found]
    return f"{measured.axis.capitalize()}: {', '.join(parts) or 'no margin in the frequencies that were measured'}."


def _format_range(name: str, form: str, over: EngineRange) -> str:
    if name not in over.ranges:
        return ""
    ends = [form.split(" ")[0].format(end) if isfinite(end) else "none" for end in over.ranges[name]]
    return " to ".join(dict.fromkeys(ends))


def engine_rows(ranges: Sequence[ParameterRange]) -> list[list[str]]:
    """Return a table row for each uncertain parameter of an engine, under the headings :data:`ENGINE_COLUMNS`."""
    return [
        [row.name, f"{row.nominal:.4g}", f"{row.low:.4g} to {row.high:.4g}", f"{row.spread:.3g}" if row.spread else ""]
        for row in ranges
    ]


def _explain_missing(name: str, measured: AxisMargins) -> str:
    """Say that a margin does not exist, and in which band."""
    if name in ("phase_lead_deg", "delay_less_s") and "crossover_hz" in measured.response.margins:
        return "none"
    least, most = measured.band_hz
    low, high = f"{least:.3g} Hz", f"{most:.4g} Hz"
    if name == "gain_db":
        return "none" if measured.is_complete else f"none up to {high}"
    return f"none from {low} on" if name == "gain_down_db" or measured.is_complete else f"none from {low} to {high}"


def heading(measured: AxisMargins) -> str:
    """Describe the excitation of an axis: band, lines, periods, peak and highest measured frequency."""
    sine = measured.sine
    band = f"{measured.axis.capitalize()}: {sine.hertz[0]:.3g} to {sine.hertz[-1]:.3g} Hz"
    heard = measured.band_hz[1]
    why = "noise hides all" if heard < sine.hertz[-1] else "nothing was measured"
    above = "" if measured.is_complete else f"; above {heard:.4g} Hz {why}"
    return (
        f"{band}, {len(sine.bins)} lines, {measured.periods} "
        f"periods of {sine.period * sine.step:g} s, peak {measured.amplitude:g} {measured.unit}{above}"
    )


def uncertainty_line(measured: AxisMargins) -> str | None:
    """Describe how well the engine is known, and margins in multiples of that; None if not stated."""
    if measured.uncertainty is None:
        return None
    gain, delay_s = measured.uncertainty
    margins = zip(
        (f"gain {100.0 * gain:.3g} %", f"delay {1e3 * delay_s:.3g} ms"), measured.in_deviations(), strict=True
    )
    parts = [text if count is None else f"{text}, the margin is {count:.3g} times that" for text, count in margins]
    line = f"engine, one standard deviation at the crossover: {'; '.join(parts)}"
    over = measured.over_engine
    lost = "" if over is None or not over.unstable else f"; {over.unstable} of {over.draws} drawn engines lose the loop"
    return line + lost


def limit_line(measured: AxisMargins) -> str | None:
    """Compare the computed loop with the limit of performance, or say why not; None if not requested."""
    limit = measured.limit
    if limit is None:
        return None
    return f"no limit of performance: {limit}" if isinstance(limit, str) else f"{measured.axis}: {limit.describe()}"


def write(margins: MeasuredMargins, folder: Path) -> dict[str, Path]:
    """Write ``margins.json``, ``response.csv`` and ``report.html``.  Raises FlightError if a file cannot be written."""
    paths = {"json": folder / "margins.json", "response": folder / "response.csv", "report": folder / "report.html"}
    data = json.dumps(margins.to_dict(), indent=2, allow_nan=False) + "\n"
    write_files({paths["json"]: data, paths["response"]: _make_csv(margins)})
    make_page(margins).write(paths["report"])
    return paths


def make_page(margins: MeasuredMargins) -> Page:
    """Return the page of measured margins: the first loop, all beside their limits, then the rest by axis."""
    scenario, cards = margins.scenario, list[Card]()
    for axis, measured in margins.axes.items():
        name = axis.capitalize()
        more = [sentence(line) for line in (uncertainty_line(measured), limit_line(measured)) if line]
        cards += [
            Card(f"{name}: open loop", figure=f"bode_{axis}", is_half=True),
            Card(f"{name}: Nyquist", figure=f"nyquist_{axis}", is_half=True),
            Card(f"{name}: sensitivity", figure=f"peak_{axis}"),
            Card(heading(measured), columns(measured), rows(measured), " ".join(more),
                 lines=[marked(note, "unmet") for note in measured.notes]),
        ]  # fmt: skip
    cards.insert(2, Card("Beside their limits", JUDGED_COLUMNS, judged_rows(margins)))
    cards += [Card("How well the engine is known", ENGINE_COLUMNS, engine_rows(margins.engine_ranges))]
    summary = [f"Not computed: {margins.uncomputed}."] if margins.uncomputed else []
    if margins.uncertainty_source is not None:
        summary += [f"Uncertainty of the engine: {margins.uncertainty_source or 'of no stated source'}."]
    if source := margins.source:
        summary += [f"{source.level} of {source.label}, sha256 {source.sha256}"]
    return Page(
        "margins measured in flight",
        f"{margins.controller_shown} on {scenario.aircraft}, engine {scenario.engine}",
        cards if margins.engine_ranges else cards[:-1],
        figures(margins),
        answer=[*map(answer, margins.axes.values()), sentence(judgement_line(margins.judged))],
        summary=summary,
        source=METHOD_NOTE,
    )


def figures(margins: MeasuredMargins) -> dict[str, Figure]:
    """Return the figures of the page by their names, three an axis."""
    drawn: dict[str, Figure] = {}
    for axis, measured in margins.axes.items():
        drawn |= {
            f"bode_{axis}": _bode_figure(measured),
            f"nyquist_{axis}": nyquist(_curves(measured), measured.response.margins["peak_sensitivity"].value, 560),
            f"peak_{axis}": _sensitivity_figure(measured),
        }
    return drawn


def _make_csv(margins: MeasuredMargins) -> str:
    lines = [
        "axis,frequency_hz,loop_real,loop_imaginary,sensitivity_real,sensitivity_imaginary,sensitivity_spread,coherence"
    ]
    for axis, measured in margins.axes.items():
        r = measured.response
        columns = (r.hertz, r.loop.real, r.loop.imag, r.sensitivity.real, r.sensitivity.imag, r.spread, r.coherence)
        lines += [f"{axis}," + ",".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True)]
    return "\n".join(lines) + "\n"


def _curves(measured: AxisMargins) -> list[Curve]:
    """Return the computed and the measured curve."""
    curves = []
    hertz = measured.sine.hertz
    if measured.computed is not None:
        inside = (measured.computed.hertz >= hertz[0]) & (measured.computed.hertz <= hertz[-1])
        near, loop = measured.computed.hertz[inside], measured.computed.loop[inside]
        curves.append(Curve("computed", ORANGE, near, loop, beneath(ORANGE)))
    dots = {"mode": "markers", "marker": {"size": 5, "color": BLUE}}
    return [*curves, Curve("measured", BLUE, hertz, measured.response.loop, dots)]


def _bode_figure(measured: AxisMargins) -> Figure:
    figure = bode(_curves(measured), 560, ["coherence"])
    coherence = trace("coherence", GREY, measured.sine.hertz, measured.response.coherence, 2)
    figure["data"].append(coherence | {"showlegend": True})
    figure["layout"]["yaxis3"]["range"] = [0.0, 1.05]
    return figure


def _sensitivity_figure(measured: AxisMargins) -> Figure:
    from scipy.special import stdtrit

    data: list[Figure] = []
    for label, colour, hertz, loop, style in _curves(measured):
        more = dict(style)
        if label == "measured":
            wide = stdtrit(measured.periods - 1, 0.975) * measured.response.spread
            more["error_y"] = {"type": "data", "array": wide, "thickness": 1, "width": 0}
        data.append(trace(label, colour, hertz, np.abs(1.0 / (1.0 + loop)), **more))
    return {"data": data, "layout": panels(320, "frequency [Hz]", ["|S|, with 95 % bounds"], True)}
