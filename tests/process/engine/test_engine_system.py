"""A system of FMUs (SSP) as one engine: stepped as by hand, judged, flown, and refused in one line where it is wrong."""

from __future__ import annotations

import io
import pickle
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import foreign_engines
import pytest
import systems
from systems import LINES, STEP, by_hand, line, pack, parameter_set, structure

import cosim.engine._bank as native
from cosim.base.errors import InputError
from cosim.codegen import measure
from cosim.codegen.ssp import write_ssp
from cosim.engine import EngineBank, load_engine
from cosim.engine.fmu.archive import Archive
from cosim.engine.fmu.instance import FmuInstance
from cosim.engine.fmu.unpacked import unpack
from cosim.engine.qualify.trial import run_task
from cosim.engine.spec import find_source
from cosim.engine.ssp.structure import sort_components
from cosim.engine.ssp.system_instance import make_instance
from cosim.flight import fly
from cosim.spec.scenario import Scenario

pytestmark = pytest.mark.skipif(measure.find_compiler() is None, reason="no C compiler")
THROTTLE = [0.5] * 20 + [1.0] * 80 + [0.2] * 60


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return systems.components(tmp_path_factory.mktemp("components"))


@pytest.fixture
def mine(tmp_path: Path, fmus: dict[str, bytes]) -> Path:
    return pack(tmp_path / "mine.ssp", structure(), fmus)


@contextmanager
def stepped(path: Path, **settings: float) -> Iterator[tuple[Archive, FmuInstance, native.Bank]]:
    archive = find_source(str(path)).archive
    with unpack(archive) as folder:
        instance = make_instance(archive, folder, "tried")
        try:
            parameters = {v.name: v for v in archive.parameters}
            named = [(parameters[name.replace("__", ".")], value) for name, value in settings.items()]
            instance.initialize(named, 0.0, step=STEP)
            yield archive, instance, native.Bank((instance.make_row(),), STEP)
        finally:
            instance.close()


def thrusts(path: Path, **settings: float) -> list[float]:
    with stepped(path, **settings) as (_, _, bank):
        return [bank.hold(0, throttle, 1)[0] for throttle in THROTTLE]


def test_it_is_stepped_as_by_hand_to_the_last_bit(mine: Path) -> None:
    assert thrusts(mine) == by_hand(THROTTLE)
    assert thrusts(mine, governor__gain=0.1) == by_hand(THROTTLE, 0.1)
    archive = find_source(str(mine)).archive
    assert [part.name for part in archive.system.components] == ["governor", "pump", "core"]
    assert archive.system.late_connections == ["core.n to governor.speed"]
    assert pickle.loads(pickle.dumps(archive)).system == archive.system


def test_the_order_is_that_of_the_connections_and_not_of_the_file(tmp_path: Path, fmus: dict[str, bytes]) -> None:
    """Without the loop: whatever is listed first, nothing is late."""
    open_loop = tuple(
        each for each in LINES if "governor.speed" not in each and 'startElement="core" startConnector="n"' not in each
    )
    path = pack(tmp_path / "open.ssp", structure(open_loop, ("core", "pump", "governor"), version="2.0"), fmus)
    archive = find_source(str(path)).archive
    assert archive.system.late_connections == []
    assert [part.name for part in archive.system.components] == ["governor", "pump", "core"]
    a, b, c = ("a",), ("b",), ("c",)
    assert sort_components([a, b, c], {a: {c}, b: {a}, c: {b}}) == ([a, b, c], {(c, a)})
    assert sort_components([a, b], {a: {a}}) == ([a, b], {(a, a)})


def test_parameter_sets_inside_and_outside_and_in_a_file(tmp_path: Path, fmus: dict[str, bytes]) -> None:
    bound = "<ssd:ParameterBindings><ssd:ParameterBinding{}</ssd:ParameterBinding></ssd:ParameterBindings>"
    inline = bound.format(f"><ssd:ParameterValues>{parameter_set({'governor.gain': 0.2})}</ssd:ParameterValues>")
    path = pack(tmp_path / "inline.ssp", structure(more=inline), fmus)
    assert thrusts(path) == by_hand(THROTTLE, 0.2)
    assert load_engine(str(path), {}, STEP, unchecked=True).parameters == {"governor.gain": 0.2}
    from_file = structure(more=bound.format(' source="resources/set.ssv">'))
    path = pack(tmp_path / "file.ssp", from_file, fmus, **{"resources/set.ssv": parameter_set({"governor.gain": 0.3})})
    assert thrusts(path) == by_hand(THROTTLE, 0.3)
    # one of a scenario's, beside a mapping file
    (tmp_path / "hot.ssv").write_text(parameter_set({"governor.gain": 0.4}))
    mapping = tmp_path / "hot.toml"
    mapping.write_text('fmu = "file.ssp"\nparameter_set = "hot.ssv"\n')
    assert find_source(str(mapping)).mapping.parameters == {"governor.gain": 0.4}
    mapping.write_text('fmu = "file.ssp"\nparameter_set = "hot.ssv"\n[parameters]\ngovernor.gain = 0.6\n')
    assert find_source(str(mapping)).mapping.parameters == {"governor.gain": 0.6}
    (tmp_path / "hot.ssv").write_text(parameter_set({"governor.gian": 0.4}))
    with pytest.raises(InputError, match=r"hot.ssv: governor.gian: file.ssp has no such parameter; did you mean"):
        find_source(str(mapping))


