"""A controller inside an autopilot: the adapters that an export writes, against declarations of ours, and flown."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from math import inf
from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet
from numpy.typing import NDArray
from places import TOOLS
from stated_figures import stated

from cosim.autopilots import betaflight as theirs
from cosim.autopilots.dump import torque_of
from cosim.autopilots.run import fly_autopilot
from cosim.base.errors import InputError
from cosim.base.protocols import EngineState
from cosim.base.signals import ZERO3, Command, Disturbance, EngineOutput, Measured
from cosim.codegen import measure
from cosim.codegen.adapters import adapter_texts, inverse
from cosim.codegen.files import Labels
from cosim.codegen.form import form_of
from cosim.results.run import Run
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario

CC = measure.compiler()
STUBS = TOOLS / "stubs"
WARNINGS = ("-Wall", "-Wextra", "-Werror", "-Wdouble-promotion")
try:
    BINARY: Path | None = theirs.program(None)
except InputError:
    BINARY = None

Array = NDArray[np.float64]

pytestmark = pytest.mark.skipif(CC is None, reason="no C compiler")


def scenario(name: str) -> Scenario:
    """The Hex-Jet on two tilting banks, or four rotors; each with a predictor."""
    made = Scenario.load("roll-doublet").replace(expect=[], controller="smith")
    return made.replace(aircraft="quadrotor", engine="motor", step_s=0.0025) if name == "quadrotor" else made


def adapted(name: str, autopilot: str, folder: Path) -> tuple[Array, Array]:
    """Write an adapter; a drive for it, and the torques that the controller of Python gives for that, in theirs."""
    flown = scenario(name)
    vehicle, _ = flown.resolved_vehicle()
    worth = torque_of(autopilot, vehicle)
    with build(flown) as simulation:
        form = form_of(simulation)
        for file, text in adapter_texts(form, Labels("ours", "a test", "MIT", ()), autopilot, worth).items():
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
            given = controller.update(
                Command(ZERO3, 0.0, tuple(map(float, asked)), throttle),  # type: ignore[arg-type]
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


def driven(program: Path, drive: Array) -> Array:
    rows = "\n".join(" ".join(f"{x:.9g}" for x in row) for row in drive)
    done = subprocess.run([program], input=rows, capture_output=True, text=True, check=True)
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
    worth = torque_of("betaflight", scenario(name).resolved_vehicle()[0])
    same(driven(tmp_path / "program", drive), wanted, worth)


def test_the_inverse_gives_back_what_the_allocation_was_told() -> None:
    form = {"jets": 4, "allocation": {"kind": "tilt", "left": [True, True, False, False], "pitch_sign": -1.0}}
    assert inverse(form) == [[0.25, 0.25, -0.25, -0.25, 0.0, 0.0], [0.0] * 4 + [-0.5, -0.5], [0.0] * 4 + [0.5, -0.5]]


def test_what_cannot_be_exported_and_an_unknown_autopilot_are_refused(hexjet: Hexjet, tmp_path: Path) -> None:
    for given, said in (
        (["--for", "inav"], "'inav' is not"),
        (
            ["--for", "betaflight", "--scenario", "hover", "--aircraft", "trijet", "--controller", "baseline"],
            "has no C form",
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
    lines = [*theirs.gains_of(vehicle), "set pidsum_limit_yaw = 500"]
    autopilot = theirs.Betaflight(binary, folder / "betaflight", vehicle, doublet.step_s, lines, 21_000, 60.0)
    return fly_autopilot(
        doublet, autopilot, "betaflight", folder, before=theirs.BEFORE_S, lean_deg=theirs.ANGLE_LIMIT_DEG,
        turn_deg_s=theirs.YAW_RATE_DEG_S,
    ).run  # fmt: skip


@pytest.mark.skipif(BINARY is None or shutil.which("patch") is None, reason="no Betaflight or no patch here")
def test_inside_betaflight_a_predictor_holds_what_is_lost_without(hexjet: Hexjet, tmp_path: Path) -> None:
    """The real thing, patched and built: the same gains at the same delay, lost without a predictor, held with it."""
    assert BINARY is not None
    sources = sources_of(BINARY, tmp_path / "sources")
    runs = {}
    for controller in ("smith", "baseline"):
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
    settled = ours.metrics["roll"].settling_time_s or inf
    stated(
        "docs/autopilots.md",
        "the roll doublet settles in {} s with {} % of overshoot and an RMS error of {}°; with the same gains, and no predictor in "
        "the same place, it is lost at {} s",
        settled,
        ours.metrics["roll"].overshoot_percent or inf,
        float(np.degrees(ours.metrics["roll"].rmse_rad)),
        without.summary.duration_s,
    )
