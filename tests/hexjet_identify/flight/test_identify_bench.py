"""An engine out of its bench logs: the truth where it is known, and words where a log does not tell."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from command_tools import Hexjet
from identification_record import SHARED
from known_benches import EXCITATIONS, Truth, bench_log

from cosim.base.errors import InputError, NotIdentifiedError
from cosim.engine import EngineBank, load_engine
from hexjet_identify.bench import Choices, Columns, Identification, identify_bench, read_records
from hexjet_identify.bench.engine_table import engine_parameters, why_no_engine
from hexjet_identify.bench.identify import throttle_limits
from hexjet_identify.fit.forms import Limits

DOCUMENT = " ".join((Path(__file__).parents[3] / "docs" / "identification.md").read_text(encoding="utf-8").split())
SHARED_DATA = Path(__file__).parents[4] / "shared" / "data"
RECORDINGS, STANDS = SHARED_DATA / "jetcat-p300" / "recordings", SHARED_DATA / "thrust-stands" / "make.py"
ONE = Truth()
TWO = Truth(lags=(0.4, 0.2))
SLEWING = Truth(lags=(0.2,), slew=(30.0, 20.0))


def write(path: Path, command: np.ndarray, thrust: np.ndarray, times: np.ndarray, names: str = "") -> Path:
    head = names or "time_s,throttle,thrust_N"
    np.savetxt(path, np.column_stack([times, command, thrust]), "%.9g", ",", header=head, comments="")
    return path


def found(tmp_path: Path, kind: str, rate: float, truth: Truth = ONE, **choices: object) -> Identification:
    times, command, thrust, _ = bench_log(kind, rate, truth, **choices)  # type: ignore[arg-type]
    return identify_bench(read_records([write(tmp_path / "bench.csv", command, thrust, times)]))


@pytest.mark.parametrize("rate", [10.0, pytest.param(50.0, marks=pytest.mark.long)])
@pytest.mark.parametrize("kind", EXCITATIONS)
@pytest.mark.parametrize("truth", [ONE, TWO], ids=["one lag", "two lags"])
def test_delay_and_lags_come_out_of_every_excitation(tmp_path: Path, kind: str, rate: float, truth: Truth) -> None:
    result = found(tmp_path, kind, rate, truth)
    low, high = result.chosen.delay_bounds
    assert result.is_explained
    # The bounds of one log in twenty miss the truth, by little.
    assert low - 1e-3 <= 0.1 <= high + 1e-3
    assert high - low < 0.1 + 2.0 / rate or any(line.startswith("the delay: ") for line in result.untold)
    value, deviation = result.chosen.total
    assert abs(value - 0.1 - sum(truth.lags)) < 4.0 * deviation + 0.5 / rate


def test_limits_of_rise_and_fall_are_found_behind_a_curved_line(tmp_path: Path) -> None:
    result = found(tmp_path, "stairs of 5 s", 50.0, Truth(lags=(0.2,), exponent=1.3, slew=(30.0, 20.0)))
    assert result.is_explained
    assert isinstance(result.chosen.form, Limits)
    assert result.chosen.numbers["rise"][0] == pytest.approx(30.0, rel=0.02)
    told = engine_parameters(result)
    assert told.find("rise")[0] == pytest.approx(30.0 / told.find("gain")[0], rel=0.02)
    assert result.chosen.numbers["fall"][0] == pytest.approx(20.0, rel=0.02)
    assert told.find("exponent")[0] == pytest.approx(1.3, abs=0.05)


def test_a_governor_is_not_explained_however_little_it_is_off(hexjet: Hexjet, tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 20.0, Truth(governor=True))
    write(tmp_path / "bench.csv", command, thrust, times)
    done = hexjet("engine", "from-bench", "bench.csv", "--out", "mine")
    assert done.status == 1
    assert done.out.startswith("not explained: ")
    assert "no engine: the model does not explain the log" in done.out
    assert {path.name for path in (tmp_path / "mine").iterdir()} == {"identification.json", "report.html"}
    told = json.loads((tmp_path / "mine" / "identification.json").read_text(encoding="utf-8"))
    assert (told["found"], told["explained"], told["verdict"]) == (False, False, "not explained")


def test_a_slow_ramp_tells_the_static_line_alone_and_the_next_test(hexjet: Hexjet, tmp_path: Path) -> None:
    times = np.arange(0.0, 100.0, 0.5)
    command = np.linspace(0.05, 0.95, len(times))
    noise = np.random.default_rng(1).normal(0.0, 0.05, len(times))
    write(tmp_path / "bench.csv", command, 12.0 * command**1.8 + noise, times)
    done = hexjet("engine", "from-bench", "bench.csv", "--out", "mine")
    said = " ".join(done.out.split())
    assert done.status == 1
    assert "no engine: the log tells neither delay nor lag, the static line alone" in said
    assert "delay and lag: so slow a command shows the static line alone. Next: a step from 0.05 to 0.95" in said
    told = json.loads((tmp_path / "mine" / "identification.json").read_text(encoding="utf-8"))
    levels = np.array(told["estimates"][0]["levels"])
    np.testing.assert_allclose(levels[:, 1], 12.0 * levels[:, 0] ** 1.8, atol=0.1)


def test_the_terminal_has_the_verdict_first_and_three_notes_at_most(hexjet: Hexjet, tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("chirp", 50.0)
    write(tmp_path / "bench.csv", command, thrust, times)
    done = hexjet("engine", "from-bench", "bench.csv", "--out", "mine")
    assert done.out.startswith("explained to 0.")
    assert sum(line.startswith(("note: ", "not told: ", "no engine: ")) for line in done.out.splitlines()) == 3
    assert " more on the page" in done.out


@pytest.mark.skipif(not STANDS.is_file(), reason="the maker of thrust-stand logs is not at hand")
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 6))])
def test_logs_of_thrust_stands_are_answered_as_their_truth_says(tmp_path: Path, seed: int) -> None:
    """A head longer than its rows, empty columns, ESC microseconds, gf, hum, limits, stamps of a host, a governor."""
    subprocess.run([sys.executable, str(STANDS), str(tmp_path), str(seed)], check=True, timeout=100)
    wrong = []
    for name, truth in json.loads((tmp_path / "truth.json").read_text(encoding="utf-8")).items():
        result = identify_bench(read_records([tmp_path / f"{name}.csv"]))
        wanted = (name != "governor", name not in ("governor", "slow-ramp"))
        low, high = result.chosen.delay_bounds
        right = (result.is_explained, not why_no_engine(result)) == wanted
        right &= low <= truth.get("delay_s", low) <= high
        if "rise_n_s" in truth:
            right &= result.chosen.numbers["rise"][0] == pytest.approx(truth["rise_n_s"], rel=0.02)
        wrong += [] if right else [f"{name}: {result.verdict.words}, {low:g} to {high:g} s, {why_no_engine(result)}"]
    assert wrong == []


def test_a_time_in_milliseconds_that_does_not_say_so_is_asked_for(tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 50.0, ONE)
    path = write(tmp_path / "bench.csv", command, thrust, 1e3 * times, "time,throttle,thrust_N")
    (doubted,) = read_records([path])
    assert "20 s from row to row: if the time is in milliseconds, time_unit ms" in doubted.notes
    (record,) = read_records([path], Columns(time_unit="ms"))
    assert record.step == pytest.approx(0.02)
    assert not any("time_unit" in note for note in record.notes)
    (record,) = read_records([path], Columns(time_unit="s"))
    assert not any("time_unit" in note for note in record.notes)
    write(path, command, thrust, times, "time,throttle,thrust [psi]")
    with pytest.raises(InputError, match=r"is in psi; allowed: a thrust or a speed in N, kN"):
        read_records([path])


def test_rows_of_a_kilohertz_are_averaged_and_the_delay_stays_where_it_is(tmp_path: Path) -> None:
    """100,000 rows in two parts: means of some, none across the gap, and a delay that is no multiple of anything."""
    times, command, thrust, _ = bench_log("stairs of 2 s", 1000.0, Truth(delay=0.1037), seconds=100.0, noise=0.2)
    keep = (times < 40.0005) | (times > 41.2)
    path = write(tmp_path / "cell.csv", command[keep], thrust[keep], times[keep])
    result = identify_bench(read_records([path]))
    (log,), chosen = result.problem.logs, result.chosen
    assert log.width > 0.004
    assert len(log.times) < 25_000
    assert not ((log.times > 40.0) & (log.times < 41.2)).any()
    assert chosen.delay == pytest.approx(0.1037, abs=0.0005)
    assert chosen.delay_bounds[0] <= 0.1037 <= chosen.delay_bounds[1]


@pytest.mark.parametrize(
    "kind", ["stairs of 5 s", *(pytest.param(one, marks=pytest.mark.long) for one in ("ramp", "chirp"))]
)
def test_the_static_curve_comes_out_with_its_exponent(tmp_path: Path, kind: str) -> None:
    value, deviation = engine_parameters(found(tmp_path, kind, 50.0, Truth(exponent=1.7))).find("exponent")
    assert abs(value - 1.7) < 4.0 * deviation < 0.4


def test_lost_and_clipped_rows_cost_nothing_but_rows(tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 50.0)
    rng = np.random.default_rng(1)
    thrust = np.minimum(thrust, 88.0)
    keep = rng.random(len(times)) > 0.1
    path = write(tmp_path / "poor.csv", command[keep], thrust[keep], times[keep])
    result = identify_bench(read_records([path]))
    words = " ".join(result.notes)
    assert "(clipped) or next to such; left out" in words
    assert result.chosen.delay == pytest.approx(0.1, abs=0.004)  # a step within lost rows is known to a row of 20 ms
    assert engine_parameters(result).find("gain")[0] == pytest.approx(100.0, abs=1.0)


def test_one_choice_of_what_is_between_rows_is_half_a_row_of_delay(tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("chirp", 20.0)
    records = read_records([write(tmp_path / "bench.csv", command, thrust, times)])
    straight, held = (identify_bench(records, Choices(between=each)) for each in ("straight", "held"))
    assert straight.chosen.delay - held.chosen.delay == pytest.approx(0.025, abs=0.002)
    assert any("taken for straight between rows, as it fits better" in note for note in identify_bench(records).notes)


def test_the_command_leaves_an_engine_that_answers_as_the_log(hexjet: Hexjet, tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 50.0, Truth(exponent=1.7))
    write(tmp_path / "bench.csv", command, thrust, times)
    done = hexjet("engine", "from-bench", "bench.csv", "--out", "mine")
    assert done.status == 0
    assert {path.name for path in (tmp_path / "mine").iterdir()} == {
        "engine.fmu", "engine.toml", "README.md", "measured.svg", "identification.json", "report.html",
    }  # fmt: skip
    table = tomllib.loads((tmp_path / "mine" / "engine.toml").read_text(encoding="utf-8"))
    assert table["parameters"]["delay_samples"] == 25
    assert table["parameters"]["lag"] == pytest.approx(0.4, abs=0.01)
    known = table["uncertainty"]
    assert known["parameters"] == ["delay_samples", "lag", "exponent", "gain", "offset"]
    assert len(known["deviation"]) == len(known["correlation"]) == 5
    with EngineBank(load_engine(str(tmp_path / "mine" / "engine.toml"), {}, 0.02), 1, 0.02) as bank:
        answered = [bank.reset(float(command[0])).thrust[0]]
        answered += [bank.step(k, (float(u),)).thrust[0] for k, u in enumerate(command[:-1])]
    assert np.sqrt(np.mean((np.array(answered) - thrust) ** 2)) < 0.55  # of which 0.5 N are noise
    told = json.loads((tmp_path / "mine" / "identification.json").read_text(encoding="utf-8"))
    assert told["explained"]
    assert told.keys() >= SHARED
    assert (told["found"], told["refused"]) == (True, [])
    assert told["delay_bounds_95_s"][0] <= 0.1 <= told["delay_bounds_95_s"][1]


def test_channels_that_are_given_leave_an_engine_where_the_output_is_a_thrust(hexjet: Hexjet, tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("chirp", 50.0, seconds=30.0)
    write(tmp_path / "bench.csv", command, thrust, times, "t_ms,throttle,thrust_N")
    given = ("--engine", "1", "--time", "t_ms", "--time-unit", "s", "--command", "throttle")
    done = hexjet("identify", "log", "bench.csv", *given, "--output", "thrust_N", "--out", "mine")
    assert done.status == 0
    assert "engine: " in done.out
    table = tomllib.loads((tmp_path / "mine" / "engine.toml").read_text(encoding="utf-8"))
    # A chirp that is taken for held has half a row of 5 samples less.
    assert table["parameters"]["delay_samples"] == pytest.approx(22.5, abs=0.5)
    assert table["parameters"]["lag"] == pytest.approx(0.4, rel=0.02)
    assert table["parameters"]["gain"] == pytest.approx(100.0, rel=0.01)
    assert load_engine(str(tmp_path / "mine" / "engine.toml"), {}, 0.004).thrust_at(1.0) > 100.0
    known = dict(zip(table["uncertainty"]["parameters"], table["uncertainty"]["deviation"], strict=True))
    assert list(known) == ["delay_samples", "lag", "gain", "offset"]
    told = json.loads((tmp_path / "mine" / "identification.json").read_text(encoding="utf-8"))
    assert told.keys() >= SHARED
    best, (low, high) = told["estimates"][0], told["delay_bounds_95_s"]
    assert known["lag"] == pytest.approx(best["standard_deviations"]["rate_1_s"] / best["rate_1_s"] ** 2, rel=1e-4)
    assert known["gain"] == pytest.approx(best["standard_deviations"]["gain"], rel=1e-4)
    assert known["delay_samples"] >= (high - low) / (2.0 * 1.96 * 0.004) * 0.999
    assert load_engine(str(tmp_path / "mine" / "engine.toml"), {}, 0.004).uncertainty is not None
    assert "hexjet identify log" in (tmp_path / "mine" / "README.md").read_text(encoding="utf-8")
    write(tmp_path / "bench.csv", 100.0 * command, thrust, times, "t_ms,throttle,thrust_N")
    done = hexjet("identify", "log", "bench.csv", *given, "--output", "thrust_N", "--out", "mine")
    assert "an engine's throttle from 0 to 1: hexjet engine from-bench --throttle-range" in " ".join(done.out.split())
    assert not (tmp_path / "mine" / "engine.toml").exists()
    write(tmp_path / "bench.csv", command, thrust, times, "t_ms,throttle,speed_rpm")
    done = hexjet("identify", "log", "bench.csv", *given, "--output", "speed_rpm", "--out", "none")
    assert "no engine: the output is in rpm, and an engine's is a thrust in N" in " ".join(done.out.split())


@pytest.mark.parametrize(
    ("name", "changed", "status", "words"),
    [
        ("three rows", lambda t, u, y: (t[:3], u[:3], y[:3]), 2, "3 rows of throttle that can be used; at least 20"),
        ("no step", lambda t, u, y: (t, 0 * u, y), 1, "throttle does not move; step it: a step up and one down"),
        ("noise alone", lambda t, u, y: (t, u, y - y + np.sin(1e4 * t**2)), 1, "the output hardly shows the command"),
        ("percent", lambda t, u, y: (t, 100 * u, y), 0, "has no unit: taken for percent; --throttle-range LOW HIGH says"),
        ("negative", lambda t, u, y: (t, u, -y), 0, "if the load cell's sign is the other one: output -thrust_N"),
        ("backwards", lambda t, u, y: (np.where(t > 30, t - 30, t), u, y), 2, "the time begins again after 30 s: two tests"),
        ("nothing but a head", lambda t, u, y: (t[:0], u[:0], y[:0]), 2, "the table has no rows"),
        ("no numbers", lambda t, u, y: (t, u, np.nan * y), 2, "0 rows of thrust_N that can be used; at least 20"),
        ("constant", lambda t, u, y: (t, u, 0 * y + 5), 1, "thrust_N does not move"),
        ("another engine's channel", lambda t, u, y: (t, u, bench_log("prbs", 20.0, seed=7)[2]), 1, "hardly shows the command"),
        ("microseconds", lambda t, u, y: (t, 1000 + 1000 * u, y), 0, "1000 to 2000 us are taken for"),
        ("a lever", lambda t, u, y: (t, 90 * u - 20, y), 0, "no engine: what throttle 0 and 1 are"),
    ],
)  # fmt: skip
def test_wrong_logs_are_told_in_a_line(
    hexjet: Hexjet, tmp_path: Path, name: str, changed: object, status: int, words: str
) -> None:
    times, command, thrust = changed(*bench_log("stairs of 5 s", 20.0)[:3])  # type: ignore[operator]
    write(tmp_path / "bench.csv", command, thrust, times)
    done = hexjet("engine", "from-bench", "bench.csv", "--out", "mine")
    assert done.status == status
    assert not any("throttle_range" in page.read_text() for page in tmp_path.glob("mine/*.[mh]*"))
    assert words in " ".join((done.out + done.err).split())
    assert "Traceback" not in done.err


def test_a_fan_that_steps_from_standstill_is_measured_whole(tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 10.0)
    rpm = 300.0 * (thrust - 25.0)  # 0 at the lowest of its levels
    (record,) = read_records([write(tmp_path / "fan.csv", command, rpm, times, "time_s,throttle,rpm")])
    assert (record.times[0], record.times[-1]) == (0.0, times[-1])
    assert not any("left out" in note for note in record.notes)


def test_a_share_that_is_called_percent_leaves_no_engine(tmp_path: Path) -> None:
    """A hundredfold gain would be wrong without a word."""
    from hexjet_identify.bench.result import why_no_engine

    times, command, thrust, _ = bench_log("stairs of 5 s", 10.0)
    result = identify_bench(read_records([write(tmp_path / "b.csv", command, thrust, times, "t,throttle [%],F [N]")]))
    assert any("is in percent and never above 0.9" in note for note in result.notes)
    assert why_no_engine(result) == "what throttle 0 and 1 are is not known: throttle_range LOW HIGH"


@pytest.mark.parametrize(
    ("head", "time", "command", "output", "newtons"),
    [
        ("t [ms],throttle [%],thrust [kN]", 1e3, 100.0, 1e-3, 1e3),
        ("time (min),Throttle (%),F (lbf)", 1.0 / 60.0, 100.0, 1.0 / 4.4482216, 4.4482216),
        ("t_us,PLA_pct,load_kgf", 1e6, 100.0, 1.0 / 9.80665, 9.80665),
        ("Time,throttle [-],Schub [N]", 1.0, 1.0, 1.0, 1.0),
    ],
)
def test_units_are_those_of_the_head(
    tmp_path: Path, head: str, time: float, command: float, output: float, newtons: float
) -> None:
    times, throttle, thrust, _ = bench_log("stairs of 5 s", 10.0)
    columns = [time * times, command * throttle, output * thrust]
    write(tmp_path / "bench.csv", columns[1], columns[2], columns[0], head)
    pyarrow.parquet.write_table(
        pyarrow.table(dict(zip(head.split(","), columns, strict=True))), tmp_path / "bench.parquet"
    )
    for name in ("bench.csv", "bench.parquet"):
        record = read_records([tmp_path / name])[0]
        assert record.step == pytest.approx(0.1)
        assert record.newtons == pytest.approx(newtons)
        assert throttle_limits([record], None, []) == ((0.0, command), True)


def test_a_tdms_is_read_by_its_waveform_or_its_channel_of_time(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    times, command, thrust, _ = bench_log("stairs of 5 s", 10.0)
    wave = {"wf_increment": 0.1, "wf_start_offset": 3.0}
    with nptdms.TdmsWriter(tmp_path / "wave.tdms") as file:
        file.write_segment([
            nptdms.ChannelObject("bench", "throttle", 100 * command, wave | {"unit_string": "%"}),
            nptdms.ChannelObject("bench", "thrust", thrust, wave | {"unit_string": "N"}),
        ])  # fmt: skip
    with nptdms.TdmsWriter(tmp_path / "stamps.tdms") as file:
        file.write_segment([
            nptdms.ChannelObject("bench", "Time [ms]", 1e3 * times + 3e3),
            nptdms.ChannelObject("bench", "throttle [%]", 100 * command),
            nptdms.ChannelObject("bench", "thrust [N]", thrust),
        ])  # fmt: skip
    for name in ("wave.tdms", "stamps.tdms"):
        record = read_records([tmp_path / name])[0]
        assert (record.command_unit, record.output_unit) == ("percent", "N")
        np.testing.assert_allclose(record.times, times + 3.0, atol=1e-9)
        np.testing.assert_array_equal(record.output, thrust)
    (tmp_path / "wave.tdms").write_bytes((tmp_path / "wave.tdms").read_bytes()[:60])
    with pytest.raises(InputError, match=r"wave\.tdms: "):
        read_records([tmp_path / "wave.tdms"])


def started_and_stopped(folder: Path, state: bool) -> Path:
    """Off, start as a jet's with a peak, 60 s of steps from idle, stop, off: at 10 Hz, speed in rpm."""
    _, command, thrust, _ = bench_log("stairs of 5 s", 10.0)
    running = 30000.0 + 700.0 * (thrust - 25.0)
    start = np.interp(np.arange(400) / 10.0, [0, 10, 30, 34, 37], [0, 0, 31000, 38000, running[0]])
    stop = running[-1] * np.exp(-np.arange(300) / 20.0)
    rpm = np.concatenate([start, running, stop])
    asked = np.concatenate(
        [np.interp(np.arange(400) / 10.0, [0, 10, 30, 35], [0, 0, 0.3, 0.2]), command, np.zeros(300)]
    )
    states = np.repeat([0, 3, 11, 8], [100, 300, 600, 300])
    columns = [np.arange(len(rpm)) / 10.0, asked, rpm, *([states] if state else [])]
    head = "time_s,throttle,rpm" + (",state" if state else "")
    np.savetxt(folder / "whole.csv", np.column_stack(columns), "%.9g", ",", header=head, comments="")
    return folder / "whole.csv"


