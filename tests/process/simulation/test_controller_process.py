"""A controller that is a program or an FMU flies in lockstep, as the same law in a class does, to the last bit."""

from __future__ import annotations

import inspect
import json
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fmpy
import pytest
from command_tools import Hexjet
from engine_tools import rewrite
from fmpy.fmi2 import FMU2Slave
from patience import is_ended
from places import ROOT, TOOLS, of_page

from cosim import InputError, Run, Scenario, fly
from cosim.base import controller_wire as wire
from cosim.campaign.run import run_campaign
from cosim.campaign.study.options import open_study
from cosim.engine.make.controller_fmu import read_controller_fmu
from cosim.results.run import scenario_toml
from cosim.results.summary import OwnController
from cosim.spec.controller_name import is_design

DOUBLET = {"kind": "doublet", "signal": "roll_deg", "start_s": 0.04, "amplitude": 8.0, "width_s": 0.1}
ROLL = Scenario.load("roll-doublet").replace(duration_s=0.4, command=[DOUBLET], expect=[])


def same(one: Run, other: Run) -> bool:
    assert set(one.log.columns) <= set(other.log.columns)
    return all(one.log[name].tobytes() == other.log[name].tobytes() for name in one.log.columns)


def flies(scenario: Scenario, *where: Path) -> Run:
    """The scenario's flight to its end."""
    run = fly(scenario, *where, report=False)
    assert run.outcome == "completed", run.reason
    return run


def own_of(run: Run) -> OwnController:
    """What the run says of the controller that it flew."""
    assert run.summary.own_controller is not None
    return run.summary.own_controller


class Loop:
    """The law of the page, in this process."""

    level = "rate"
    parameters = (("share", 1.0, "", "of the gains", 0.0, 10.0),)
    columns = (("roll_integral", "1", "body", "integral of the roll error"),)

    def prepare(self, belief: Any) -> None:
        self.share, self.step = belief.parameters["share"], belief.step_s

    def reset(self) -> None:
        self.integral = [0.0, 0.0, 0.0]
        self.shown = (0.0,)

    def update(self, setpoint: Any, measured: Any, applied: Any) -> list[float]:
        errors = [a - b for a, b in zip(setpoint, measured, strict=True)]
        self.integral = [held + 0.5 * self.step * error for held, error in zip(self.integral, errors, strict=True)]
        self.shown = (self.integral[0],)
        pairs = zip((0.05, 0.2, 0.2), errors, self.integral, strict=True)
        return [self.share * gain * (error + held) for gain, error, held in pairs]


@pytest.fixture(scope="module")
def reference() -> Run:
    run = fly(ROLL.replace(controller_parameters={}), controller=Loop)
    assert run.outcome == "completed", run.reason
    return run


