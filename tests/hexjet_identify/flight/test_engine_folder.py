"""The folder that each identification of an engine leaves: an engine that flies, its page, its picture."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet
from known_benches import Truth, bench_log

from cosim.engine import load_engine
from cosim.engine.response import find_curve_problems
from cosim.spec.vehicle import file_seen_from
from hexjet_identify.bench import identify_bench, read_records
from hexjet_identify.bench.result import BenchIdentifyResult

SVG = "{http://www.w3.org/2000/svg}"
GIVEN = ("--engine", "1", "--time", "t_s", "--command", "throttle", "--output", "thrust_N")
COMMANDS = {
    "bench": ("engine", "from-bench", "bench.csv"),
    "own parameters": ("engine", "from-bench", "bench.csv", "--engine", "fitted", "--fit", "lag", "--fit", "gain",
                       "--set", "offset=5", "--set", "lag=0.2"),
    "log": ("identify", "log", "bench.csv", *GIVEN),
}  # fmt: skip


def log_of(
    folder: Path, truth: Truth, kind: str = "chirp", noise: float = 0.5, seed: int = 1, rate: float = 50.0
) -> Path:
    times, command, thrust, _ = bench_log(kind, rate, truth, noise=noise, seconds=40.0, seed=seed)
    rows = np.column_stack([times, command, thrust])
    np.savetxt(folder / "bench.csv", rows, "%.9g", ",", header="t_s,throttle,thrust_N", comments="")
    return folder / "bench.csv"


@pytest.mark.parametrize("command", COMMANDS)
def test_it_has_an_engine_a_page_and_a_picture(hexjet: Hexjet, tmp_path: Path, command: str) -> None:
    """The thrust at rest is the bench's, 5 N at no throttle included; the page has what an engine's page has."""
    log_of(tmp_path, Truth())
    done = hexjet(*COMMANDS[command], "--out", "mine")
    assert done.status == 0, done.out + done.err
    engine = load_engine(file_seen_from("mine", tmp_path), {}, 0.004)
    for throttle in (0.4, 0.6):
        assert engine.thrust_at(throttle) == pytest.approx(5.0 + 100.0 * throttle, abs=0.5)
    assert engine.uncertainty is not None
    page = (tmp_path / "mine" / "README.md").read_text(encoding="utf-8")
    for part in ("**Source.** bench.csv", "**Validity.** throttle from", "**Residuals.**", "**Not told by the log**"):
        assert part in page
    assert not re.search(r"\|\s*\|$", page.replace("| with 95 % bounds | |", ""), re.MULTILINE)  # no empty row
    (picture,) = re.findall(r"!\[Measured and modelled\]\((\S+)\)", page)
    drawing = ET.parse(tmp_path / "mine" / picture).getroot()
    texts = {each.text for each in drawing.iter(f"{SVG}text")}
    assert texts >= {"measured", "model, of the command alone", "command", "time [s]", "N"}
    curves = [each.get("points", "") for each in drawing.iter(f"{SVG}polyline")]
    assert all(len(curve.split()) > 100 for curve in curves[:3])


def test_a_delay_between_two_steps_is_as_unsure_as_the_step_that_it_is_rounded_to(tmp_path: Path) -> None:
    """66 ms are 16.5 steps of 4 ms: however well they are known, the engine has 16 or 17, and its bounds the truth."""
    result = identify_bench(read_records([log_of(tmp_path, Truth(delay=0.066), "stairs of 2 s", 0.05, rate=500.0)]))
    assert np.ptp(result.chosen.delay_bounds) < 0.006
    engine = load_engine(str(BenchIdentifyResult(result).write(tmp_path / "mine").files["engine"]), {}, 0.004)
    assert engine.uncertainty is not None
    (deviation,) = engine.uncertainty.deviation[:1]
    assert deviation >= abs(result.chosen.delay / 0.004 - engine.parameters["delay_samples"])
    assert abs(16.5 - engine.parameters["delay_samples"]) < 1.96 * deviation


@pytest.mark.parametrize("seed", range(4))
def test_an_engine_without_idle_thrust_is_fit_to_fly(tmp_path: Path, seed: int) -> None:
    """Noise puts the line at throttle 0 below no thrust half of the time; the engine has none there, and no less."""
    path = log_of(tmp_path, Truth(gain=20.0, offset=0.0), "stairs of 2 s", seed=seed)
    result = identify_bench(read_records([path]))
    assert not any("static curve is below 0" in note for note in result.notes)
    engine = load_engine(str(BenchIdentifyResult(result).write(tmp_path / "mine").files["engine"]), {}, 0.004)
    assert find_curve_problems(engine.curve) == []


def test_a_load_cell_whose_zero_is_wrong_is_named(tmp_path: Path) -> None:
    result = identify_bench(read_records([log_of(tmp_path, Truth(gain=20.0, offset=-2.0), "stairs of 5 s")]))
    (note,) = [note for note in result.notes if "static curve is below 0" in note]
    assert re.search(r"is below 0 up to throttle 0\.(1|09\d?) \(-", note)
    engine = load_engine(str(BenchIdentifyResult(result).write(tmp_path / "mine").files["engine"]), {}, 0.004)
    assert find_curve_problems(engine.curve) == []
    assert engine.thrust_at(0.6) == pytest.approx(10.0, abs=0.3)


def test_where_none_is_left_that_is_the_last_word(hexjet: Hexjet, tmp_path: Path) -> None:
    log_of(tmp_path, Truth(gain=-20.0, offset=0.0), "stairs of 5 s")
    done = hexjet("engine", "from-bench", "bench.csv", "--out", "mine")
    assert done.status == 0  # a model is told
    assert "no engine: the thrust falls where the throttle rises" in " ".join(done.out.split())
    done = hexjet("fly", "hover", "--engine", "mine/engine.toml")
    assert done.status == 2
    line = f"{Path('mine', 'engine.toml')}: the identification left no engine; {Path('mine', 'report.html')} says why"
    assert line in done.err.replace(f"{tmp_path}/", "")
