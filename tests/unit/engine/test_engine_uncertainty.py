"""The table [uncertainty] of a mapping file: what is read, what is refused, and what it is no part of."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from engine_tools import archive

from cosim.base.errors import InputError
from cosim.cli.main import run as run_command
from cosim.engine import load_engine
from cosim.engine.fmu.uncertainty import MAX_SIGMA, lower_factor, without_uncertainty
from cosim.engine.source import find_source
from hexjet_identify.replay.flown import Model
from hexjet_identify.replay.replay import Choices, draw_vehicles

TABLE = """[uncertainty]
source = "bench.csv: 6 steps"
parameters = ["delay_samples", "pole", "gain"]
deviation = [1.2, 0.006, 0.02]
correlation = [
[1.0, -0.8, 0.0],
[-0.8, 1.0, 0.0],
[0.0, 0.0, 1.0]]
spread = [0.0, 0.002, 0.01]
"""


def mapping(folder: Path, table: str = TABLE, more: str = "") -> Path:
    path = folder / "fan.toml"
    path.write_text(f'fmu = "{archive("edf-as-flown", 3)}"\n[parameters]\ndelay_samples = 20\n{table}{more}')
    return path


def test_a_table_is_read_with_its_engine(tmp_path: Path) -> None:
    spec = load_engine(str(mapping(tmp_path)), {}, 0.004, unchecked=True)
    assert (spec.uncertainty.deviation, spec.uncertainty.spreads) == ([1.2, 0.006, 0.02], [0.0, 0.002, 0.01])
    plain = TABLE.replace("spread", "#").partition("correlation")[0]
    bare = find_source(str(mapping(tmp_path, plain))).mapping.uncertainty
    assert (bare.spreads, bare.correlations) == ([0.0] * 3, np.eye(3).tolist())
    assert find_source(str(mapping(tmp_path, ""))).mapping.uncertainty is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[1.2, 0.006, 0.02]", "[1.2, 0.006]", "deviation has 2 entries, and there are 3 parameters"),
        ("1.2", "-1.2", "uncertainty.deviation.0 = -1.2: should be greater than or equal to 0"),
        ('"pole"', '"polo"', "polo: no such parameter; did you mean 'pole'"),
        ('"pole"', '"throttle_start"', "throttle_start: is set by the simulation itself; allowed: delay_samples"),
        ('"pole"', '"gain"', "parameters: gain is there twice"),
        ("[-0.8, 1.0, 0.0]", "[-0.7, 1.0, 0.0]", "pole with delay_samples is -0.7, delay_samples with pole -0.8"),
        ("[0.0, 0.0, 1.0]", "[0.0, 0.0, 0.9]", "correlation: gain with itself is 0.9, and must be 1"),
        (
            "[1.0, -0.8, 0.0],\n[-0.8, 1.0, 0.0],\n[0.0, 0.0, 1.0]",
            "[1.0, -0.8, 0.9],\n[-0.8, 1.0, 0.0],\n[0.9, 0.0, 1.0]",
            "its smallest eigenvalue is -0.204",
        ),
        ("[1.2, 0.006, 0.02]", "[0.0, 0.0, 0.0]\nspread = [0.0, 0.0, 0.0] #", "nothing is uncertain"),
    ],
)
def test_a_wrong_table_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    table = TABLE.replace(old, new, 1)
    if "spread = [0.0, 0.0" in new:
        table = table.replace("spread = [0.0, 0.002, 0.01]", "")
    path = mapping(tmp_path, table)
    with pytest.raises(InputError) as complaint:
        find_source(str(path))
    (line,) = str(complaint.value).splitlines()
    assert line.startswith(f"{path}: uncertainty")
    assert message in line


def test_a_switch_is_no_uncertain_number(tmp_path: Path) -> None:
    source = find_source(str(mapping(tmp_path)))
    switch = [
        type(v)(**{**v.__dict__, "type": "Boolean"}) if v.name == "pole" else v for v in source.archive.parameters
    ]
    with pytest.raises(InputError, match="pole is a fixed Boolean; allowed: fixed or tunable numbers"):
        source.mapping.uncertainty.check_parameters(switch, None, "fan.toml")


def test_the_table_is_no_part_of_the_engine(tmp_path: Path) -> None:
    prints = []
    for table in ("", TABLE, TABLE.replace("1.2", "2.4"), f"\n{TABLE}"):
        path = mapping(tmp_path, table, "[rotor]\ninertia_kg_m2 = 1e-4\n")
        prints.append(load_engine(str(path), {}, 0.004, unchecked=True).fingerprint)
    assert len(set(prints)) == 1
    other = mapping(tmp_path, TABLE, "[rotor]\ninertia_kg_m2 = 2e-4\n")
    assert load_engine(str(other), {}, 0.004, unchecked=True).fingerprint != prints[0]


@pytest.mark.parametrize(
    "written",
    [
        TABLE.replace("[uncertainty]", "[ uncertainty ]"),
        TABLE.replace("[uncertainty]", '["uncertainty"]  # of the bench'),
        TABLE.replace("[uncertainty]", "[ 'uncertainty' ]"),
        "uncertainty.parameters = ['pole']\nuncertainty.deviation = [0.1]\n",
        "uncertainty = { parameters = ['pole'], deviation = [0.1] }\n",
    ],
)
def test_the_table_is_no_part_of_the_engine_however_it_is_written(written: str, tmp_path: Path) -> None:
    path = tmp_path / "fan.toml"
    stated = "fmu = 'fan.fmu'\n"
    following = "\n[[stage]]\nblades = 3\n[[stage]]\nblades = 5\n"
    path.write_text(stated + following)
    without = without_uncertainty(path)
    path.write_text(stated + written + following)
    assert without_uncertainty(path) == without
    assert b"blades = 5" in without
    path.write_text(stated + written + following.replace("5", "7"))
    assert without_uncertainty(path) != without


def test_show_prints_a_mapping_file_with_its_uncertainty(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["show", str(mapping(tmp_path)), "--json"]) == 0
    (engine,) = json.loads(capsys.readouterr().out)
    rows = {number["name"]: number for number in engine["numbers"]}
    assert engine["description"] == "uncertainty: bench.csv: 6 steps"
    assert rows["delay_samples"]["value"] == 20
    assert rows["uncertainty.pole"]["value"] == 0.006
    assert "0.002 between engines; correlation -0.8 with delay_samples" in rows["uncertainty.pole"]["meaning"]


@pytest.mark.parametrize("rank", [1, 2, 3])
def test_the_factor_gives_the_correlation_again(rank: int) -> None:
    rows = np.random.default_rng(rank).normal(size=(3, rank))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    lower = np.array(lower_factor((rows @ rows.T).tolist()))
    assert np.allclose(lower @ lower.T, rows @ rows.T, atol=1e-6)
    assert np.allclose(lower, np.tril(lower))


def test_a_replay_draws_each_parameter_cut_off_at_its_own_deviation_whatever_the_correlation(tmp_path: Path) -> None:
    engine = load_engine(str(mapping(tmp_path)), {}, 0.004, unchecked=True)
    drawn = list(draw_vehicles(cast(Model, SimpleNamespace(engine=engine)), Choices(draws=6000)))
    pole, gain = (np.array([change.parameters[name] for change in drawn]) for name in ("pole", "gain"))
    for name, values, deviation in (("pole", pole, 0.006), ("gain", gain, 0.02)):
        off = (values - engine.parameters[name]) / deviation
        assert np.max(np.abs(off)) <= MAX_SIGMA
        assert np.std(off) == pytest.approx(0.9866, rel=4.0 / np.sqrt(2.0 * 6000))  # of a normal number cut off at 3
    delay = np.array([change.parameters["delay_samples"] for change in drawn])
    assert np.all(delay == np.round(delay))
    assert np.corrcoef(delay, pole)[0, 1] == pytest.approx(-0.8, abs=0.04)
