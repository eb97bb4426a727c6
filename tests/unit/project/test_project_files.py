"""What the project says of itself to those who cite, join, host and release it; and that older files stay readable.

CHANGELOG.md, CITATION.cff, CODE_OF_CONDUCT.md, SECURITY.md, docs/versions.md, .github/, [tool.cibuildwheel].
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from places import ROOT, TESTS

from cosim import Scenario, fly, open_run
from cosim.campaign import open_campaign
from cosim.campaign.run import fly_again
from cosim.campaign.study.study import Study
from cosim.results.report.flight import write_report
from cosim.simulation.controllers.controller_file import apply_controller, read_controller
from hexjet_paper import numbers

yaml = pytest.importorskip("yaml", reason="no PyYAML, with which these files are read")
SETUP = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = SETUP["project"]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
OLDER = sorted(path for path in (TESTS / "older").iterdir() if path.is_dir())


def read(path: Path) -> Any:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def test_it_is_cited_as_what_it_is() -> None:
    """The keys that the Citation File Format 1.2.0 asks for, and what pyproject.toml says too."""
    cited = read(ROOT / "CITATION.cff")
    assert cited["cff-version"] == "1.2.0"
    assert {"message", "title", "authors", "type"} <= set(cited)
    assert cited["type"] == "software"
    assert str(cited["version"]) == PROJECT["version"]
    assert cited["license"] == PROJECT["license"]
    assert cited["authors"] == PROJECT["authors"]  # an entity each: nobody is invented
    assert cited["keywords"] == PROJECT["keywords"]
    released = re.findall(
        r"^## \d+\.\d+\.\d+ - (\S+)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert str(cited.get("date-released", "")) == (released[0] if released else "")  # a date only of what was released


def test_the_paper_is_cited_with_its_authors() -> None:
    """As the paper prints them, in its order."""
    (paper,) = read(ROOT / "CITATION.cff")["references"]
    names = [f"{author['given-names'][0]}. {author['family-names']}" for author in paper["authors"]]
    assert numbers.SOURCE.startswith(", ".join(names) + ", ")
    assert paper["title"] in numbers.SOURCE


def test_the_changes_are_kept() -> None:
    """Newest first, in the sections of Keep a Changelog; a version without a date is the one that is not released."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    versions = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert versions[0] == "Unreleased"
    assert all(re.fullmatch(r"\d+\.\d+\.\d+ - \d{4}-\d\d-\d\d", version) for version in versions[1:])
    sections = re.findall(r"^### (.*)$", text, re.MULTILINE)
    assert set(sections) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert PROJECT["version"] == versions[1].split(" - ")[0]
    assert max(map(len, text.split("## 0.2.")[0].splitlines())) <= 140


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_is_one(path: Path) -> None:
    """Jobs with steps that each use an action of a stated version or run something, a limit of time, no rights to write."""
    flow = read(path)
    assert {"name", "permissions", "jobs"} <= set(flow)
    assert True in flow or "on" in flow  # YAML 1.1 reads "on" as true
    assert flow["permissions"] == {"contents": "read"}
    for name, job in flow["jobs"].items():
        assert job["timeout-minutes"] <= 120, name
        assert "runs-on" in job
        for step in job["steps"]:
            assert ("uses" in step) != ("run" in step), step
            if "uses" in step:
                assert re.fullmatch(r"[\w-]+/[\w-]+@v\d+\.\d+\.\d+", step["uses"]), step
        for key in re.findall(r"\$\{\{ matrix\.(\w+) \}\}", str(job)):
            assert key in job["strategy"]["matrix"], key


def test_a_change_is_judged_as_it_is_here() -> None:
    jobs = read(ROOT / ".github" / "workflows" / "verdict.yml")["jobs"]
    assert [step["run"] for step in jobs["verdict"]["steps"] if "run" in step] == [".ci/run"]
    least = PROJECT["requires-python"].removeprefix(">=")
    assert jobs["verdict"]["strategy"]["matrix"]["python"][0] == least
    assert any("docs" in step.get("run", "") for step in jobs["site"]["steps"])


def test_a_commit_is_checked_as_make_check_does() -> None:
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").split("\ncheck:")[1].split("\n\n")[0]
    (local,) = read(ROOT / ".pre-commit-config.yaml")["repos"]
    assert local["repo"] == "local"
    commands = [hook["entry"] for hook in local["hooks"]]
    assert commands == [line.strip().replace("$(BIN)", ".venv/bin") for line in recipe.splitlines()[1:]]
    assert not any(hook["pass_filenames"] for hook in local["hooks"])  # each reads the whole project, as make check


def test_a_wheel_is_built_for_each_python_and_system() -> None:
    wanted = SETUP["tool"]["cibuildwheel"]
    pythons = [int(each.removeprefix("cp3").removesuffix("-*")) for each in wanted["build"].split()]
    assert pythons == list(range(11, 11 + len(pythons)))
    assert len(pythons) >= 3
    assert wanted["test-command"].startswith("hexjet fly ")
    assert {"linux", "macos", "windows"} <= set(wanted)
    jobs = read(ROOT / ".github" / "workflows" / "release.yml")["jobs"]
    systems = {each.split("-")[0] for each in jobs["wheels"]["strategy"]["matrix"]["system"]}
    assert systems == {"ubuntu", "macos", "windows"}
    assert any(step.get("uses", "").startswith("pypa/cibuildwheel@") for step in jobs["wheels"]["steps"])


@pytest.mark.parametrize("folder", OLDER, ids=lambda path: path.name)
def test_an_older_run_opens_and_flies(folder: Path, tmp_path: Path) -> None:
    run = open_run(folder / "run")
    assert run.outcome == "completed"
    assert run.summary.flat_metrics["roll.rmse_rad"] is not None
    assert len(run.log["roll_rad"]) == run.summary.steps
    assert write_report(run, tmp_path / "report.html") is None
    again = fly(Scenario.load(folder / "run" / "scenario.toml"))
    assert again.outcome == "completed"
    assert again.summary.steps == run.summary.steps


@pytest.mark.parametrize("folder", OLDER, ids=lambda path: path.name)
def test_an_older_campaign_opens_and_flies(folder: Path) -> None:
    study = Study.load(folder / "campaign" / "study.toml")
    campaign = open_campaign(folder / "campaign")
    assert len(campaign.columns["flight"]) == study.draws * len(study.controller_names)
    assert fly_again(campaign, 0).run.outcome == "completed"


@pytest.mark.parametrize("folder", OLDER, ids=lambda path: path.name)
def test_an_older_design_flies(folder: Path) -> None:
    path = folder / "design.toml"
    run = fly(apply_controller("hover", path, ["duration_s=0.4", "expect=[]"]))
    assert run.outcome == "completed"
    assert run.summary.controller == read_controller(path).controller


def locked(name: str) -> set[str]:
    """What a lock pins, a line a package: name, version and for which Python or system."""
    return set(re.findall(r"^(\w\S*==[^\\\n]*?) *\\?$", (ROOT / name).read_text(), re.MULTILINE))


def test_flying_takes_the_versions_that_are_tested() -> None:
    flying, everything = locked("requirements.lock"), locked("requirements-dev.lock")
    assert flying < everything
    assert len(flying) < len(everything) / 2
    names = {line.partition("==")[0] for line in flying}
    assert {"jsbsim", "numpy", "pyarrow", "mypy", "setuptools"} <= names
    assert not names & {"pytest", "playwright", "mavproxy", "pandas", "sphinx"}
