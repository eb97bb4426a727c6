"""The measurements as tables of text, the same on a terminal and on a page.  Every figure is a median [quartiles]."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import starmap
from typing import Any

from benchmarks.measures.blocks import Breakdown
from benchmarks.measures.browser import Frames, PageTimes
from benchmarks.measures.campaign import EARLY, PROCESSES, CampaignCost
from benchmarks.measures.growth import EngineCounts, Lengths, LogRates
from benchmarks.measures.others import Others
from benchmarks.measures.own_blocks import BASELINE, OwnBlocks
from benchmarks.measures.pages import Pages
from benchmarks.measures.process import UNIT, Memory, Startup
from benchmarks.measures.speed import BARE, RECORDED
from benchmarks.peers.block_diagram import LABEL, SUBSTEPS, BlockDiagram
from benchmarks.peers.multirotor import WHOLE_FLIGHT, Multirotor
from benchmarks.peers.peers import ALONE, EXCHANGE, OURS, Peers
from benchmarks.suite import (
    BLOCKS,
    CAMPAIGN,
    ENGINES,
    LOG,
    MEMORY,
    OTHERS,
    OWN,
    PAGES,
    PATHSIM,
    PEERS,
    ROTORPY,
    START,
    STEP,
    TIME,
    Result,
)
from benchmarks.targets import judge_targets, runs_a_step
from benchmarks.timing import Cost, Spread

ASKED, MISSED, BESIDE, MACHINE = "asked", "missed", "others in short", "machine"
KEYS = (
    *(ASKED, MISSED, BESIDE, STEP, BLOCKS, OTHERS, OWN, PEERS, PATHSIM, ROTORPY, TIME, ENGINES, LOG, PAGES, START),
    *(MEMORY, CAMPAIGN, MACHINE),
)

Row = tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """``columns`` are the headings after the first, which names the rows; ``notes`` stand below."""

    title: str
    columns: Row
    rows: Sequence[Row]
    notes: list[str] = field(default_factory=list)


def tables(result: Result) -> dict[str, list[Table]]:
    """Return the tables by part, in the order in which they are read; none for a part that was not measured."""
    measured: dict[str, tuple[Any, Callable[[Any], Iterable[Table]]]] = {
        STEP: (result.step, lambda runs: starmap(_step, runs.items())),
        BLOCKS: (result.blocks, lambda part: [_blocks(part)]),
        OTHERS: (result.others, _others),
        OWN: (result.own, lambda part: [_own_blocks(part)]),
        PEERS: (result.peers, lambda part: [_peers(part)]),
        PATHSIM: (result.pathsim, lambda part: [_pathsim(part)]),
        ROTORPY: (result.rotorpy, lambda part: [_rotorpy(part)]),
        TIME: (result.time, lambda part: [_time(part)]),
        ENGINES: (result.engines, _engines),
        LOG: (result.log, lambda part: [_log(part)]),
        PAGES: (result.pages, _pages),
        START: (result.start, _start),
        MEMORY: (result.memory, lambda part: [_memory(part)]),
        CAMPAIGN: (result.campaign, _campaign),
    }
    tables_by_part = {key: list(make(part)) for key, (part, make) in measured.items() if part}
    goals = _goals(result)
    missed = [row[:-1] for row in goals.rows if row[-1] == "no"]
    return {
        ASKED: [goals],
        MISSED: [Table(f"goals that are not met, of {len(goals.rows)}", goals.columns[:-1], missed)],
        BESIDE: list(_others_beside(result)),
        **tables_by_part,
        MACHINE: list(_machine(result)),
    }


def spread(value: Spread) -> str:
    """``median [lower quartile, upper quartile]``, to three digits of the median."""
    digits = _digits(value.median)
    return f"{value.median:.{digits}f} [{value.low:.{digits}f}, {value.high:.{digits}f}]"


def _digits(value: float) -> int:
    """Decimals that leave three digits, and no more than three."""
    size = abs(value)
    return 0 if size >= 100.0 else 1 if size >= 10.0 else 2 if size >= 1.0 else 3


def _goals(result: Result) -> Table:
    rows = []
    for judged in judge_targets(result):
        bound = f"at {'least' if judged.least else 'most'} {judged.bound:g} {judged.unit}"
        rows.append((judged.name, bound, judged.before or "-", spread(judged.measured), "yes" if judged.met else "no"))
    return Table("asked for", ("goal", "before", "after", "met"), rows)


def _others_beside(result: Result) -> Iterator[Table]:
    """Yield what others cost in this run, each beside what of ours does the same or more."""
    rows: list[Row] = []
    for runs, costs in (result.step or {}).items():
        ours = costs[RECORDED].units.median
        rows.append(_beside(f"bare JSBSim, {runs_a_step(runs)}", float(runs), "a recorded step", ours))
    if result.pathsim and result.pathsim.cost:
        theirs, ours = result.pathsim.cost.units.median, result.pathsim.ours.units.median
        rows.append(_beside(f"{LABEL}, {runs_a_step(SUBSTEPS)}", theirs, "a recorded step", ours))
    if result.peers:
        ours = result.peers.costs[OURS][EXCHANGE].units_process.median
        for name, tasks in result.peers.costs.items():
            if name != OURS:
                rows.append(_beside(f"{name}, six FMUs", tasks[EXCHANGE].units_process.median, "six FMUs", ours))
    if result.rotorpy:
        for name, hover in result.rotorpy.hovers.items():
            if WHOLE_FLIGHT in name:
                ours = hover.cost.units.median / hover.ratio.median
                rows.append(_beside(name, hover.cost.units.median, "a recorded step", ours))
    if rows:
        yield Table("others in the same run, units a step", ("theirs", "ours", "ours is", "theirs by ours"), rows)


def _beside(name: str, theirs: float, what: str, ours: float) -> Row:
    values = [f"{value:.{_digits(value)}f}" for value in (theirs, ours, theirs / ours)]
    return (name, values[0], values[1], what, values[2])


def _cost(cost: Cost) -> Row:
    return spread(cost.wall_us), spread(cost.cpu_us), spread(cost.units)


US = ("us wall", "us cpu", "units")


def _step(runs: int, costs: dict[str, Cost]) -> Table:
    rows = [(name, *_cost(cost)[:2], "1" if name == BARE else spread(cost.units)) for name, cost in costs.items()]
    return Table(f"one control step, JSBSim runs in it: {runs}", US, rows)


def _blocks(breakdown: Breakdown) -> Table:
    outside = breakdown.outside.units.median
    rows = []
    for name, cost in breakdown.alone.items():
        met = breakdown.in_flight.get(name)
        us, units = ("-", cost.units.median) if met is None else (f"{met.us:.2f}", met.units)
        rows.append((name, spread(cost.cpu_us), us, f"{units:.2f}", f"{100.0 * units / outside:.0f}"))
    remainder = breakdown.rest_units
    rows.append(("rest: loop, records", "", "", f"{remainder:.2f}", f"{100.0 * remainder / outside:.0f}"))
    rows.append(("all, recorded to disk", "", spread(breakdown.outside.cpu_us), f"{outside:.2f}", "100"))
    title = f"where it goes outside JSBSim, {breakdown.substeps} runs a step"
    return Table(title, ("us alone", "us in flight", "units", "%"), rows)


def _others(others: Others) -> Iterator[Table]:
    rows = [(name, *(spread(cost.units) for cost in costs.values())) for name, costs in others.outside.items()]
    columns = tuple(map(runs_a_step, next(iter(others.outside.values()))))
    yield Table("not JSBSim, recorded to disk, in other flights; units", columns, rows)
    rows = [(name, *map(spread, ratios.values())) for name, ratios in others.vehicles.items()]
    yield Table(
        "a step of each vehicle in hover, recorded to disk, by the Hex-Jet's with as many JSBSim runs", columns, rows
    )


def _own_blocks(blocks: OwnBlocks) -> Table:
    """By both clocks: what waits for a process takes none of the processor's time."""
    rows = [
        (f"{BASELINE}, what is not JSBSim", *_cost(blocks.ours), spread(blocks.ours.units_wall)),
        *((f"more by {name}", *_cost(cost), spread(cost.units_wall)) for name, cost in blocks.more.items()),
    ]
    notes = [] if blocks.missing is None else [_missing("a whole controller, as an FMU", blocks.missing)]
    return Table("a hover with blocks of one's own, 1 run a step", (*US, "units of wall time"), rows, notes)