@pytest.mark.parametrize("state", [False, True])
def test_a_start_and_a_stop_are_left_out_and_that_is_said(tmp_path: Path, state: bool) -> None:
    (record,) = read_records([started_and_stopped(tmp_path, state)])
    assert 37.0 <= record.times[0] <= 41.5
    assert 93.0 <= record.times[-1] <= 100.1  # its last step, at 95 s, is not at rest when it is shut down
    assert any(note.startswith("off, start or stop of the engine: 0.0 to ") for note in record.notes)
    chosen = identify_bench([record]).chosen
    assert chosen.delay_bounds[0] <= 0.1 <= chosen.delay_bounds[1]


def test_two_engines_mixed_are_named_and_their_spread_kept(tmp_path: Path) -> None:
    paths = []
    for n, truth in enumerate((Truth(), Truth(delay=0.15, lags=(0.6,), gain=130.0))):
        times, command, thrust, _ = bench_log("stairs of 5 s", 20.0, truth, seed=n)
        paths.append(write(tmp_path / f"{n}.csv", command, thrust, times))
    result = identify_bench(read_records(paths))
    assert {note.split(" is ")[0] for note in result.notes if "two engines" in note} >= {"lag", "gain"}
    assert result.spread["gain"] == pytest.approx(30.0 / 2**0.5, rel=0.1)


