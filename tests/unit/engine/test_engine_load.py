"""Loading an engine: names, parameters, static curve, and one clear line for everything that cannot be loaded."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import replace as replaced
from pathlib import Path

import numpy as np
import pytest
from engine_tools import NEWTON_PER_KGF, PAPER, STEP, archive, edit_description, rewrite

from cosim.base.errors import InputError
from cosim.base.signals import Ambient
from cosim.engine import Air, EngineBank, EngineSpec, find_source, list_engine_names, load_engine
from cosim.engine.response import Curve
from cosim.simulation.engine_reference import make_engine_reference

pytestmark = pytest.mark.usefixtures("built_engines")


@pytest.fixture(autouse=True)
def _clean(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Whatever happens, no temporary folder is left, and nobody changes the working directory."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    here = Path.cwd()
    yield
    assert list(folder.iterdir()) == []
    assert Path.cwd() == here


def full_thrust(spec: EngineSpec) -> float:
    return spec.thrust_at(1.0)


def test_the_library_lists_its_engines() -> None:
    assert list_engine_names() == [
        "edf", "edf-as-flown", "fitted", "jetcat-p300", "motor", "p220", "p220-2025", "turbine-100", "turbine-20",
        "turbine-220", "turbojet",
    ]  # fmt: skip


THIN = Air(79495.2, 275.15, 0.0)  # of the standard atmosphere 2 km up


def test_an_engine_is_measured_in_the_air_it_is_given() -> None:
    """Against the engine itself, settled there: it starts in equilibrium and stays, with a seventh less thrust."""
    spec, low = load_engine("turbine-20", {}, STEP, air=THIN), load_engine("turbine-20", {}, STEP)
    ambient = Ambient(THIN.pressure, THIN.temperature, (THIN.speed,))
    with EngineBank(low, 1, STEP) as bank:
        for throttle, thrust in zip(spec.curve.throttle, spec.curve.thrust, strict=True):
            assert bank.reset(throttle, ambient).thrust[0] == pytest.approx(thrust, rel=1e-8)
    assert 0.8 < spec.thrust_at(0.5) / low.thrust_at(0.5) < 0.9
    assert (spec.air, low.air, spec.start) == (THIN, Air(101325.0, 288.15, 0.0), low.start)
    with EngineBank([spec, low], 2, STEP) as bank:  # each in the air it was measured in
        assert bank.reset(0.5).thrust == pytest.approx((spec.thrust_at(0.5), low.thrust_at(0.5)), rel=1e-8)
    thin, dense = make_engine_reference(spec, STEP), make_engine_reference(low, STEP)
    assert thin.thrust == spec.curve.thrust
    # its ECU holds the speed that the throttle demands, whatever the air
    assert thin.speed[5:] == pytest.approx(dense.speed[5:], rel=1e-6)


def test_an_engine_without_a_port_for_the_air_is_the_same_in_every_air() -> None:
    assert load_engine("edf", {}, STEP, air=THIN) == load_engine("edf", {}, STEP)


@pytest.mark.parametrize("suffix", ["", "-fmi2"])
@pytest.mark.parametrize("name", PAPER)
def test_a_library_engine_knows_its_numbers(name: str, suffix: str) -> None:
    gain, pole, delay = PAPER[name]
    spec = load_engine(name + suffix, {}, STEP)
    assert (spec.name, spec.family, spec.library) == (name + suffix, name, True)
    assert spec.fmi == ("2.0" if suffix else "3.0")
    assert (spec.pole, spec.delay_samples, spec.internal_step) == (pole, delay, STEP)
    assert spec.transport_delay == pytest.approx(delay * STEP, abs=1e-15)
    # the time constants of the paper: 0.33 s and 0.029 s (29.9 ms unrounded)
    assert spec.lag == pytest.approx({"turbojet": 0.32857}.get(name, 0.029904), rel=2e-5)
    assert spec.parameters == {"gain": gain, "pole": pole, "delay_samples": delay, "newton_per_unit": NEWTON_PER_KGF}
    steady = gain / (1.0 - pole) * NEWTON_PER_KGF
    assert full_thrust(spec) == pytest.approx(steady, rel=1e-9)
    # measured by stepping until the thrust stands still to 1e-10, so a few times that
    np.testing.assert_allclose(spec.curve.thrust, np.array(spec.curve.throttle) * steady, rtol=0.0, atol=1e-8)


def test_parameters_change_curve_and_ledger() -> None:
    spec = load_engine("edf", {"delay_samples": 12, "pole": 0.9, "newton_per_unit": 1.0}, STEP)
    assert (spec.delay_samples, spec.pole, spec.transport_delay) == (12, 0.9, pytest.approx(0.048))
    assert full_thrust(spec) == pytest.approx(2.554, rel=1e-9)
    assert spec.parameters["delay_samples"] == 12.0


def test_the_longest_delay_is_measured_through() -> None:
    spec = load_engine("turbojet", {"delay_samples": 1000}, STEP)
    assert full_thrust(spec) == pytest.approx(0.01866 / 0.0121 * NEWTON_PER_KGF, rel=1e-9)
    assert spec.settling_window > 1000


def test_by_path_there_is_no_ledger_but_everything_else() -> None:
    by_name = load_engine("turbojet", {}, STEP)
    by_path = load_engine(str(archive("turbojet", 3)), {}, STEP, unchecked=True)
    assert (by_path.pole, by_path.delay_samples, by_path.lag, by_path.transport_delay) == (None, None, None, None)
    assert (by_path.name, by_path.title, by_path.start) == ("turbojet", "turbojet", "throttle_start")
    assert not by_path.library
    assert (by_path.sha256, by_path.curve, by_path.parameters) == (by_name.sha256, by_name.curve, by_name.parameters)


def test_a_start_parameter_that_does_not_start_the_engine_there_is_not_used(tmp_path: Path) -> None:
    """Named as ours, but another parameter's reference: setting it changes the gain, not the start."""
    text = 'name="throttle_start" valueReference="7"'
    path = edit_description(archive("edf", 3), tmp_path / "a.fmu", text, text.replace("7", "99"))
    gain = 'name="gain" valueReference="3"'
    path = edit_description(path, tmp_path / "b.fmu", gain, gain.replace("3", "7"))
    path = edit_description(path, tmp_path / "c.fmu", text.replace("7", "99"), text.replace("7", "3"))
    assert load_engine(str(path), {}, STEP, unchecked=True).start is None