def _peers(peers: Peers) -> Table:
    """Units of all threads' processor time: some of them step in threads of their own."""
    rows = [
        (f"{name} {peers.versions[name]}: {task}", spread(costs[task].wall_us), spread(costs[task].units_process))
        for name, costs in peers.costs.items()
        for task in (EXCHANGE, ALONE)
        if task in costs
    ]
    title = f"six instances of {peers.fmu}, {peers.steps} steps; units of all threads together"
    return Table(title, ("us wall", "units"), rows, [_missing(name, why) for name, why in peers.missing.items()])


def _missing(name: str, why: str) -> str:
    return f"{name} not measured: {why}"


def _pathsim(diagram: BlockDiagram) -> Table:
    rows = [("ours, recorded to disk", *_cost(diagram.ours), "1")]
    if diagram.cost and diagram.ratio:
        rows.append((f"{LABEL} {diagram.version}", *_cost(diagram.cost), spread(diagram.ratio)))
    notes = [] if diagram.missing is None else [_missing("PathSim", diagram.missing)]
    title = f"a hover of {diagram.steps} steps in a block diagram, {SUBSTEPS} JSBSim runs in a step"
    return Table(title, (*US, "by ours"), rows, notes)


def _rotorpy(multirotor: Multirotor) -> Table:
    rows = []
    for name, hover in multirotor.hovers.items():
        second = spread(hover.cost.wall_us.times(hover.rate))
        step = spread(hover.cost.wall_us), spread(hover.cost.units)
        rows.append((name, *step, second, spread(hover.factor), spread(hover.ratio)))
    notes = [] if multirotor.missing is None else [_missing("RotorPy", multirotor.missing)]
    for rate, count in multirotor.evaluations.items():
        notes.append(
            f"RotorPy {multirotor.version} at {rate} Hz: {count:.1f} evaluations of its equations of motion a step."
        )
    columns = ("us a step", "units a step", "us a second flown", "seconds flown a second", "by ours at that rate")
    return Table(f"a hover of {multirotor.seconds:g} s", columns, rows, notes)


