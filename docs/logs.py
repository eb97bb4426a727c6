"""The coverage of docs/identify-logs.md: logs whose truth is known, and how often the bounds of the delay hold it.

python docs/logs.py                        all thousand, the tables written into the page; half an hour of a processor
python docs/logs.py --rows FILE.json       the same; what is done is kept in the file, and a second call goes on there
python docs/logs.py --share 0.05 --print   a twentieth of them, printed
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cosim.base.runtime.threads import one_thread

one_thread()

import click  # noqa: E402
import numpy as np  # noqa: E402

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "tools"))

from known_logs import Flaws, Log, Truth, closed_loops  # noqa: E402

from cosim.base.errors import InputError  # noqa: E402
from cosim.design.logged.identify_log import identify_log  # noqa: E402
from cosim.results.logs import Channel, FlightLog, LogSignals  # noqa: E402
from cosim.results.report.marks import table, write_marks  # noqa: E402

PAGE, MARK = ROOT / "docs" / "identify-logs.md", "coverage"
COLUMNS = (
    "logs", "number", "hold the truth (95 % interval of that share)", "median error", "within one sample", "refused",
)  # fmt: skip
SECONDS, LONGEST = 14.0, 0.3
CONFIDENCE = 0.95  # of the intervals of the shares
ENGINE = Truth(gain=46.03, rate=1.0 / 0.3286, lags=())
TWO = Truth(lags=(0.0299, 0.009))
DOUBLETS, STRONG, SWEEP = {"size": 0.5}, {"size": 1.5}, {"size": 0.5, "sweep": 0.006}
ALONE = {"size": 0.0, "sweep": 0.2, "loop": False}
SHORT_KNOWN = {"lags": 2, "hold": {"lag_2_s": 0.009}}


class Kind(NamedTuple):
    """Logs of one kind: truth, flaws, how many, how they are flown, and what the identification is told."""

    truth: Truth
    flaws: Flaws
    number: int
    flown: Mapping[str, Any]
    told: Mapping[str, Any] = {}


KINDS = {
    "two lags, sweep": Kind(TWO, Flaws(), 280, SWEEP),
    "one lag, sweep, wrong stamps": Kind(Truth(), Flaws(jitter=0.0, stamps=0.15, lost=0.0), 100, SWEEP),
    "engine, sweep, no loop": Kind(ENGINE, Flaws(gyro=0.05, turbulence=0.0), 100, ALONE),
    "one lag, doublets": Kind(Truth(), Flaws(), 170, DOUBLETS),
    "one lag, doublets three times as strong": Kind(Truth(), Flaws(), 100, STRONG),
    "two lags, doublets": Kind(TWO, Flaws(), 150, DOUBLETS),
    "two lags, doublets, the short lag stated": Kind(TWO, Flaws(), 100, DOUBLETS, SHORT_KNOWN),
}
Row = tuple[float, float, float]  # delay, bounds; less the truth, samples


def one(log: Log, kind: Kind) -> Row | None:
    """A log identified as the command does it; None where that refuses."""
    truth = kind.truth
    signals = {"u": log.command, "y": log.output, "r": log.setpoint}
    flight = FlightLog(Path("known"), "table", {name: Channel(log.times, each) for name, each in signals.items()})
    what = "roll" if truth.lags else "engine:1"
    try:
        found = identify_log(flight, what, LogSignals("u", "y", "r"), longest_delay=LONGEST, **kind.told)
    except InputError:
        return None
    delay, low, high = (value / truth.step - truth.delay_samples for value in (found.chosen.delay, *found.delay_bounds))
    return delay, low, high


def study(name: str, number: int, rows: list[Row | None], kept: Path | None = None) -> list[Row | None]:
    """So many logs of a kind, the same ones for the same number and fewer, ``rows`` of them done; kept by tens."""
    kind = KINDS[name]
    for batch in range(len(rows) // 10 * 10, number, 10):
        del rows[batch:]
        logs = closed_loops(10, SECONDS, seed=batch + 1, truth=kind.truth, flaws=kind.flaws, **kind.flown)
        rows += [one(log, kind) for log in logs[: number - batch]]
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
    error, low, high = got.T
    return (
        name,
        f"{len(rows)}",
        share((low <= 0.0) & (high >= 0.0)),
        f"{np.median(error):+.2f}",
        share(np.abs(error) <= 1.0),
        f"{len(rows) - len(got)}",
    )


@click.command()
@click.option("--share", "part", type=click.FloatRange(0.0, 1.0, min_open=True), default=1.0)
@click.option("--rows", "kept", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--write/--print", default=True)
def main(part: float, kept: Path | None, write: bool) -> None:
    """Identify them, or a share of them, and write the table into the page or print it."""
    every: list[Row | None] = []
    lines = []
    done = json.loads(kept.read_text(encoding="utf-8")) if kept and kept.exists() else {}
    for name, kind in KINDS.items():
        rows = study(name, max(1, round(part * kind.number)), [row and tuple(row) for row in done.get(name, [])], kept)
        every += rows
        lines.append(said(name, rows))
        click.echo(" | ".join(lines[-1]), err=True)
    lines.append(said("all", every))
    text = table(COLUMNS, lines)
    if write:
        write_marks(PAGE, {MARK: text})
    else:
        click.echo(text, nl=False)


if __name__ == "__main__":
    main()
