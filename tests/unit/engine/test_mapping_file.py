"""``hexjet engine map``: a mapping file begun, with what is found and what is open."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest
from command_tools import Hexjet

from cosim import InputError, map_engine
from cosim.base.storage.paths import data_folder
from cosim.engine.fmu.mapping import read_mapping
from cosim.engine.source import find_source

THROTTLE = 'name="throttle" valueReference="1"'
RANGE = 'unit="1" min="0.0" max="1.0" start="0.0" />\n    <Float64 name="thrust"'
THRUST = 'unit="N" min="0.0" />'


def renamed(path: Path, *changes: tuple[str, str]) -> Path:
    """The FMU of an engine with another description: it is not run."""
    with zipfile.ZipFile(data_folder("fmus") / "edf.fmu") as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            data = source.read(name)
            if name == "modelDescription.xml":
                text = data.decode()
                for old, new in changes:
                    assert old in text
                    text = text.replace(old, new, 1)
                data = text.encode()
            target.writestr(name, data)
    return path


ODD = (
    (RANGE, 'unit="deg" start="15.0" />\n    <Float64 name="thrust"'),
    (THROTTLE, 'name="u Hebel" valueReference="1"'),
    ('name="thrust"', 'name="Schub"'),
    (THRUST, 'min="0.0" />\n    <Float64 name="T5" valueReference="9" causality="output" unit="s" />'),
)


def test_what_is_found_is_a_mapping_file_as_it_stands(tmp_path: Path) -> None:
    made = map_engine(renamed(tmp_path / "mine.fmu"), tmp_path / "below" / "mine.toml")
    file, fmu, ports = read_mapping(made.files["mapping"])
    assert (file.fmu, fmu.resolve()) == ("../mine.fmu", tmp_path / "mine.fmu")
    assert ports.ports == made.found == {"throttle": "throttle", "thrust": "thrust", "start": "throttle_start"}
    assert made.is_complete
    assert not made.open
    assert find_source(str(made.files["mapping"])).archive.thrust.name == "thrust"


def test_what_is_open_is_said_at_once_and_stated_it_flies(tmp_path: Path) -> None:
    """The lever in degrees without a range, and the thrust under a name that nobody knows."""
    made = map_engine(renamed(tmp_path / "odd.fmu", *ODD))
    assert list(made.open) == ["throttle", "thrust"]
    assert "in deg and states no range" in made.open["throttle"]
    assert "no output that may be its thrust (outputs: Schub, T5)" in made.open["thrust"]
    text = made.files["mapping"].read_text()
    assert "# throttle = [0.0, 1.0]\n" in text
    assert '#     "Schub": no unit, no range, ' in text
    stated = text.replace("# throttle = [0.0, 1.0]", "throttle = [15.0, 90.0]").replace(
        '# thrust = ""', 'thrust = "Schub"'
    )
    made.files["mapping"].write_text(stated)
    archive = find_source(str(made.files["mapping"])).archive
    assert (archive.thrust.name, archive.ports["throttle"].value(1.0)) == ("Schub", 90.0)


def test_the_command_says_it_and_whether_it_is_enough(hexjet: Hexjet, tmp_path: Path) -> None:
    renamed(tmp_path / "odd.fmu", *ODD)
    renamed(tmp_path / "mine.fmu")
    done = hexjet("engine", "map", "odd.fmu")
    assert (done.status, done.out.splitlines()[0]) == (1, "found: start = throttle_start")
    assert done.out.splitlines()[-1] == "next: state in odd.toml what is open"
    told = json.loads(hexjet("engine", "map", "mine.fmu", "--json").out)
    assert told == {
        "fmu": "mine.fmu", "mapping": "mine.toml", "open": {}, "complete": True,
        "found": {"throttle": "throttle", "thrust": "thrust", "start": "throttle_start"},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("mine.fmu", "mine.toml: is there already; name another file as out, or remove it"),
        ("mine.toml", "mine.toml: is a mapping file already; hexjet engine check mine.toml says what it lacks"),
        ("edf", "edf: is no file; hexjet engine map takes the FMU of an engine, FILE.fmu"),
        ("text.fmu", "text.fmu: is not an FMU: not a zip archive"),
        ("gone.fmu", "gone.fmu: no such file"),
    ],
)
def test_what_is_no_engine_is_told_so(name: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    renamed(Path("mine.fmu"))
    Path("mine.toml").write_text("")
    Path("text.fmu").write_text("no archive")
    assert map_engine("mine.fmu", "below").files["mapping"] == Path("below/mine.toml")
    with pytest.raises(InputError) as error:
        map_engine(name)
    assert str(error.value) == line