def _time(lengths: Lengths) -> Table:
    rows = []
    for seconds, cost in lengths.steps.items():
        memory = lengths.memory[seconds]
        flying = next(mark.resident_mb for mark in memory.landmarks if mark.where == "4/4")
        flying_text = "-" if flying is None else spread(flying)
        rows.append((f"{seconds} s", spread(cost.cpu_us), spread(cost.units), flying_text, spread(memory.peak_mb)))
    notes = [f"A step of the longest flight costs {spread(lengths.growth)} times one of the shortest, round by round."]
    columns = ("us cpu", "units", "resident at its end, MB", "peak with log and summary, MB")
    return Table("a recorded step by the time that is flown", columns, rows, notes)


def _engines(counts: EngineCounts) -> Iterator[Table]:
    banks = [(f"{count}", spread(cost.cpu_us), spread(cost.units)) for count, cost in counts.banks.items()]
    yield Table(f"a bank's step by its engines ({counts.engine})", ("us cpu", "units"), banks)
    rows = [(name, *_cost(cost)) for name, cost in counts.flown.items()]
    yield Table("whole recorded step, 4 runs in it; units of the Hex-Jet's airframe", US, rows)


def _log(rates: LogRates) -> Table:
    names = {0: "nothing is recorded", 1: "every step"}
    rows = [(names.get(every, f"one step in {every}"), *_cost(cost)) for every, cost in rates.steps.items()]
    return Table("whole step by what is recorded, 4 JSBSim runs in it", US, rows)


def _pages(pages: Pages) -> Iterator[Table]:
    rows = [
        (
            f"{seconds} s",
            *(f"{size:.2f}" for size in (page.whole_mb, page.shared_mb, page.log_mb)),
            spread(page.write_s),
            spread(page.by_flight),
        )
        for seconds, page in pages.by_length.items()
    ]
    columns = ("MB", "MB with shared assets", "MB of the log", "s to write it", "by the flight's own time")
    yield Table(f"the page of a flight ({pages.flight}) by the time that is flown", columns, rows)
    flights, title = pages.campaign.flights, "the page of a campaign"
    yield Table(title, ("MB",), [(f"{flights} flights", f"{pages.campaign.mb:.2f}")])
    title = "pages in a browser"
    if pages.missing:
        yield Table(title, ("",), [], [_missing(title, pages.missing)])
        return
    looks_by_page = {f"{seconds} s": page.seen for seconds, page in pages.by_length.items()}
    looks_by_page[f"{flights} flights"] = pages.campaign.seen
    looks = [(name, look) for name, look in looks_by_page.items() if look]
    takes: list[tuple[str, Callable[[PageTimes], Spread | None]]] = [
        ("s until it is there", lambda look: look.open_s),
        ("s of its thread until then", lambda look: look.open_cpu_s),
    ]
    for action, of in (("scrolled", lambda look: look.scrolled), ("replaying", lambda look: look.replayed)):
        takes += [
            (f"{action}: frames a second", _frame(of, "rate")),
            (f"{action}: % of them late", _frame(of, "late")),
            (f"{action}: ms of its thread a frame", _frame(of, "page_ms")),
            (f"{action}: ms of what draws a frame", _frame(of, "drawing_ms")),
        ]
    rows = [
        (name, *("-" if (value := take(look)) is None else spread(value) for _, look in looks)) for name, take in takes
    ]
    yield Table(title, tuple(name for name, _ in looks), rows, [f"{pages.browser}."])


