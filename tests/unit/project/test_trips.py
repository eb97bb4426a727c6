"""The trips of docs/design.md: every function that they name is there and on the way, and their lengths are as said."""

from __future__ import annotations

import ast
import re
from functools import cache

import pytest
from places import ROOT
from stated_figures import defined

# The same ways in commit 2f44bdb, by the same rule: file:function, of cosim/.
BEFORE = {
    "throttle": """
        scenario:StepCommand commands:pulse commands:Commander.at simulation:Simulation.step altitude:AltitudeController.update
        simulation:Simulation._allocate allocation:TiltAllocator.allocate thrust:ThrustMap.throttle simulation:Simulation._drive
        shutoff:Shutoff.throttle faults:FaultyEngines.step mismatch:OtherEngines.step bank:EngineBank.step _bank.c:advance
        bank:EngineBank.step mismatch:OtherEngines._given faults:FaultyEngines.step shutoff:Shutoff.delivered
        simulation:Simulation._jet_forces airflow:Airstreams.act airframe:Airframe.step airframe:Airframe._apply_forces
        airframe:_Write.put_in_plane""",
    "thrust": """
        _bank.c:get_outputs bank:EngineBank.step mismatch:OtherEngines._given faults:FaultyEngines.step shutoff:Shutoff.delivered
        simulation:Simulation._drive simulation:Simulation.step _rows.c:read_sample recorder:_Blocks.hand_on _rows.c:transpose
        arrow:StreamSink.write arrow:stream_to_parquet arrow:ParquetLog.__getitem__ figures:thrust_figure figures:Reader.xy
        report:_render report:figure_json""",
    "MAVLink command": """
        peer:Peer.feed frames:Parser.feed link:Link.take vehicle:Vehicle.receive vehicle:Vehicle._command commands:order_of
        commands:plan commands:_set_mode vehicle:Vehicle._next vehicle:Vehicle.ask links:_Port.ask exchange:Exchange.ask
        gcs:Session._between exchange:Exchange.take gcs:Session._answer gcs:_Flight.ask autopilot:Autopilot.handle
        autopilot:Autopilot._set_mode autopilot:Autopilot._enter links:_Port.answer links:_Port.collect vehicle:Vehicle._next
        vehicle:Vehicle._acknowledge""",
    "study's key": """
        vary:parse_vary options:open_study study:Study.from_table study:check study:Study.key keys:find_key draws:inverse draws:Draws._make
        plan:scenario_of keys:with_values scenario:Scenario.from_table simulation:build vehicle:load_vehicle flight:resolve""",
    "requirement": """
        cli:design make:design make:_axes make:_axis tune:tune tune:excess tune:Box.tuning result:write file:write_controller
        file:controller_table""",
}  # fmt: skip
# Whom nobody on the way calls by name: a part of the way begins there, after what was made beforehand or has waited for
# its turn; a request's answer is found by the request's type.
FIRST = {
    "cosim/spec/scenario/commands.py:StepCommand",
    "cosim/simulation/script/commander.py:pulse",
    "cosim/simulation/step.py:Simulation.step",
    "cosim/results/recorder.py:_Blocks.hand_on",
    "cosim/results/arrow.py:stream_to_parquet",
    "cosim/results/report/page.py:render",
    "cosim/results/report/signals_data.py:run_data",
    "cosim/groundstation/mavlink/wire/peer.py:Peer.feed",
    "cosim/groundstation/mavlink/wire/link.py:Link.take",
    "cosim/groundstation/session.py:Session._between",
    "cosim/control/autopilot/answers.py:Answers._set_mode",
    "cosim/groundstation/exchange.py:Port.collect",
    "cosim/campaign/study/options.py:open_study",
    "cosim/campaign/study/draws.py:inverse",
    "cosim/campaign/study/draws.py:Draws._make",
    "cosim/campaign/study/plan.py:scenario_of",
    "cosim/spec/scenario/scenario.py:Scenario.resolved_vehicle",
    "cosim/cli/controllers/design.py:design",
}
SECTION = (ROOT / "docs" / "design.md").read_text(encoding="utf-8").split("## Five trips")[1].split("\n## ")[0]
STOP = re.compile(r"^(\d+)\. `([\w/]+\.(?:py|c)):([\w.]+)`$", re.MULTILINE)
TRIPS = {part.split("**")[0]: part for part in re.split(r"^\*\*", SECTION, flags=re.MULTILINE)[1:]}


@cache
def named(file: str, function: str) -> frozenset[str]:
    """The names in a function's text, and in the tables of its module that it reads."""
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    *holders, last = function.split(".")
    body: list[ast.stmt] = tree.body
    for holder in holders:
        (body,) = (node.body for node in body if isinstance(node, ast.ClassDef) and node.name == holder)
    (text,) = (node for node in body if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and node.name == last)
    names = _names(text)
    for node in tree.body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and _names(node) & names & {
            target.id for target in ast.walk(node) if isinstance(target, ast.Name) and isinstance(target.ctx, ast.Store)
        }:
            names |= _names(node)
    return frozenset(names)


def _names(node: ast.AST) -> set[str]:
    return {part.attr if isinstance(part, ast.Attribute) else part.id for part in ast.walk(node)
            if isinstance(part, (ast.Attribute, ast.Name))}  # fmt: skip


def test_there_are_five() -> None:
    assert len(TRIPS) == 5
    assert {f"{file}:{name}" for _, file, name in STOP.findall(SECTION)} >= FIRST


@pytest.mark.parametrize("trip", TRIPS)
def test_every_stop_exists(trip: str) -> None:
    stops = STOP.findall(TRIPS[trip])
    assert [int(number) for number, _, _ in stops] == list(range(1, len(stops) + 1))
    assert len(stops) == len(re.findall(r"^\d+\.", TRIPS[trip], re.MULTILINE)), "a line is no `file:function`"
    missing = [f"{file}:{name}" for _, file, name in stops if name not in defined(ROOT / file)]
    assert not missing


@pytest.mark.parametrize("trip", TRIPS)
def test_every_stop_is_called_by_another_of_them(trip: str) -> None:
    """Of those that are Python; through a table of the module too, as a command's handler is."""
    stops = {(file, name) for _, file, name in STOP.findall(TRIPS[trip]) if file.endswith(".py")}
    astray = []
    for file, name in stops:
        called = name.rpartition(".")[2]
        if called == "__getitem__" or f"{file}:{name}" in FIRST:
            continue
        if not any(called in named(*other) for other in stops - {(file, name)}):
            astray.append(f"{file}:{name}")
    assert not astray


@pytest.mark.parametrize("way", BEFORE)
def test_the_lengths_are_what_is_said(way: str) -> None:
    (trip,) = [part for title, part in TRIPS.items() if way in title.split(" to ")[0]]
    now, before = (int(figure) for figure in re.search(r"(\d+) stops, before (\d+)", trip).groups())  # type: ignore[union-attr]
    assert (now, before) == (len(STOP.findall(trip)), len(BEFORE[way].split()))
    assert now < before
