"""What a person sees in the terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.base.protocols import Observer
    from cosim.base.signals import Sample
    from cosim.campaign.engine_out import EngineOut
    from cosim.campaign.failsafe_survey import Failsafes
    from cosim.campaign.fault_survey import Survival
    from cosim.campaign.run import Again
    from cosim.campaign.search.result import Searched
    from cosim.campaign.store import Campaign, Tally
    from cosim.campaign.study.keys import Key
    from cosim.design.design import Design
    from cosim.design.identify import Identification
    from cosim.engine import CheckReport
    from cosim.groundstation.links import Links
    from cosim.groundstation.session import Session
    from cosim.paper.result import Reproduction
    from cosim.results.run import Run
    from cosim.spec.scenario import Scenario

_PIPE_WIDTH = 120


@contextmanager
def flight_progress(scenario: Scenario, quiet: bool) -> Iterator[Sequence[Observer]]:
    """An observer that shows how far the flight is, on a terminal; none in a pipe."""
    if quiet or not sys.stderr.isatty():
        yield ()
        return
    from rich.console import Console
    from rich.progress import Progress

    every = max(1, round(0.5 / scenario.step_s))
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(scenario.name, total=scenario.steps)

        class Watch:
            def observe(self, sample: Sample) -> None:
                if sample.k % every == 0:
                    progress.update(task, completed=sample.k)

        yield (Watch(),)


@contextmanager
def output_to_stderr(active: bool) -> Iterator[None]:
    """While a flight must leave standard output alone, send what an FMU or a library prints there to standard error."""
    if not active:
        yield
        return
    import ctypes
    import os

    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        ctypes.CDLL(None).fflush(None)  # what C code has printed but not yet written
        os.dup2(kept, 1)
        os.close(kept)


@contextmanager
def part_progress(title: str, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A function that is told the part that is done, how many are, and of how many; shown on a terminal."""
    if quiet or not sys.stderr.isatty():
        yield lambda part, done, of: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(title, total=None)
        yield lambda part, done, of: progress.update(task, description=part, completed=done, total=of)


@contextmanager
def sweep_progress(folder: Path, quiet: bool) -> Iterator[Callable[[Tally, int, int], None]]:
    """A function that is told what became of the flights, how many are finished, and of how many.

    On a terminal it shows them, their rate and the time left.  Ctrl-C is answered in a line, wherever.
    """
    reached = [0, 0]
    try:
        with _sweep_bar(quiet) as show:

            def tell(tally: Tally, done: int, of: int) -> None:
                reached[:] = done, of
                show(tally, done, of)

            yield tell
    except KeyboardInterrupt:
        done, of = reached
        print(
            f"hexjet: stopped; {done} of {of} flights are kept: hexjet sweep {folder} --resume goes on"
            if of
            else "hexjet: stopped before the first flight",
            file=sys.stderr,
        )
        raise


@contextmanager
def _sweep_bar(quiet: bool) -> Iterator[Callable[[Tally, int, int], None]]:
    if quiet or not sys.stderr.isatty():
        yield lambda tally, done, of: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"), TimeRemainingColumn())
    shares = TextColumn("{task.fields[shares]}")
    # the processor is for the flights
    with Progress(*columns, shares, console=Console(stderr=True), transient=True, refresh_per_second=2) as progress:
        task = progress.add_task("", total=None, rate="", shares="")

        def show(tally: Tally, done: int, of: int) -> None:
            if progress.tasks[0].total is None:
                progress.reset(task, total=of, completed=done)  # what was flown before says nothing of the rate
            speed = progress.tasks[0].speed
            rate = "" if speed is None else f"{speed:.1f}/s"
            shares = ", ".join(f"{name} {tally.successes[name] / n:.0%}" for name, n in sorted(tally.flown.items()))
            progress.update(task, completed=done, rate=rate, shares=shares)

        yield show