def _frame(of: Callable[[PageTimes], Frames | None], name: str) -> Callable[[PageTimes], Spread | None]:
    def take(look: PageTimes) -> Spread | None:
        frames = of(look)
        return None if frames is None else getattr(frames, name)

    return take


def _start(startup: Startup) -> Iterator[Table]:
    rows = [
        (name, spread(measured))
        for name, measured in (
            ("Python starts", startup.python_s),
            ("imports", startup.imports_s),
            ("builds the flight, begins the log", startup.build_s),
            ("to the first step", startup.first_step_s),
        )
    ]
    yield Table("From the command to the first step: hexjet fly hover", ("s",), rows)
    costs = [(name, spread(cost.cpu_s), spread(cost.units)) for name, cost in startup.commands.items()]
    yield Table("Whole processes", ("s cpu", f"by {UNIT}"), costs)


def _memory(memory: Memory) -> Table:
    rows = []
    for mark in memory.landmarks:
        where = f"{mark.where} of the flight" if "/" in mark.where else mark.where
        resident = "-" if mark.resident_mb is None else spread(mark.resident_mb)
        rows.append((where, resident, spread(mark.peak_mb)))
    page = "" if memory.page_mb is None else f", its page {memory.page_mb:.2f} MB"
    note = f"Each flight with its files took {spread(memory.wall_s)} s; its folder has {memory.log_mb:.0f} MB{page}."
    title = f"{memory.minutes:g} min flown, {memory.steps} steps"
    return Table(title, ("resident MB", "peak so far MB"), rows, [note])


def _campaign(cost: CampaignCost) -> Iterator[Table]:
    one, two = PROCESSES
    rows = [
        (
            "bare JSBSim, runs a ms",
            *(spread(cost.bare.rate[count].times(1e-3)) for count in PROCESSES),
            spread(cost.bare.gain),
        ),
        (
            f"flights of {cost.flight_s:g} s, 1/s",
            *(spread(cost.flown.rate[count]) for count in PROCESSES),
            spread(cost.flown.gain),
        ),
        ("gain of the campaign by bare JSBSim's", "", "", spread(cost.share)),
    ]
    yield Table("from one process to two", (f"{one} process", f"{two} processes", "gain"), rows)
    beside = [
        (f"a flight of {cost.flight_s:g} s by its steps alone, times", spread(cost.flight.by_steps)),
        ("a campaign without its flights, s", spread(cost.flight.fixed_s)),
    ]
    yield Table("beside the steps: processor time", ("",), beside)
    if cost.study:
        study = cost.study
        held = [
            (f"worker {number}, {worker.flights} flights", _mb(worker.early_mb), _mb(worker.end_mb))
            for number, worker in enumerate(study.workers, 1)
        ]
        duration = f"{study.flights} flights in {study.wall_s:.0f} s, one run"
        note = f"{duration}; {spread(study.rate)} flights a second over its tenths."
        cheap = [] if cost.cheap_s is None else [f'With `substeps = "campaign"` they take {cost.cheap_s:.0f} s.']
        title = f"a study of {study.flights} flights, two workers: resident memory, MB"
        yield Table(title, (f"after {EARLY} flights", "after the last"), held, [note, *cheap])


def _mb(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f}"


def _machine(result: Result) -> Iterator[Table]:
    machine, plan = result.machine, result.plan
    memory = "-" if machine.memory_mb is None else f"{machine.memory_mb / 1000.0:.1f} GB"
    rows = [
        ("processor", machine.cpu),
        ("cores", str(machine.cores)),
        ("memory", memory),
        ("kernel", f"{machine.system}, {machine.kernel}"),
        ("C library", machine.libc or "-"),
    ]
    rows.append(("modules of a control step", "compiled" if machine.compiled else "Python source"))
    if machine.load:
        rows.append(("load before, after", ", ".join(f"{value:.2f}" for value in machine.load)))
    if machine.processor_share is not None:
        rows.append(("processor time by wall time in flight", f"{machine.processor_share:.3f}"))
    rows += [(f"compiler of {name}", version) for name, version in result.compilers.items()]
    rows.append(
        (
            "repeats",
            f"{plan.rounds} rounds, {min(plan.rounds, plan.dear_rounds)} of what is dear, "
            f"{plan.starts} processes started, {plan.campaign.rounds} rounds of the campaign",
        )
    )
    rows.append(("steps of a timed flight", str(plan.steps)))
    rows.append(("measured in", f"{result.wall_s:.0f} s"))
    yield Table("the machine", ("",), rows)
    yield Table("the packages", ("version",), list(result.versions.items()))
