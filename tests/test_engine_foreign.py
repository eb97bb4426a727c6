"""Engines of other people's tools: blemished, source only, started, noisy, of integers, with constants."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import pytest
from foreign_engines import SOURCE, description, force, foreign, lever, library

from cosim.base.errors import InputError
from cosim.cli.main import main
from cosim.engine.archive import read_archive, validate
from cosim.engine.compile import compile_archive, needs_compiling
from cosim.engine.description import is_blemish


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("foreign")


# ---- descriptions

SWITCH = ("valve", "valve", "input", 'Boolean: start="false"')
BLEMISHED = {
    "unit": (('unit="N"', 'unit="kgf"'), 'The unit "kgf" of variable "thrust"'),
    "display unit of no unit": (('unit="N"', 'unit="kgf" displayUnit="lbf"'), 'The unit "kgf" of variable "thrust"'),
    "variability": ((' variability="discrete"', ""), 'The variable "valve" \\(line '),
    "no start": (('max="1" start="0"', 'max="1"'), r'Variable "throttle" .* has no start value'),
    "date": (('modelName="foreign"', 'modelName="foreign" generationDateAndTime="today"'), "'today' is not a valid"),
    "own attribute": (('<CoSimulation ', '<CoSimulation hasWings="true" '), "'hasWings' is not allowed"),
}  # fmt: skip


@pytest.mark.parametrize("what", BLEMISHED)
def test_a_blemish_that_no_step_depends_on_is_listed_and_read_over(what: str, place: Path) -> None:
    change, said = BLEMISHED[what]
    archive = read_archive(foreign(place, "blemished", "lag=0.2", [lever(), force(), SWITCH], change=change))
    assert any(re.search(said, text) for text in archive.blemishes)
    assert all(is_blemish(text) for text in archive.blemishes)
    assert archive.thrust.name == "thrust"
    assert archive.ports["thrust"].scale == (9.80665 if "kgf" in change[1] else 1.0)


def test_dependencies_are_nobodys_business_here(place: Path) -> None:
    """Checked by the trial, beyond what reading checks; no step looks at them."""
    wrong = (
        '<Outputs><Unknown index="2"/>',
        '<Outputs><Unknown index="2" dependencies="1" dependenciesKind="fixed fixed"/>',
    )
    complaints = validate(foreign(place, "dependencies", "lag=0.2", change=wrong))
    assert complaints
    assert all(is_blemish(text) for text in complaints)


DANGEROUS = {
    "a name for two": (('name="valve"', 'name="throttle"'), 'The variable name "throttle" .*is not unique'),
    "no reference": (('name="valve" valueReference="7"', 'name="valve"'), "'valueReference' is required but missing"),
    "a reference that is none": (('valueReference="7"', 'valueReference="many"'), "'many' is not a valid value"),
    "no type": (('<Boolean start="false"/>', ""), "Missing child element"),
    "unknown force": (('unit="N"', 'unit="furlong"'), "its thrust is in furlong, which the FMU does not define"),
    "a step that is no number": (('<CoSimulation ', '<CoSimulation maxOutputDerivativeOrder="x" '), "'x' is not a valid"),
}  # fmt: skip


@pytest.mark.parametrize("what", DANGEROUS)
def test_what_decides_which_number_is_read_is_refused(what: str, place: Path) -> None:
    change, said = DANGEROUS[what]
    path = foreign(place, "dangerous", "lag=0.2", [lever(), force(), SWITCH], change=change)
    with pytest.raises(InputError, match=said) as caught:
        read_archive(path)
    assert "\n" not in str(caught.value)


def test_a_blemished_engine_is_fit_and_flies_with_a_warning(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """In the trial of every foreign engine too, which the flight makes."""
    path = foreign(place, "blemished-flight", "lag=0.1,delay=0.02", change=('unit="N"', 'unit="newton"'))
    given = ["--set", "duration_s=1.0", "--out", str(place / "run"), "--json"]
    with pytest.raises(SystemExit):
        main(["fly", "hover", "--engine", str(path), "--controller", "baseline", *given])
    out, err = capfd.readouterr()
    assert '"outcome": "completed"' in out, err
    assert (
        f'{path}: blemish in its description, of no effect on stepping: The unit "newton" of variable "thrust"' in err
    )
    assert out.startswith("{")


# ---- sources


@pytest.fixture(scope="module")
def sources(place: Path) -> Path:
    """An FMU of sources alone: what the library is made of, with the stubs that FMPy asks for."""
    library(2, place)
    path = place / "sources.fmu"
    files = '><SourceFiles><File name="all.c"/></SourceFiles></CoSimulation>'
    text = description("foreign:lag=0.2", [lever(), force()], 2)
    text = re.sub(r"(<CoSimulation [^>]*)/>", rf"\1{files}", text)
    stubs = (place / "foreign2.c").read_text().replace(str(SOURCE), SOURCE.name)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr("sources/all.c", stubs)
        archive.writestr(f"sources/{SOURCE.name}", SOURCE.read_text())
    return path


def test_an_engine_of_sources_alone_names_the_command_and_is_compiled_by_it(
    sources: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert needs_compiling(sources)
    with pytest.raises(InputError, match=r"no binary at all.; it has sources: hexjet fmu compile makes one of them"):
        read_archive(sources)
    made = sources.with_name("compiled.fmu")
    with pytest.raises(SystemExit) as ended:
        main(["fmu", "compile", str(sources), "--out", str(made)])
    assert ended.value.code == 0
    assert capfd.readouterr().out.strip() == str(made)
    assert needs_compiling(sources)
    assert not needs_compiling(made)
    assert read_archive(made).thrust.name == "thrust"


def test_sources_that_do_not_compile_say_why(sources: Path) -> None:
    path = sources.with_name("wrong.fmu")
    with zipfile.ZipFile(sources) as before, zipfile.ZipFile(path, "w") as after:
        for name in before.namelist():
            text = b"int broken(" if name == "sources/all.c" else before.read(name)
            after.writestr(name, text)
    with pytest.raises(InputError, match=r"do not compile .*error"):
        compile_archive(path)
    with pytest.raises(InputError, match="has no sources"):
        compile_archive(foreign(sources.parent, "no-sources", "lag=0.2"))
