"""The functions of the package: one path with the commands, wrong arguments in a line, results that show themselves."""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE

import cosim
from cosim import InputError
from cosim.api import Result
from cosim.cli.results.show import show as show_command

CALLS = (
    "compare", "design", "export", "export_controller", "export_vehicle", "identify", "margins", "prove", "rare",
    "replay", "search", "show", "sweep",
)  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_a_call_is_typed_and_refuses_a_name_that_is_none(name: str) -> None:
    call = getattr(cosim, name)
    signature = inspect.signature(call)
    assert signature.return_annotation not in (inspect.Signature.empty, "Any")
    assert all(each.annotation is not inspect.Parameter.empty for each in signature.parameters.values())
    with pytest.raises(InputError, match=rf"^{name}: no argument 'ou'; did you mean 'out'\? "):
        if "out" not in signature.parameters:
            raise InputError(f"{name}: no argument 'ou'; did you mean 'out'? it writes nothing")
        call("hover", ou="x")


@pytest.mark.parametrize(
    ("name", "arguments", "options", "line"),
    [
        ("sweep", (42,), {}, "sweep: name: 42 is a value of type int; allowed: str | Path"),
        ("sweep", ("hover",), {"runs": "x"}, "sweep: runs: 'x' is a value of type str; allowed: int | None"),
        ("sweep", ("hover",), {"settings": "seed=1"}, "sweep: settings: 'seed=1' is a value of type str; allowed: "),
        ("sweep", ("hover",), {"settings": {"seed": object}}, "settings: seed: <class 'object'> is no number, text"),
        ("sweep", (), {}, "sweep: missing a required argument: 'name'"),
        ("identify", ("rol",), {}, "identify: subject: 'rol': did you mean 'roll'? allowed: engine, pitch, roll, yaw"),
        ("identify", ("engine",), {}, "identify: engine: name which"),
        ("margins", (None,), {}, "margins: scenario: None is a value of type NoneType; allowed: Scenario | str | Path"),
        ("design", (), {"out": "x.txt"}, "--out x.txt: must end in .toml, by which --controller knows it"),
        ("compare", ("a",), {}, "compare: 1 flights; allowed: 2 to 8"),
        ("export", ("runs/a", "csvv"), {}, "export: to: 'csvv': did you mean 'csv'? allowed: csv, mat, mcap, "),
        ("export_vehicle", (), {"outside": ["engine"]}, "export_vehicle: outside: 'engine': did you mean 'engines'?"),
        ("search", ("hover",), {"within": 3.0}, "--within: goes with --worst or --likely"),
        ("show", ("hexjt",), {}, "nothing that can be flown is called 'hexjt'; did you mean 'hexjet'"),
    ],
)
def test_a_wrong_argument_is_one_line(
    name: str, arguments: tuple[object, ...], options: dict[str, object], line: str
) -> None:
    with pytest.raises(InputError) as error:
        getattr(cosim, name)(*arguments, **options)
    assert str(error.value).startswith(line)
    assert "\n" not in str(error.value)


def test_a_package_that_is_called_stays_a_package() -> None:
    from cosim.identify import identify_engine

    assert cosim.identify.identify_engine is identify_engine
    assert cosim.identify is sys.modules["cosim.identify"]
    assert callable(cosim.design)


def test_what_is_shown_is_what_the_command_prints(capsys: pytest.CaptureFixture[str]) -> None:
    shown = cosim.show("roll-doublet")
    show_command.main(["roll-doublet", "--json"], standalone_mode=False)
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(shown.to_list()))
    assert str(shown).startswith("roll-doublet, scenario: ")
    assert "<td>duration_s</td>" in shown._repr_html_()
    assert shown.folder is None


def test_a_result_says_where_its_files_are_and_escapes_what_it_shows(tmp_path: Path) -> None:
    class Found(Result):
        def __init__(self) -> None:
            self.files = {"report": tmp_path / "report.html"}

        def lines(self) -> list[str]:
            return ["a < b", "and c"]

    found = Found()
    assert repr(found) == f"<Found: a < b, {tmp_path}>"
    assert "<b>a &lt; b</b>" in found._repr_html_()
    assert f'href="{tmp_path}/report.html"' in found._repr_html_()


_STATE = """
import os, sys, signal, warnings, logging, locale, multiprocessing
def state():
    handlers = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    roots = list(logging.root.handlers), logging.root.level
    filters = [each for each in warnings.filters if "numpy" not in repr(each)]  # numpy's own are its business
    return (handlers, filters, warnings.showwarning, roots, locale.setlocale(locale.LC_ALL),
            dict(os.environ), list(sys.path), sys.excepthook, sys.flags.dev_mode, sys.getswitchinterval(),
            multiprocessing.get_start_method(allow_none=True), sys.getrecursionlimit(), os.getcwd(), os.umask(18))
os.umask(18)
before = state()
import cosim
[getattr(cosim, name) for name in cosim.__all__]
after = state()
import numpy
changed = [n for n, (a, b) in enumerate(zip(before, after)) if a != b]
assert not changed, changed
assert numpy.geterr() == {"divide": "warn", "over": "warn", "under": "ignore", "invalid": "warn"}
assert "matplotlib" not in sys.modules
"""


def test_importing_everything_changes_nothing_of_the_caller() -> None:
    """Signals, warnings, logging, locale, environment, search path, how processes start, numpy's errors."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    done = subprocess.run(
        [sys.executable, "-c", _STATE], capture_output=True, text=True, timeout=PATIENCE, env=environment
    )
    assert done.returncode == 0, done.stderr
