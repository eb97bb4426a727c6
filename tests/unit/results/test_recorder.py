"""The log and the run's folder: nothing lost, nothing changed, the same bytes every time."""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from math import isnan, nan, pi
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from flights import STEP, samples, scenario, setup
from places import TOOLS

from cosim.base import signals as sg
from cosim.base.errors import FlightError, InputError
from cosim.results.log import arrow as arrow_module
from cosim.results.log import recorder as recorder_module
from cosim.results.log.arrow import ParquetLog, StreamSink, stream_to_parquet
from cosim.results.log.columns import COLUMNS, NAMES
from cosim.results.log.recorder import BackgroundSink, MemorySink, Recorder
from cosim.results.run import LOG, RUN_FILES, SCENARIO, STREAM, SUMMARY, Run, begin_run, open_run

BLOCK = 250  # rows in one second of flight


def bits(values: np.ndarray) -> bytes:
    """What makes two columns the same, NaN included."""
    return np.ascontiguousarray(values).tobytes()


def numbered() -> tuple[sg.Sample, dict[str, float]]:
    """A sample whose numbers are all different, and the column each belongs to, named by hand in the sample's order."""
    count = itertools.count(2.0)

    def some(size: int) -> Any:
        return tuple(itertools.islice(count, size))

    def one() -> float:
        return next(count)

    # the attitudes: level, and (1, 1, 1, 1) / 2, which turns x to y, y to z and z to x: roll 90 deg, then yaw 90 deg
    motion = (some(3), some(3), (1.0, 0.0, 0.0, 0.0), some(3), some(3), some(3))
    state = sg.State(*motion, one(), some(3), one(), True, False, some(3))
    sample = sg.Sample(
        k=7,
        time=1.0,
        state=sg.State(*state),
        command=sg.Command(some(3), one(), place=some(2)),
        measured=sg.Measured(some(3), (0.5, 0.5, 0.5, 0.5), some(3), some(3), one(), some(3)),
        control=sg.ControlSignals(some(3), some(3), some(3), one(), allocated=-1.0),
        actuation=sg.Actuation(some(6), some(2), sg.Unallocated(*some(4))),
        tilt=some(2),
        engines=sg.EngineOutput(some(6), some(6), some(6), some(6)),
        disturbance=sg.Disturbance(some(3), some(3), some(3), wind=(-1.0, -1.0, -1.0), payload=some(4)),
        fuel=one(),
        spool_moment=some(3),
        health=some(6),
        faults=some(12),
    )
    row = {"time_s": 1.0, "on_ground": 1.0, "hull_contact": 0.0}
    row |= {"roll_measured_rad": pi / 2, "pitch_measured_rad": 0.0, "yaw_measured_rad": pi / 2}
    jets = [name.format(n) for name in ("thrust_{}_N", *PER_JET) for n in range(1, 7)]
    return sample, row | dict(zip(BEFORE_JETS.split() + jets + BEHIND_JETS.split(), itertools.count(2.0), strict=False))


BEFORE_JETS = """
north_m east_m down_m velocity_north_m_s velocity_east_m_s velocity_down_m_s roll_rad pitch_rad yaw_rad
rate_p_rad_s rate_q_rad_s rate_r_rad_s specific_force_x_m_s2 specific_force_y_m_s2 specific_force_z_m_s2
altitude_m wind_north_m_s wind_east_m_s wind_down_m_s mass_kg air_rate_p_rad_s air_rate_q_rad_s air_rate_r_rad_s
roll_setpoint_rad pitch_setpoint_rad yaw_setpoint_rad altitude_setpoint_m north_setpoint_m east_setpoint_m
rate_p_measured_rad_s rate_q_measured_rad_s rate_r_measured_rad_s north_measured_m east_measured_m down_measured_m
velocity_north_measured_m_s velocity_east_measured_m_s velocity_down_measured_m_s altitude_measured_m
specific_force_x_measured_m_s2 specific_force_y_measured_m_s2 specific_force_z_measured_m_s2
rate_p_setpoint_rad_s rate_q_setpoint_rad_s rate_r_setpoint_rad_s
rate_p_predicted_rad_s rate_q_predicted_rad_s rate_r_predicted_rad_s torque_roll torque_pitch torque_yaw collective
throttle_1 throttle_2 throttle_3 throttle_4 throttle_5 throttle_6 tilt_left_command_rad tilt_right_command_rad
refused_roll refused_pitch refused_yaw refused_collective tilt_left_rad tilt_right_rad
"""
PER_JET = ("spool_speed_{}_rad_s", "exhaust_temperature_{}_K", "fuel_flow_{}_kg_s")
BEHIND_JETS = """
disturbance_force_x_N disturbance_force_y_N disturbance_force_z_N
disturbance_moment_x_N_m disturbance_moment_y_N_m disturbance_moment_z_N_m
disturbance_torque_roll disturbance_torque_pitch disturbance_torque_yaw payload_kg payload_x_m payload_y_m payload_z_m
fuel_kg spool_moment_x_N_m spool_moment_y_N_m spool_moment_z_N_m
health_1 health_2 health_3 health_4 health_5 health_6
fault_jet_1 fault_jet_2 fault_jet_3 fault_jet_4 fault_jet_5 fault_jet_6
fault_servo_left fault_servo_right fault_gyro fault_attitude fault_gnss fault_barometer
"""


