"""What a line calls a choice: an option where a command runs, an argument where a program calls."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim import InputError
from cosim.base.wording import at_command_line, option_of, says_arguments


@says_arguments
def call(
    text: str,
    *,
    out: Path | None = None,
    settings: tuple[str, ...] = (),
    duration_s: float | None = None,
    begin: float | None = None,
    controllers: tuple[str, ...] = (),
    likely: bool = False,
    limit: bool = True,
    lead: bool = True,
) -> None:
    raise InputError(text)


LINES = [  # as a line is written, and as a program reads it
    ("--duration 3: too short", "call: duration_s = 3: too short"),
    ("--duration: too short", "call: duration_s: too short"),
    ("x: raise --duration (now 3), or --begin 2", "x: raise duration_s (now 3), or begin 2"),
    ("--likely: goes without --worst", "call: likely=True: goes without --worst"),  # it has no such argument
    ("left out (--no-limit, --lead)", "left out (limit=False, lead=True)"),
    ("--set a.b=3: is none", "call: settings a.b=3: is none"),
    ("c: name a folder with --out", "c: name a folder with out"),
    ("one is made by: hexjet design --out F (then --controller F)", None),
    ("hexjet sweep DIR --out x; --out y", "hexjet sweep DIR --out x; out y"),
    ("m.toml: is a mapping file; it goes with --engine FILE", "m.toml: is a mapping file; it goes with engine FILE"),
    ("a--out and ---out", "a--out and ---out"),
]


@pytest.mark.parametrize(("line", "told"), LINES)
def test_a_program_reads_of_its_arguments_and_a_user_of_options(line: str, told: str | None) -> None:
    with pytest.raises(InputError) as error:
        call(line)
    assert str(error.value) == (told or "one is made by: hexjet design --out F (then controllers F)")
    with at_command_line(["--out"]), pytest.raises(InputError) as error:
        call(line)
    assert str(error.value) == line


def test_an_argument_is_called_as_the_option_of_the_command_that_runs() -> None:
    assert option_of("settings") is None
    with at_command_line(["--set", "--controller", "--time-limit"]):
        assert [option_of(name) for name in ("settings", "controllers", "time_limit_s", "out")] == [
            "--set", "--controller", "--time-limit", None,
        ]  # fmt: skip
        with at_command_line(["--out"]):
            assert option_of("settings") is None
    assert option_of("out") is None
