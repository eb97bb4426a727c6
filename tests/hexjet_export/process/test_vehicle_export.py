"""The vehicle as an FMU: other masters fly it to our own log, bit for bit, and are told when it cannot fly."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import fmpy
import numpy as np
import pytest
from command_tools import Hexjet
from engine_tools import Driven, driven, rewrite

from cosim import fly
from cosim.base.errors import InputError
from cosim.results.run import Run
from cosim.spec.scenario import Scenario
from hexjet_export.controller import measure
from hexjet_export.vehicle.export import export_vehicle
from hexjet_export.vehicle.ports import ExportedFlight, VehicleContents
from hexjet_export.vehicle.process import describe_version_differences
from hexjet_export.vehicle.ssp import write_ssp

STEP = 0.004
STEPS = 375  # the doublet begins after 1 s
pytestmark = pytest.mark.skipif(
    measure.find_compiler() is None or sys.platform != "linux", reason="no C compiler, or not Linux"
)

# outputs of the FMU and columns of our log: the whole state, what is measured, and what the engines do
COLUMNS = {
    **{f"position_{x}": f"{x}_m" for x in ("north", "east", "down")},
    **{f"velocity_{x}": f"velocity_{x}_m_s" for x in ("north", "east", "down")},
    **{x: f"{x}_rad" for x in ("roll", "pitch", "yaw")},
    **{f"{x}_rate": f"rate_{y}_rad_s" for x, y in zip(("roll", "pitch", "yaw"), "pqr", strict=True)},
    **{f"measured_{x}_rate": f"rate_{y}_measured_rad_s" for x, y in zip(("roll", "pitch", "yaw"), "pqr", strict=True)},
    **{f"specific_force_{x}": f"specific_force_{x}_m_s2" for x in "xyz"},
    "altitude": "altitude_m",
    "measured_altitude": "altitude_measured_m",
}


def doublet(**changes: object) -> Scenario:
    return Scenario.load("roll-doublet").replace(duration_s=STEPS * STEP, expect=[], controller="smith", **changes)


@pytest.fixture(scope="module")
def ours() -> Run:
    return fly(doublet(), report=False)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_vehicle(doublet(), tmp_path_factory.mktemp("whole") / "out", name="ours").exported.folder


@pytest.fixture(scope="module")
def unpacked(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unpacked")
    fmpy.extract(str(whole / "ours-fmi2.fmu"), str(folder))
    return folder


@pytest.fixture(scope="module")
def flying(whole: Path, unpacked: Path) -> Iterator[Driven]:
    """One instance, which tests start anew, because a process takes seconds to start."""
    with driven(whole / "ours-fmi2.fmu", unpacked) as slave:
        yield slave


def again(slave: Driven, **parameters: float) -> Driven:
    slave.fmu.reset()
    slave.start(**parameters)
    return slave


def same(name: str, seen: list[float], run: Run, first: int = 0) -> None:
    """Bit for bit."""
    assert seen == run.log[COLUMNS[name]][first : first + len(seen)].tolist(), name


def test_fmpy_flies_the_log_to_the_last_bit(flying: Driven, ours: Run) -> None:
    slave = again(flying)
    seen: dict[str, list[float]] = {name: [] for name in COLUMNS}
    for k in range(STEPS):
        for name, values in seen.items():
            values.append(slave.get(name))
        slave.fmu.doStep(k * STEP, STEP)
    for name, values in seen.items():
        same(name, values, ours)
    assert max(abs(x) for x in seen["roll"]) > 0.1
    # what the engines are told and deliver is that of the step before
    for name, column in (("throttle_1", "throttle_1"), ("thrust_6", "thrust_6_N"), ("servo_left", "tilt_left_rad")):
        assert slave.get(name) == ours.log[column][-1]


def test_fmi_3_and_steps_of_several_control_steps(whole: Path, tmp_path: Path, ours: Run) -> None:
    assert fmpy.validation.validate_fmu(str(whole / "ours.fmu")) == []
    assert fmpy.validation.validate_fmu(str(whole / "ours-fmi2.fmu")) == []
    with driven(whole / "ours.fmu", tmp_path / "u") as slave:
        slave.start()
        seen = []
        for k in range(0, STEPS, 3):
            seen.append(slave.get("roll"))
            slave.fmu.doStep(k * STEP, 3 * STEP)
    assert seen == ours.log["roll_rad"][::3].tolist()


def test_another_seed_and_the_first_one_again(flying: Driven, ours: Run) -> None:
    other = fly(doublet(seed=5, command=[]).replace(duration_s=0.1), report=False)
    slave = again(flying, seed=5)
    for k in range(20):
        slave.fmu.doStep(k * STEP, STEP)
    assert slave.get("measured_roll_rate") == other.log["rate_p_measured_rad_s"][20]
    slave = again(flying)
    slave.fmu.doStep(0.0, STEP)
    assert slave.get("measured_roll_rate") == ours.log["rate_p_measured_rad_s"][1]


def test_set_points_of_the_importer(flying: Driven) -> None:
    step = {"kind": "step", "signal": "roll_deg", "amplitude": 5.0, "start_s": 0.0}
    asked = fly(doublet(command=[step]).replace(duration_s=0.4), report=False)
    slave = again(flying, commanded=1.0, roll_setpoint=float(asked.log["roll_setpoint_rad"][0]))
    seen = []
    for k in range(99):
        seen.append(slave.get("roll"))
        slave.fmu.doStep(k * STEP, STEP)
    same("roll", seen, asked)
    assert seen[-1] != 0.0


def test_a_flight_that_is_over_is_an_error_with_its_reason(flying: Driven) -> None:
    slave = again(flying, commanded=1.0, engines=2.0)
    flying.messages.clear()
    with pytest.raises(Exception, match="fmi2DoStep"):
        slave.fmu.doStep(0.0, 2000 * STEP)
    assert any("the flight is over: crashed" in line for line in flying.messages), flying.messages


def test_what_a_step_may_not_be(flying: Driven) -> None:
    slave = again(flying)
    flying.messages.clear()
    with pytest.raises(Exception, match="fmi2DoStep"):
        slave.fmu.doStep(0.0, 0.006)
    assert "communication step 0.006 s is not a whole multiple of the control step 0.004 s" in flying.messages[-1]


def test_a_python_that_is_not_there_or_has_not_the_package(
    whole: Path, unpacked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    monkeypatch.setattr(Driven, "_log", lambda self, text: said.append(text.decode()))
    bare = tmp_path / "python"
    bare.write_text("#!/bin/sh\nexit 1\n")
    bare.chmod(0o755)
    for python, reason in (("/nowhere/python", "cannot be started"), (str(bare), "has the Python")):
        monkeypatch.setenv("HEXJET_PYTHON", python)
        with pytest.raises(Exception, match="instantiate"):
            Driven(whole / "ours-fmi2.fmu", unpacked)
        assert reason in said[-1]
        assert python in said[-1]
        assert "HEXJET_PYTHON" in said[-1]


def test_other_versions_are_refused_by_name(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert describe_version_differences({"jsbsim": "1", "python": "3"}, {"jsbsim": "1", "python": "3"}) == ""
    assert describe_version_differences({"jsbsim": "1"}, {}) == "jsbsim missing in place of 1"

    def older(contents: dict[str, bytes]) -> None:
        made = contents["resources/vehicle.json"].decode()
        contents["resources/vehicle.json"] = made.replace('"jsbsim": "', '"jsbsim": "0.').encode()

    said: list[str] = []
    monkeypatch.setattr(Driven, "_log", lambda self, text: said.append(text.decode()))
    changed = rewrite(whole / "ours.fmu", tmp_path / "ours.fmu", older)
    with pytest.raises(Exception, match="nstantiate"):
        Driven(changed, tmp_path / "u")
    assert "made with other versions: jsbsim" in said[-1]


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The SSP, and what is in it, in one folder."""
    folder = tmp_path_factory.mktemp("system")
    done = export_vehicle(doublet(), folder / "out" / "ours-fmi2.ssp", kind="ssp", name="ours").exported
    assert done.files == ["ours-fmi2.ssp"]
    with zipfile.ZipFile(done.folder / "ours-fmi2.ssp") as ssp:
        ssp.extractall(folder)
    return folder