@pytest.fixture(scope="module")
def loop_c(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loop")
    source = of_page("process", folder / "loop.c")
    strict = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O2", "-ffp-contract=off"]
    subprocess.run([shutil.which("cc") or "gcc", *strict, str(source), "-o", str(folder / "loop")], check=True)
    return folder / "loop"


def test_the_program_of_the_page_in_c_flies_as_the_class(loop_c: Path, reference: Run, tmp_path: Path) -> None:
    run = flies(ROLL.replace(controller=f"process:{loop_c}"), tmp_path / "run")
    assert run.log.columns == reference.log.columns
    assert same(reference, run)
    own = own_of(run)
    assert (own.level, own.repeatable, own.parameters) == ("rate", True, {"share": 1.0})
    # from the copy in its folder, which is no program by its mode, with another value of its own
    assert same(reference, fly(Scenario.load(tmp_path / "run" / "scenario.toml")))
    weaker = fly(ROLL.replace(controller=f"process:{loop_c}", controller_parameters={"share": 0.5}))
    assert not same(reference, weaker)


def test_so_does_that_in_python_and_a_study_of_it_says_that_it_repeats(reference: Run, tmp_path: Path) -> None:
    name = f"process:{of_page('script', tmp_path / 'loop.py')}"
    assert same(reference, fly(ROLL.replace(controller=name)))
    vary = ["controller_parameters.share=0.5,1"]
    study = open_study("hover", vary=vary, controllers=[name], settings=["duration_s=0.1"])
    columns = run_campaign(study, tmp_path / "campaign", workers=1).columns
    told = [list(columns[name]) for name in ("outcome", "controller", "controller_repeatable")]
    assert told == [["completed"] * 2, ["process:loop.py"] * 2, [True] * 2]
    assert (tmp_path / "campaign" / "loop.py").is_file()


@pytest.mark.skipif(sys.platform != "linux", reason="told by /proc")
def test_what_a_process_has_started_ends_with_the_flight(tmp_path: Path) -> None:
    """In a session of its own, which a signal to the process's group does not reach."""
    program, started = of_page("script", tmp_path / "loop.py"), tmp_path / "started"
    more = (
        "import os, subprocess\n"
        "quiet = dict.fromkeys(('stdin', 'stdout', 'stderr'), subprocess.DEVNULL)\n"
        "helper = subprocess.Popen(['sleep', '1000'], start_new_session=True, **quiet)\n"
        f"open({str(started)!r}, 'a').write(f'{{helper.pid}}\\n')\n"
    )
    program.write_text(more + program.read_text(encoding="utf-8"), encoding="utf-8")
    flies(ROLL.replace(controller=f"process:{program}", duration_s=0.1))
    helpers = [int(line) for line in started.read_text().splitlines()]
    assert helpers
    assert all(is_ended(helper) for helper in helpers)


def test_a_program_with_a_file_of_toml_as_its_argument_is_no_design(tmp_path: Path, reference: Run) -> None:
    names = {"a/b.toml": True, "B.TOML": True, "b.fmu.toml": False, "process:l.py b.toml": False}
    assert {name: is_design(name) for name in names} == names
    script = of_page("script", tmp_path / "loop.py")
    assert same(reference, fly(ROLL.replace(controller=f"process:{script} gains.toml")))


QUADJET = Scenario.load("quadjet-hover").replace(duration_s=0.4, command=[DOUBLET], expect=[])
OUTSIDE = """
import json, struct, sys
from math import nan
from cosim.base.protocols import EngineState
from cosim.base.signals import Command, Disturbance, EngineOutput, Measured
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario

read, write = sys.stdin.buffer, sys.stdout.buffer
write.write(b'{"level": "controller", "extras": ["unallocated", "off", "shown"]}\\n')
write.flush()
line = read.readline()
told = json.loads(line) if line else sys.exit()
simulation = build(Scenario.load(FLOWN))
cascade, jets = simulation.cascade, len(told["vehicle"]["jets"])
asked, answer = struct.Struct(f"<{1 + len(told['inputs'])}d"), struct.Struct(f"<{1 + len(told['outputs'])}d")
while len(frame := read.read(asked.size)) == asked.size:
    k, *numbers = asked.unpack(frame)
    at = dict(zip(told["inputs"], numbers, strict=True))
    def some(text):
        return tuple(at[name] for name in text.split())
    def per_jet(name):
        return tuple(at[f"{name}_{jet}"] for jet in range(1, jets + 1))
    if k == 0:
        cascade.reset(told["on_ground"], at["fuel_burnt"])
    else:
        assert tuple(at[f"tilt_{name}_applied"] for name in told["servos"]) == given.tilt
        unknown = (nan,) * jets
        reports = map(per_jet, ("spool_speed", "exhaust_temperature", "fuel_flow"))
        cascade.watch(EngineOutput(unknown, *reports), at["fuel_burnt"])
    command = Command(
        some("roll_setpoint pitch_setpoint yaw_setpoint"), at["altitude_setpoint"],
        ahead=at["ahead_setpoint"] if at.get("ahead_commanded") else None,
    )
    measured = Measured(
        some("roll_rate pitch_rate yaw_rate"), some("attitude_w attitude_x attitude_y attitude_z"),
        some("position_north position_east position_down"), some("velocity_north velocity_east velocity_down"),
        at["altitude"], some("specific_force_x specific_force_y specific_force_z"),
    )
    given = cascade.update(command, measured, Disturbance(), EngineState.FLY)
    s = cascade.signals
    shown = (*s.rate_setpoint, *s.rate_predicted, *s.torque, s.collective, s.allocated)
    off = [float(jet in given.off) for jet in range(jets)]
    write.write(answer.pack(k, *given.throttle, *given.tilt, *given.unallocated, *off, *shown))
    write.flush()
"""
AHEAD = {"kind": "step", "signal": "ahead_m_s", "start_s": 0.04, "amplitude": 20.0}


@pytest.mark.parametrize(
    "flown", [ROLL, QUADJET, Scenario.load("jetwing-transition").replace(duration_s=0.2, command=[AHEAD], expect=[])]
)
def test_the_whole_cascade_flies_from_a_process_as_inside_with_banks_hinges_or_a_wing(
    flown: Scenario, tmp_path: Path
) -> None:
    script = tmp_path / "outside.py"
    script.write_text(OUTSIDE.replace("FLOWN", repr(str(tmp_path / "flown.toml"))))
    (tmp_path / "flown.toml").write_bytes(scenario_toml(flown))
    ours, theirs = flies(flown), flies(flown.replace(controller=f"process:{script}"))
    # what the law for the wing shows, and the health of engines, are the built-in controller's alone
    names = [name for name in ours.log.columns if name in theirs.log.columns and not name.startswith("health")]
    assert {f"tilt_{hinge.name}_rad" for hinge in flown.resolved_vehicle()[0].hinges} <= set(names)
    assert all(ours.log[name].tobytes() == theirs.log[name].tobytes() for name in names)


def test_an_fmu_is_told_hinges_and_moves_them(tmp_path: Path) -> None:
    ours = fly(QUADJET).log
    vehicle, _ = QUADJET.resolved_vehicle()
    jets, hinges = len(vehicle.jets), [hinge.name for hinge in vehicle.hinges]
    told = [f"throttle_{jet}" for jet in range(1, jets + 1)] + [f"tilt_{name}_command_rad" for name in hinges]
    table = zip(*(ours[name].tolist() for name in told), strict=True)
    (tmp_path / "table.h").write_text("".join(f"{{{', '.join(map(repr, row))}}},\n" for row in table))
    # as others spell them, and not in the vehicle's order
    spelt = ["Tilt" + name.title().replace("_", "") for name in hinges]
    rows = [(f"{name}Applied", 1 + n, "input", 'start="0"') for n, name in enumerate(spelt)]
    rows += [(name, 31 + jets + n, "output", "") for n, name in reversed(list(enumerate(spelt)))]
    rows += [(f"throttle_{n}", 30 + n, "output", "") for n in range(1, jets + 1)]
    path = by_hand(tmp_path, rows, f"-DANSWERS={len(told)}", f"-DJETS={jets}")
    theirs = flies(QUADJET.replace(controller=str(path))).log
    moved = [name for name in ours.columns if name.startswith(("throttle", "tilt", "thrust", "position", "roll_rad"))]
    assert all(ours[name].tobytes() == theirs[name].tobytes() for name in moved)
    said = fly(Scenario.load("hover").replace(duration_s=0.02, expect=[], controller=str(path))).reason
    assert f"is for {jets} jets and servos " in said
    assert "; hexjet has 6 and servos left, right" in said


WRONG = """
import json, os, random, struct, sys, time
print('{"level": "predictor"}', flush=True)
line = sys.stdin.buffer.readline()
told = json.loads(line) if line else sys.exit()
out = sys.stdout.buffer
while len(frame := sys.stdin.buffer.read(24)) == 24:
    k, measured, applied = struct.unpack("<3d", frame)
    answer = struct.pack("<2d", k, measured)
    if k == 10:
        WHAT
    out.write(answer)
    out.flush()
"""


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("time.sleep(60)", "the process did not answer within 3 s"),
        ("os.abort()", "the process was ended by SIGABRT"),
        ("sys.exit(3)", "the process ended with status 3"),
        ("os.close(1); time.sleep(60)", "the process closed its output"),
        ("answer = struct.pack('<2d', k, float('nan'))", "the rate of roll = nan: must be finite"),
        ("answer = b'debugging prints'", "and not with the step; does it print to its output?"),
        ("answer = struct.pack('<2d', -1.0, 0.0) + b'no more\\n'", "no more"),
    ],
)
def test_what_a_process_does_wrong_ends_the_run_which_names_it(tmp_path: Path, what: str, reason: str) -> None:
    script = tmp_path / "wrong.py"
    script.write_text(WRONG.replace("WHAT", what))
    limit = 3.0 if "within" in reason else 60.0
    run = fly(ROLL.replace(duration_s=0.1, controller=f"process:{script}", controller_limit_s=limit))
    assert run.outcome == "failed"
    assert run.reason.startswith("controller process:wrong.py: ")
    assert reason in run.reason
    assert "at step 10 (0.040 s)" in run.reason
    assert len(run.log) == 10


