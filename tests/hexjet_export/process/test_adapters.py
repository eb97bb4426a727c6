"""A controller inside an autopilot: the adapters that an export writes, against declarations of ours, and flown."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from autopilot_standins import free_port
from command_tools import Hexjet
from numpy.typing import NDArray
from places import TOOLS
from scipy.optimize import brentq

from cosim.base.errors import InputError
from cosim.base.geodesy import Geodesy
from cosim.base.protocols import EngineState
from cosim.base.signals import ZERO3, Command, Disturbance, EngineOutput, Measured
from cosim.results.run import Run
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from hexjet_export.controller import measure
from hexjet_export.controller.adapters import render_adapter
from hexjet_export.controller.files import Labels
from hexjet_export.controller.form import make_form
from hexjet_sitl import betaflight as theirs
from hexjet_sitl.firmware_parameters import find_torque_scale
from hexjet_sitl.lockstep import Setup
from hexjet_sitl.run import fly_autopilot

CC = measure.find_compiler()
STUBS = TOOLS / "stubs"
CXX = shutil.which("c++") or shutil.which("g++")
WARNINGS = ("-Wall", "-Wextra", "-Werror", "-Wdouble-promotion", "-Wfloat-equal", "-Wshadow")
# What the adapters include, each with all that the stub of their autopilot declares.
HEADERS = {
    "ardupilot": (
        "AC_CustomControl_config.h",
        "AC_CustomControl_Backend.h",
        "AP_Scheduler/AP_Scheduler.h",
        "GCS_MAVLink/GCS.h",
    ),
    "px4": (
        "drivers/drv_hrt.h",
        *(f"px4_platform_common/{name}" for name in ("atomic.h", "defines.h", "log.h", "px4_work_queue/WorkItem.hpp")),
        *(f"uORB/{name}.hpp" for name in ("Publication", "Subscription", "SubscriptionCallback")),
        *(f"uORB/topics/vehicle_{name}.h" for name in ("angular_velocity", "control_mode", "land_detected")),
        *(f"uORB/topics/vehicle_{name}_setpoint.h" for name in ("rates", "thrust", "torque")),
    ),
}
try:
    BINARY: Path | None = theirs.find_program(None)
except InputError:
    BINARY = None

Array = NDArray[np.float64]

pytestmark = pytest.mark.skipif(CC is None, reason="no C compiler")


def scenario(name: str) -> Scenario:
    """The Hex-Jet on two tilting banks, with curves of thrust too, or four rotors; each with a predictor."""
    if name == "hexjet-p220":
        return Scenario.load("full-scale-roll-doublet").replace(expect=[], controller="smith")
    made = Scenario.load("roll-doublet").replace(expect=[], controller="smith")
    return made.replace(aircraft="quadrotor", engine="motor", step_s=0.0025) if name == "quadrotor" else made


def adapted(name: str, autopilot: str, folder: Path) -> tuple[Array, Array]:
    """Write an adapter; a drive for it, and the torques that the controller of Python gives for that, in theirs."""
    flown = scenario(name)
    vehicle, _ = flown.resolved_vehicle()
    worth = find_torque_scale(autopilot, vehicle)
    with build(flown) as simulation:
        form = make_form(simulation)
        for file, text in render_adapter(form, Labels("ours", "a test", "MIT", ()), autopilot, worth).items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(text)
        controller, jets = simulation.controller, len(vehicle.jets)
        controller.reset(True, 0.0)
        quiet = EngineOutput(*[(0.0,) * jets] * 4)
        draw = np.random.default_rng(5)
        drive, torques = [], []
        for k in range(400):
            flies = not 150 <= k < 160
            size = 0.05 if k < 300 else 3.0  # at the end the allocation is at its limits
            asked, rate = (size * draw.standard_normal(3).astype(np.float32) for _ in range(2))
            throttle = float(np.float32(draw.uniform(0.3, 0.8)))
            drive.append([*asked, *rate, throttle, float(flies)])
            told = simulation.cascade.thrust_map
            share = brentq(lambda c: told.throttle((c,) * jets)[0] - throttle, -0.5, 1.5, xtol=1e-12)  # noqa: B023
            given = controller.update(
                Command(ZERO3, 0.0, tuple(map(float, asked)), share),  # type: ignore[arg-type]
                Measured(tuple(map(float, rate)), (1.0, 0.0, 0.0, 0.0), ZERO3, ZERO3, 0.0),  # type: ignore[arg-type]
                Disturbance(),
                EngineState.FLY if flies else EngineState.IDLE,
            )
            controller.watch(quiet, 0.0)
            if name == "quadrotor":
                torque = [
                    float(np.mean([sign * u for sign, u in zip(signs, given.throttle, strict=True)]))
                    for signs in zip(*form["allocation"]["signs"], strict=True)
                ]
            else:
                sides = [
                    np.mean([u for u, jet in zip(given.throttle, vehicle.jets, strict=True) if jet.servo == side])
                    for side in ("left", "right")
                ]
                left, right = given.tilt
                torque = [
                    0.5 * float(sides[0] - sides[1]),
                    0.5 * form["allocation"]["pitch_sign"] * (left + right),
                    0.5 * (left - right),
                ]
            torques.append(torque if flies else [0.0, 0.0, 0.0])
    return np.array(drive), np.array(torques) / np.array(worth)


def driven(program: Path, drive: Array, *told: str) -> Array:
    rows = "\n".join(" ".join(f"{x:.9g}" for x in row) for row in drive)
    done = subprocess.run([program, *told], input=rows, capture_output=True, text=True)
    assert done.returncode == 0, (done.returncode, done.stderr)
    return np.array([[float(x) for x in line.split()] for line in done.stdout.splitlines()])


def same(found: Array, wanted: Array, worth: tuple[float, float, float]) -> None:
    """In throttle and rad within 1e-5: single precision of a loop that is fed with noise of up to 3 rad/s."""
    assert found.shape == wanted.shape
    assert np.abs((found - wanted) * np.array(worth)).max() < 1e-5
    assert (np.abs(wanted * np.array(worth)).max(axis=0) > 0.02).all()


def compiled(program: Path, *sources: Path | str) -> None:
    done = subprocess.run(
        [str(CC), "-std=gnu17", "-O1", *WARNINGS, "-o", program, *sources, "-lm"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def built(program: Path, autopilot: str, sources: Path) -> None:
    """The adapter of C++ and the controller of C in a folder, and what stands in for the autopilot."""
    around = program.parent / "headers"
    for name in HEADERS[autopilot]:
        (around / name).parent.mkdir(parents=True, exist_ok=True)
        (around / name).write_text(f'#include "{autopilot}.hpp"\n')
    includes = [f"-I{each}" for each in (around, STUBS / autopilot, sources)]
    objects = []
    for file in [*sorted(sources.glob("*.c")), *sources.glob("*.cpp"), STUBS / autopilot / "drive.cpp"]:
        plain = file.suffix == ".c"
        language = [str(CC), "-std=c99", "-pedantic"] if plain else [str(CXX), "-std=c++17", '-DMODULE_NAME="ours"']
        objects.append(program.parent / f"{file.name}.o")
        done = subprocess.run(
            [*language, "-O1", *WARNINGS, *includes, "-c", "-o", objects[-1], file], capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
    subprocess.run([str(CXX), "-o", program, *objects, "-lm"], check=True)


def new_files(patch: Path, folder: Path) -> None:
    """What a patch adds, without the program patch."""
    for part in re.split(r"^--- /dev/null\n\+\+\+ b/", patch.read_text(), flags=re.MULTILINE)[1:]:
        name, count, *lines = part.splitlines()
        assert count == f"@@ -0,0 +1,{len(lines)} @@"
        assert all(line.startswith("+") for line in lines)
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(line[1:] for line in lines) + "\n")


@pytest.mark.parametrize("name", ["hexjet", "quadrotor"])
def test_betaflight_hears_the_torques_of_the_controller(name: str, tmp_path: Path) -> None:
    """Gyro and set-points in its axes and units, at four times the controller's rate, over the end of its clock."""
    drive, wanted = adapted(name, "betaflight", tmp_path)
    new_files(tmp_path / "ours-betaflight.patch", tmp_path / "sources")
    flight = tmp_path / "sources" / "src" / "main" / "flight"
    source = flight / "ours_betaflight.c"
    if name == "quadrotor":  # the loop of the drive is of 1 ms
        source.write_text(source.read_text().replace("#define STEP_US 2500", "#define STEP_US 4000"))
    includes = [f"-I{STUBS / 'betaflight'}", f"-I{flight.parent}"]
    compiled(tmp_path / "program", *includes, STUBS / "betaflight" / "drive.c", *sorted(flight.glob("*.c")))
    worth = find_torque_scale("betaflight", scenario(name).resolved_vehicle()[0])
    same(driven(tmp_path / "program", drive), wanted, worth)