def test_the_static_curve_is_linear_between_points_and_ends_at_its_ends() -> None:
    spec = replaced(load_engine("edf", {}, STEP), curve=Curve((0.0, 0.5, 1.0), (2.0, 4.0, 16.0)))
    thrusts = [spec.thrust_at(throttle) for throttle in (-1.0, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5)]
    assert thrusts == [2.0, 2.0, 3.0, 4.0, 10.0, 16.0, 16.0]


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        (
            {"gian": 1.0},
            "gian: no such parameter; did you mean 'gain'? allowed: delay_samples, gain, newton_per_unit, pole",
        ),
        ({"pole": 1.0}, "pole = 1: must be a number from 0 to 0.999999"),
        ({"gain": float("nan")}, "gain = nan: must be a number from 0 to 1000"),
        ({"delay_samples": 2.5}, "delay_samples = 2.5: must be a whole number from 0 to 1000"),
        ({"delay_samples": 1001}, "delay_samples = 1001: must be a whole number from 0 to 1000"),
        ({"throttle_start": 0.5}, "throttle_start is set by the simulation itself; allowed: delay_samples, gain, "),
        ({"gain": 0.0}, "thrust does not answer the throttle within 10 s"),
    ],
)
def test_wrong_parameters_are_refused(parameters: dict[str, float], words: str) -> None:
    assert words in refusal("edf", parameters)


def refusal(name: str, parameters: dict[str, float] | None = None, step: float = STEP) -> str:
    with pytest.raises(InputError) as caught:
        # in this process: what a trial in another one says is tested elsewhere
        load_engine(name, parameters or {}, step, unchecked=True)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_unknown_engine_lists_the_known_ones() -> None:
    assert refusal("turbo").startswith("unknown engine 'turbo'; did you mean 'turbojet'? allowed: edf, edf-as-flown, ")


def test_a_system_of_fmus_is_told_as_what_left(tmp_path: Path) -> None:
    left = "jet.ssp: a system of FMUs (SSP) as an engine left in version 0.3.0; use"
    assert refusal("jet.ssp").startswith(left)
    (tmp_path / "mapping.toml").write_text('fmu = "jet.ssp"\n')
    assert left in refusal(str(tmp_path / "mapping.toml"))