def recorded(flight: list[sg.Sample]) -> MemorySink:
    sink = MemorySink()
    recorder = Recorder(STEP, sink)
    for sample in flight:
        recorder.observe(sample)
    recorder.flush()
    return sink


def fly(folder: Path | None, steps: int, seed: int = 1) -> Run:
    recording = begin_run(setup(), scenario(), folder)
    for sample in samples(steps, seed=seed):
        recording.observe(sample)
    return recording.finish("completed", f"flew {steps} steps", wall_s=2.0)


@pytest.fixture(scope="module")
def flight() -> list[sg.Sample]:
    return list(samples(1100))


def test_every_wire_ends_in_the_column_that_bears_its_name() -> None:
    sample, row = numbered()
    log = recorded([sample]).log()
    assert set(row) == set(log.columns) == set(NAMES)
    for name, value in row.items():
        # the angles come through an arc tangent, everything else is copied
        assert log[name].tolist() == ([pytest.approx(value, abs=1e-15)] if "measured_rad" in name else [value]), name


def test_setpoints_are_nan_where_their_loop_is_replaced() -> None:
    sample, _ = numbered()
    log = recorded(
        [sample._replace(command=sg.Command((2.0, 3.0, 4.0), 5.0, rate=(0.0, 0.0, 0.0), collective=0.5))]
    ).log()
    missing = {name for name in NAMES if isnan(log[name][0])}
    angles = {"roll_setpoint_rad", "pitch_setpoint_rad", "yaw_setpoint_rad"}
    assert missing == angles | {"altitude_setpoint_m", "north_setpoint_m", "east_setpoint_m"}


def test_every_column_is_described_once() -> None:
    assert len(NAMES) == len(set(NAMES))
    for column in COLUMNS:
        assert column.meaning
        assert column.unit
        suffixes = {"rad": "_rad", "m": "_m", "s": "_s", "kg": "_kg", "N": "_N", "m/s": "_m_s", "rad/s": "_rad_s"}
        if column.unit in suffixes and "torque" not in column.name and "refused" not in column.name:
            assert column.name.endswith(suffixes[column.unit]), column


def test_a_second_of_flight_is_handed_on_at_once(tmp_path: Path, flight: list[sg.Sample]) -> None:
    sink = StreamSink(tmp_path / STREAM, "")
    recorder = Recorder(STEP, sink)
    sizes = []
    for sample in flight[: 2 * BLOCK]:
        recorder.observe(sample)
        sizes.append((tmp_path / STREAM).stat().st_size)
    sink.close()
    growths = [k + 1 for k in range(1, len(sizes)) if sizes[k] > sizes[k - 1]]
    assert growths == [BLOCK, 2 * BLOCK]
    assert recorder.steps == 2 * BLOCK


def test_a_slow_flight_is_handed_on_when_its_time_has_come(monkeypatch: pytest.MonkeyPatch, flight: list) -> None:
    def sizes(patience: float, between: float = 0.0) -> list[int]:
        monkeypatch.setattr(recorder_module, "MAX_FLUSH_INTERVAL_S", patience)
        sink = MemorySink()
        recorder = Recorder(STEP, sink)
        for sample in flight[:4]:
            time.sleep(between)
            recorder.observe(sample)
        assert recorder.steps == 4
        return [table.shape[1] for table in sink.tables]

    assert sizes(0.0) == [1, 1, 1, 1]
    assert sizes(1000.0) == []
    assert sizes(0.03, between=0.02)[0] <= 2  # and the clock starts anew with each