def test_systems_in_systems_and_units_that_differ(tmp_path: Path, fmus: dict[str, bytes]) -> None:
    """The core in a system of its own whose outlet is in newtons; the system's in pounds-force, by its units."""
    uri = "http://ssp-standard.org/SSP1/SystemStructure"
    inner = (
        '<ssd:System name="hot"><ssd:Connectors><ssd:Connector name="in" kind="input"/>'
        '<ssd:Connector name="push" kind="output"><ssc:Real unit="N"/></ssd:Connector></ssd:Connectors>'
        '<ssd:Elements><ssd:Component name="core" source="resources/core.fmu"/></ssd:Elements><ssd:Connections>'
        + line("in", "core.fuel") + line("core.thrust_kN", "push", systems.KILO) + "</ssd:Connections></ssd:System>"
    )  # fmt: skip
    lbf = '<ssc:Unit name="lbf"><ssc:BaseUnit kg="1" m="1" s="-2" factor="4.4482216152605"/></ssc:Unit></ssd:Units>'
    connectors = systems.CONNECTORS.replace('unit="N"', 'unit="lbf"')
    lines = (line("throttle", "pump.command"), line("pump.flow", "hot.in"), line("hot.push", "thrust"))
    text = structure(lines, ("pump",), connectors=connectors).replace("</ssd:Elements>", f"{inner}</ssd:Elements>", 1)
    # the replacement above hits the inner list first where it comes first; the outer one is meant
    text = text.replace("</ssd:Units>", lbf)
    assert uri in text
    archive = find_source(str(pack(tmp_path / "deep.ssp", text, fmus))).archive
    assert [part.name for part in archive.system.components] == ["pump", "hot.core"]
    assert (archive.thrust.unit, archive.system.targets[archive.thrust.reference][0].factor) == (
        "lbf",
        1000.0 / 4.4482216152605,
    )
    assert archive.ports["thrust"].scale == 4.4482216152605


CONTROL_SSV = """<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
 xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="1.0" name="control">
<ssv:Parameters><ssv:Parameter name="k"><ssv:Real value="30" unit="per cent"/></ssv:Parameter></ssv:Parameters>
<ssv:Units><ssc:Unit name="per cent"><ssc:BaseUnit factor="0.01"/></ssc:Unit></ssv:Units>
</ssv:ParameterSet>"""


def test_an_archive_as_another_tool_writes_it_is_read_and_flies(tmp_path: Path, fmus: dict[str, bytes]) -> None:
    """Written by hand from SSP 1.0: systems in a system, units on connectors, sets inline and in a file, transformations.

    Geometry, notes and annotations of the tool's own, names with blanks: the lever is in per cent, the thrust in
    pounds-force, the core's in kilonewtons, the gain 0.3 by the file and 0.4 by the set outside.  In the loop the core
    is listed first, and so takes the fuel of the step before.
    """

    def by_hand(gain: float) -> list[float]:
        flow = n = 0.0
        found = []
        for demand in THROTTLE:
            n = n + 0.05 * (flow - n)
            valve = min(max(demand + gain * (demand - n), 0.0), 1.0)
            flow = flow + 0.2 * (valve - flow)
            found.append(20.0 * n)
        return found

    text = (Path(systems.__file__).with_name("other_tool.ssd")).read_text(encoding="utf-8")

    def packed(name: str, structure_text: str) -> Path:
        contents = {"core of it": fmus["core"], "pump": fmus["pump"], "governor": fmus["governor"]}
        return pack(tmp_path / name, structure_text, contents, **{"resources/control.ssv": CONTROL_SSV})

    path = packed("other.ssp", text)
    assert thrusts(path) == pytest.approx(by_hand(0.4), rel=1e-12)
    inside = re.sub(
        r"<ssd:ParameterBindings>\s*<ssd:ParameterBinding prefix.*?</ssd:ParameterBindings>", "", text, flags=re.S
    )
    assert thrusts(packed("inside.ssp", inside)) == pytest.approx(by_hand(0.3), rel=1e-12)
    archive = find_source(str(path)).archive
    assert (archive.throttle.unit, archive.thrust.unit, archive.model) == ("%", "lbf", "propulsion unit")
    assert [part.name for part in archive.system.components] == ["Hot section.core", "Control.governor", "pump"]
    assert archive.system.late_connections == ["pump.flow to Hot section.core.fuel"]
    run = fly(Scenario.load("hover").replace(
        engine=str(path), engine_unchecked=True, controller="baseline", duration_s=0.2, expect=[]
    ))  # fmt: skip
    assert run.outcome == "completed"