def test_two_clocks_are_refused_in_a_line(tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 20.0)
    np.savetxt(tmp_path / "ecu.csv", np.column_stack([times, command]), "%.9g", ",", header="t,throttle", comments="")
    np.savetxt(tmp_path / "cell.csv", np.column_stack([times, thrust]), "%.9g", ",", header="t,F (N)", comments="")
    with pytest.raises(InputError, match=r"no column is called like what output needs.*on one clock in one file"):
        read_records([tmp_path / "ecu.csv", tmp_path / "cell.csv"])


def test_columns_that_are_called_alike_are_asked_for(tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 20.0)
    path = tmp_path / "two.csv"
    np.savetxt(path, np.column_stack([times, command, thrust, thrust]), "%.9g", ",",
               header="time_s,throttle,thrust_1_N,thrust_2_N", comments="")  # fmt: skip
    with pytest.raises(Exception, match="thrust_1_N, thrust_2_N: output NAME says which"):
        read_records([path])
    assert read_records([path], Columns(output="thrust_2_N"))[0].output_unit == "N"


def test_an_output_that_does_not_move_is_refused(tmp_path: Path) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 20.0)
    path = write(tmp_path / "still.csv", command, 0.0 * thrust, times)
    with pytest.raises(NotIdentifiedError, match="thrust_N does not move"):
        identify_bench(read_records([path]))