def test_a_slow_disk_in_a_thread_of_its_own_gets_every_bit(flight: list[sg.Sample]) -> None:
    class Slow(MemorySink):
        def write(self, table: np.ndarray) -> None:
            time.sleep(0.01)  # rows come in meanwhile
            super().write(table.copy())

    slow = Slow()
    behind = BackgroundSink(slow)
    recorder = Recorder(STEP, behind)
    for k, sample in enumerate(flight):
        recorder.observe(sample)
        if k % 60 == 0:
            recorder.flush()
    recorder.flush()
    behind.settle()
    log, expected = slow.log(), recorded(flight).log()
    assert all(bits(log[name]) == bits(expected[name]) for name in NAMES)


def test_the_file_holds_exactly_what_was_recorded(tmp_path: Path, flight: list[sg.Sample]) -> None:
    run, memory = fly(tmp_path / "run", 1100), recorded(flight).log()
    assert len(run.log) == len(memory) == 1100
    assert run.log.columns == memory.columns == NAMES
    for name in NAMES:
        assert run.log[name].dtype == np.float64
        assert bits(run.log[name]) == bits(memory[name]), name
    blocks = list(run.log.blocks(("time_s", "thrust_3_N"), rows=300))
    assert [len(block["time_s"]) for block in blocks] == [300, 300, 300, 200]
    assert bits(np.concatenate([block["thrust_3_N"] for block in blocks])) == bits(memory["thrust_3_N"])


def test_the_same_flight_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        fly(tmp_path / name, 600)
    fly(tmp_path / "c", 600, seed=2)
    first, second, other = ((tmp_path / name / LOG).read_bytes() for name in "abc")
    assert first == second != other


def test_how_the_rows_were_cut_leaves_no_trace(tmp_path: Path, flight: list, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrow_module, "ROWS_PER_GROUP", 400)
    random = Random(5)
    files = []
    for name, chance in (("whole", 0.0), ("cut", 0.05)):
        sink = StreamSink(tmp_path / name, name)
        recorder = Recorder(STEP, sink)
        for sample in flight:
            recorder.observe(sample)
            if random.random() < chance:
                recorder.flush()
        recorder.flush()
        sink.end()
        sink.close()
        assert stream_to_parquet(tmp_path / name, tmp_path / f"{name}.parquet") == 1100
        files.append((tmp_path / f"{name}.parquet").read_bytes())
    assert files[0] == files[1]
    groups = pq.ParquetFile(tmp_path / "cut.parquet").metadata
    assert [groups.row_group(i).num_rows for i in range(groups.num_row_groups)] == [400, 400, 300]


def test_the_file_describes_its_columns_and_nothing_of_the_machine(tmp_path: Path) -> None:
    fly(tmp_path / "run", 10)
    schema = pq.read_schema(tmp_path / "run" / LOG)
    assert schema.metadata is None
    field = schema.field("rate_p_predicted_rad_s")
    assert field.metadata[b"unit"] == b"rad/s"
    assert field.metadata[b"frame"] == b"body"


def test_an_unknown_column_suggests_a_near_one(tmp_path: Path) -> None:
    for run in (fly(tmp_path / "run", 10), fly(None, 10)):
        with pytest.raises(InputError, match=r"no column 'rol_rad'; did you mean 'roll_rad'\?"):
            run.log["rol_rad"]


@pytest.mark.parametrize("rows", [0, 1])
def test_a_flight_of_next_to_nothing(tmp_path: Path, rows: int) -> None:
    run = fly(tmp_path / "run", rows)
    assert len(run.log) == len(run.log["roll_rad"]) == run.summary.steps == rows
    assert len(open_run(tmp_path / "run").log) == rows
    assert len(fly(None, rows).log["roll_rad"]) == rows