def test_the_check_tries_it_as_any_engine(mine: Path) -> None:
    """The parts of hexjet fmu check that are not one more run, in this process."""
    parts = ("validate", "load", "start", "repeat", "reset", "restore", "serialize")
    said: list[dict[str, Any]] = []
    run_task({"name": str(mine), "parameters": {}, "step": STEP, "parts": parts}, said.append)
    found = {each["of"]: each for each in said if "of" in each}
    assert [each["problems"] for each in found.values()] == [[]] * len(parts)
    assert found["validate"]["found"]["features"][0] == "governor: resources/governor.fmu"
    answers = {key: value for part in parts[4:] for key, value in found[part]["found"].items()}
    assert answers == {"reset_restores_start": True, "state_restores": True, "serialized_state_restores": True}


def test_it_flies_and_flies_again_from_the_run_in_a_process_of_its_own(mine: Path, tmp_path: Path) -> None:
    (tmp_path / "slow.ssv").write_text(parameter_set({"governor.gain": 0.2}))
    mapping = tmp_path / "slow.toml"
    mapping.write_text('fmu = "mine.ssp"\nparameter_set = "slow.ssv"\n')
    changes = {"engine": str(mapping), "engine_unchecked": True, "controller": "baseline", "duration_s": 0.2}
    run = fly(Scenario.load("hover").replace(**changes, expect=[]), tmp_path / "run", report=False)
    assert run.outcome == "completed"
    assert [row.samples for row in run.summary.delay_ledger if "core.n to governor.speed" in row.element] == [0.0]
    kept = Scenario.read(tmp_path / "run" / "scenario.toml")
    assert kept.engine_parameters == {"governor.gain": 0.2}
    again = fly(kept.replace(engine_isolated=True), report=False)
    assert again.log["thrust_1_N"].tolist() == run.log["thrust_1_N"].tolist()


def test_a_component_that_fails_is_named_with_its_file(mine: Path) -> None:
    with stepped(mine) as (_, instance, bank):
        bank.hold(0, 0.5, 1)
        instance.fmu._components[1].call("terminate")  # the pump, behind its back
        with pytest.raises(native.FailureError) as failure:
            bank.hold(0, 0.5, 1)
        said = instance.explain(failure.value, "at step 1")
        assert "component pump (resources/pump.fmu): " in said
        instance.fmu._components[1]._stepping = False


def test_one_bank_with_systems_and_fmus(mine: Path) -> None:
    specs = [load_engine(str(mine), {}, STEP, unchecked=True), load_engine("edf", {}, STEP)]
    with EngineBank(specs, 2, STEP) as bank:
        first = bank.reset(0.5)
        assert first.thrust[0] == pytest.approx(10.0, abs=1e-6)
        assert bank.step(0, (0.5, 0.5)).thrust[0] == pytest.approx(10.0, abs=1e-6)


def test_it_is_not_exported_as_a_component(mine: Path, tmp_path: Path) -> None:
    spec = load_engine(str(mine), {}, STEP, unchecked=True)
    flight = SimpleNamespace(simulation=SimpleNamespace(stations=[spec]))
    with pytest.raises(InputError, match=r"engine of jet 1 \(mine.ssp\): is a system itself"):
        write_ssp(flight, tmp_path / "vehicle.fmu", tmp_path / "out.ssp", 3, 1.0)


def test_a_lever_in_whole_numbers_is_rounded_as_that_of_an_fmu(tmp_path: Path) -> None:
    fmu = foreign_engines.foreign(
        tmp_path, "servo", "lag=0.2,pulse=1", [foreign_engines.PULSE, foreign_engines.force()]
    )
    pulse = '<ssc:LinearTransformation factor="1000.0" offset="1000.0"/>'
    text = structure((line("throttle", "servo.esc_us", pulse), line("servo.thrust", "thrust")), ("servo",))
    path = pack(tmp_path / "servo.ssp", text, {"servo": fmu.read_bytes()})
    throttle = [0.1234, 0.5678, 1.0]
    found = []
    for each in (fmu, path):
        with stepped(each) as (_, _, bank):
            found.append([bank.hold(0, value, 3) for value in throttle])
    assert found[0] == found[1]
    assert found[0][0][-1] > 0.0


