"""The measurements as tables of text, the same on a terminal and on a page.  Every figure is a median [quartiles]."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import starmap
from typing import Any

from benchmarks.measures.process import UNIT, Startup
from benchmarks.measures.speed import BARE, RECORDED
from benchmarks.peers.block_diagram import LABEL, SUBSTEPS, BlockDiagram
from benchmarks.peers.multirotor import WHOLE_FLIGHT, Multirotor
from benchmarks.peers.peers import ALONE, EXCHANGE, OURS, Peers
from benchmarks.suite import PARTS, PATHSIM, PEERS, ROTORPY, START, STEP, Result
from benchmarks.targets import judge_targets, runs_a_step
from benchmarks.timing import Cost, Spread

ASKED, MISSED, BESIDE, MACHINE = "asked", "missed", "others in short", "machine"
KEYS = (ASKED, MISSED, BESIDE, *PARTS, MACHINE)

Row = tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A table's title, headings after the first column, rows, and notes below it."""

    title: str
    columns: Row
    rows: Sequence[Row]
    notes: list[str] = field(default_factory=list)


def tables(result: Result) -> dict[str, list[Table]]:
    """Return the tables by part in reading order; none for a part that was not measured."""
    measured: dict[str, tuple[Any, Callable[[Any], Iterable[Table]]]] = {
        STEP: (result.step, lambda runs: starmap(_make_step_table, runs.items())),
        PEERS: (result.peers, lambda part: [_make_peers_table(part)]),
        PATHSIM: (result.pathsim, lambda part: [_make_pathsim_table(part)]),
        ROTORPY: (result.rotorpy, lambda part: [_make_rotorpy_table(part)]),
        START: (result.start, _list_start_tables),
    }
    tables_by_part = {key: list(make(part)) for key, (part, make) in measured.items() if part}
    goals = _make_goals_table(result)
    missed = [row[:-1] for row in goals.rows if row[-1] == "no"]
    return {
        ASKED: [goals],
        MISSED: [Table(f"goals that are not met, of {len(goals.rows)}", goals.columns[:-1], missed)],
        BESIDE: list(_list_others_tables(result)),
        **tables_by_part,
        MACHINE: list(_list_machine_tables(result)),
    }


def spread(value: Spread) -> str:
    """Return ``median [lower quartile, upper quartile]`` with three digits of the median."""
    digits = _count_decimals(value.median)
    return f"{value.median:.{digits}f} [{value.low:.{digits}f}, {value.high:.{digits}f}]"


def _count_decimals(value: float) -> int:
    """Return the number of decimals, at most three, that leaves three digits."""
    size = abs(value)
    return 0 if size >= 100.0 else 1 if size >= 10.0 else 2 if size >= 1.0 else 3


def _make_goals_table(result: Result) -> Table:
    rows = []
    for judged in judge_targets(result):
        bound = f"at {'least' if judged.least else 'most'} {judged.bound:g} {judged.unit}"
        rows.append((judged.name, bound, judged.before or "-", spread(judged.measured), "yes" if judged.met else "no"))
    return Table("asked for", ("goal", "before", "after", "met"), rows)


def _list_others_tables(result: Result) -> Iterator[Table]:
    """Yield the table of what other programs cost in this run, beside what ours costs for the same or more."""
    rows: list[Row] = []
    for runs, costs in (result.step or {}).items():
        ours = costs[RECORDED].units.median
        rows.append(_compare_row(f"bare JSBSim, {runs_a_step(runs)}", float(runs), "a recorded step", ours))
    if result.pathsim and result.pathsim.cost:
        theirs, ours = result.pathsim.cost.units.median, result.pathsim.ours.units.median
        rows.append(_compare_row(f"{LABEL}, {runs_a_step(SUBSTEPS)}", theirs, "a recorded step", ours))
    if result.peers:
        ours = result.peers.costs[OURS][EXCHANGE].units_process.median
        for name, tasks in result.peers.costs.items():
            if name != OURS:
                rows.append(_compare_row(f"{name}, six FMUs", tasks[EXCHANGE].units_process.median, "six FMUs", ours))
    if result.rotorpy:
        for name, hover in result.rotorpy.hovers.items():
            if WHOLE_FLIGHT in name:
                ours = hover.cost.units.median / hover.ratio.median
                rows.append(_compare_row(name, hover.cost.units.median, "a recorded step", ours))
    if rows:
        yield Table("others in the same run, units a step", ("theirs", "ours", "ours is", "theirs by ours"), rows)


