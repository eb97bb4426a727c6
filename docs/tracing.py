"""Which requirement is flown by which scenario or study, and which tests name it: ``python docs/tracing.py`` prints it.

The requirements are those of the files that are shipped; the tests are read, not run.  ``reference.py`` makes a page of
it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from cosim.campaign.analysis.table import describe_range
from cosim.campaign.study.study import Study, study_names
from cosim.results.report.marks import table
from cosim.results.wording import metric
from cosim.spec.scenario import Range, Scenario, scenario_names

ROOT = Path(__file__).parents[1]
TESTS = ROOT / "tests"
EXPECTED = "test_scenarios.py"  # flies every scenario with every controller and engine that it expects something of
# calls that are given a scenario's or a study's name and do something with it; of a command line the second word
NAMING = (
    "load",
    "read",
    "fly",
    "hexjet",
    "open_study",
    "apply_controller",
    "resolve_search",
    "load_scenario",
    "Stepper",
)
TITLES = ("requirement", "flown by", "named by the tests")


class Traced(NamedTuple):
    """What one scenario or study requires, and the tests that name it."""

    name: str
    kind: str  # scenario or study
    requirements: tuple[str, ...]
    tests: tuple[str, ...]


def traced() -> list[Traced]:
    """Every shipped scenario and study, in the order of their names."""
    named = tests_by_name({*scenario_names(), *study_names()})
    scenarios = [
        Traced(name, "scenario", tuple(_of_scenario(Scenario.load(name))), (EXPECTED, *named.get(name, ())))
        for name in scenario_names()
    ]
    studies = [
        Traced(name, "study", tuple(_of_study(Study.load(name))), tuple(named.get(name, ()))) for name in study_names()
    ]
    return scenarios + studies


def tests_by_name(names: set[str]) -> Mapping[str, list[str]]:
    """The files of tests that hand each of ``names`` to a call of :data:`NAMING`, or are parametrised by it."""
    found: dict[str, list[str]] = {}
    for path in sorted(TESTS.rglob("test_*.py")):
        for name in sorted(set(_handed(ast.parse(path.read_text(encoding="utf-8")))) & names):
            if path.name != EXPECTED:
                found.setdefault(name, []).append(path.name)
    return found


def _handed(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if called in NAMING:
            yield from _texts(node.args)
        elif called == "parametrize":
            yield from _texts(list(ast.walk(node)))


def _texts(nodes: list[Any]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def _of_scenario(scenario: Scenario) -> Iterator[str]:
    for entry in scenario.expect:
        who = f"{entry.controller} with {entry.engine}"
        yield f"{who}: {', '.join([' or '.join(entry.outcome), *_of_metrics(entry.metrics)])}"
    yield from (f"{entry.name}: {entry.formula}" for entry in scenario.require)
    for key, limit in scenario.limits.model_dump(exclude_none=True).items():
        yield f"limit {key}: {'none' if limit is False else f'{limit:g}'}"


def _of_study(study: Study) -> Iterator[str]:
    yield "every flight to its end, within its limits"
    yield from (f"{entry.name}: {entry.formula}" for entry in study.require)
    yield from _of_metrics(study.success)
    if study.until is not None:
        yield f"probability and confidence: {study.until}"


def _of_metrics(ranges: Mapping[str, Range]) -> Iterator[str]:
    for name, allowed in ranges.items():
        yield f"{metric(name).label} {describe_range(name, allowed)}"


def page() -> str:
    """The page of reference."""
    rows = [
        (text, f"{one.kind} {one.name}", ", ".join(one.tests) or "none")
        for one in traced()
        for text in one.requirements
    ]
    return (
        "# Requirements, what flies them, and the tests\n\nWhat every shipped scenario and study requires of its "
        f"flights, and the files of tests that name it. {EXPECTED} flies every scenario with each controller and "
        "engine that it expects something of. What is required of a study of yours, "
        "[hexjet prove](../docs/prove.md) says.\n\n" + table(TITLES, rows, left=3)
    )


if __name__ == "__main__":
    print(page())