def test_a_clock_of_a_component_is_said_not_to_tick(fmus: dict[str, bytes], tmp_path: Path) -> None:
    clock = (
        '<Clock name="tick" valueReference="77" causality="input" variability="discrete" '
        'intervalVariability="constant" intervalDecimal="0.02"/></ModelVariables>'
    )
    for events, why in (
        ("true", "the components of a system are stepped without event mode"),
        ("false", "the FMU has no event mode"),
    ):
        pump = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(fmus["pump"])) as source, zipfile.ZipFile(pump, "w") as changed:
            for name in source.namelist():
                text = source.read(name)
                if name == "modelDescription.xml":
                    text = text.replace(b"<CoSimulation ", f'<CoSimulation hasEventMode="{events}" '.encode())
                    text = text.replace(b"</ModelVariables>", clock.encode())
                changed.writestr(name, text)
        path = pack(tmp_path / f"{events}.ssp", structure(), fmus | {"pump": pump.getvalue()})
        notes = find_source(str(path)).archive.port_notes
        assert f"component pump: its clock tick never ticks: {why}" in notes


def test_part_of_an_array_is_not_connected(tmp_path: Path) -> None:
    rows = [foreign_engines.lever(), ("thrusts", "thrusts", "output", 'size="2" unit="N"')]
    fmu = foreign_engines.foreign(tmp_path, "array", "lag=0.1", rows, fmi=3)
    text = structure((line("throttle", "array.throttle"), line("array.thrusts[1]", "thrust")), ("array",))
    path = pack(tmp_path / "array.ssp", text, {"array": fmu.read_bytes()})
    with pytest.raises(InputError, match=r"component array .*: thrusts\[1\] is part of an array"):
        find_source(str(path))


WRONG = {
    "no structure": (None, "is not an SSP: it has no SystemStructure.ssd"),
    "version": (lambda t: t.replace('version="1.0" name', 'version="0.9" name'), "SSP version 0.9 is not supported"),
    "component": (lambda t: t.replace("pump.fmu", "pumps.fmu"), "component pump: there is no resources/pumps.fmu"),
    "variable": (
        lambda t: t.replace('endConnector="command"', 'endConnector="comand"'),
        "component pump (resources/pump.fmu): has no variable comand; did you mean 'command'?",
    ),
    "element": (lambda t: t.replace('endElement="pump"', 'endElement="pomp"'), "ends at pomp.command, and there is no"),
    "kind": (lambda t: t.replace('kind="input"', 'kind="inout"'), "connector throttle: kind 'inout' is not supported"),
    "transformation": (
        lambda t: t.replace("LinearTransformation", "BooleanMappingTransformation"),
        "the connection to thrust has a BooleanMappingTransformation, which is not supported",
    ),
    "twice": (lambda t: t.replace('endConnector="speed"', 'endConnector="demand"'), "governor.demand is connected to both"),
    "script": (
        lambda t: t.replace("x-fmu-sharedlibrary", "x-python", 1),
        "component governor (resources/governor.fmu, application/x-python) is no FMU",
    ),
    "no thrust": (lambda t: t.replace('"thrust"', '"noise"').replace('unit="N"', 'unit="1"'), "known as its thrust"),
    "entity": (lambda t: t.replace("?>", "?><!DOCTYPE x>", 1), "declares a document type"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_one_line_with_the_file(case: str, tmp_path: Path, fmus: dict[str, bytes]) -> None:
    change, said = WRONG[case]
    path = tmp_path / "wrong.ssp"
    if change is None:
        import zipfile

        with zipfile.ZipFile(path, "w") as ssp:
            ssp.writestr("readme.txt", "nothing")
    else:
        pack(path, change(structure()), fmus)
    with pytest.raises(InputError) as refused:
        find_source(str(path))
    text = str(refused.value)
    assert text.startswith(f"{path}: ")
    assert said in text
    assert "\n" not in text


def test_a_component_that_is_no_fmu_is_named(tmp_path: Path, fmus: dict[str, bytes]) -> None:
    path = pack(tmp_path / "wrong.ssp", structure(), fmus | {"core": b"nothing"})
    with pytest.raises(InputError, match=r"wrong.ssp: component core \(resources/core.fmu\): is not an FMU"):
        find_source(str(path))