def test_conversion_takes_no_more_memory_for_a_longer_flight(tmp_path: Path) -> None:
    code = f"""
import resource, sys
import numpy as np
from pathlib import Path
from cosim.results.log.columns import NAMES
from cosim.results.metrics import flight_metrics
from cosim.results.log.arrow import ParquetLog, StreamSink, stream_to_parquet
folder = Path({str(tmp_path)!r})
def peak(rows):
    sink = StreamSink(folder / f"{{rows}}.arrows", "")
    random = np.random.default_rng(1)
    for _ in range(rows // {BLOCK}):
        sink.write(random.normal(size=(len(NAMES), {BLOCK})))
    sink.end(); sink.close()
    assert stream_to_parquet(folder / f"{{rows}}.arrows", folder / "x.parquet") == rows
    flight_metrics(ParquetLog(folder / "x.parquet"), {STEP})
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
print(peak(40_000), peak(160_000))
"""
    short, long = map(int, subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout.split())
    held = 120_000 * len(NAMES) * 8  # 80 MB, if the difference between the two were in memory
    # five columns of the longer flight may be: 6 MB, and twice that in temporaries
    assert long - short < held / 3


def test_every_complete_batch_of_a_torn_stream_is_recovered(tmp_path: Path) -> None:
    begun = begin_run(setup(), scenario(), tmp_path / "whole")
    ends = []
    stream = tmp_path / "whole" / STREAM
    for k, sample in enumerate(samples(1050), start=1):
        if k == 1:
            ends.append(stream.stat().st_size)
        begun.observe(sample)
        if k % BLOCK == 0:
            ends.append(stream.stat().st_size)
    content = stream.read_bytes()
    assert len(content) == ends[-1]
    assert len(ends) == 5
    toml = (tmp_path / "whole" / SCENARIO).read_bytes()
    expected = begun.finish("completed", "").log["roll_rad"]
    random = Random(2)
    cuts = {end + shift for end in ends for shift in (-9, -8, -1, 0, 1, 4, 8, 9, 200)} | {
        random.randrange(ends[0], ends[-1]) for _ in range(25)
    }
    for number, cut in enumerate(sorted(cut for cut in cuts if ends[0] <= cut <= ends[-1])):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / SCENARIO).write_bytes(toml)
        (folder / STREAM).write_bytes(content[:cut])
        run = open_run(folder)
        rows = BLOCK * (sum(end <= cut for end in ends) - 1)
        assert len(run.log) == run.summary.steps == rows, cut
        assert bits(run.log["roll_rad"]) == bits(expected[:rows])
        assert (run.outcome, run.reason, run.summary.wall_s) == ("failed", "interrupted", None)
        assert run.scenario.name == run.summary.scenario == "roll-doublet"
        assert sorted(path.name for path in folder.iterdir()) == sorted([LOG, SCENARIO, SUMMARY])


@pytest.mark.parametrize("cut", [0, 3, 200, 5000])
def test_a_stream_torn_before_its_first_row_is_said_in_one_line(tmp_path: Path, cut: int) -> None:
    begun = begin_run(setup(), scenario(), tmp_path / "whole")
    content = (tmp_path / "whole" / STREAM).read_bytes()
    begun.finish("completed", "")
    (tmp_path / STREAM).write_bytes(content[:cut])
    with pytest.raises(InputError, match=r"torn before its first row"):
        open_run(tmp_path)
    assert (tmp_path / STREAM).exists()


CHILD = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from flights import samples, scenario, setup
from cosim.results.run import begin_run
recording = begin_run(setup(), scenario(), Path({folder!r}))
for sample in samples(10**9):
    recording.observe(sample)
    print(sample.k + 1, flush=True)
