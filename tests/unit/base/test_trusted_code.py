"""Whose code is run: what names it, and where it is remembered."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from cosim.base import trust
from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.base.storage.user import cache_folder, settings_folder


@pytest.fixture(autouse=True)
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A user who has flown nothing so far, in an empty folder."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    monkeypatch.delenv(trust.ENVIRONMENT, raising=False)
    monkeypatch.setattr(trust, "_decision", trust.Decision())
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text("text")
    return path


def runs(code: trust.Code, *arguments: str) -> bool:
    """Whether a command with these arguments runs it, by a user who never has."""
    (settings_folder() / trust.REMEMBERED).unlink(missing_ok=True)
    with trust.at_a_command(None, arguments):
        try:
            trust.need_trust([code], "test")
        except trust.CodeRefusedError:
            return False
        return True


@pytest.mark.parametrize(
    "arguments",
    [("--controller", "mine.py:Mine"), ("--controller=mine.py:Mine",), ("--set", 'metrics=["mine.py:f", "other.py:g"]'),
     ("--metric", "./mine.py:f"), ("mine.py",)],
)  # fmt: skip
def test_a_file_is_named_by_its_path(arguments: tuple[str, ...], file: Path) -> None:
    assert runs(trust.code_of(file), "fly", "hover", *arguments)
    (file.parent / "sub").mkdir()
    assert not runs(trust.code_of(file.rename(file.parent / "sub" / "mine.py")), "fly", "hover", *arguments)


def test_a_mapping_file_names_its_fmu_where_it_is_an_engine(file: Path) -> None:
    code = trust.code_of(file, Path("map.toml"))
    for arguments in (
        ("fly", "hover", "--engine", "map.toml"),
        ("fly", "--engine=3=map.toml"),
        ("fmu", "check", "map.toml"),
    ):
        assert runs(code, *arguments)
    for arguments in (
        ("fly", "map.toml"),
        ("fly", "hover", "--model", "map.toml"),
        ("fly", "hover", "--engine", "o.toml"),
    ):
        assert not runs(code, *arguments)


def test_what_a_program_names_is_a_text_or_a_path(file: Path) -> None:
    trust.mention([None, "", "other.py", Path("mine.py")], file.parent)
    trust.need_trust([trust.code_of(file)], "test")


@pytest.mark.parametrize("name", ["scenario.toml", "table.csv", "run", "program"])
def test_data_is_never_named_as_code(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("text")
    assert not runs(trust.code_of(tmp_path / name), "fly", name, "--engine", name, "--set", f"a={name}")


def test_a_program_is_named_with_its_arguments(file: Path) -> None:
    code = trust.code_of(file, trust.process_name(file, " --fast"), arguments=" --fast")
    assert runs(code, "fly", "--controller", "process:mine.py --fast")
    for other in ("process:mine.py", "process:mine.py --slow", "mine.py:Mine"):
        assert not runs(code, "fly", "--controller", other)
    assert code.sha256 != trust.code_of(file).sha256


def test_arguments_of_a_program_are_shown_and_remembered(file: Path) -> None:
    """In one line, without what a terminal obeys."""
    code = trust.code_of(file, arguments=" -c 'rm *'\n\x1b[2K[b]harmless")
    shown = rf"{file} -c 'rm *'\n\x1b[2K[b]harmless"
    with trust.at_a_command(None, []), pytest.raises(trust.CodeRefusedError) as refused:
        trust.need_trust([code], "test")
    assert f"test: {shown}: is code" in str(refused.value)
    trust.remember([code])
    assert (settings_folder() / trust.REMEMBERED).read_text() == f"{code.sha256}  {shown}\n"


def test_it_is_remembered_as_sha256sum_writes_it(file: Path) -> None:
    place = settings_folder() / trust.REMEMBERED
    sha256 = hashlib.sha256(file.read_bytes()).hexdigest()
    assert runs(trust.code_of(file), "fly", "mine.py")
    assert place.read_text() == f"{sha256}  {file}\n"
    assert place.stat().st_mode & 0o077 == 0
    trust.need_trust([trust.code_of(file)], "test")
    place.write_text("no line of ours\n" + place.read_text())
    trust.need_trust([trust.code_of(file)], "test")
    assert len(place.read_text().splitlines()) == 2
    place.write_text(f"#{sha256}  forgotten\n")
    with pytest.raises(InputError, match=r"test: .*mine\.py: is code that you have not flown before"):
        trust.need_trust([trust.code_of(file)], "test")


def test_nothing_runs_while_somebody_looks(file: Path) -> None:
    trust.trust(file)
    with trust.without_code(), pytest.raises(trust.CodeRefusedError, match="nothing is run to look at something"):
        trust.need_trust([trust.code_of(file)], "test")
    trust.need_trust([trust.code_of(file)], "test")


def test_what_is_shipped_is_trusted_and_not_remembered() -> None:
    trust.need_trust([trust.code_of(data_folder("scenarios") / "hover.toml")], "test")
    assert not settings_folder().exists()


def test_a_refusal_is_one_line(tmp_path: Path) -> None:
    files = [tmp_path / f"{number}.py" for number in range(9)]
    for file in files:
        file.write_text(file.name)
    with pytest.raises(trust.CodeRefusedError, match=r"0\.py, .*3\.py and 5 more: is code") as refused:
        trust.need_trust(map(trust.code_of, files), "test")
    assert "\n" not in str(refused.value)


def test_folders_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert settings_folder() == tmp_path / "settings" / "hexjet"
    for variable in ("XDG_CONFIG_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(variable, "not/absolute")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("sys.platform", "linux")
    assert (settings_folder(), cache_folder()) == (tmp_path / ".config/hexjet", tmp_path / ".cache/hexjet")
    monkeypatch.setattr("sys.platform", "darwin")
    assert settings_folder() == tmp_path / "Library/Application Support/hexjet"


def test_without_a_home_nothing_is_remembered(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CONFIG_HOME")
    monkeypatch.setattr(Path, "home", homeless)
    with trust.at_a_command(None, ["mine.py"]):
        trust.need_trust([trust.code_of(file)], "test")
    with pytest.raises(trust.CodeRefusedError):
        trust.need_trust([trust.code_of(file)], "test")