def test_one_that_is_not_repeatable_is_called_so(tmp_path: Path, hexjet: Hexjet) -> None:
    (tmp_path / "dice.py").write_text(
        WRONG.replace("WHAT", "answer = struct.pack('<2d', k, measured + 1e-9 * random.random())")
    )
    told = hexjet(*["fly", "hover", "--controller", "process:dice.py", "--set", "duration_s=0.1", "--out", "run"]).told
    assert "controller process:dice.py is not repeatable" in told
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["own_controller"]["repeatable"] is False


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("raise SystemExit('no licence')", "the process ended with status 1 before it had said what it is: no licence"),
        ("print('hello')", "its first line is no JSON: b'hello'"),
        ({"level": "pilot"}, "level = 'pilot': must be one of predictor, rate, attitude, controller"),
        ({"level": "rate", "colums": []}, "'colums': did you mean 'columns'?"),
        ({"level": "rate", "parameters": 1}, "parameters = 1: must be a list of Parameter(name, default, ...)"),
        ({"level": "controller", "extras": 1}, "extras = 1: must be a list"),
        (
            {"level": "rate", "extras": ["off"]},
            "extras: 'off': must be of a whole controller, and one of unallocated, off, shown",
        ),
    ],
)
def test_what_is_no_controller_is_one_line(tmp_path: Path, text: str | dict[str, Any], message: str) -> None:
    (tmp_path / "wrong.py").write_text(text if isinstance(text, str) else f"print({json.dumps(text)!r})")
    with pytest.raises(InputError, match=re.escape(message)):
        fly(ROLL.replace(controller=f"process:{tmp_path / 'wrong.py'}"))
    with pytest.raises(InputError, match="no such file"):
        fly(ROLL.replace(controller="process:nowhere.py"))