def _compare_row(name: str, theirs: float, what: str, ours: float) -> Row:
    values = [f"{value:.{_count_decimals(value)}f}" for value in (theirs, ours, theirs / ours)]
    return (name, values[0], values[1], what, values[2])


def _cost_row(cost: Cost) -> Row:
    return spread(cost.wall_us), spread(cost.cpu_us), spread(cost.units)


US = ("us wall", "us cpu", "units")


def _make_step_table(runs: int, costs: dict[str, Cost]) -> Table:
    rows = [(name, *_cost_row(cost)[:2], "1" if name == BARE else spread(cost.units)) for name, cost in costs.items()]
    return Table(f"one control step, JSBSim runs in it: {runs}", US, rows)


def _make_peers_table(peers: Peers) -> Table:
    """Return the table of peers, in units of all threads' processor time, as some step in threads of their own."""
    rows = [
        (f"{name} {peers.versions[name]}: {task}", spread(costs[task].wall_us), spread(costs[task].units_process))
        for name, costs in peers.costs.items()
        for task in (EXCHANGE, ALONE)
        if task in costs
    ]
    title = f"six instances of {peers.fmu}, {peers.steps} steps; units of all threads together"
    return Table(title, ("us wall", "units"), rows, [_missing_note(name, why) for name, why in peers.missing.items()])


def _missing_note(name: str, why: str) -> str:
    return f"{name} not measured: {why}"


def _make_pathsim_table(diagram: BlockDiagram) -> Table:
    rows = [("ours, recorded to disk", *_cost_row(diagram.ours), "1")]
    if diagram.cost and diagram.ratio:
        rows.append((f"{LABEL} {diagram.version}", *_cost_row(diagram.cost), spread(diagram.ratio)))
    notes = [] if diagram.missing is None else [_missing_note("PathSim", diagram.missing)]
    title = f"a hover of {diagram.steps} steps in a block diagram, {SUBSTEPS} JSBSim runs in a step"
    return Table(title, (*US, "by ours"), rows, notes)


def _make_rotorpy_table(multirotor: Multirotor) -> Table:
    rows = []
    for name, hover in multirotor.hovers.items():
        second = spread(hover.cost.wall_us.times(hover.rate))
        step = spread(hover.cost.wall_us), spread(hover.cost.units)
        rows.append((name, *step, second, spread(hover.factor), spread(hover.ratio)))
    notes = [] if multirotor.missing is None else [_missing_note("RotorPy", multirotor.missing)]
    for rate, count in multirotor.evaluations.items():
        notes.append(
            f"RotorPy {multirotor.version} at {rate} Hz: {count:.1f} evaluations of its equations of motion a step."
        )
    columns = ("us a step", "units a step", "us a second flown", "seconds flown a second", "by ours at that rate")
    return Table(f"a hover of {multirotor.seconds:g} s", columns, rows, notes)


def _list_start_tables(startup: Startup) -> Iterator[Table]:
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


def _list_machine_tables(result: Result) -> Iterator[Table]:
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
            f"{plan.starts} processes started",
        )
    )
    rows.append(("steps of a timed flight", str(plan.steps)))
    rows.append(("measured in", f"{result.wall_s:.0f} s"))
    yield Table("the machine", ("",), rows)
    yield Table("the packages", ("version",), list(result.versions.items()))