TURBINE = {"acceleration": 0.2, "deceleration": 0.4, "speed_gain": 0.025}


def turbine_log(folder: Path, seed: int, speed: bool = False) -> Path:
    times, command, _, _ = bench_log("stairs of 5 s", 50.0, seconds=45.0)
    with EngineBank(load_engine("turbine-220", TURBINE | {"delay_samples": 40}, 0.02), 1, 0.02) as bank:
        outputs = [bank.reset(float(command[0]))]
        outputs += [bank.step(k, (float(u),)) for k, u in enumerate(command[:-1])]
    noise = np.random.default_rng(seed).standard_normal(len(times))
    if speed:
        rpm = np.array([each.spool_speed[0] for each in outputs]) * 30.0 / np.pi
        return write(folder / "turbine.csv", command, rpm + 50.0 * noise, times, "time_s,throttle,speed_rpm")
    return write(folder / "turbine.csv", command, np.array([each.thrust[0] for each in outputs]) + 0.5 * noise, times)


@pytest.mark.parametrize("speed", [False, pytest.param(True, marks=pytest.mark.long)])
def test_the_parameters_of_a_turbine_and_its_ecu_come_out(hexjet: Hexjet, tmp_path: Path, speed: bool) -> None:
    """Its own ramps, damping and delay, each within four standard deviations."""
    turbine_log(tmp_path, 1, speed)
    fits = [text for name in TURBINE for text in ("--fit", name)]
    done = hexjet("engine", "from-bench", "turbine.csv", "--engine", "turbine-220", *fits, "--out", "mine")
    assert done.status == 0, done.err
    told = json.loads((tmp_path / "mine" / "identification.json").read_text(encoding="utf-8"))
    assert told.keys() >= SHARED
    assert told["explained"]
    for name, value in (TURBINE | {"delay_s": 0.16}).items():
        assert abs(told["parameters"][name] - value) < 4.0 * told["standard_deviations"][name]
    table = tomllib.loads((tmp_path / "mine" / "engine.toml").read_text(encoding="utf-8"))
    assert table["uncertainty"]["parameters"] == ["delay_samples", *TURBINE]
    assert load_engine(str(tmp_path / "mine" / "engine.toml"), {}, 0.004).thrust_at(1.0) == pytest.approx(
        220.0, abs=0.1
    )


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("--fit", "acceleration"), 2, "name the engine"),
        (("--engine", "turbine-220", "--fit", "accelration"), 2, "did you mean 'acceleration'"),
        (("--engine", "turbine-220", "--fit", "command_dead_band"), 2, "is 0; say where to begin"),
        (("--engine", "turbine-220", "--fit", "light_speed"), 1, "light_speed not told"),
    ],
)
def test_what_cannot_be_fitted_is_told_in_a_line(
    hexjet: Hexjet, tmp_path: Path, arguments: tuple[str, ...], status: int, words: str
) -> None:
    turbine_log(tmp_path, 1)
    done = hexjet("engine", "from-bench", "turbine.csv", *arguments, "--out", "mine")
    assert done.status == status
    assert words in " ".join((done.out + done.err).split())


