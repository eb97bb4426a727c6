"""A library for Windows beside that for this machine, where MinGW is; run by Wine, where that is too."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import fmpy
import pytest
from engine_tools import STEP
from foreign_engines import foreign
from places import TOOLS

from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.cli.main import main
from cosim.engine import load_engine
from cosim.engine.fmu.archive import read_archive
from cosim.engine.make import compile as compiling
from cosim.engine.make.compile import WINDOWS_COMPILER, compile_archive, has_windows

needs_mingw = pytest.mark.skipif(shutil.which(WINDOWS_COMPILER) is None, reason=f"no {WINDOWS_COMPILER}")
WINE = shutil.which("wine64") or shutil.which("wine") or ("/usr/lib/wine/wine64" if Path("/usr/lib/wine/wine64").is_file() else None)  # fmt: skip


@needs_mingw
@pytest.mark.parametrize(("name", "fmi", "folder"), [("turbojet-fmi2", 2, "win64"), ("turbojet", 3, "x86_64-windows")])
def test_both_libraries_are_in_one_archive(
    name: str, fmi: int, folder: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """With every function that the standard asks for, and of Windows' own libraries alone."""
    source, made = data_folder("fmus") / f"{name}.fmu", tmp_path / "both.fmu"
    with pytest.raises(SystemExit) as ended:
        main(["fmu", "compile", str(source), "--windows", "--out", str(made)])
    assert ended.value.code == 0
    assert capfd.readouterr().out.strip() == str(made)
    assert has_windows(made)
    assert not has_windows(source)
    assert read_archive(made).equations_sha256 == read_archive(source).equations_sha256  # the same engine to a design
    with zipfile.ZipFile(made) as fmu:
        library = tmp_path / "engine.dll"
        library.write_bytes(fmu.read(f"binaries/{folder}/turbojet.dll"))
    tool = WINDOWS_COMPILER.replace("gcc", "objdump")
    listed = subprocess.run([tool, "-p", str(library)], capture_output=True, text=True, check=True).stdout
    assert f"fmi{fmi}DoStep" in listed
    needed = set(re.findall(r"DLL Name: (\S+)", listed))
    assert needed <= {"KERNEL32.dll", "msvcrt.dll"} or all(
        each.startswith("api-ms-win") for each in needed - {"KERNEL32.dll"}
    )


@pytest.mark.long
@needs_mingw
@pytest.mark.skipif(WINE is None, reason="no Wine")
def test_it_computes_the_same_bits_there(tmp_path: Path) -> None:
    """The paper's turbojet, whose arithmetic has no function of the library of mathematics: 100 steps by Wine."""
    made = compile_archive(data_folder("fmus") / "turbojet-fmi2.fmu", tmp_path / "both.fmu", windows=True)
    with zipfile.ZipFile(made) as fmu:
        (tmp_path / "engine.dll").write_bytes(fmu.read("binaries/win64/turbojet.dll"))
    headers = Path(fmpy.__file__).parent / "c-code"
    driver = tmp_path / "driver.exe"
    subprocess.run(
        [WINDOWS_COMPILER, "-O1", "-w", "-static", f"-I{headers}", str(TOOLS / "windows_driver.c"), "-o", str(driver)], check=True
    )  # fmt: skip
    archive = read_archive(made)
    references = [str(archive.ports[name].variable.reference) for name in ("throttle", "thrust")]
    assert WINE is not None
    done = subprocess.run(
        [WINE, str(driver), "engine.dll", archive.token, str(STEP), *references],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=600,
        env={**os.environ, "WINEPREFIX": str(tmp_path / "wine"), "WINEDEBUG": "-all", "DISPLAY": ""},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    there = [float.fromhex(line) for line in done.stdout.split()]
    result = fmpy.simulate_fmu(
        str(made), stop_time=100 * STEP, step_size=STEP, output_interval=STEP, start_values={archive.throttle.name: 1.0},
        output=[archive.thrust.name], fmi_type="CoSimulation",
    )  # fmt: skip
    assert there == [float(row[1]) for row in result][1:101]
    assert there[-1] > 0.0


def test_without_the_compiler_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "WINDOWS_COMPILER", "no-such-compiler")
    source = data_folder("fmus") / "turbojet.fmu"
    with pytest.raises(InputError, match=r"no-such-compiler is not found .on Debian: apt install gcc-mingw") as caught:
        compile_archive(source, tmp_path / "both.fmu", windows=True)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "both.fmu").exists()
    with pytest.raises(InputError, match="has no sources"):
        compile_archive(foreign(tmp_path, "closed", "lag=0.1"), windows=True)
    assert load_engine("turbojet", {}, STEP).library