def test_engines_outside_stepped_before_the_vehicle_make_the_same_flight(
    system: Path, tmp_path: Path, ours: Run
) -> None:
    """A master that goes from one to the next: engines with the throttles of now, then the vehicle with their thrusts."""
    fmus = system / "resources"
    with ExitStack() as stack:
        vehicle = stack.enter_context(driven(fmus / "ours-fmi2.fmu", tmp_path / "vehicle"))
        engine = fmus / "edf-as-flown-fmi2.fmu"
        engines = [stack.enter_context(driven(engine, tmp_path / "engine", name=f"engine {i}")) for i in range(6)]
        vehicle.start()
        for i, each in enumerate(engines, 1):
            each.start(throttle_start=vehicle.get(f"start_throttle_{i}"))
        seen = []
        for k in range(STEPS):
            seen.append(vehicle.get("roll"))
            for i, each in enumerate(engines, 1):
                each.set("throttle", vehicle.get(f"throttle_{i}"))
                each.fmu.doStep(k * STEP, STEP)
                vehicle.set(f"thrust_{i}", each.get("thrust"))
            vehicle.fmu.doStep(k * STEP, STEP)
    same("roll", seen, ours)


def test_a_controller_outside_that_does_the_same_makes_the_same_flight(ours: Run) -> None:
    """Without the FMU around it: the block that the process steps."""
    log, told = ours.log, iter(range(STEPS))

    def meet() -> None:
        k = next(told)
        names = [each.name for each in flight.outputs]
        assert dict(zip(names, flight.read_outputs(), strict=True))["roll"] == log["roll_rad"][k]
        flight.input_values.update({f"throttle_{i}": log[f"throttle_{i}"][k] for i in range(1, 7)})
        flight.input_values.update({f"tilt_{side}": log[f"tilt_{side}_command_rad"][k] for side in ("left", "right")})

    flight = ExportedFlight(doublet(), VehicleContents(controller=False), meet)
    try:
        flight.simulation.reset()
        for k in range(STEPS - 1):
            flight.simulation.step()
            assert flight.simulation.state.rate[0] == log["rate_p_rad_s"][k + 1]
            assert flight.command.attitude[0] == log["roll_setpoint_rad"][k]
    finally:
        flight.close()