"""


@pytest.fixture
def flying(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    code = CHILD.format(tests=str(TOOLS), folder=str(tmp_path / "run"))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        yield child, tmp_path / "run"
        child.kill()


def test_kill_9_loses_at_most_a_second_of_flight(flying: tuple[subprocess.Popen[str], Path]) -> None:
    child, folder = flying
    assert child.stdout is not None
    for line in child.stdout:
        if int(line) >= 870:
            break
    with pytest.raises(InputError, match="still being recorded"):
        open_run(folder)
    child.send_signal(signal.SIGKILL)
    done = [int(line) for line in child.stdout if line.endswith("\n")]
    child.wait()
    last = done[-1] if done else 870
    run = open_run(folder)
    assert last - BLOCK < len(run.log) <= last + 1
    assert run.outcome == "failed"
    assert run.reason == "interrupted"
    assert not (folder / STREAM).exists()
    expected = recorded(list(samples(len(run.log)))).log()
    for name in NAMES:
        assert bits(run.log[name]) == bits(expected[name]), name
    again = open_run(folder)
    assert again.summary == run.summary
    assert bits(again.log["east_m"]) == bits(run.log["east_m"])


def test_killed_between_summary_and_clearing_up(tmp_path: Path) -> None:
    run = fly(tmp_path / "run", 600)
    begun = begin_run(setup(), scenario(), tmp_path / "other")
    for sample in samples(600):
        begun.observe(sample)
    stream = (tmp_path / "other" / STREAM).read_bytes()
    begun.finish("completed", "")
    (tmp_path / "run" / STREAM).write_bytes(stream)
    before = (tmp_path / "run" / LOG).read_bytes()
    assert open_run(tmp_path / "run").summary == run.summary
    assert (tmp_path / "run" / LOG).read_bytes() == before
    assert not (tmp_path / "run" / STREAM).exists()


@pytest.mark.parametrize("name", RUN_FILES)
def test_a_folder_that_holds_a_run_is_refused_untouched(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("precious")
    with pytest.raises(InputError, match="already holds a run"):
        begin_run(setup(), scenario(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "precious"


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "run", Path("/proc/run")):
        with pytest.raises(InputError, match=re.escape(str(folder))):
            begin_run(setup(), scenario(), folder)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission(tmp_path: Path) -> None:
    (tmp_path / "shut").mkdir(mode=0o500)
    with pytest.raises(InputError, match="Permission denied"):
        begin_run(setup(), scenario(), tmp_path / "shut")


def test_the_scenario_can_be_flown_from_the_folder(tmp_path: Path) -> None:
    sticks = tmp_path / "somewhere" / "sticks.csv"
    sticks.parent.mkdir()
    sticks.write_text("time_s,roll\n0,0\n")
    flown = scenario(command=[{"kind": "table", "file": "sticks.csv"}], vehicle={"mass_kg": 6.0})
    begin_run(setup(), flown, tmp_path / "run", {"sticks.csv": sticks}).finish("completed", "")
    assert (tmp_path / "run" / "sticks.csv").read_text() == sticks.read_text()
    run = open_run(tmp_path / "run")
    assert run.scenario.model_dump() == flown.model_dump()
    assert run.scenario.folder == tmp_path / "run"
    assert tomllib.loads((tmp_path / "run" / SCENARIO).read_text())["vehicle"] == {"mass_kg": 6.0}
    for name in ("../x.csv", "summary.json"):
        with pytest.raises(InputError, match="cannot be copied"):
            begin_run(setup(), flown, tmp_path / "other", {name: sticks})
    with pytest.raises(InputError, match=r"nowhere\.csv"):
        begin_run(setup(), flown, tmp_path / "other", {"sticks.csv": tmp_path / "nowhere.csv"})
    assert not any((tmp_path / "other").iterdir())


def test_the_summary_says_what_the_design_asks_for(tmp_path: Path) -> None:
    run = fly(tmp_path / "run", 2000)
    text = (tmp_path / "run" / SUMMARY).read_text()
    data = json.loads(text)
    assert data == run.summary.model_dump(mode="json") == open_run(tmp_path / "run").summary.model_dump(mode="json")
    assert data["outcome"] == "completed"
    assert data["reason"] == "flew 2000 steps"
    assert (data["steps"], data["duration_s"], data["wall_s"]) == (2000, 8.0, 2.0)
    assert (data["realtime_factor"], data["step_us"]) == (4.0, 1000.0)
    said = [data[key] for key in ("scenario", "aircraft", "engine", "controller", "seed")]
    assert said == ["roll-doublet", "hexjet", "edf-as-flown", "smith", 1]
    wanted = {"rmse_rad", "max_abs_error_rad", "overshoot_percent", "settling_time_s", "rate_rmse_rad_s"}
    assert wanted <= set(data["metrics"]["roll"])
    assert data["metrics"]["roll"]["commanded"]
    assert data["expectations_met"] is True
    assert data["complaints"] == []
    assert data["delay_ledger"] == [row.model_dump(mode="json") for row in setup().delay_ledger]
    assert len(text.splitlines()) < 110  # for people too


def test_an_unmet_expectation_is_said() -> None:
    begun = begin_run(setup(), scenario())
    for sample in samples(2000, zeta=0.1):
        begun.observe(sample)
    run = begun.finish("crashed", "the hull touched the ground")
    assert run.summary.expectations_met is False
    assert run.summary.complaints[0] == "outcome = crashed, expected completed"
    assert run.summary.complaints[1].startswith("roll.overshoot_percent = ")
    assert run.metrics["roll"].overshoot_percent == run.summary.flat_metrics["roll.overshoot_percent"]


def test_without_a_folder_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = fly(None, 300)
    assert run.folder is None
    assert run.scenario.name == "roll-doublet"
    assert len(run.log) == 300
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        (SUMMARY, None, "no run here"),
        (LOG, None, "no run here"),
        (SUMMARY, "{", "not a run's summary"),
        (SUMMARY, "{}", "scenario: Field required"),
        (LOG, "PAR1 or not", "cannot be read as Parquet"),
        (STREAM, "not a stream at all, but long enough", "torn before its first row"),
    ],
)
def test_a_spoilt_folder_is_one_line(tmp_path: Path, name: str, content: str | None, complaint: str) -> None:
    fly(tmp_path, 10)
    if content is None:
        (tmp_path / name).unlink()
    else:
        if name == STREAM:
            (tmp_path / SUMMARY).unlink()
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=complaint) as raised:
        open_run(tmp_path)
    assert str(tmp_path) in str(raised.value)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no run here"):
        open_run(tmp_path / "nowhere")


FULL = """
import resource, signal, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from flights import samples, scenario, setup
from cosim.base.errors import FlightError
from cosim.results.run import begin_run
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
recording = begin_run(setup(), scenario(), Path({folder!r}))
# no file may grow past 600 kB, as on a disk that fills: a second of flight is 210 kB
resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, resource.RLIM_INFINITY))
try:
    for sample in samples(2000):
        recording.observe(sample)
