"""A controller as C: the bits of the flight, with every compiler that is here, and what is refused."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from command_tools import Hexjet
from exported_controllers import CASES, CC, HEXJET, LOOPS, STRICT, driven, made, scenario, written
from long_cases import long_after, long_case
from places import DESIGNS, TOOLS

from cosim import fly
from cosim.base.errors import InputError
from cosim.control.predictors.registry import PREDICTORS
from cosim.simulation.build import build
from hexjet_export.controller import measure
from hexjet_export.controller.export import ExportedController, export_controller
from hexjet_export.controller.form import LAWS, make_form, make_predictor_form
from hexjet_export.controller.vectors import INPUTS, list_output_names, record_vectors

pytestmark = pytest.mark.skipif(CC is None, reason="no C compiler")


def ran(folder: Path, *flags: str, cc: str | None = CC, name: str = "ours") -> subprocess.CompletedProcess[str]:
    """What the test program says, compiled with warnings as errors."""
    program = folder / "program"
    files = [str(folder / source) for source in measure.list_sources(name)]
    command = [str(cc), *measure.CFLAGS, *STRICT, *flags, "-o", str(program), *files, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return subprocess.run([str(program)], capture_output=True, text=True, check=False)


# what these have in C is also in one of the others
REPEATED = {
    "state", "a broken delay, smith", "pairs of poles, smith", "four poles, state-disturbance", "leads of a single lag",
    "a schedule without leads", "curves, leads and schedule", "a rate law of PIDs",
}  # fmt: skip


@pytest.mark.parametrize("case", [long_case(case) if case in REPEATED else case for case in CASES])
def test_every_branch_of_every_controller_gives_the_same_bits(case: str, tmp_path: Path) -> None:
    name, changes = CASES[case]
    with build(made(name, changes)) as simulation:
        form = make_form(simulation)
        folder = written(tmp_path, simulation, driven(simulation, 300, seed=len(case)), form)
    done = ran(folder, "-O2")
    assert done.returncode == 0, done.stdout
    assert "300 steps, 0 numbers differ" in done.stdout


@pytest.mark.parametrize("case", LOOPS)
def test_the_loops_alone_ask_for_the_same_bits(case: str, tmp_path: Path) -> None:
    """Told what was not given in the step before, as by a mixer of one's own; at limits most of the time."""
    name, changes = LOOPS[case]
    with build(made(name, changes)) as simulation:
        form = make_form(simulation, loops=True)
        folder = written(tmp_path, simulation, driven(simulation, 300, seed=len(case)), form)
    done = ran(folder, "-O2")
    assert done.returncode == 0, done.stdout
    assert "300 steps, 0 numbers differ in their bits; greatest deviation: collective 0, torque 0" in done.stdout
    text = (folder / "ours.h").read_text(encoding="utf-8")
    assert " throttle[" not in text
    assert "unallocated[4]; /* roll, pitch, yaw, collective: what your mixer could not give" in text
    assert ("angular accelerations" in text) == (changes["controller"] == "baseline")


def test_the_loops_alone_are_one_command(hexjet: Hexjet, tmp_path: Path) -> None:
    """With the aircraft whose surfaces have no C form, which the refusal of the whole says."""
    options = ["--scenario", "jetwing-roll-doublet", "--set", "duration_s=0.2"]
    done = hexjet("export", "controller", *options, "--loops", "--out", str(tmp_path / "out"), "--json")
    assert (done.status, done.err) == (0, "")
    said = json.loads(done.out)
    assert (said["steps"], said["measured"]["same"]) == (50, True)
    assert said["without_fmus"] == "the loops alone are C for a mixer of yours"
    assert "the loops alone" in (tmp_path / "out" / "README.md").read_text(encoding="utf-8")


COMPILERS = [
    pytest.param(cc, marks=[] if shutil.which(cc) else pytest.mark.skip(reason=f"no {cc} here"))
    for cc in ("gcc", "clang")
]