MASTER = """
import ctypes, json, sys
from pathlib import Path
master, path, steps, references = sys.argv[1], sys.argv[2], int(sys.argv[3]), json.loads(sys.argv[4])
rows = []
if master == "ecos":
    library = Path(sys.prefix) / "lib" / "libtbb.so.12"  # which ecospy needs and nobody else looks for there
    if library.is_file():
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    import ecospy
    if path.endswith(".ssp"):
        simulation = ecospy.EcosSimulation(step_size=0.004, ssp_path=path)
        simulation.init(parameter_set="start")
    else:
        structure = ecospy.EcosSimulationStructure()
        structure.add_model("vehicle", path)
        simulation = ecospy.EcosSimulation(step_size=0.004, structure=structure)
        simulation.init()
    for _ in range(steps):
        rows.append([simulation.get_real(f"vehicle::{name}") for name in references])
        simulation.step()
    simulation.free()
else:
    from libcosimpy import CosimExecution, CosimLogging, CosimObserver, CosimSlave
    CosimLogging.log_output_level(CosimLogging.CosimLogLevel.FATAL)
    if path.endswith(".ssd"):
        run = CosimExecution.CosimExecution.from_ssp_file(path, 4_000_000)
        (index,) = [each.index for each in run.slave_infos() if each.name == b"vehicle"]
    else:
        run = CosimExecution.CosimExecution.from_step_size(4_000_000)
        slave = CosimSlave.CosimLocalSlave(path, "vehicle")
        index = run.add_local_slave(slave)
    observer = CosimObserver.CosimObserver.create_last_value()
    run.add_observer(observer)
    for _ in range(steps):
        run.step()  # what it observes is that of the step's end
        rows.append(list(observer.last_real_values(index, list(references.values()))))
Path(sys.argv[5]).write_text(json.dumps(rows))
"""


