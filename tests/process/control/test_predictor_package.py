"""A predictor of an installed package is offered, flown, swept and searched by its name."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from command_tools import hexjet_beside, install


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
    listed = hexjet_beside(package, "show", "controllers")
    assert re.search("my-smith +Smith, from a package", listed.stdout)
    swept = hexjet_beside(
        package, "sweep", "hover", "--vary", "vehicle.mass_kg=5.6:5.8", "--runs", "1", "--set", "duration_s=0.2",
        "--controller", "my-smith", "--controller", "smith", "--workers", "1", "--out", "out", "--json",
    )  # fmt: skip
    assert swept.returncode == 0, swept.stderr
    assert "my-smith" in json.dumps(json.loads(swept.stdout))
    searched = hexjet_beside(
        package, "search", "hover", "--vary", "mismatch.delay_samples=0:1", "--set", "duration_s=0.2",
        "--controller", "my-smith", "--workers", "1", "--out", "found",
    )  # fmt: skip
    assert searched.returncode in (0, 1), searched.stderr
    assert "my-smith" in searched.stdout


def test_one_that_is_not_installed_is_asked_for(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As any other code of the user's: naming it is enough.  What only looks goes without it."""
    with (package / "my_predictors.py").open("a") as file:
        file.write("# nobody has flown this one\n")
    monkeypatch.delenv("HEXJET_TRUST", raising=False)
    script = f"import sys; sys.path.insert(0, {str(package)!r}); from cosim.cli.main import main; main()"
    listed, misspelt, named = (
        subprocess.run([sys.executable, "-c", script, *words], capture_output=True, text=True, cwd=package, check=False)
        for words in (
            ["show", "controllers"],
            ["fly", "hover", "--controller", "my-smit"],
            ["fly", "hover", "--controller", "my-smith", "--set", "duration_s=0.1"],
        )
    )
    assert listed.returncode == 0, listed.stderr
    assert "my-smith" not in listed.stdout
    assert misspelt.returncode == 2
    assert "entry point 'my-smith' of hexjet.predictors" in misspelt.stderr
    assert "has code that has not been run before" in misspelt.stderr
    assert named.returncode == 0, named.stderr


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "my-smith = my_predictors:NONE",
            "entry point 'my-smith' of hexjet.predictors: my_predictors:NONE cannot be loaded: AttributeError",
        ),
        (
            "other = my_predictors:SPEC",
            "entry point 'other' of hexjet.predictors: must be a PredictorSpec of this name",
        ),
    ],
)
def test_a_package_that_does_not_is_told_in_one_line(package: Path, text: str, message: str) -> None:
    (package / "my_predictors-1.0.dist-info" / "entry_points.txt").write_text(f"[hexjet.predictors]\n{text}\n")
    done = hexjet_beside(package, "fly", "hover", "--controller", "my-smith")
    assert done.returncode == 2
    assert message in done.stderr
    assert "importlib" not in done.stderr
    assert "__init__.py" not in done.stderr
    assert "Traceback" not in done.stderr


def test_two_of_one_name_are_refused_and_the_same_one_twice_is_not(package: Path) -> None:
    """Which of them flies would depend on the order of installation; a package may state one in both groups."""
    other = package / "other_predictors-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other-predictors\nVersion: 1.0\n")
    for value, status in (("my_predictors:SPEC", 0), ("my_predictors:OTHER", 2)):
        (other / "entry_points.txt").write_text(f"[hexjet.plugins]\npredictor.my-smith = {value}\n")
        done = hexjet_beside(package, "fly", "hover", "--controller", "my-smith", "--set", "duration_s=0.1")
        assert done.returncode == status, done.stderr
    assert "predictor 'my-smith': there is one of this name already: " in done.stderr
    assert "my_predictors:SPEC" in done.stderr
    assert "my_predictors:OTHER" in done.stderr
