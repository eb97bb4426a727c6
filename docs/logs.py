"""The coverage of docs/identify-logs.md: logs whose truth is known, and how often the bounds of the delay hold it.

python docs/logs.py                all of them, the table written into the page; some 15 min of a processor
python docs/logs.py --share 0.05   a twentieth of them, printed
"""

from __future__ import annotations

import sys
from pathlib import Path

from cosim.base.threads import one_thread

one_thread()

import click  # noqa: E402
import numpy as np  # noqa: E402

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "tools"))

from known_logs import Flaws, Truth, closed_loops  # noqa: E402

from cosim.base.errors import InputError  # noqa: E402
from cosim.design.logged.identify_log import identify_log  # noqa: E402
from cosim.results.logs import Channel, FlightLog, Wanted  # noqa: E402
from cosim.results.report.marks import table, write_marks  # noqa: E402

PAGE, MARK = ROOT / "docs" / "identify-logs.md", "coverage"
COLUMNS = (
    "logs", "number", "hold the truth", "if the form is right", "median width", "median error", "within one sample",
    "refused",
)  # fmt: skip
SECONDS, LONGEST = 14.0, 0.3
ENGINE = Truth(gain=46.03, rate=1.0 / 0.3286, lags=())
TWO = Truth(lags=(0.0299, 0.009))
DOUBLETS, SWEEP = {"size": 0.5}, {"size": 0.5, "sweep": 0.006}
KINDS = {  # truth, flaws, number, and what else closed_loops is told
    "two lags, sweep": (TWO, Flaws(), 350, SWEEP),
    "one lag, doublets": (Truth(), Flaws(), 250, DOUBLETS),
    "two lags, doublets": (TWO, Flaws(), 200, DOUBLETS),
    "one lag, sweep, wrong stamps": (Truth(), Flaws(jitter=0.0, stamps=0.15, lost=0.0), 100, SWEEP),
    "engine, sweep, no loop": (
        ENGINE,
        Flaws(gyro=0.05, turbulence=0.0),
        100,
        {"size": 0.0, "sweep": 0.2, "loop": False},
    ),
}
Row = tuple[float, float, float, float, float]  # delay, bounds, bounds if the form is right; less the truth, samples


def one(log, truth: Truth, engine: bool) -> Row | None:
    """A log identified as the command does it; None where that refuses."""
    signals = {"u": log.command, "y": log.output, "r": log.setpoint}
    flight = FlightLog(Path("known"), "table", {name: Channel(log.times, each) for name, each in signals.items()})
    try:
        found = identify_log(flight, "engine:1" if engine else "roll", Wanted("u", "y", "r"), longest_delay=LONGEST)
    except InputError:
        return None
    values = (found.chosen.delay, *found.delay_bounds, *found.chosen.delay_bounds)
    return tuple(value / truth.step - truth.delay_samples for value in values)


def study(kind: str, number: int) -> list[Row | None]:
    """So many logs of a kind, the same ones for the same number and fewer."""
    truth, flaws, _, told = KINDS[kind]
    rows: list[Row | None] = []
    for batch in range(0, number, 10):
        logs = closed_loops(10, SECONDS, seed=batch + 1, truth=truth, flaws=flaws, **told)
        rows += [one(log, truth, not truth.lags) for log in logs[: number - batch]]
    return rows


def said(kind: str, rows: list[Row | None]) -> tuple[str, ...]:
    """A row of the table."""
    got = np.array([row for row in rows if row is not None])
    error, low, high, near, far = got.T
    return (
        kind,
        f"{len(rows)}",
        f"{100.0 * np.mean((low <= 0.0) & (high >= 0.0)):.1f} %",
        f"{100.0 * np.mean((near <= 0.0) & (far >= 0.0)):.1f} %",
        f"{np.median(high - low):.2f}",
        f"{np.median(error):+.2f}",
        f"{100.0 * np.mean(np.abs(error) <= 1.0):.0f} %",
        f"{len(rows) - len(got)}",
    )


@click.command()
@click.option("--share", type=click.FloatRange(0.0, 1.0, min_open=True), default=1.0)
@click.option("--write/--print", default=True)
def main(share: float, write: bool) -> None:
    """Identify them, or a share of them, and write the table into the page or print it."""
    every: list[Row | None] = []
    lines = []
    for kind, (_, _, number, _) in KINDS.items():
        rows = study(kind, max(1, round(share * number)))
        every += rows
        lines.append(said(kind, rows))
        click.echo(" | ".join(lines[-1]), err=True)
    lines.append(said("all", every))
    text = table(COLUMNS, lines)
    if write:
        write_marks(PAGE, {MARK: text})
    else:
        click.echo(text, nl=False)


if __name__ == "__main__":
    main()