def seen_by(master: str, path: Path, fmu: Path, result: Path) -> dict[str, list[float]]:
    """What another master sees of the vehicle, in a process of its own, where its libraries disturb nobody."""
    package = {"ecos": "ecospy", "libcosim": "libcosimpy"}[master]
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"no {package}: pip install {package}")
    description = fmpy.read_model_description(str(fmu))
    references = {v.name: v.valueReference for v in description.modelVariables if v.name in COLUMNS}
    command = [sys.executable, "-c", MASTER, master, str(path), str(STEPS - 1), json.dumps(references), str(result)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=result.parent)
    assert done.returncode == 0, done.stderr[-2000:]
    columns = zip(*json.loads(result.read_text()), strict=True)
    return {name: list(values) for name, values in zip(references, columns, strict=True)}


@pytest.mark.parametrize(("master", "fmu"), [("ecos", "ours.fmu"), ("libcosim", "ours-fmi2.fmu")])
def test_other_masters_fly_it_to_the_last_bit(master: str, fmu: str, whole: Path, ours: Run, tmp_path: Path) -> None:
    for name, values in seen_by(master, whole / fmu, whole / fmu, tmp_path / "rows.json").items():
        same(name, values, ours, first=1 if master == "libcosim" else 0)


@pytest.mark.parametrize("master", ["ecos", "libcosim"])
def test_other_masters_fly_the_system_with_thrusts_that_come_a_step_later(
    master: str, system: Path, tmp_path: Path
) -> None:
    """They step all components at once: what is a delay of one step here, and bit for bit that."""
    late = fly(doublet(mismatch={"delay_samples": 1}), report=False)
    path = system / ("out/ours-fmi2.ssp" if master == "ecos" else "SystemStructure.ssd")
    found = seen_by(master, path, system / "resources" / "ours-fmi2.fmu", tmp_path / "rows.json")
    for name, values in found.items():
        same(name, values, late, first=1 if master == "libcosim" else 0)


def test_the_system_keeps_to_the_schema_of_ssp(system: Path) -> None:
    from fmpy.ssp.ssd import read_ssd

    read = read_ssd(str(system / "out" / "ours-fmi2.ssp"))  # it validates
    assert [each.name for each in read.system.elements] == [*(f"engine_{i}" for i in range(1, 7)), "vehicle"]


def test_an_engine_with_units_of_its_own_is_connected_by_transformations(tmp_path: Path) -> None:
    big = doublet(aircraft="hexjet-p220", engine="p220").replace(controller="baseline")
    flight = ExportedFlight(big, VehicleContents(engines=False), lambda: None)
    flight.close()
    (tmp_path / "vehicle.fmu").write_bytes(b"")
    write_ssp(flight, tmp_path / "vehicle.fmu", tmp_path / "v.ssp", 3, 1.0)
    with zipfile.ZipFile(tmp_path / "v.ssp") as ssp:
        text = ssp.read("SystemStructure.ssd").decode()
    speed = re.search(r'startConnector="(spool_speed|speed)"[^>]*>\s*<ssc:LinearTransformation factor="([^"]+)"', text)
    assert speed is not None
    assert float(speed[2]) == pytest.approx(2.0 * np.pi / 60.0, rel=1e-15)  # from rpm


def test_what_cannot_be_exported_is_one_line(hexjet: Hexjet) -> None:
    Path("full").mkdir()
    Path("full/file").touch()
    done = hexjet("export", "vehicle", "--out", "full")
    assert (done.status, done.err) == (2, "hexjet: full: is there already and not an empty folder; name another\n")
    fault = {"kind": "stuck_throttle", "jet": 1, "start_s": 0.1}
    with pytest.raises(InputError, match="fault stuck_throttle: acts between controller and engines, and both are out"):
        ExportedFlight(doublet(fault=[fault]), VehicleContents(False, False), lambda: None)