def test_a_misspelt_file_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MyEngine.fmu", "engine.toml", "identification.json"):
        (tmp_path / name).touch()
    with monkeypatch.context() as there:
        there.chdir(tmp_path)
        assert refusal("MyEngine.fm") == "engine MyEngine.fm: no such file; did you mean 'MyEngine.fmu'?"
        assert refusal("engin.toml") == "engine engin.toml: no such file; did you mean 'engine.toml'?"
    assert refusal(str(tmp_path)) == f"engine {tmp_path}: is a folder; name its file: {tmp_path / 'engine.toml'}"
    source = tmp_path / "engine.py"
    source.touch()
    assert refusal(str(source)) == f"{source}: is Python code, not an FMU: pythonfmu3 build -f makes one of it"


@pytest.mark.parametrize("name", ["edf", "edf-fmi2"])
@pytest.mark.parametrize("step", [0.005, 0.002, 0.0040001])
def test_a_step_that_does_not_fit_names_both_numbers(name: str, step: float) -> None:
    hint = "step_s of the scenario or the vehicle may be 0.004 or 0.008"
    words = f"{archive('edf', 2 if 'fmi2' in name else 3)}: step {step:g} s is not a whole multiple of the engine's"
    assert refusal(name, step=step) == f"{words} internal step 0.004 s; {hint}"


def test_an_fmu_that_cannot_state_its_step_says_it_itself(tmp_path: Path) -> None:
    path = shutil.copy(archive("edf", 2), tmp_path / "mine.fmu")
    assert refusal(str(path), step=0.005) == (
        f"{path}: doStep returned error while its thrust was measured: "
        "communication step 0.005 s is not a whole multiple of the internal step 0.004 s"
    )


def test_what_is_no_archive_or_has_no_binary_is_told_with_what_there_is(tmp_path: Path) -> None:
    """What is broken inside an archive is test_engine_broken.py."""
    assert refusal(str(tmp_path / "nowhere.fmu")) == f"{tmp_path / 'nowhere.fmu'}: no such file"
    assert refusal(str(tmp_path)) == f"{tmp_path}: is a folder; an .fmu archive is needed"

    def for_windows(contents: dict[str, bytes]) -> None:
        name = next(name for name in contents if name.startswith("binaries/"))
        contents["binaries/x86_64-windows/edf.dll"] = contents.pop(name)

    said = refusal(str(rewrite(archive("edf", 3), tmp_path / "broken.fmu", for_windows)))
    assert said.endswith("/edf.so (it has: x86_64-windows); it has sources: python -m fmpy compile makes one of them")


def test_an_engine_that_was_found_is_handed_on(tmp_path: Path) -> None:
    path = shutil.copy(archive("edf", 3), tmp_path / "theirs.fmu")
    source = find_source("theirs.fmu", tmp_path)
    assert find_source(source, tmp_path / "elsewhere") is source
    assert source == find_source(str(path))
    assert load_engine(source, {}, STEP, unchecked=True) == load_engine(str(path), {}, STEP, unchecked=True)
    assert [find_source(name).name for name in ("edf", "edf-fmi2")] == ["edf", "edf-fmi2"]


def test_loading_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    load_engine("edf-fmi2", {}, STEP)
    load_engine("edf", {}, STEP)
    assert capfd.readouterr() == ("", "")


def test_what_a_library_engine_computes_has_a_hash_of_its_own(tmp_path: Path) -> None:
    """Another compiler makes another archive of the same engine; another start value or equation makes another engine."""
    shipped = load_engine("edf", {}, STEP)

    def compiled(contents: dict[str, bytes]) -> None:
        (name,) = [name for name in contents if name.endswith(".so")]
        contents[name] += b"GCC: another"
        contents["sources/slave.c"] += b"\n"

    def equation(contents: dict[str, bytes]) -> None:
        contents["sources/delayed_lag.c"] += b"\n"

    again = load_engine(str(rewrite(archive("edf", 3), tmp_path / "again.fmu", compiled)), {}, STEP, unchecked=True)
    assert again.sha256 != shipped.sha256
    assert again.identity == shipped.identity != shipped.sha256
    other = load_engine(str(rewrite(archive("edf", 3), tmp_path / "other.fmu", equation)), {}, STEP, unchecked=True)
    assert other.identity != shipped.identity
    foreign = edit_description(archive("edf", 3), tmp_path / "foreign.fmu", 'Tool="hexjet-cosim"', 'Tool="another"')
    theirs = load_engine(str(foreign), {}, STEP, unchecked=True)
    assert theirs.identity == theirs.sha256
