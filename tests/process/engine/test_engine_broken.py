"""Broken FMUs: each gets one clear line, and none ends or hangs the process that asks."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import psutil
import pytest
from broken_fmus import BROKEN, DESCRIPTION, UNFIT, UNUSABLE, XML, Broken, Kit, packed
from patience import PATIENCE

from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.cli.main import main
from cosim.engine import EngineBank, build_engines, check, check_fmu, isolated, load_checked, load_engine, make_bank
from cosim.engine.fmu import container
from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.isolated import end_idle

STEP = 0.004
# A process needs half a second to start, and longer on a busy machine: then it is tried again with more patience.
TIME_LIMITS = (4.0, 20.0, PATIENCE)  # s

every_broken = pytest.mark.parametrize("broken", BROKEN, ids=[each.name for each in BROKEN])

NO_FLOW = "reports no fuel flow: the tank of a vehicle stays full with it"


@pytest.fixture(scope="module", autouse=True)
def temporary(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder for temporary files that is empty in the end, however the FMUs ended."""
    folder = tmp_path_factory.mktemp("temporary")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(folder))
        patch.setenv("TMPDIR", str(folder))  # of the children
        yield folder
    end_idle()
    assert list(folder.iterdir()) == []


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    return Kit(tmp_path_factory.mktemp("libraries"))