def print_campaign(campaign: Campaign, page: Path) -> None:
    """What became of the flights, by controller, and where the data and the page are."""
    from cosim.campaign.analysis.summary import campaign_summary, summary_lines

    console = _console()
    for line in summary_lines(campaign_summary(campaign)):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    console.print(f"folder: {campaign.folder}", highlight=False, soft_wrap=True)
    console.print(f"report: {page}", highlight=False, soft_wrap=True)


def print_again(again: Again) -> None:
    """A flight of a campaign, and whether it is what it was."""
    print_run(again.run)
    console = _console()
    console.print(f"flight {again.number}: [bold]{again.verdict}[/bold]", highlight=False)
    for line in again.otherwise:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def print_run(run: Run) -> None:
    """Outcome, metrics, what was expected and not met, and where the report is."""
    summary = run.summary
    console = _console()
    but = f"; [bold]{summary.verdict}[/bold]" if summary.verdict not in (None, "not completed") else ""
    console.print(f"{summary.scenario}: [bold]{run.outcome}[/bold], {run.reason}{but}", highlight=False)
    console.print(
        f"{summary.aircraft}, engine {summary.engine}, controller {summary.controller}, seed {summary.seed}: "
        f"{summary.duration_s:.2f} s flown" + _speed(summary.realtime_factor),
        highlight=False,
    )
    print_metrics([run])
    _print_whole(run)
    for text in summary.exceeded:
        console.print(f"beyond its limit: {text}", highlight=False)
    for complaint in summary.complaints:
        console.print(f"not as expected: {complaint}", highlight=False)
    if run.folder is not None:
        console.print(f"report: {run.folder / 'report.html'}", highlight=False, soft_wrap=True)


def print_metrics(runs: Sequence[Run], by: str = "axis") -> None:
    """A table of the axes' metrics in the units of the page, one row an axis and run; ``by`` names the first column."""
    from rich import box
    from rich.table import Table

    from cosim.results.report.flight import axis_cell
    from cosim.results.wording import AXIS_ROWS

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(by)
    for row in AXIS_ROWS:
        table.add_column(f"{row.title}, {row.unit}".lower().replace("rmse", "RMSE"), justify="right")
    for run in runs:
        for axis, metrics in run.metrics.items():
            if metrics.commanded or by == "axis":
                label = axis if by == "axis" else f"{run.summary.controller}, {axis}"
                table.add_row(label, *[axis_cell(metrics, row.key, row.factor, row.digits) for row in AXIS_ROWS])
    _console().print(table)


def _print_whole(run: Run) -> None:
    """What is measured of the whole flight, with its limits."""
    from rich import box
    from rich.table import Table

    from cosim.results.report.flight import whole_rows

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for title in ("whole flight", "value", "limit", "unit"):
        table.add_column(title, justify="right" if title in ("value", "limit") else "left")
    for row in whole_rows(run.summary):
        value = f"[bold]{row['value']}[/bold]" if row["beyond"] else row["value"]
        table.add_row(row["label"].lower().replace("rmse", "RMSE"), value, row["limit"], row["unit"])
    if table.row_count:
        _console().print(table)


def print_catalogue(found: dict[str, list[dict[str, Any]]]) -> None:
    """Names and titles, kind by kind."""
    console = _console()
    for kind, entries in found.items():
        if len(found) > 1:
            console.print(f"[bold]{kind}[/bold]")
        width = max((len(entry["name"]) for entry in entries), default=0)
        for entry in entries:
            console.print(f"  {entry['name']:{width}}  {entry['title']}", highlight=False, soft_wrap=True)


def print_check(report: CheckReport, page: Path) -> None:
    """The findings, one to a line, problems last, and where the page is."""
    console = _console()
    for label, value in report.lines():
        console.print(f"{label:22} {value}", highlight=False, soft_wrap=True, markup=False)
    for problem in report.problems:
        console.print(f"problem: {problem}", highlight=False, soft_wrap=True, markup=False)
    console.print(f"report: {page}", highlight=False, soft_wrap=True)
    console.print("fit to fly" if report.ok else "not fit to fly", style="bold")


