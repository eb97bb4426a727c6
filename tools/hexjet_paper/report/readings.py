"""What the report and the pages say of the readings of section II-D, and of models that are off."""

from __future__ import annotations

from math import log
from typing import Literal, NamedTuple

from cosim.pages import table
from hexjet_paper import numbers
from hexjet_paper.claims import CLAIMS, ClaimRow, Evidence, claim_rows
from hexjet_paper.experiments import Metrics, hexjet_ratios
from hexjet_paper.readings import DELAY_ERRORS, GAIN_FACTORS, ModelError, ReadingResult, Trial

# Claims that depend on how the printed model is read.
DEPENDENT = ("hexjet-baseline", "hexjet-smith", "hexjet-overshoot", "hexjet-settling")


class Table(NamedTuple):
    """Head and rows of a table of texts."""

    head: tuple[str, ...]
    rows: list[tuple[str, ...]]

    def markdown(self, left: int = 9) -> str:
        """Return the table as Markdown with ``left`` left-aligned columns."""
        return table(self.head, self.rows, left=left)


def judge_reading(result: ReadingResult) -> list[ClaimRow]:
    """Judge the claims that depend on the reading, by its flights with raised and fitted gains."""

    def make_evidence(fidelity: Literal["linear", "flight"]) -> Evidence:
        metrics: dict[str, Metrics] = {}
        for name, gains in (("hexjet-doublet", "raised"), ("hexjet-doublet-calibrated", "fitted")):
            metrics |= {f"{name}.{c}": getattr(result.trial(gains, c), fidelity) for c in ("baseline", "smith")}
        return Evidence(metrics=metrics, margins={}, gain_at_low_end={}, gain_at_8_hz={})

    return claim_rows(
        make_evidence("linear"), make_evidence("flight"), [claim for claim in CLAIMS if claim.key in DEPENDENT]
    )


def readings_table(results: list[ReadingResult]) -> Table:
    """Return the table of the readings: vehicle that follows, doublets in flight, claims."""

    def make_row(name: str, cells: list[str]) -> tuple[str, ...]:
        return (name, *cells)

    def format_gains(name: str, result: ReadingResult) -> str:
        used = result.trial(name, "smith").gains
        return f"{used.p:.3g}, {used.attitude_gain_1_s:.3g} 1/s"

    rows = [
        make_row("engine", [r.engine for r in results]),
        make_row("thrust per unit throttle", [f"{r.thrust_n:.2f} N" for r in results]),
        make_row("roll gain, rad/s² per unit throttle", [f"{r.slope:.0f}" for r in results]),
        make_row("J_xx that follows", [f"{r.inertia_kg_m2:.4f} kg m²" for r in results]),
        make_row(
            "pole of the slowest lag", [f"{r.fast_pole:.4f}, {1e3 * _pole_lag(r.fast_pole):.0f} ms" for r in results]
        ),
    ]
    titles = (
        ("shipped", "gains of vehicle.toml"),
        ("fitted", "fitted gains"),
        ("raised", "raised gains"),
    )
    for name, title in titles:
        rows.append(make_row(f"{title}: rate, attitude", [format_gains(name, r) for r in results]))
        if name == "fitted":
            rows.append(make_row("doublet, each half", [f"{r.trial(name, 'smith').each_s:.0f} s" for r in results]))
        for controller in ("baseline", "smith"):
            cells = [_describe_outcome(r.trial(name, controller)) for r in results]
            rows.append(make_row(f"{'Smith' if controller == 'smith' else controller}, {title}", cells))
        if name == "fitted":
            cells = [", ".join(f"x {r.largest_gains[c]:.2f}" for c in ("baseline", "smith")) for r in results]
            rows.append(make_row("both gains may grow, linear: baseline, Smith", cells))
            rows += [
                make_row(f"{what} (paper {numbers.value(key):g} %)", [_format_ratio(r, key) for r in results])
                for what, key in (
                    ("less overshoot with Smith", "hexjet.less_overshoot"),
                    ("faster settling with Smith", "hexjet.faster_settling"),
                )
            ]
    judged = [judge_reading(result) for result in results]
    for n, claim in enumerate(judged[0]):
        rows.append(make_row(f"claim: {claim.claim}", [_list_verdicts(rows_of[n]) for rows_of in judged]))
    return Table(("", *(result.title for result in results)), rows)


def _pole_lag(pole: float) -> float:
    return -numbers.value("hexjet.step") / log(pole)


def _describe_outcome(trial: Trial) -> str:
    if trial.lost_s is not None:
        return f"lost at {trial.lost_s:.1f} s"
    m = trial.flight
    if not m.stable:
        return "does not settle, swings up"
    settles = "settles too late" if m.settling_s is None else f"settles in {m.settling_s:.1f} s"
    return f"{m.overshoot_percent or 0.0:.0f} % overshoot, {settles}"


def _format_ratio(result: ReadingResult, key: str) -> str:
    a, b = (result.trial("fitted", c) for c in ("baseline", "smith"))
    linear, flight = (
        hexjet_ratios(x.overshoot_percent, y.overshoot_percent, x.settling_s, y.settling_s)[key]
        for x, y in ((a.linear, b.linear), (a.flight, b.flight))
    )
    return f"{linear:.0f} % linear, {flight:.0f} % flown"


def _list_verdicts(row: ClaimRow) -> str:
    flight = row.flight.verdict if row.flight else "not flown"
    return row.linear.verdict if row.linear.verdict == flight else f"{row.linear.verdict}; in flight {flight}"


def model_error_table(errors: list[ModelError]) -> Table:
    """Return the table of overshoot and settling, over errors of the model's delay (down) and gain (across)."""
    cells = {(error.delay_error, error.gain_factor): error for error in errors}
    rows = [
        (
            f"{numbers.value('hexjet.delay') + delay:.0f} samples ({delay:+d})" if delay else "25 samples, as printed",
            *(_describe_model_error(cells[delay, factor]) for factor in GAIN_FACTORS if (delay, factor) in cells),
        )
        for delay in DELAY_ERRORS
        if (delay, GAIN_FACTORS[0]) in cells
    ]
    return Table(("delay of the model", *(f"gain x {factor:g}" for factor in GAIN_FACTORS)), rows)


def _describe_model_error(error: ModelError) -> str:
    if not error.stable or error.settling_s is None:
        return "does not settle"
    return f"{error.overshoot_percent or 0.0:.0f} %, {error.settling_s:.1f} s"


def model_errors_in_words(errors: list[ModelError]) -> str:
    """Return a sentence on Smith's predictor with wrong models."""
    off = [error for error in errors if error.delay_error or error.gain_factor != 1.0]
    good = [error for error in off if error.stable and error.settling_s is not None]
    text = (
        f"With the delay of the predictor's model off by {max(DELAY_ERRORS)} samples either way, its gain off by "
        f"{100.0 * (max(GAIN_FACTORS) - 1.0):.0f} % either way, and both, {len(good)} of {len(off)} flights settle at "
        "the same gains"
    )
    if not good:
        return f"{text}."
    overshoots = [error.overshoot_percent or 0.0 for error in good]
    times = [error.settling_s or 0.0 for error in good]
    return (
        f"{text}, with {min(overshoots):.0f} to {max(overshoots):.0f} % of overshoot and in {min(times):.1f} to "
        f"{max(times):.1f} s."
    )