@pytest.mark.skipif(CXX is None, reason="no C++ compiler")
@pytest.mark.parametrize("name", ["hexjet", "hexjet-p220", "quadrotor"])
def test_ardupilot_hears_the_torques_of_the_controller(name: str, tmp_path: Path) -> None:
    """At twice the controller's rate; at a rate of which it is no whole number the main controller is handed on."""
    drive, wanted = adapted(name, "ardupilot", tmp_path)
    built(tmp_path / "program", "ardupilot", tmp_path / "AC_CustomControl")
    flown = scenario(name)
    vehicle, _ = flown.resolved_vehicle()
    least = f"{vehicle.control.allocation.throttle_min}"
    found = driven(tmp_path / "program", drive, f"{0.5 * flown.step_s}", least)
    same(found, wanted, find_torque_scale("ardupilot", vehicle))
    handed = driven(tmp_path / "program", drive, f"{flown.step_s / 1.6}", least)
    assert np.allclose(handed, (0.1, 0.2, 0.3))


def test_px4s_module_waits_for_no_target_that_is_made_after_it(tmp_path: Path) -> None:
    """PX4 adds modules from outside before its platform's libraries, px4_work_queue among them.

    Its instructions do not stop in lockstep what alone would answer.
    """
    adapted("hexjet", "px4", tmp_path)
    (lists,) = (tmp_path / "src" / "modules").glob("*/CMakeLists.txt")
    text = lists.read_text()
    assert "px4_add_module(" in text
    assert "DEPENDS" not in text
    said = " ".join((tmp_path / "README.md").read_text().split())
    assert "In SITL in lockstep nobody would answer between these two lines" in said
    assert "`ours start` goes into the place of `mc_rate_control start`" in said