except FlightError as error:
    print(sample.k, error)
if {roomy}:
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
else:
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
try:
    run = recording.finish("completed", "")
    print(run.outcome, run.reason)
except FlightError as error:
    print(error)
"""


@pytest.mark.parametrize("roomy", [True, False])
def test_a_full_disk_ends_the_run_and_keeps_what_was_written(tmp_path: Path, roomy: bool) -> None:
    folder = tmp_path / "run"
    code = FULL.format(tests=str(TOOLS), folder=str(folder), roomy=roomy)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    during, after = done.stdout.splitlines()
    assert during == f"749 {folder / STREAM}: File too large"  # the third second did not fit
    if roomy:
        # the disk has room again by then: the block that failed is written after all, and nothing is missing
        assert after.startswith("completed")
        log, expected = open_run(folder).log, recorded(list(samples(750))).log()
        assert all(bits(log[name]) == bits(expected[name]) for name in NAMES)
    else:
        assert after.startswith(f"{folder / LOG}: File too large; what was flown is kept in {folder / STREAM}")
        assert sorted(path.name for path in folder.iterdir()) == sorted([STREAM, SCENARIO])
        assert len(open_run(folder).log) == 500


def test_a_log_that_fails_to_the_end_makes_the_run_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun = begin_run(setup(), scenario(), tmp_path / "run")
    for sample in samples(600):
        begun.observe(sample)

    def refuse(self: StreamSink, table: object) -> None:
        raise FlightError("flight.arrows: Input/output error")

    monkeypatch.setattr(StreamSink, "write", refuse)
    run = begun.finish("completed", "")
    assert (run.outcome, run.reason, len(run.log)) == ("failed", "flight.arrows: Input/output error", 500)


def test_an_unreadable_value_survives(tmp_path: Path) -> None:
    sample, _ = numbered()
    odd = sample._replace(engines=sample.engines._replace(thrust=(nan, float("inf"), -0.0, 5e-324, 1e308, -1.0)))
    recording = begin_run(setup(), scenario(), tmp_path / "run")
    recording.observe(odd)
    run = recording.finish("failed", "engine 1")
    thrust = np.array([run.log[f"thrust_{jet}_N"][0] for jet in range(1, 7)])
    assert bits(thrust) == bits(np.array(odd.thrust))
    assert isinstance(run.log, ParquetLog)
    with pa.OSFile(str(tmp_path / "run" / LOG)) as file:
        assert file.size() > 0