ROWS = [
    *[(name, 1 + n, "input", 'start="0"') for n, name in enumerate(wire.input_names("rate", 6)[:6])],
    *[(name, 11 + n, "output", "") for n, name in enumerate(wire.output_names("rate", 6, ()))],
    ("roll_integral", 14, "output", ""),
    ("share", 20, "parameter", 'start="1" min="0" max="10"'),
]


@pytest.fixture(scope="module")
def fmu_c(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU of FMI 2.0 that nobody's tool wrote."""
    return by_hand(tmp_path_factory.mktemp("fmu"), ROWS)


def by_hand(folder: Path, rows: Sequence[tuple[str, int, str, str]], *flags: str) -> Path:
    source = TOOLS / "foreign_controller.c"
    defined = set(re.findall(r"(fmi2\w+)\(", source.read_text()))
    needed = {each for each, _ in inspect.getmembers(FMU2Slave) if each.startswith("fmi2")}
    stubs = "\n".join(f"int {each}(void) {{ return 3; }}" for each in sorted(needed - defined))
    (folder / "all.c").write_text(f'#include "{source}"\n{stubs}\n')
    binary = folder / f"loop{fmpy.sharedLibraryExtension}"
    flags = ("-shared", "-fPIC", "-O2", "-w", "-ffp-contract=off", f"-I{folder}", *flags)
    subprocess.run([shutil.which("cc") or "gcc", *flags, str(folder / "all.c"), "-o", str(binary)], check=True)
    fixed = ' variability="fixed"'
    made = "\n".join(
        f'<ScalarVariable name="{name}" valueReference="{place}" causality="{causality}"'
        f"{fixed if causality == 'parameter' else ''}><Real {more}/></ScalarVariable>"
        for name, place, causality, more in rows
    )
    outputs = [k for k, row in enumerate(rows, start=1) if row[2] == "output"]
    unknown = "".join(f'<Unknown index="{k}"/>' for k in outputs)
    with zipfile.ZipFile(folder / "loop.fmu", "w") as archive:
        archive.writestr(
            "modelDescription.xml",
            '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="2.0" modelName="loop" guid="loop">'
            '<CoSimulation modelIdentifier="loop" canHandleVariableCommunicationStepSize="true"/>'
            f"<ModelVariables>{made}</ModelVariables><ModelStructure><Outputs>{unknown}</Outputs>"
            f"<InitialUnknowns>{unknown}</InitialUnknowns></ModelStructure></fmiModelDescription>",
        )
        archive.write(binary, f"binaries/{fmpy.platform}/{binary.name}")
    return folder / "loop.fmu"


def test_an_fmu_written_by_hand_flies_as_the_class(fmu_c: Path, reference: Run, tmp_path: Path) -> None:
    run = flies(ROLL.replace(controller=str(fmu_c)), tmp_path / "run")
    assert same(reference, run)
    own = own_of(run)
    assert (own.level, own.repeatable, own.parameters) == ("rate", True, {"share": 1.0})
    assert same(run, fly(Scenario.load(tmp_path / "run" / "scenario.toml")))


def test_a_parameter_with_a_dot_in_its_name_is_one_too(fmu_c: Path, tmp_path: Path) -> None:
    def rename(contents: dict[str, bytes]) -> None:
        contents["modelDescription.xml"] = contents["modelDescription.xml"].replace(b'"share"', b'"pid.share"')

    path = rewrite(fmu_c, tmp_path / "dotted.fmu", rename)
    scenario = ROLL.replace(duration_s=0.2)
    run = flies(scenario.replace(controller=str(path), controller_parameters={"pid_share": 0.5}))
    assert same(run, fly(scenario.replace(controller=str(fmu_c), controller_parameters={"share": 0.5})))
    assert not same(run, fly(scenario.replace(controller=str(fmu_c))))


PYTHON_FMU = """
from pythonfmu3 import Fmi3Causality, Fmi3Slave, Fmi3Variability, Float64

class PythonLoop(Fmi3Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.share, self.integral = 0.0, 1.0, [0.0, 0.0, 0.0]
        moving = {"variability": Fmi3Variability.continuous}
        self.register_variable(Float64("time", causality=Fmi3Causality.independent, **moving))
        self.register_variable(Float64("share", causality=Fmi3Causality.parameter, variability=Fmi3Variability.fixed))
        for axis in ("roll", "pitch", "yaw"):
            for name, causality in (
                (f"{axis}_asked", Fmi3Causality.input), (f"gyro_{axis}", Fmi3Causality.input),
                (f"{axis}_torque", Fmi3Causality.output),
            ):
                setattr(self, name, 0.0)
                self.register_variable(Float64(name, causality=causality, **moving))

    def do_step(self, time, step):
        for n, (axis, gain) in enumerate(zip(("roll", "pitch", "yaw"), (0.05, 0.2, 0.2))):
            error = getattr(self, f"{axis}_asked") - getattr(self, f"gyro_{axis}")
            self.integral[n] += 0.5 * step * error
            setattr(self, f"{axis}_torque", self.share * gain * (error + self.integral[n]))
        return True
"""


def test_one_of_pythonfmu3_through_a_mapping_file(tmp_path: Path, reference: Run, hexjet: Hexjet) -> None:
    script = tmp_path / "pythonloop.py"
    script.write_text(PYTHON_FMU)
    command = [sys.executable, "-m", "pythonfmu3", "build", "-f", str(script), "-d", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    axes = ("roll", "pitch", "yaw")
    lines = [f'{axis}_rate_setpoint = "{axis}_asked"\n{axis}_rate = "gyro_{axis}"\n' for axis in axes]
    mapping = tmp_path / "mine.fmu.toml"
    mapping.write_text('fmu = "PythonLoop.fmu"\n[ports]\n' + "".join(lines))
    run = flies(ROLL.replace(controller=str(mapping)), tmp_path / "run")
    assert own_of(run).repeatable
    assert set(own_of(run).files) == {"mine.fmu.toml", "PythonLoop.fmu"}
    # the time of its step is the difference of two of FMI's times, so to rounding
    names = [name for name in reference.log.columns if "rad" in name and not re.search("seen|predicted", name)]
    both = [name for name in names if name in run.log.columns]
    assert max(abs(reference.log[name] - run.log[name]).max() for name in both) < 1e-9
    said = hexjet("engine", "check", str(mapping)).told
    assert re.search(r"level +rate", said)
    assert "is not told of: roll_applied, pitch_applied, yaw_applied" in said
    mapping.write_text('fmu = "PythonLoop.fmu"\n[ports]\nroll_rate = "gyro"\n')
    with pytest.raises(InputError, match=r"ports\.roll_rate = 'gyro': is no input of it; did you mean"):
        fly(ROLL.replace(controller=str(mapping)))


def test_an_fmu_that_crashes_ends_the_run(fmu_c: Path) -> None:
    fmu = read_controller_fmu(fmu_c)
    assert (fmu.level, list(fmu.inputs)) == ("rate", list(wire.input_names("rate", 6)[:6]))
    command = {"kind": "step", "signal": "rate_p_deg_s", "start_s": 0.04, "amplitude": 1e6}
    run = fly(ROLL.replace(controller=str(fmu_c), command=[command, command | {"start_s": 0.044}] * 40))
    assert run.outcome == "failed", run.reason
    assert "loop.fmu: the process was ended by SIGABRT" in run.reason


def test_an_engine_is_no_controller() -> None:
    with pytest.raises(InputError, match=r"edf\.fmu: is no controller: it has no output throttle_1, roll_torque"):
        fly(ROLL.replace(controller=str(ROOT / "fmus" / "edf.fmu")))