@pytest.mark.skipif(CXX is None, reason="no C++ compiler")
@pytest.mark.parametrize("name", ["hexjet", "quadrotor"])
def test_px4_is_told_the_torques_of_the_controller(name: str, tmp_path: Path) -> None:
    """At the gyro samples nearest to the controller's steps, though their times are unsteady; started and stopped."""
    drive, wanted = adapted(name, "px4", tmp_path)
    module = tmp_path / "src" / "modules" / "ours"
    built(tmp_path / "program", "px4", module)
    flown = scenario(name)
    found = driven(tmp_path / "program", drive, f"{round(1e6 * flown.step_s)}")
    same(found, wanted, find_torque_scale("px4", flown.resolved_vehicle()[0]))
    stated_sources = set(re.findall(r"^\t\t(\S+\.c\w*)$", (module / "CMakeLists.txt").read_text(), re.MULTILINE))
    assert stated_sources == {path.name for path in module.iterdir() if path.suffix in (".c", ".cpp")}
    assert "modules/ours\n" in (tmp_path / "src" / "CMakeLists.txt").read_text()


def test_what_cannot_be_exported_and_an_unknown_autopilot_are_refused(hexjet: Hexjet, tmp_path: Path) -> None:
    for given, said in (
        (["--for", "inav"], "'inav': allowed: ardupilot, betaflight, px4"),
        (
            ["--for", "betaflight", "--scenario", "hover", "--aircraft", "trijet", "--controller", "baseline"],
            "flown by effectiveness",
        ),
    ):
        done = hexjet("export", "controller", *given, "--out", str(tmp_path / "out"))
        assert (done.status, said in done.err, "Traceback" in done.err) == (2, True, False), done.err
        assert len(done.err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def sources_of(binary: Path, folder: Path) -> Path:
    """A copy of what the installed SITL was built from."""
    firmware = binary.parent.parent
    if not (firmware / "Makefile").is_file():
        pytest.skip(f"{firmware}: Betaflight's sources are not there")
    folder.mkdir()
    for name in ("src", "mk"):
        shutil.copytree(firmware / name, folder / name)
    for file in firmware.iterdir():
        if file.is_file():
            shutil.copy2(file, folder)
    (folder / "lib").symlink_to(firmware / "lib")
    return folder


def patched(patch: Path, sources: Path, *how: str) -> None:
    command = ["patch", "-p1", "--fuzz=0", "-i", str(patch), *how]
    done = subprocess.run(command, cwd=sources, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.skipif(BINARY is None or shutil.which("patch") is None, reason="no Betaflight or no patch here")
def test_the_patch_fits_its_sources(tmp_path: Path) -> None:
    """Without any shift of lines or inexact context."""
    assert BINARY is not None
    firmware = BINARY.parent.parent
    if not (firmware / "Makefile").is_file():
        pytest.skip(f"{firmware}: Betaflight's sources are not there")
    for name in ("mk/source.mk", "src/main/flight/pid.c"):
        (tmp_path / name).parent.mkdir(parents=True)
        shutil.copy2(firmware / name, tmp_path / name)
    adapted("hexjet", "betaflight", tmp_path / "made")
    patched(tmp_path / "made" / "ours-betaflight.patch", tmp_path)
    loop = (tmp_path / "src/main/flight/pid.c").read_text()
    assert loop.count("ours_") == 3
    assert (
        loop.index("= pidSum;")
        < loop.index("ours_ask(")
        < loop.index("ours_answer(")
        < loop.index("pidData[axis].Sum = 0;")
    )
    assert "flight/ours_rates.c \\" in (tmp_path / "mk/source.mk").read_text()


def flown_inside(binary: Path, folder: Path) -> Run:
    doublet = Scenario.load("roll-doublet")
    vehicle, _ = doublet.resolved_vehicle()
    lines = [*theirs.make_gain_settings(vehicle), "set pidsum_limit_yaw = 500"]
    autopilot = theirs.Betaflight(
        binary,
        folder / "betaflight",
        vehicle,
        doublet.step_s,
        Geodesy(0.0, 0.0),
        Setup(0, 60.0, free_port(), lines=lines),
    )
    return fly_autopilot(doublet, autopilot, folder).run


@pytest.mark.long
@pytest.mark.skipif(BINARY is None or shutil.which("patch") is None, reason="no Betaflight or no patch here")
def test_inside_betaflight_a_predictor_holds_what_is_lost_without(hexjet: Hexjet, tmp_path: Path) -> None:
    """The real thing, patched and built: the same gains at the same delay, lost without a predictor, held with it."""
    assert BINARY is not None
    sources = sources_of(BINARY, tmp_path / "sources")
    runs = {}
    for controller in ("smith", "optimal", "baseline"):
        out = tmp_path / controller
        given = ["--controller", controller, "--name", "ours", "--no-fmu", "--for", "betaflight", "--out", str(out)]
        assert hexjet("export", "controller", *given).status == 0
        patch = out / "betaflight" / "ours-betaflight.patch"
        patched(patch, sources)
        built = subprocess.run(
            ["make", "TARGET=SITL"], cwd=sources, capture_output=True, text=True, env=os.environ | {"MAKEFLAGS": ""}
        )
        assert built.returncode == 0, built.stderr[-2000:]
        program = tmp_path / f"betaflight-{controller}"
        shutil.copy2(next((sources / "obj").glob("betaflight_*_SITL")), program)
        patched(patch, sources, "-R")
        runs[controller] = flown_inside(program, tmp_path / "runs" / controller)
    ours, without = runs["smith"], runs["baseline"]
    assert (ours.outcome, without.outcome) == ("completed", "diverged")
    least = runs["optimal"].metrics["roll"]
    settled = ours.metrics["roll"].settling_time_s
    assert least.settling_time_s < settled < 5.0


GPL = "SPDX-License-Identifier: GPL-3.0-or-later"
MINE = "SPDX-License-Identifier: LicenseRef-Mine"


@pytest.mark.parametrize("autopilot", ["betaflight", "ardupilot", "px4"])
def test_what_is_a_part_of_an_autopilot_has_its_licence(autopilot: str) -> None:
    """GPL for what touches or includes their code, the user's own for the C that is his alone; PX4 is BSD."""
    flown = scenario("hexjet")
    vehicle, _ = flown.resolved_vehicle()
    with build(flown) as simulation:
        form = make_form(simulation)
    files = render_adapter(
        form, Labels("ours", "a test", "LicenseRef-Mine", ()), autopilot, find_torque_scale(autopilot, vehicle)
    )
    readme = files.pop("README.md")
    if autopilot == "betaflight":
        head, *added = re.split(
            r"^--- /dev/null\n\+\+\+ b/src/main/flight/", files.pop("ours-betaflight.patch"), flags=re.M
        )
        assert GPL in head
        files = {text.partition("\n")[0]: re.sub(r"^\+", "", text.split("@@\n")[1], flags=re.M) for text in added}
    sources = {Path(name).name: text for name, text in files.items() if name.endswith((".c", ".h", ".cpp"))}
    theirs = {
        "betaflight": {"ours_betaflight.c", "ours_betaflight.h"},
        "ardupilot": {"AC_CustomControl_Ours.cpp", "AC_CustomControl_Ours.h"},
        "px4": set(),
    }[autopilot]
    assert {name for name, text in sources.items() if text.startswith(f"/* {GPL} */\n")} == theirs
    assert {name for name, text in sources.items() if text.startswith(f"/* {MINE} */\n")} == set(sources) - theirs
    own = {"ours.c", "ours.h", "ours_parameters.c", "ours_rates.c", "ours_rates.h"}
    assert own <= set(sources)
    for name in own:  # nothing of theirs is in what carries the user's licence
        includes = re.findall(r'^#include "(.+)"', sources[name], re.M)
        assert set(includes) <= own
    assert ("GPL-3.0-or-later" in readme) == bool(theirs)
    assert ("LicenseRef-Mine" in readme) == bool(theirs)


def test_another_licence_is_refused_for_what_is_theirs(hexjet: Hexjet, tmp_path: Path) -> None:
    short = ["--set", "duration_s=0.2", "--no-fmu", "--name", "ours"]
    asked = ["export", "controller", *short, "--licence", "MIT", "--for", "betaflight", "--for", "px4"]
    done = hexjet(*asked, "--out", str(tmp_path / "mit"))
    assert done.status == 0
    assert done.err == (
        "hexjet: note: licence MIT: not for what touches or includes betaflight's code: GPL-3.0-or-later\n"
    )
    readme = (tmp_path / "mit" / "README.md").read_text(encoding="utf-8")
    assert "Licence of these files: MIT." in readme
    assert "What in `betaflight/` touches or includes the autopilot's own code is GPL-3.0-or-later" in readme
    asked[asked.index("MIT")] = "GPL-3.0-or-later"
    assert hexjet(*asked, "--out", str(tmp_path / "gpl")).err == ""
