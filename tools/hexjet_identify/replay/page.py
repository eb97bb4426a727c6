"""What a replay leaves in a folder: ``replay.json``, ``replay.csv`` and ``report.html``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from cosim.base.arrays import Array
from cosim.base.storage.files import write_files
from cosim.identify.page import judged_page
from cosim.pages import Card, Page
from cosim.results.report.plot import BLUE, GREY, HOVER, ORANGE, Figure, axis_name, beneath, panels, trace
from hexjet_identify.replay.replay import Replay
from hexjet_identify.replay.windows import CHANNELS

# Figures of three channels each, in the order of CHANNELS.
_TITLES: Final = {"rates": "Angular rates", "forces": "Specific force", "angles": "Angles"}
CHANNEL_COLUMNS: Final = (
    "channel", "time within", "error, rms", "movement, rms", "Theil's U", "bias / variance / covariance, %", "told",
)  # fmt: skip
BAND_COLUMNS: Final = (
    "channel", "Hz", "Theil's U", "coherence", "measured over modelled, dB", "deg",
)  # fmt: skip
OPEN_LOOP_TEXT: Final = (
    "Open loop, in windows of {:g} s: a vehicle that hovers is not stable without its controller, so the model is "
    "started anew from the recorded state at the beginning of each. The state at a window's start is fitted to it."
)
ENVELOPE_TEXT: Final = (
    "The envelope is that of {} draws and twice the noise; a channel is explained that is within it for 90 % of the "
    "time. Theil's U is 0 for equal and 1 for useless, about the mean measured in each window."
)
CAUSE_COLUMNS: Final = ("number", "stated", "explains best", "95 %", "removes of the misfit")
CAUSES_TEXT: Final = (
    "Each number alone, beside the start and the constant moment of the windows and the accelerometer's zero; cases "
    "as they are. What is named removes half of the misfit or more and leaves the rest in the envelope; what explains "
    "the flight about as well is named beside it. An inertia about an axis looks like the levers about it."
)
RATIO_TEXT: Final = (
    "A gain that is flat and not 0 dB is an inertia, a lever or a thrust; a phase that falls with frequency is a delay."
)


def write(result: Replay, folder: Path) -> dict[str, Path]:
    """Write page, JSON and CSV.  Raises FlightError if a file cannot be written."""
    paths = {name: folder / file for name, file in (("json", "replay.json"), ("csv", "replay.csv"))}
    text = json.dumps(result.to_dict(), indent=2, allow_nan=False) + "\n"
    write_files({paths["json"]: text, paths["csv"]: _make_csv(result)})
    paths["report"] = folder / "report.html"
    page(result).write(paths["report"])
    return paths


def page(result: Replay) -> Page:
    """Return the page of a replay."""
    drawn = figures(result)
    # The last column is empty where nothing is off.
    width = len(CAUSE_COLUMNS) - (not result.causes.is_off)
    causes = [row[:width] for row in cause_rows(result)]
    cards = [
        *(Card(f"{title}, measured and modelled", figure=name) for name, title in _TITLES.items() if name in drawn),
        Card("Measured over modelled, by frequency", text=RATIO_TEXT, figure="ratio"),
        Card("Channels", CHANNEL_COLUMNS, channel_rows(result), _describe_comparison(result)),
        Card("What each number would explain", CAUSE_COLUMNS[:width], causes, CAUSES_TEXT),
        *([Card("Bands", BAND_COLUMNS, bands)] if (bands := band_rows(result)) else []),
    ]
    shown = Page(
        "replay of a recorded flight",
        f"{result.aircraft} with {result.engine}, flown again with the commands of {result.log}",
        cards,
        drawn,
        problems=[result.fault] if result.fault else [],
        notes=result.notes,
        source=result.log,
    )
    return judged_page(result.judgement, shown)


def _describe_comparison(result: Replay) -> str:
    """Return how both were compared: how the model was driven, the envelope, what was drawn, moments and wind."""
    how = OPEN_LOOP_TEXT.format(result.window_s)
    x, y, z = result.moment_rms
    wind = result.wind
    blows = wind.reason or (
        f"{wind.velocity[0]:.1f}, {wind.velocity[1]:.1f} m/s north, east, within {wind.deviation or 0.0:.1f}"
    )
    return (
        f"{how} {ENVELOPE_TEXT.format(result.choices.draws)} Drawn: {'; '.join(result.tolerances)}. Each window has a "
        f"constant moment beside what the engines make, of {x:.2g}, {y:.2g}, {z:.2g} N m (rms) about x, y, z: of the "
        f"air, or of a centre of gravity or engines that are not where they are stated. Wind: {blows}."
    )


def cause_rows(result: Replay) -> list[tuple[str, ...]]:
    """Return the table: number or case, stated and best value, its bounds, and the share that it removes."""
    rows: list[tuple[str, ...]] = []
    for row in result.causes.tried:
        share = f"{100.0 * max(row.removed, 0.0):.0f} %" if result.causes.is_off else ""
        rows += [(part.name, *part.texts, share) for part in row.parts]
        if not row.parts:
            rows.append((row.name, "", "", "", share))
    return rows


def channel_rows(result: Replay) -> list[tuple[str, ...]]:
    """Return the channels as texts: name, time within, error, movement, Theil's U and its split, whether it is told."""
    return [
        (
            f"{c.name} [{c.unit}]",
            f"{100.0 * c.within:.1f} %",
            f"{c.rms:.3g}",
            f"{c.measured_rms:.3g}",
            f"{c.theil.u:.3f}",
            " / ".join(f"{100.0 * share:.0f}" for share in c.theil[1:]),
            "yes" if c.excited else "no more than its noise",
        )
        for c in result.channels
    ]