def print_identification(found: Identification, paths: dict[str, Path]) -> None:
    """The models side by side, the chosen one's discrete form, how the stated one compares, and where the files are."""
    from rich import box
    from rich.table import Table

    from cosim.design.identify.result import equations, fit_rows

    console = _console()
    sweep, response = found.sweep, found.response
    console.print(
        f"{found.subject}: [bold]{found.channel}[/bold], {sweep.from_hz:.3g} to {sweep.to_hz:.3g} Hz in "
        f"{sweep.duration_s:g} s, amplitude {sweep.amplitude:.3g}; {len(response.hertz)} points, "
        f"coherence at least {response.coherence.min():.4f}",
        highlight=False,
    )
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("with 95 % bounds")
    for fit in found.fits:
        table.add_column(fit.label, justify="right")
    for row in fit_rows(found):
        table.add_row(*row)
    console.print(table)
    for text in equations(found):
        console.print(f"G(z) = {text}", highlight=False, markup=False)
    deviation = found.reference_deviation()
    if found.reference is not None and deviation is not None:
        console.print(
            f"the model that {found.subject} states ({found.reference.source}) is within {deviation[0]:.2f} dB and "
            f"{deviation[1]:.1f} deg of the response",
            highlight=False,
        )
    if found.ledger_samples is not None:
        console.print(f"all delay as the delay ledger has it: {found.ledger_samples:.2f} samples", highlight=False)
    for note in found.notes:
        console.print(f"note: {note}", highlight=False)
    for name in ("model", "report"):
        if name in paths:
            console.print(f"{name}: {paths[name]}", highlight=False, soft_wrap=True)