@pytest.fixture(
    scope="module", params=["roll-doublet smith", "full-scale-roll-doublet smith", "trijet-roll-doublet baseline"]
)
def flown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The vectors of a flight."""
    name, controller = request.param.split()
    with build(scenario(name, controller=controller, duration_s=4.0)) as simulation:
        form = make_form(simulation)
        return written(tmp_path_factory.mktemp("flown"), simulation, record_vectors(simulation), form)


@pytest.mark.parametrize("cc", COMPILERS)
@pytest.mark.parametrize("level", ["-O2", long_case("-O0")])
def test_a_flight_is_repeated_to_the_last_bit(flown: Path, cc: str, level: str) -> None:
    done = ran(flown, level, cc=cc)
    assert (done.returncode, "1000 steps, 0 numbers differ" in done.stdout) == (0, True), done.stdout


def test_single_precision_stays_within_half_a_step_of_a_12_bit_command(flown: Path) -> None:
    done = ran(flown, "-O2", "-DOURS_FLOAT")
    assert done.returncode == 0, done.stdout
    assert "0 numbers differ" not in done.stdout.replace("10 numbers", "")  # it is not double under another name


NEARLY = "nearly"  # newlib rounds some functions otherwise where doubles are in software, in Debian 12's at least
CROSS = shutil.which("arm-none-eabi-gcc"), shutil.which("qemu-system-arm")


@pytest.mark.skipif(None in CROSS, reason="no arm-none-eabi-gcc, or no qemu-system-arm, here")
@pytest.mark.parametrize(
    ("board", "flags", "says"),
    [
        ("mps2-an386", ["-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-DOURS_FLOAT"], ""),
        ("mps2-an386", ["-mcpu=cortex-m4", "-mfloat-abi=soft"], NEARLY),
        ("mps2-an500", ["-mcpu=cortex-m7", "-mfloat-abi=hard", "-mfpu=fpv5-d16"], ", 0 numbers differ"),
    ],
    ids=["float on a Cortex-M4", "double on a Cortex-M4", "double on a Cortex-M7"],
)
def test_a_microcontroller_repeats_the_flight(flown: Path, board: str, flags: list[str], says: str) -> None:
    cc, qemu = CROSS
    image = flown / "image.elf"
    files = [*(str(flown / source) for source in measure.list_sources("ours")), str(TOOLS / "cortex_m_start.c")]
    script = str(TOOLS / "cortex_m.ld")
    built = [str(cc), *measure.CFLAGS, *flags, "-mthumb", "-O2", "--specs=rdimon.specs", "-T", script, "-o", str(image)]
    done = subprocess.run([*built, *files, "-lm"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    options = ["-M", board, "-nographic", "-semihosting-config", "enable=on,target=native", "-kernel", str(image)]
    ran = subprocess.run([str(qemu), *options], capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)
    if says == NEARLY and ran.returncode == 1:
        off = re.search(r"greatest deviation: throttle (\S+), tilt (\S+) rad", ran.stdout)
        assert off is not None, ran.stdout + ran.stderr
        assert max(map(float, off.groups())) < 1e-10
        return
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert f"1000 steps{', 0 numbers differ' if says == NEARLY else says}" in ran.stdout


def test_single_precision_says_where_it_is_not_enough(tmp_path: Path) -> None:
    """The one built-in controller of docs/export.md that a float does not carry."""
    flight = scenario("full-scale-roll-doublet", controller="filtered-smith", duration_s=3.0)
    done = export_controller(flight, tmp_path / "out", name="ours", fmus=False).exported
    assert done.measured is not None
    assert (done.measured.same, done.measured.float_passes) == (True, False)
    assert "not within half a step of a 12-bit command" in (tmp_path / "out" / "README.md").read_text(encoding="utf-8")


def test_the_test_program_finds_a_controller_that_is_another(flown: Path, tmp_path: Path) -> None:
    """One gain that is off by its last bit."""
    folder = shutil.copytree(flown, tmp_path / "other")
    path = folder / "ours_parameters.c"
    text = path.read_text(encoding="utf-8")
    before, _, rest = text.partition(".roll = {.p = R(")
    value, _, after = rest.partition(")")
    changed = float.fromhex(hex_up(float(value)))
    path.write_text(f"{before}.roll = {{.p = R({changed!r}){after}", encoding="utf-8")
    done = ran(folder, "-O2")
    assert done.returncode == 1
    assert "first at step" in done.stdout


def hex_up(value: float) -> str:
    """The next double."""
    from math import inf, nextafter

    return nextafter(value, inf).hex()


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="no cppcheck here")
def test_cppcheck_has_nothing_to_say(flown: Path) -> None:
    files = [str(flown / name) for name in ("ours.c", "ours_parameters.c", "test_ours.c")]
    options = [
        "--enable=warning,style,performance,portability",
        "--std=c99",
        "--inconclusive",
        "--error-exitcode=3",
        "-q",
    ]
    done = subprocess.run(["cppcheck", *options, *files], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    strict = ["cppcheck", "--addon=misra", "--enable=style", "--std=c99", "-q", *files[:2]]
    said = subprocess.run(strict, capture_output=True, text=True, check=False).stderr
    assert set(re.findall(r"misra-c2012-([\d.]+)", said)) <= {"2.5", "12.1", "12.3"}  # as docs/export.md says


def test_no_heap_no_globals_no_library_but_mathematics(flown: Path, tmp_path: Path) -> None:
    """What the object files define and need; data that can be written would be state."""
    objects = []
    for source in ("ours.c", "ours_parameters.c"):
        objects.append(tmp_path / f"{source}.o")
        subprocess.run([str(CC), *measure.CFLAGS, "-O2", "-c", "-o", objects[-1], flown / source], check=True)
    listed = subprocess.run(["nm", *objects], capture_output=True, text=True, check=True).stdout
    kinds = {line.split()[-2]: line.split()[-1] for line in listed.splitlines() if len(line.split()) >= 2}
    symbols = [line.split() for line in listed.splitlines() if len(line.split()) >= 2]
    assert not [s for s in symbols if s[-2] in "dDbBC"], listed
    needed = {s[-1] for s in symbols if s[-2] == "U"} - {"ours_parameters"}
    # what a compiler may call for copies and zeros, in a program without a library too
    needed -= {"memcpy", "memset", "memmove"}
    assert needed <= {"sin", "cos", "sincos", "exp", "sqrt", "__stack_chk_fail"}, needed
    assert kinds


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> ExportedController:
    """A whole folder."""
    folder = tmp_path_factory.mktemp("exported") / "out"
    return export_controller(
        scenario(HEXJET, controller="smith", duration_s=2.0), folder, name="ours", licence="MIT"
    ).exported


def test_a_folder_has_what_is_said_of_it(exported: ExportedController) -> None:
    folder, found = exported.folder, exported.measured
    assert sorted(exported.files) == sorted(path.name for path in folder.iterdir())
    assert {"ours.fmu", "ours-fmi2.fmu", "ours.c", "README.md"} <= set(exported.files)
    assert (exported.steps, exported.without_fmus) == (500, None)
    assert found is not None
    assert found.same
    assert found.float_passes
    assert found.stack is None or 0 < found.stack < 4096
    assert found.state is not None
    for path in folder.glob("*.[ch]"):
        assert path.read_text(encoding="utf-8").startswith("/* SPDX-License-Identifier: MIT */\n")
    head = (folder / "ours.h").read_text(encoding="utf-8")
    assert "the engine monitor and the plans around lost engines" in head
    assert f"{found.state} bytes" in (folder / "README.md").read_text(encoding="utf-8")


def test_the_command_says_what_it_came_to(hexjet: Hexjet, tmp_path: Path) -> None:
    designed = ["--controller", str(DESIGNS / "turbojet.toml"), "--engine", "turbojet"]
    options = ["--set", "duration_s=0.2", "--no-fmu", "--out", str(tmp_path / "out")]
    done = hexjet("export", "controller", *designed, *options, "--json")
    assert (done.status, done.err) == (0, "")
    said = json.loads(done.out)
    assert (said["steps"], said["measured"]["same"]) == (50, True)
    assert sorted(said["files"]) == sorted(path.name for path in (tmp_path / "out").iterdir())
    text = (tmp_path / "out" / "controller_parameters.c").read_text(encoding="utf-8")
    assert text.startswith("/* SPDX-License-Identifier: NOASSERTION */\n")
    assert " of turbojet.toml\n" in text


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_fmus_answer_as_the_flight(exported: ExportedController, fmi: int, tmp_path: Path) -> None:
    import fmpy
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    path = exported.folder / ("ours.fmu" if fmi == 3 else "ours-fmi2.fmu")
    assert fmpy.validation.validate_fmu(str(path)) == []
    with build(scenario(HEXJET, controller="smith", duration_s=2.0)) as simulation:
        vectors = record_vectors(simulation)
    description = fmpy.read_model_description(str(path))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    slave = (FMU2Slave if fmi == 2 else FMU3Slave)(
        guid=description.guid if fmi == 2 else description.instantiationToken,
        unzipDirectory=fmpy.extract(str(path), str(tmp_path)),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="ours",
    )
    slave.instantiate()
    if fmi == 2:
        slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    put, get = (slave.setReal, slave.getReal) if fmi == 2 else (slave.setFloat64, slave.getFloat64)
    into = [reference[name] for name in INPUTS]
    out = [reference[name] for name in list_output_names(6)]
    assert tuple(get(out[:6])) == vectors.start
    for k, row in enumerate(vectors.rows):
        put(into, list(row[: len(INPUTS)]))
        slave.doStep(k * 0.004, 0.004)
        assert tuple(get(out)) == row[len(INPUTS) :], k
    slave.terminate()
    slave.freeInstance()


BACK = {
    "FMI 3": ("ours.fmu", HEXJET, {"controller": "smith"}),
    "FMI 2, leads and schedule": ("ours-fmi2.fmu", "full-scale-roll-doublet", {"controller": "state-model"}),
    # from the ground: in the air a controller from outside begins with even thrusts
    "hinges": ("ours.fmu", "trijet-climb-and-land", {"controller": "baseline", "duration_s": 6.0}),
    "a rotorcraft": (
        "ours.fmu",
        HEXJET,
        {"controller": "smith", "aircraft": "quadrotor", "engine": "motor", "step_s": 0.0025},
    ),
}


@pytest.mark.parametrize("case", long_after(2, BACK))
def test_flown_back_it_leaves_the_same_log(case: str, exported: ExportedController, tmp_path: Path) -> None:
    """Every sample of every column, as bytes: NaN included."""
    file, name, changes = BACK[case]
    flight = scenario(name, **{"duration_s": 2.0, **changes})
    folder = exported.folder if case == "FMI 3" else export_controller(flight, tmp_path / "out", name="ours").folder
    ours = fly(flight, report=False).log
    theirs = fly(flight.replace(controller=str(folder / file)), report=False).log
    assert theirs.columns == ours.columns
    assert [column for column in ours.columns if ours[column].tobytes() != theirs[column].tobytes()] == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--name", "2nd"], "name 2nd: must be a C identifier"),
        (["--licence", "a */ b"], "licence a */ b: must be one line of letters"),
        (["--out", "."], "is there already and not an empty folder"),
        (["--scenario", "fault-flame-out"], "allocation with a failed engine is not exported"),
        (["--scenario", "jetwing-roll-doublet", "--set", "duration_s=0.2"], "surfaces have no C form; with loops"),
        (["--scenario", "jetwing-cruise", "--loops"], "a speed ahead, flown by the wing's law, which is not exported"),
        (["--loops", "--for", "px4"], "loops: not with an autopilot"),
    ],
)
def test_what_cannot_be_is_one_line(hexjet: Hexjet, arguments: list[str], message: str, tmp_path: Path) -> None:
    (tmp_path / "kept").touch()
    given = [str(tmp_path) if each == "." else each for each in arguments]
    out = [] if "--out" in given else ["--out", str(tmp_path / "new")]
    done = hexjet("export", "controller", *given, *out)
    assert (done.status, done.out) == (2, "")
    assert message in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_every_built_in_predictor_has_a_c_form() -> None:
    """And is among those whose bits are compared."""
    ours = {spec.name for spec in PREDICTORS.values() if spec.make.__module__.startswith("cosim.")}
    assert ours | {"pid-smith", "optimal"} == {changes.get("controller", "smith") for _, changes in CASES.values()}


@pytest.mark.parametrize("name", LAWS)
def test_laws_that_are_named_have_a_c_form_and_others_say_which_have(name: str) -> None:
    with build(scenario(HEXJET).replace(controller=name)) as simulation:
        assert make_form(simulation)["law"]
    refused = rf"^controller adrc.* has no C form; allowed: baseline, .*{name}"
    with build(scenario(HEXJET).replace(controller="adrc")) as simulation, pytest.raises(InputError, match=refused):
        make_form(simulation)


def test_a_flight_by_requests_is_refused(tmp_path: Path) -> None:
    flight = scenario(HEXJET).model_copy(update={"requests": "requests.jsonl"})
    with pytest.raises(InputError, match="is flown by an autopilot's requests; choose one with commands"):
        export_controller(flight, tmp_path / "out", name="ours")


@pytest.mark.parametrize("level", ["predictor", "rate", "controller"])
def test_a_controller_of_the_users_is_refused_by_its_name(level: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(
        f"class Mine:\n    level = {level!r}\n    def reset(self): ...\n    def update(self, *given): ...\n"
    )
    flight = scenario(HEXJET).replace(controller=f"{path}:Mine")
    with pytest.raises(InputError, match=r"^controller mine\.py:Mine has no C form; allowed: baseline, "):
        export_controller(flight, tmp_path / "out", name="ours")
    assert not (tmp_path / "out").exists()


def test_a_predictor_of_somebody_elses_has_no_c_form() -> None:
    class Own:
        def reset(self) -> None: ...

        def update(self, measured: float, applied: float) -> float:
            return measured

    with pytest.raises(InputError, match=r"^pitch: the predictor Own has no C form; those that have: NoPredictor, "):
        make_predictor_form(Own(), "pitch")


def test_without_a_compiler_the_text_is_written_and_nothing_claimed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    done = export_controller(scenario(HEXJET, duration_s=0.1), tmp_path / "out", name="ours", fmus=False).exported
    assert done.measured is None
    assert "nothing: no C compiler was found" in (tmp_path / "out" / "README.md").read_text(encoding="utf-8")


def test_a_compiler_that_refuses_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = tmp_path / "cc"
    compiler.write_text("#!/bin/sh\necho 'x.c:1: error: out of sorts' >&2\nexit 1\n", encoding="utf-8")
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    with pytest.raises(InputError, match=r"refuses: x\.c:1: error: out of sorts"):
        export_controller(scenario(HEXJET, duration_s=0.1), tmp_path / "out", name="ours", fmus=False)


def test_the_stack_is_that_of_the_deepest_way() -> None:
    def node(name: str, size: int) -> str:
        return f'node: {{ title: "{name}" label: "{name}\\nc.c:1:2\\n{size} bytes (static)\\n0 dynamic objects" }}\n'

    def edge(source: str, target: str) -> str:
        return f'edge: {{ sourcename: "{source}" targetname: "{target}" label: "c.c:3:4" }}\n'

    graph = node("a", 16) + node("b", 32) + node("c", 64) + node("d", 8)
    graph += edge("a", "b") + edge("a", "c") + edge("b", "d") + edge("c", "sin")
    assert measure._greatest_stack(graph) == 80
    assert measure._greatest_stack("") is None
