"""The coverage of docs/identify-logs.md: logs whose truth is known, and how often the bounds hold it.

python docs/logs.py                        all of them, the tables written into the page; ten minutes of a processor
python docs/logs.py --rows FILE.json       the same; what is done is kept in the file, and a second call goes on there
python docs/logs.py --share 0.05 --print   a twentieth of them, printed
python docs/logs.py --only drawn           kinds with this word alone, and their tables alone
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from cosim.base.runtime.threads import one_thread

one_thread()

import click  # noqa: E402
import numpy as np  # noqa: E402

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "tools"))

from known_logs import Flaws, Log, Truth, closed_loops, drawn  # noqa: E402

from cosim.base.errors import InputError  # noqa: E402
from cosim.results.report.marks import table, write_marks  # noqa: E402
from hexjet_identify.logs import Channel, FlightLog, LogSignals  # noqa: E402
from hexjet_identify.prediction_error.estimate import Estimate  # noqa: E402
from hexjet_identify.prediction_error.identify_log import identify_log  # noqa: E402

PAGE, MARK, NUMBERS = ROOT / "docs" / "identify-logs.md", "coverage", "coverage-numbers"
COLUMNS = (
    "logs", "number", "hold the truth (95 % interval of that share)", "median error", "within one sample", "refused",
)  # fmt: skip
NUMBER_COLUMNS = ("logs", "gain", "lag", "delay", "delay and lags together", "median error of the gain", "refused")
SECONDS, LONGEST = 14.0, 0.3
SURE = 1.96  # standard deviations: 95 %
CONFIDENCE = 0.95  # of the intervals of the shares
ENGINE = Truth(gain=46.03, rate=1.0 / 0.3286, lags=())
TWO = Truth(lags=(0.0299, 0.009))
DOUBLETS, STRONG, SWEEP = {"size": 0.5}, {"size": 1.5}, {"size": 0.5, "sweep": 0.006}
ALONE = {"size": 0.0, "sweep": 0.2, "loop": False}
CALM = Flaws(gyro=0.01, turbulence=0.02, jitter=0.075, lost=0.01)
ROUGH = replace(CALM, turbulence=0.05)
EVERY = replace(ROUGH, jitter=0.0, lost=0.0)  # then the noise's model has terms of 4 ms, else of two samples
SHORT_KNOWN = {"lags": 2, "hold": {"lag_2_s": 0.009}}


class Kind(NamedTuple):
    """Logs of one kind: truth, flaws, how many, how they are flown, and what the identification is told."""

    truth: Truth | None  # None: each another one
    flaws: Flaws
    number: int
    flown: Mapping[str, Any]
    told: Mapping[str, Any] = {}


KINDS = {
    "drawn vehicles, strong doublets": Kind(None, CALM, 40, DOUBLETS),
    "drawn vehicles, strong doublets, rough air": Kind(None, ROUGH, 40, DOUBLETS),
    "drawn vehicles, strong doublets, rough air, every sample": Kind(None, EVERY, 20, DOUBLETS),
    "drawn vehicles, sweep": Kind(None, CALM, 20, SWEEP),
    "drawn vehicles, sweep, rough air": Kind(None, ROUGH, 20, SWEEP),
    "two lags, sweep": Kind(TWO, Flaws(), 10, SWEEP),
    "one lag, sweep, wrong stamps": Kind(Truth(), Flaws(jitter=0.0, stamps=0.15, lost=0.0), 10, SWEEP),
    "engine, sweep, no loop": Kind(ENGINE, Flaws(gyro=0.05, turbulence=0.0), 10, ALONE),
    "one lag, doublets": Kind(Truth(), Flaws(), 10, DOUBLETS),
    "one lag, doublets three times as strong": Kind(Truth(), Flaws(), 10, STRONG),
    "two lags, doublets": Kind(TWO, Flaws(), 10, DOUBLETS),
    "two lags, doublets, the short lag stated": Kind(TWO, Flaws(), 10, DOUBLETS, SHORT_KNOWN),
}
# delay, bounds; less the truth, samples; errors of gain, lag, and delay and lags together, in standard deviations; the
# gain's, as a share; the lag's is NaN where the form has another number of lags than the truth
Row = tuple[float, ...]


def one(log: Log, truth: Truth, kind: Kind) -> Row | None:
    """A log identified as the command does it; None where that refuses."""
    signals = {"u": log.command, "y": log.output, "r": log.setpoint}
    flight = FlightLog(Path("known"), "table", {name: Channel(log.times, each) for name, each in signals.items()})
    what = "roll" if truth.lags else "engine:1"
    try:
        found = identify_log(flight, what, LogSignals("u", "y", "r"), longest_delay=LONGEST, **kind.told)
    except InputError:
        return None
    delay, low, high = (value / truth.step - truth.delay_samples for value in (found.chosen.delay, *found.delay_bounds))
    return delay, low, high, *_errors(found.chosen, truth)


def _errors(chosen: Estimate, truth: Truth) -> tuple[float, float, float, float]:
    engine = chosen.form.engine
    gain = truth.gain / truth.rate if engine else truth.gain
    known = (1.0 / truth.rate, *truth.lags) if engine else truth.lags
    slowest = max(range(1, len(chosen.x) - 1), key=lambda i: float(chosen.x[i]), default=0)
    off = float(1.0 / chosen.x[0] if engine else chosen.x[slowest]) - max(known)
    deviation = chosen.deviation(0) / float(chosen.x[0]) ** 2 if engine else chosen.deviation(slowest)
    same = chosen.form.lags == len(truth.lags) and deviation > 0.0
    total, wide = chosen.all_delay
    late = truth.delay_samples * truth.step + sum(known)
    error = chosen.gain - gain
    lag = off / deviation if same else float("nan")
    return error / chosen.gain_deviation, lag, (total - late) / wide, error / gain


def study(name: str, number: int, rows: list[Row | None], kept: Path | None = None) -> list[Row | None]:
    """So many logs of a kind, the same ones for the same number and fewer, ``rows`` of them done; kept by tens."""
    kind = KINDS[name]
    for batch in range(len(rows) // 10 * 10, number, 10):
        del rows[batch:]
        flown, truths = dict(kind.flown), [kind.truth] * 10
        if kind.truth is None:
            truths, flown["p"], flown["attitude"] = drawn(10, batch + 1)
        logs = closed_loops(10, SECONDS, seed=batch + 1, truth=truths, flaws=kind.flaws, **flown)
        rows += [one(log, truth, kind) for log, truth in zip(logs[: number - batch], truths, strict=False)]
        if kept:
            done = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else {}
            kept.write_text(json.dumps(done | {name: rows}) + "\n", encoding="utf-8")
    return rows[:number]


def share(true: Sequence[bool]) -> str:
    """How many of these are true, with the interval of Clopper and Pearson of the share."""
    from scipy.stats import binomtest

    count = int(np.sum(true))
    low, high = binomtest(count, len(true)).proportion_ci(CONFIDENCE)
    return f"{count}: {100.0 * count / len(true):.1f} % ({100.0 * low:.1f} to {100.0 * high:.1f})"


def said(name: str, rows: Sequence[Row | None]) -> tuple[str, ...]:
    """A row of the table."""
    got = np.array([row for row in rows if row is not None])
    error, low, high = got.T[:3]
    return (
        name,
        f"{len(rows)}",
        share((low <= 0.0) & (high >= 0.0)),
        f"{np.median(error):+.2f}",
        share(np.abs(error) <= 1.0),
        f"{len(rows) - len(got)}",
    )


def numbers(name: str, rows: Sequence[Row | None]) -> tuple[str, ...]:
    """A row of the table of gain and lag."""
    got = np.array([row for row in rows if row is not None])
    _, low, high, gain, lag, late, off = got.T
    told = lag[np.isfinite(lag)]
    return (
        name,
        share(np.abs(gain) <= SURE),
        share(np.abs(told) <= SURE) if len(told) else "",
        share((low <= 0.0) & (high >= 0.0)),
        share(np.abs(late) <= SURE),
        f"{100.0 * np.median(np.abs(off)):.2g} %",
        f"{len(rows) - len(got)}",
    )


@click.command()
@click.option("--share", "part", type=click.FloatRange(0.0, 1.0, min_open=True), default=1.0)
@click.option("--rows", "kept", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--only", default="", metavar="WORD")
@click.option("--write/--print", default=True)
def main(part: float, kept: Path | None, only: str, write: bool) -> None:
    """Identify them, or a share of them, and write the tables into the page or print them."""
    every: list[Row | None] = []
    lines, further = [], []
    done = json.loads(kept.read_text(encoding="utf-8")) if kept and kept.exists() else {}
    for name, kind in KINDS.items():
        if only not in name:
            continue
        rows = study(name, max(1, round(part * kind.number)), [row and tuple(row) for row in done.get(name, [])], kept)
        every += rows
        lines.append(said(name, rows))
        further.append(numbers(name, rows))
        click.echo(" | ".join(further[-1]), err=True)
    lines.append(said("all", every))
    made = {NUMBERS: table(NUMBER_COLUMNS, further)} | ({} if only else {MARK: table(COLUMNS, lines)})
    if write:
        write_marks(PAGE, made)
    else:
        click.echo("\n".join(made.values()), nl=False)


if __name__ == "__main__":
    main()