@pytest.fixture(scope="module")
def archives(kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("broken")
    paths = {each.name: folder / f"{each.name}.fmu" for each in BROKEN}
    for each in BROKEN:
        paths[each.name].write_bytes(each.make(kit))
    return paths


Checked = Callable[[str], tuple[Any, Any]]


@pytest.fixture(scope="module")
def checked(request: pytest.FixtureRequest, archives: dict[str, Path]) -> Iterator[Checked]:
    """The check of each path that is asked for, made once, four at a time: most of the time is spent waiting."""
    found: dict[str, Future[tuple[Any, Any]]] = {}
    parameters = [getattr(item, "callspec", None) for item in request.session.items]
    wanted = {each.params["broken"].name for each in parameters if each and "broken" in each.params}
    with ThreadPoolExecutor(4) as pool:
        words = {archives[each.name]: each.words for each in BROKEN if each.name in wanted}
        for path in words:
            found[str(path)] = pool.submit(patiently, path, words[path])
        yield lambda path: found[path].result()
        pool.shutdown(cancel_futures=True)


def patiently(path: Path, words: str) -> tuple[Any, Any]:
    """The check of an engine of which ``words`` must be said."""
    for limit in TIME_LIMITS:
        found = check.check_and_measure(str(path), STEP, {}, limit)
        lines = found[0].problems
        if not any("takes too long" in line for line in lines) or any(re.search(words, line) for line in lines):
            break
    return found


@pytest.fixture(autouse=True)
def _unharmed() -> Iterator[None]:
    """Whatever an FMU does, this process is where and what it was."""
    here, third = Path.cwd(), [1.0, 3.0]
    yield
    assert Path.cwd() == here
    assert third[0] / third[1] == 1.0 / 3.0


def lines_of(checked: Checked, path: Path) -> tuple[int, list[str]]:
    try:
        report, _ = checked(str(path))
    except InputError as error:
        return UNUSABLE, [str(error)]
    return (0 if report.ok else UNFIT), report.problems


@every_broken
def test_the_check_says_what_is_wrong(broken: Broken, archives: Mapping[str, Path], checked: Checked) -> None:
    status, lines = lines_of(checked, archives[broken.name])
    assert status == broken.status, lines
    assert any(re.search(broken.words, line) for line in lines), lines
    assert all(line.isprintable() for line in lines), lines


@pytest.mark.parametrize("name", ["crash-step", "hump"])
def test_a_flight_refuses_it_in_one_line(
    name: str,
    archives: Mapping[str, Path],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Before anything of it was loaded here; a check says the same and leaves a page."""
    broken = next(each for each in BROKEN if each.name == name)
    for limit in TIME_LIMITS:
        monkeypatch.setattr(check, "MAX_CHECK_S", limit)
        with pytest.raises(SystemExit) as left:
            main(["fly", "hover", "--engine", str(archives[name]), "--out", str(tmp_path / "flight")])
        out, err = capfd.readouterr()
        assert (left.value.code, out, err.count("\n")) == (2, "", 1)
        if re.search(broken.words, err):
            break
    assert re.search(broken.words, err)
    assert str(archives[name]) in err
    assert not (tmp_path / "flight").exists()
    assert str(archives[name]) not in Path("/proc/self/maps").read_text()
    with pytest.raises(SystemExit) as left:
        main(["engine", "check", str(archives[name]), "--json", "--time-limit", "3", "--out", str(tmp_path / "check")])
    found = json.loads(capfd.readouterr().out)
    assert left.value.code == UNFIT
    assert any(re.search(broken.words, line) or "too long" in line for line in found["problems"])
    assert False in found["answers"].values()
    assert (tmp_path / "check" / "report.html").exists()


def test_a_process_that_an_engine_changes_is_not_this_one(kit: Kit, sound: Path) -> None:
    """Its folder, its rounding, its tiny numbers, its files: nothing of that is asked, since it is alone there."""
    for fault in ("chdir", "rounding", "tiny", "chatter", "spawn"):
        sound.write_bytes(packed(kit.contents(fault)))
        spec = load_engine(str(sound), {}, STEP, unchecked=True)
        with make_bank([spec] * 2, STEP) as bank:
            bank.reset(0.5)
            assert bank.step(0, (0.5, 0.5)).thrust == pytest.approx((10.0, 10.0))
        end_idle()


@pytest.fixture
def sound(kit: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same library without a fault; nothing is remembered of it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(load_checked, "_fit_engines", set())
    path = tmp_path / "sound.fmu"
    path.write_bytes(packed(kit.contents()))
    return path


def test_without_a_fault_it_is_fit_and_flies(sound: Path) -> None:
    """So that what is said of the others is said of the fault."""
    report = check_fmu(str(sound))
    assert report.problems == []
    assert report.thrust == pytest.approx([20.0 * k / 20 for k in range(21)], abs=1e-8)
    assert report.delay_samples_up == report.delay_samples_down == 0
    with EngineBank(load_engine(str(sound), {}, STEP), 6, STEP) as bank:
        bank.reset(0.5)
        assert bank.step(0, (0.5,) * 6).thrust == pytest.approx((10.0,) * 6)


def test_an_engine_is_checked_once(sound: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checks: list[object] = []
    once = check.check_and_measure
    monkeypatch.setattr(check, "check_and_measure", lambda *asked: checks.append(1) or once(*asked))
    first = load_engine(str(sound), {}, STEP)
    assert load_engine(str(sound), {}, STEP) == first
    plain = load_engine(str(sound), {}, STEP, unchecked=True, isolated=False)  # measured here: the same, bit for bit
    assert (plain.curve, plain.start, plain.settling_window) == (first.curve, first.start, first.settling_window)
    assert len(checks) == 1
    load_engine(str(sound), {}, 2 * STEP)  # another question
    assert len(checks) == 2


def test_in_another_air_it_is_only_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A height costs a measurement and not another check; it is remembered by its air, and is that of the library."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(load_checked, "_fit_engines", set())
    asked: list[Air] = []
    measure = isolated.measure_in
    for module in (check, load_checked):
        monkeypatch.setattr(module, "measure_in", lambda *given: asked.append(given[4]) or measure(*given))
    build_engines(["turbine-20"])
    path = tmp_path / "foreign.fmu"
    path.write_bytes((data_folder("fmus") / "turbine-20.fmu").read_bytes())
    thin = Air(79495.2, 275.15, 0.0)
    high = load_engine(str(path), {}, STEP, air=thin)
    assert asked == [STANDARD_AIR, thin]
    low = load_engine(str(path), {}, STEP)
    assert load_engine(str(path), {}, STEP, air=thin) == high
    assert len(asked) == 2
    assert high.curve == load_engine("turbine-20", {}, STEP, air=thin).curve
    assert low.curve == load_engine("turbine-20", {}, STEP).curve


@pytest.mark.parametrize("text", ["", "{", "[]", '{"throttle": [0], "thrust": [1]}', "null", '{"throttle": 1}'])
def test_a_broken_memory_is_no_memory(text: str, sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = load_checked.find_source(str(sound))
    place = load_checked._cache_path(source, {}, STEP, STANDARD_AIR)
    place.parent.mkdir(parents=True)
    place.write_text(text)
    assert load_checked._read_cached(place) is None


def test_a_memory_that_cannot_be_kept_is_done_without(sound: Path, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("not a folder")
    assert load_engine(str(sound), {}, STEP).thrust_at(1.0) == pytest.approx(20.0)


def test_only_what_is_fit_is_remembered(kit: Kit, sound: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sound.write_bytes(packed(kit.contents("process")))
    for _ in range(2):
        with pytest.raises(InputError, match=r"is not fit to fly: two processes with.*unchecked_engine"):
            load_engine(str(sound), {}, STEP)


def test_what_is_unfit_flies_unchecked(kit: Kit, sound: Path, tmp_path: Path) -> None:
    sound.write_bytes(packed(kit.contents("process")))
    with pytest.raises(SystemExit) as left:
        main(["fly", "hover", "--engine", str(sound), "--set", "duration_s=1", "--controller", "baseline",
              "--unchecked-engine", "--out", str(tmp_path / "flight"), "--json"])  # fmt: skip
    assert left.value.code == 0
    assert "engine_unchecked = true" in (tmp_path / "flight" / "scenario.toml").read_text()


def test_no_unit_is_newtons_with_a_note(kit: Kit, sound: Path) -> None:
    contents = kit.contents()
    sound.write_bytes(packed(contents | {XML: contents[XML].replace(b' unit="N"', b"")}))
    report = check_fmu(str(sound))
    assert report.problems == []
    assert report.notes == ["thrust states no unit; it is taken to be in N", NO_FLOW]


def test_an_engine_may_tremble_at_rest(kit: Kit, sound: Path) -> None:
    """As a solver with a tolerance leaves it; its delay, longer than the usual window, is found behind the trembling."""
    sound.write_bytes(packed(kit.contents("trembling")))
    report = check_fmu(str(sound))
    assert report.problems == []
    assert report.notes == [NO_FLOW, "its thrust ripples at rest; it counts as steady within 1e-06 of itself"]
    assert report.delay_samples_up == report.delay_samples_down == 100
    assert report.thrust == pytest.approx([float(k) for k in range(21)], abs=1e-4)
    spec = load_engine(str(sound), {}, STEP)
    assert (spec.ripple, spec.settling_window) == (1e-6, 250)
    with EngineBank(spec, 2, STEP) as bank:
        assert bank.reset(0.5).thrust == pytest.approx((10.0,) * 2, abs=1e-4)


def test_a_slow_one_is_not_waited_for(kit: Kit, sound: Path) -> None:
    """2 ms a step: it does answer, but would take minutes."""
    sound.write_bytes(packed(kit.contents("slow")))
    (problem,) = check_fmu(str(sound), time_limit_s=5.0).problems
    assert problem.startswith("takes too long: was not done within 5 s; ")


def test_a_killed_check_takes_its_child_along(kit: Kit, sound: Path, tmp_path: Path) -> None:
    sound.write_bytes(packed(kit.contents("hang-step")))
    script = f"from cosim.engine import check_fmu; check_fmu({str(sound)!r})"
    parent = subprocess.Popen([sys.executable, "-c", script], env=os.environ | {"TMPDIR": str(tmp_path)})
    try:
        child = _wait_for(lambda: next(filter(_at_work, psutil.Process(parent.pid).children()), None))
    finally:
        parent.kill()
        parent.wait()
    assert _wait_for(lambda: not _at_work(child))


def _at_work(process: psutil.Process) -> bool:
    """Beyond its start, and there; short-lived ones of a start come and go."""
    try:
        return process.status() != "zombie" and process.cpu_times().user > 0.7
    except psutil.NoSuchProcess:
        return False


def _wait_for(what: Callable[[], Any], seconds: float = PATIENCE) -> Any:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = what()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError("waited in vain")


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ("max_packed_bytes", "is .* large; an engine may have 100 bytes"),
        ("max_unpacked_bytes", "would unpack to .*; an engine may have 100 bytes"),
        ("max_files", "has 2 files inside; an engine may have 1"),
        ("max_xml_bytes", f"{XML} is larger than 100 bytes"),
        ("max_name_bytes", "has a name of more than 10 bytes inside"),
        ("max_xml_depth", "nests elements more than 1 deep"),
    ],
)
def test_limits_of_the_archive(limit: str, words: str, sound: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    value = {"max_files": 1, "max_name_bytes": 10, "max_xml_depth": 1}.get(limit, 100)
    monkeypatch.setattr(container, "LIMITS", container.LIMITS._replace(**{limit: value}))
    with pytest.raises(InputError, match=words):
        load_engine(str(sound), {}, STEP)


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null"])
def test_a_device_is_not_read(path: str, tmp_path: Path) -> None:
    (tmp_path / "device.fmu").symlink_to(path)
    with pytest.raises(InputError, match="is not an ordinary file"):
        load_engine(str(tmp_path / "device.fmu"), {}, STEP)


def test_latin_letters_are_read(kit: Kit, sound: Path) -> None:
    """An older encoding, as some tools write it."""
    contents = kit.contents()
    text = DESCRIPTION[2].replace("{fault}", "").replace("UTF-8", "ISO-8859-1").replace('"broken" guid', '"é" guid')
    sound.write_bytes(packed(contents | {XML: text.encode("latin-1")}))
    assert load_checked.find_source(str(sound)).archive.model == "é"