@pytest.mark.long
@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings of a JetCat P300-PRO are not at hand")
def test_the_ramp_of_a_real_ecu_foretells_half_of_its_steps_from_the_others(hexjet: Hexjet, tmp_path: Path) -> None:
    fits = ("--fit", "fuel_integral", "--fit", "fuel_fall")
    log = str(RECORDINGS / "run-2023-01-09-a.csv")
    done = hexjet("engine", "from-bench", log, "--engine", "jetcat-p300", *fits, "--out", str(tmp_path / "mine"))
    assert done.status == 0, done.err
    told = json.loads((tmp_path / "mine" / "identification.json").read_text(encoding="utf-8"))
    verdict = done.out.partition("\n")[0]
    assert f"`{verdict}`" in DOCUMENT
    assert told["residual_of_swing"] < 0.007
    assert len(told["held_back"]["movements"]) == 6
    assert any("the log has no thrust" in note for note in told["notes"])
    (line,) = told["not_told"]
    assert line.startswith("how small, quick commands are answered: no movement of setpoint_rpm is smaller than ")
    assert "Next: 2000 rpm up and down about 60000" in line


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings of a JetCat P300-PRO are not at hand")
def test_real_recordings_are_read_whole() -> None:
    """Start and stop by state and speed, and an engine out of fuel."""
    for name, begin, end in (
        ("run-2022-12-14.csv", 71.7, 132.1),
        ("run-2023-01-09-a.csv", 71.1, 268.9),
        ("run-2023-02-22-b.csv", 67.8, 1180.0),
    ):
        (record,) = read_records([RECORDINGS / name])
        assert record.times[0] == pytest.approx(begin, abs=0.2)
        assert end - 3.0 < record.times[-1] <= end


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings of a JetCat P300-PRO are not at hand")
def test_a_real_turbojet_is_no_lag_and_that_is_said() -> None:
    """Its ECU ramps fuel by error and level: delay and lags are 1 to 4 s together, and do not explain it."""
    columns = Columns("setpoint_rpm", "rpm", begin=80.0, end=290.0)
    result = identify_bench(read_records([RECORDINGS / "run-2023-01-09-a.csv"], columns))
    assert not result.is_explained
    assert any("try engine jetcat-p300 with fit fuel_integral" in note for note in result.notes)
    assert 1.0 < result.chosen.total[0] < 4.0


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings of a JetCat P300-PRO are not at hand")
def test_three_steps_of_a_real_turbojet_tell_delay_and_lags_together_alone() -> None:
    """Two equal lags leave 1 % of the range beside the steps, too few to hold any back: no lag is told, no engine left."""
    columns = Columns("setpoint_rpm", "rpm", begin=250.0, end=1150.0)
    result = identify_bench(read_records([RECORDINGS / "run-2023-02-22-b.csv"], columns))
    total, deviation = result.chosen.total
    assert 1.0 < total < 4.0
    assert deviation < 0.05 * total
    assert result.verdict.times == 0
    assert result.is_explained
    (line,) = result.refused
    assert (
        "does not tell the lag and the second lag, whose 95 % bounds exceed the value; delay and lags together are "
        in line
    )
    assert "Next: a step from 5e+04 to 1e+05 and back, each held 13 s" in line
