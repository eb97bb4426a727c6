"""A predictor of an installed package is offered, flown, swept and searched by its name."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from command_tools import Done, hexjet_beside, install


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """One that states a predictor among its entry points."""
    place = install(tmp_path, "my-predictors", "1.0", "[hexjet.predictors]\nmy-smith = my_predictors:SPEC\n")
    (place / "my_predictors.py").write_text(
        "from dataclasses import replace\n"
        "from cosim.control.predictors.registry import SMITH\n"
        "SPEC = replace(SMITH, name='my-smith', title='Smith, from a package', number=None)\n"
    )
    return place


def test_a_package_brings_one(package: Path) -> None:
    assert re.search("my-smith +Smith, from a package", hexjet_beside(package, "show", "controllers").told)
    short = "--set duration_s=0.2 --controller my-smith --workers 1"
    sweep = f"sweep hover --vary vehicle.mass_kg=5.6:5.8 --runs 1 {short} --controller smith --out out --json"
    assert "my-smith" in json.dumps(json.loads(hexjet_beside(package, *sweep.split()).told))
    search = f"search hover --vary mismatch.delay_samples=0:1 {short} --out found"
    searched = hexjet_beside(package, *search.split())
    assert searched.status in (0, 1), searched.err
    assert "my-smith" in searched.out


def test_one_that_is_not_installed_is_asked_for(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As any other code of the user's: naming it is enough.  What only looks goes without it."""
    with (package / "my_predictors.py").open("a") as file:
        file.write("# nobody has flown this one\n")
    monkeypatch.delenv("HEXJET_TRUST", raising=False)
    script = f"import sys; sys.path.insert(0, {str(package)!r}); from cosim.cli.main import main; main()"

    def here(words: str) -> Done:
        command = [sys.executable, "-c", script, *words.split()]
        done = subprocess.run(command, capture_output=True, text=True, cwd=package, check=False)
        return Done(done.returncode, done.stdout, done.stderr)

    assert "my-smith" not in here("show controllers").told
    misspelt = here("fly hover --controller my-smit").refusal
    assert "entry point 'my-smith' of hexjet.predictors" in misspelt
    assert "has code that has not been run before" in misspelt
    assert here("fly hover --controller my-smith --set duration_s=0.1").told


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("my-smith = my_predictors:NONE", "'my-smith' of hexjet.predictors: my_predictors:NONE cannot be loaded: Attr"),
        ("other = my_predictors:SPEC", "'other' of hexjet.predictors: must be a PredictorSpec of this name"),
    ],
)
def test_a_package_that_does_not_is_told_in_one_line(package: Path, text: str, message: str) -> None:
    (package / "my_predictors-1.0.dist-info" / "entry_points.txt").write_text(f"[hexjet.predictors]\n{text}\n")
    said = hexjet_beside(package, "fly", "hover", "--controller", "my-smith").refusal
    assert f"entry point {message}" in said
    assert "importlib" not in said
    assert "__init__.py" not in said


def test_two_of_one_name_are_refused_and_the_same_one_twice_is_not(package: Path) -> None:
    """Which of them flies would depend on the order of installation; a package may state one in both groups."""
    other = package / "other_predictors-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other-predictors\nVersion: 1.0\n")

    def flown(value: str) -> Done:
        (other / "entry_points.txt").write_text(f"[hexjet.plugins]\npredictor.my-smith = {value}\n")
        return hexjet_beside(package, *["fly", "hover", "--controller", "my-smith", "--set", "duration_s=0.1"])

    assert flown("my_predictors:SPEC").told
    said = flown("my_predictors:OTHER").refusal
    assert "predictor 'my-smith': there is one of this name already: " in said
    assert "my_predictors:SPEC" in said
    assert "my_predictors:OTHER" in said