def band_rows(result: Replay) -> list[tuple[str, ...]]:
    """Return the bands in which a channel moves, as texts."""
    return [
        (
            c.name,
            f"{b.low_hz:.2g} to {b.high_hz:.2g}",
            f"{b.u:.3f}",
            f"{b.coherence:.2f}",
            "" if b.gain_db is None else f"{round(b.gain_db, 1) + 0.0:+.1f}",
            "" if b.phase_deg is None else f"{round(b.phase_deg) + 0:+d}",
        )
        for c in result.channels
        for b in c.bands
        if b.excited
    ]


def _make_csv(result: Replay) -> str:
    """Return the compared rows: time, window, and of each channel what was measured, modelled, and the envelope."""
    flying = result.flying
    rows = flying.rows
    columns: list[tuple[str, Array]] = [
        ("time_s", flying.flight.times[rows].ravel()),
        ("window", np.repeat(np.arange(len(rows)), rows.shape[1]).astype(float)),
    ]
    measured = flying.measured()
    for name, unit, c in _list_shown_channels(result):
        label = f"{name}_{unit.replace('/', '_').replace('^', '')}"
        for kind, values in (("", measured), ("_model", result.modelled), ("_low", result.low), ("_high", result.high)):
            columns.append((label + kind, values[:, :, c].ravel()))
    head = ",".join(name for name, _ in columns)
    table = np.stack([values for _, values in columns], axis=1)
    return "\n".join([head, *(",".join(f"{value:.9g}" for value in row) for row in table.tolist())]) + "\n"


def _list_shown_channels(result: Replay) -> list[tuple[str, str, int]]:
    present = {channel.name for channel in result.channels}
    return [(name, unit, c) for c, (name, unit) in enumerate(CHANNELS) if name in present]


def figures(result: Replay) -> dict[str, Figure]:
    """Return the page's figures: the signals of each kind, and measured over modelled by frequency."""
    kinds = {
        name: [entry for entry in _list_shown_channels(result) if entry[2] // 3 == n] for n, name in enumerate(_TITLES)
    }
    return {name: _draw_signals(result, shown) for name, shown in kinds.items() if shown} | {
        "ratio": _draw_ratio(result)
    }


def _break_between_windows(values: Array) -> Array:
    """Return windows (w, n) as one curve with a gap between windows."""
    return np.concatenate([values, np.full((len(values), 1), np.nan)], axis=1).ravel()


def _draw_signals(result: Replay, shown: Sequence[tuple[str, str, int]], max_points: int = 6000) -> Figure:
    """Return what was measured and modelled, each curve with ``max_points`` or up to twice as many."""
    flying = result.flying
    rows, measured = flying.rows, flying.measured()
    every = slice(None, None, max(1, rows.size // max_points))
    times = _break_between_windows(flying.flight.times[rows])[every]
    data = []
    for panel, (_, _, c) in enumerate(shown):
        curves: tuple[tuple[str, str, Array, dict[str, Any]], ...] = (
            ("envelope", GREY, result.low, {"line": {"color": GREY, "width": 1.0}}),
            ("envelope", GREY, result.high, {"line": {"color": GREY, "width": 1.0}, "showlegend": False}),
            ("measured", ORANGE, measured, beneath(ORANGE)),
            ("model", BLUE, result.modelled, {}),
        )
        data += [
            trace(label, colour, times, _break_between_windows(values[:, :, c])[every], panel, **how)
            for label, colour, values, how in curves
        ]
    titles = [f"{name} [{unit}]" for name, unit, _ in shown]
    return {"data": data, "layout": panels(220 * len(shown) + 60, "time of the log [s]", titles, log=False) | HOVER}


def _draw_ratio(result: Replay) -> Figure:
    """Return measured over modelled: gain, phase and coherence of the channels that move."""
    data = []
    colours = iter((ORANGE, BLUE, "#2f9e44", "#c2339b", "#e03131", "#7048e8", "#1098ad", "#a0522d", GREY))
    for channel in [c for c in result.channels if c.excited] or result.channels[:3]:
        name, ratio, colour = channel.name, channel.ratio, next(colours)
        use = (ratio.hertz > 0.0) & (ratio.hertz <= 0.4 / result.flying.flight.step) & ratio.excited
        value = ratio.value[use]
        gain = 20.0 * np.log10(np.maximum(np.abs(value), 1e-6))
        for panel, values in enumerate((gain, np.degrees(np.angle(value)), ratio.coherence[use])):
            data.append(trace(name, colour, ratio.hertz[use], values, panel, mode="lines+markers", marker={"size": 4}))
    layout = panels(560, "frequency [Hz]", ("gain [dB]", "phase [deg]", "coherence"), log=True) | HOVER
    layout[axis_name("yaxis", 2)]["range"] = [0.0, 1.05]
    return {"data": data, "layout": layout}
