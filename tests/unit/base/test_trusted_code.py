"""Whose code is run: what names it, what its folder's hash covers, and where it is remembered."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base import trust
from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.base.storage.user import cache_folder, settings_folder
from cosim.base.trust import Code, program_code

REFUSED = "has code that has not been run before"


@pytest.fixture(autouse=True)
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A user who has flown nothing so far, in an empty folder."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / ".settings"))
    monkeypatch.delenv(trust.ENV_VAR, raising=False)
    monkeypatch.setattr(trust, "_decision", trust.TrustDecision())
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text("text")
    return path


def runs(code: Code, *arguments: str, forget: bool = True) -> bool:
    """Whether a command with these arguments runs it, by a user who never has."""
    if forget:
        (settings_folder() / trust.TRUSTED_LIST).unlink(missing_ok=True)
    with trust.command_trust_scope(None, arguments):
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
def test_a_named_file_trusts_its_folder_and_none_below(arguments: tuple[str, ...], file: Path) -> None:
    (file.parent / "sub").mkdir()
    (file.parent / "sub" / "mine.py").write_text("text")
    assert runs(Code(file), "fly", "hover", *arguments)
    assert runs(Code(file.with_name("beside.py")), "fly", "hover", *arguments)
    assert not runs(Code(file.parent / "sub" / "mine.py"), "fly", "hover", *arguments)


def test_a_mapping_file_names_its_fmu_where_it_is_an_engine(file: Path) -> None:
    (file.parent / "sub").mkdir()
    code = Code(file.parent / "sub" / "its.fmu", (Path("map.toml"),))
    for arguments in (("fly", "--engine", "map.toml"), ("fly", "--engine=3=map.toml"), ("engine", "check", "map.toml")):
        assert runs(code, *arguments)
    for arguments in (("fly", "map.toml"), ("fly", "--model", "map.toml"), ("fly", "hover", "--engine", "o.toml")):
        assert not runs(code, *arguments)


def test_what_a_program_names_is_a_text_or_a_path(file: Path) -> None:
    trust.trust_named_code([None, "", "other.fmu", Path("mine.py")], file.parent)
    trust.need_trust([Code(file)], "test")


@pytest.mark.parametrize("name", ["scenario.toml", "table.csv", "run", "program"])
def test_data_is_never_named_as_code(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("text")
    assert not runs(program_code(tmp_path / name, ""), "fly", name, "--model", name, "--set", f"a={name}")


def test_a_program_is_named_and_remembered_with_its_arguments(file: Path) -> None:
    code = program_code(file, " --fast")
    for other in ("process:mine.py", "process:mine.py --slow", "mine.py:Mine"):
        assert not runs(code, "fly", "--controller", other)
    assert runs(code, "fly", "--controller", "process:mine.py --fast")
    assert runs(code, "fly", forget=False)
    assert not runs(program_code(file, " --slow"), "fly", forget=False)


def test_a_folder_is_remembered_and_any_other_file_asks_again(file: Path) -> None:
    """What it imports, loads, or is shadowed by: nobody has to see which; what hexjet itself reads and writes is data."""
    place, folder, code = settings_folder() / trust.TRUSTED_LIST, file.parent, Code(file)
    assert runs(code, "fly", "mine.py")
    line = place.read_text()
    assert line[64:] == f"  {folder}\n"
    assert place.stat().st_mode & 0o077 == 0
    for name in ("scenario.toml", "runs/one/mine.py", "out/log.arrows", "out/report.html", "__pycache__/mine.pyc",
                 ".git/config", "out/mine.py"):  # fmt: skip
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("text")
        assert runs(code, "fly", forget=False), name
    for name in ("enum.py", "json/__init__.py", "enum.pyc", "deep/lib.so", "etc/rcS", "setup", ".profile"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("another text")
        assert not runs(code, "fly", forget=False), name
        (folder / name).unlink()
    outside = folder.with_name(f"{folder.name}-outside")
    outside.mkdir()
    (outside / "enum.py").write_text("another text")
    for name, target in (("enum.py", outside / "enum.py"), ("elsewhere", outside)):
        (folder / name).symlink_to(target)
        assert not runs(code, "fly", forget=False), name
        (folder / name).unlink()
    assert runs(code, "fly", forget=False)
    place.write_text("no line of ours\n" + line)
    assert runs(code, "fly", forget=False)
    place.write_text(f"#{line}")
    assert not runs(code, "fly", forget=False)


def test_code_counts_whatever_its_name_is(tmp_path: Path) -> None:
    """As does what a program is told to read beside it."""
    (tmp_path / "tool.toml").write_text("text")
    (tmp_path / "told.csv").write_text("text")
    code = program_code(tmp_path / "tool.toml", " told.csv")
    assert runs(code, "fly", "process:tool.toml told.csv")
    assert runs(code, forget=False)
    for name in ("tool.toml", "told.csv"):
        (tmp_path / name).write_text("another")
        assert not runs(code, "fly", forget=False)
        (tmp_path / name).write_text("text")


def test_a_program_in_bin_brings_the_folder_above(tmp_path: Path) -> None:
    for name in ("px/bin/px4", "px/etc/rcS", "bin/tool"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("text")
    code = program_code(tmp_path / "px/bin/px4", "")
    assert code.folder == tmp_path / "px"
    assert program_code(tmp_path / "bin/tool", "").folder == tmp_path / "bin"
    assert runs(code, "fly", "process:px/bin/px4")
    (tmp_path / "px/etc/rcS").write_text("another")
    assert not runs(code, "fly", forget=False)


@pytest.mark.parametrize("limit", ["max_files", "max_mb"])
def test_a_folder_that_is_too_large_is_not_remembered(limit: str, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(trust._hash_folder.__kwdefaults__, limit, 0)
    assert runs(Code(file), "fly", "mine.py")
    with pytest.raises(InputError, match=r"\(mine\.py; too large to be remembered\): has code"):
        trust.need_trust([Code(file)], "test")


def test_what_this_program_wrote_leaves_a_folder_as_trusted_as_it_was(file: Path) -> None:
    made, run = file.parent / "made.fmu", file.parent / "run"
    made.write_text("made")
    trust.remember_written(file.parent, [made])
    assert not runs(Code(made), forget=False)
    assert runs(Code(file), "fly", "mine.py")
    made.write_text("made anew")
    trust.remember_written(file.parent, [made])
    assert not runs(Code(made), forget=False)
    made.unlink()
    assert runs(Code(file), "fly", "mine.py")
    made.write_text("made anew")
    trust.remember_written(file.parent, [made])
    assert runs(Code(made), forget=False)
    trust.need_trust([Code(file)], "test")
    run.mkdir()
    for name, text, trusted in (("mine.py", "text", True), ("enum.py", "somebody else's", False)):
        (run / name).write_text(text)
        trust.remember_written(run)
        assert runs(Code(run / "mine.py"), forget=False) is trusted


def test_a_question_or_a_refusal_is_one_line_that_no_terminal_obeys(tmp_path: Path) -> None:
    for number in range(6):
        (tmp_path / f"{number}.py").write_text("text")
    code = [Code(tmp_path / f"{number}.py") for number in range(6)]
    with trust.command_trust_scope(None, []), pytest.raises(trust.CodeRefusedError) as refused:
        trust.need_trust([*code, program_code(tmp_path / "x\n\x1b[2K", " -c 'rm *'")], "test")
    assert f"test: {tmp_path} (0.py, 1.py, 2.py, 3.py and 3 more): {REFUSED}" in str(refused.value)
    with trust.command_trust_scope(None, []), pytest.raises(trust.CodeRefusedError) as refused:
        trust.need_trust([program_code(tmp_path / "x\n\x1b[2K", " -c 'rm *'")], "test")
    assert rf"test: {tmp_path} (x\n\x1b[2K -c 'rm *'): {REFUSED}" in str(refused.value)


def test_nothing_runs_while_somebody_looks(file: Path) -> None:
    trust.trust(file)
    with trust.without_code(), pytest.raises(trust.CodeRefusedError, match="nothing is run to look at something"):
        trust.need_trust([Code(file)], "test")
    trust.need_trust([Code(file)], "test")


def test_what_is_shipped_is_trusted_and_not_remembered() -> None:
    trust.need_trust([Code(data_folder("scenarios") / "hover.toml")], "test")
    assert not settings_folder().exists()


def test_folders_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert settings_folder() == tmp_path / ".settings" / "hexjet"
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
    with trust.command_trust_scope(None, ["mine.py"]):
        trust.need_trust([Code(file)], "test")
    with pytest.raises(trust.CodeRefusedError):
        trust.need_trust([Code(file)], "test")