def print_design(found: Design, paths: dict[str, Path]) -> None:
    """The model, shipped and designed margins, what limits the design or why there is none, and the files."""
    from rich import box
    from rich.table import Table

    from cosim.design.result import COLUMNS, rows, summary_lines

    console = _console()
    console.print(f"{found.vehicle.name} with engine [bold]{found.engine.name}[/bold]", highlight=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    shown = [k for k, column in enumerate(COLUMNS) if column not in ("attitude 1/s", "P", "I", "D", "delay ms")]
    for k in shown:
        table.add_column(COLUMNS[k], justify="left" if k < 2 else "right", no_wrap=True)
    for row in rows(found):
        table.add_row(*(row[k] for k in shown))
    console.print(table)
    for line in summary_lines(found):
        console.print(line, highlight=False, markup=False)
    for name, path in paths.items():
        console.print(f"{name}: {path}", highlight=False, soft_wrap=True)


def print_paper(found: Reproduction, report: Path) -> None:
    """Claims and numbers of the paper beside ours, how many claims follow, and where the report is."""
    from rich import box
    from rich.table import Table

    from cosim.paper.page import compared, counts_in_words

    console = _console()
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("quantity", "unit", "paper", "linear", "", "flight", "", "origin"):
        table.add_column(title, justify="left" if title in ("quantity", "unit", "origin") else "right")
    for row in compared(found.rows):
        name = f"{row.quantity} ({row.note})" if ".state" in row.key else row.quantity
        linear = _cell(row.linear, "{:.4g}"), _cell(row.linear_deviation, "{:+.1f} %")
        flight = _cell(row.flight, "{:.4g}"), _cell(row.flight_deviation, "{:+.1f} %")
        table.add_row(name, row.unit, f"{row.paper:.4g}", *linear, *flight, row.origin)
    console.print(table)
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("claim", "linear plant", "six degrees of freedom"):
        table.add_column(title)
    for claim in found.claims:
        table.add_row(claim.claim, claim.linear.verdict, claim.flight.verdict if claim.flight else "-")
    console.print(table)
    console.print(counts_in_words(found.claims), highlight=False)
    console.print(f"report: {report}", highlight=False, soft_wrap=True)


def print_keys(keys: Sequence[Key]) -> None:
    """What can be varied: its value now, its unit, and what it may be."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for title in ("key", "value", "unit", "allowed"):
        table.add_column(title, justify="right" if title == "value" else "left", overflow="fold")
    for key in keys:
        nominal = str(key.nominal).lower() if isinstance(key.nominal, bool) else key.nominal
        table.add_row(key.path, "-" if nominal is None else f"{nominal}", key.unit, key.allowed)
    _console().print(table, highlight=False, markup=False)


def print_search(searched: Searched) -> None:
    """Where each controller breaks, when that counts as broken, how closely was looked, and the files."""
    from rich import box
    from rich.table import Table

    from cosim.campaign.search.page import how_fine, joint_lines
    from cosim.campaign.search.page import table as edges

    console, found = _console(), searched.found
    base = found.study.base()
    console.print(f"{base.name}: {base.aircraft}, engine {base.engine}; {found.flights} flights", highlight=False)
    console.print(found.criterion, highlight=False, markup=False, soft_wrap=True)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    titles, rows = edges(found)
    for title in titles:
        table.add_column(title, overflow="fold")
    for row in rows:
        table.add_row(*row)
    console.print(table, markup=False)
    for line in [*joint_lines(found), *map(how_fine, found.plan.spans)]:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    for case in searched.cases:
        if not case.same:
            console.print(
                f"case {case.name}: flown again it ended {case.reason}, not as in the search", highlight=False
            )
    console.print(f"cases: {searched.folder / 'cases'}", highlight=False, soft_wrap=True)
    console.print(f"report: {searched.folder / 'search.html'}", highlight=False, soft_wrap=True)


@contextmanager
def search_progress(folder: Path, quiet: bool) -> Iterator[Callable[[int], None]]:
    """A function that is told how many flights there are so far; Ctrl-C is answered in a line, wherever."""
    reached = 0
    try:
        with part_progress("search", quiet) as show:

            def tell(flights: int) -> None:
                nonlocal reached
                reached = flights
                show(f"{flights} flights", flights, 0)

            yield tell
    except KeyboardInterrupt:
        kept = f"{reached} flights are kept: the same command with --out {folder} --resume goes on"
        print(f"hexjet: stopped; {kept if reached else 'before the first flight'}", file=sys.stderr)
        raise


def print_survival(found: Survival, report: Path) -> None:
    """How many places of each fault are held, by controller, what explains it, and where the report is."""
    from rich import box
    from rich.table import Table

    from cosim.campaign.fault_survey import summary

    console = _console()
    controllers, rows = summary(found)
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("fault", "from", *controllers, "detected, s"):
        table.add_column(title, justify="left" if title in ("fault", "from") else "right")
    for kind, start, cells in rows:
        times = [time for cell in cells if cell.detected_s for time in cell.detected_s]
        shown = [f"{cell.held}/{cell.flown}  {cell.lean_deg:3.0f} deg {cell.lost_m:4.1f} m" for cell in cells]
        table.add_row(kind, start, *shown, f"{min(times):.3f} to {max(times):.3f}" if times else "-")
    console.print(table)
    console.print(
        "held at so many of the places where it can happen; the largest lean and the most height lost there",
        highlight=False,
    )
    if found.moments is not None:
        one = found.moments
        console.print(
            f"a jet lost in hover: {one.moment:.3g} N m about roll, {one.acceleration:.3g} rad/s^2; "
            f"{one.late:.3g} s until the others answer: {one.rate:.2g} rad/s, {one.angle:.2g} rad by then",
            highlight=False,
        )
    for limit in found.limits:
        held, airborne = (" ".join(f"{value:g}" for value in each) or "-" for each in (limit.held, limit.airborne))
        lost = "nowhere" if limit.lost_at is None else f"at {limit.lost_at:g}"
        console.print(
            f"{limit.quantity}, {limit.start}, {limit.controller}: held at {held}; airborne at {airborne}; lost {lost}",
            highlight=False,
            soft_wrap=True,
        )
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("lost jets", "thrust over weight", "roll authority", "yaw balanced"):
        table.add_column(title, justify="left" if title == "lost jets" else "right")
    for each in found.attainable:
        roll = "cannot hover" if each.roll is None else f"{100.0 * each.roll:.0f} %"
        lost = ", ".join(map(str, each.lost)) or "none"
        table.add_row(lost, f"{each.thrust:.2f}", roll, "yes" if each.yaw else "no")
    console.print(table)
    console.print(f"report: {report}", highlight=False, soft_wrap=True)


def print_engine_out(found: EngineOut, paths: Sequence[Path]) -> None:
    """What became of every vehicle with one engine out, what no control could have done better, and where it stands."""
    from rich import box
    from rich.table import Table

    from cosim.campaign.engine_out import TABLES, rows

    console = _console()
    aircraft = [each.aircraft for each in found.flights] + [each.aircraft for each in found.left]
    for name, lines in rows(found, aircraft).items():
        table = Table(box=box.SIMPLE_HEAD)
        for title in TABLES[name]:
            table.add_column(title)
        for line in lines:
            table.add_row(*line)
        if lines:
            console.print(table)
    console.print(
        "each jet: verdict, largest lean, height lost, furthest drift; bounds: the lean that no throttles avoid, "
        "and while it does not spin no tilts either, told of it at once; the second table: the bound for throttles "
        "alone with one thing changed, and when the opposite engine has to be shut off for a bound at the limit",
        highlight=False,
    )
    for path in paths:
        console.print(str(path), highlight=False, soft_wrap=True)


def print_failsafes(found: Failsafes, table: Path) -> None:
    """What became of each failsafe in each wind, and where the flights are."""
    from rich import box
    from rich.table import Table

    from cosim.campaign.failsafe_survey import summary

    console = _console()
    shown = Table(box=box.SIMPLE_HEAD)
    for title in ("failsafe", "wind, m/s", "ended", "touch-down, m/s", "thrust 10 s later, N"):
        shown.add_column(title, justify="left" if title in ("failsafe", "ended") else "right")
    for row in summary(found):
        numbers = [
            "-" if value != value else f"{value:{form}}"
            for value, form in ((row.touchdown_m_s, ".2f"), (row.thrust_n, ".1f"))
        ]
        shown.add_row(row.failsafe, f"{row.wind_m_s:g}", row.ends, *numbers)
    console.print(shown)
    console.print(
        f"{found.aircraft}, {found.engine}, {found.controller}: the fastest touch-down and the most thrust of all "
        f"heights; a leg that touches faster than {found.limit_m_s:.2f} m/s counts as a crash",
        highlight=False,
        soft_wrap=True,
    )
    console.print(f"every flight: {table}", highlight=False, soft_wrap=True)


def print_gcs(session: Session, links: Links, to_stderr: bool) -> None:
    """Where to connect, what flies, and where it is recorded."""
    from rich.console import Console

    console = Console(stderr=True) if to_stderr else _console()
    scenario, place = session.scenario, session.scenario.environment
    rows = [
        ("vehicle", f"{scenario.aircraft}, engine {scenario.engine}, controller {scenario.controller}"),
        ("place", f"{place.latitude_deg:.6f}, {place.longitude_deg:.6f}, {place.ground_m:g} m above the sea"),
        ("system", str(links.system)),
        *[("MAVLink", _where(url)) for url in links.urls],
        *([("page", links.page)] if links.page else []),
        ("parameters", f"{session.parameters or 'not kept'}"),
        ("run", str(session.facts.folder)),
        ("pace", "as fast as it goes" if session.factor is None else f"{session.factor:g} x real time"),
    ]
    for label, value in rows:
        console.print(f"{label:11} {value}", highlight=False, soft_wrap=True, markup=False)
    console.print("ready; Ctrl-C ends it", highlight=False)


def print_session(runs: Sequence[Run], counts: Mapping[str, Any], to_stderr: bool) -> None:
    """How a session went, in a line."""
    print(session_line(runs, counts), file=sys.stderr if to_stderr else sys.stdout)


def session_line(runs: Sequence[Run], counts: Mapping[str, Any]) -> str:
    """Flights and how the last one ended, steps that were late, what the links refused, and how to fly it again."""
    from shlex import quote

    last = runs[-1]
    paced = [run.summary.pacing for run in runs if run.summary.pacing is not None]
    refused = {reason.replace("_", " "): count for reason, count in counts["refused"].items() if count}
    why = f" ({', '.join(f'{count} {reason}' for reason, count in sorted(refused.items()))})" if refused else ""
    signatures = sum(refused.get(reason, 0) for reason in ("signature", "unsigned", "replay"))
    faults = counts["failures"]
    return "; ".join(
        [
            f"{len(runs)} flight{'s' if len(runs) > 1 else ''}, the last {last.outcome}: {last.reason}",
            *([", ".join(["beyond limits", *last.summary.exceeded])] if last.summary.beyond else []),
            f"{sum(each.missed_deadlines for each in paced)} steps late" if paced else "not paced",
            f"{counts['taken']} frames taken, {sum(refused.values())} refused{why}",
            f"{signatures} bad signatures",
            *([f"{sum(faults.values())} faults of the links, the first: {next(iter(faults))}"] if faults else []),
            f"recorded in {' '.join(str(run.folder) for run in runs)}",
            f"again: hexjet fly {quote(f'{last.folder}/scenario.toml')}",
        ]
    )


def _where(url: str) -> str:
    kind, _, place = url.partition(":")
    port = place.rpartition(":")[2]
    known = {f"{14540 + n}": " (MAVSDK listens there)" for n in range(10)}
    known["14550"] = " (QGroundControl and MAVProxy listen there)"
    if kind == "udpout":
        return f"sends to udp {place}{known.get(port, '')}"
    return {"udpin": f"listens at udp {place}", "tcpin": f"listens at tcp {place}"}.get(kind, f"{kind} {place}")


@contextmanager
def live_line(links: Links, quiet: bool) -> Iterator[None]:
    """A line about the flight, twice a second, on a terminal; from a thread, because a terminal may be slow."""
    if quiet or not sys.stderr.isatty():
        yield
        return
    import threading

    over = threading.Event()

    def show() -> None:
        told = 0
        while not over.wait(0.5):
            for message in links.exchange.messages:
                if message.number > told:
                    told = message.number
                    print(f"\r\x1b[K{message.severity.name.lower()}: {message.text}", file=sys.stderr)
            print(f"\r\x1b[K{_state(links)}", end="", file=sys.stderr, flush=True)

    thread = threading.Thread(target=show, name="live line", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(timeout=1.0)
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def _state(links: Links) -> str:
    snapshot = links.exchange.snapshot
    if snapshot is None:
        return ""
    status, pace = snapshot.status, snapshot.pace
    state = "armed" if status.armed else "disarmed"
    speed = "" if pace.reached is None else f"  {pace.reached:.2f} x"
    missed = f"  deadlines missed {pace.missed} of {pace.steps}" if pace.factor else ""
    count = sum(list(links.link.refused.values()))  # a list at once: another thread counts
    refused = f"  frames refused {count}" if count else ""
    return (
        f"{snapshot.time:8.1f} s  {status.mode.value} {state}  {snapshot.measured.altitude:6.1f} m"
        f"  stations {links.heard}{speed}{missed}{refused}"
    )


def _speed(factor: float | None) -> str:
    return "" if factor is None else f", {factor:.0f} x real time"


def _cell(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _console() -> Any:
    from rich.console import Console

    # in a pipe there is no width to fit
    return Console() if sys.stdout.isatty() else Console(width=_PIPE_WIDTH)
