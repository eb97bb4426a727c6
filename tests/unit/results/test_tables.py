"""A log as a table with units, as a figure, and as what a notebook shows: in memory and from a folder."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

from cosim import InputError, Scenario, fly, open_run, plot
from cosim.base.protocols import Column
from cosim.results.log.recorder import MemoryLog
from cosim.results.run import Run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("runs") / "run"
    return fly(Scenario.load("hover").replace(duration_s=0.02, expect=[]), folder, report=False)


def test_a_table_has_the_columns_over_time_with_their_units(run: Run) -> None:
    pytest.importorskip("pandas", reason="the extra notebook is not installed: make setup")
    for log in (
        run.log,
        open_run(run.folder or "").log,
        MemoryLog([log_table(run)], run.log.columns, run.log.described),
    ):
        whole, part = log.table(), log.table("thrust_1_N", "rate_p_rad_s")
        assert [*whole.columns] == [name for name in log.columns if name != "time_s"]
        assert [*part.columns] == ["thrust_1_N", "rate_p_rad_s"]
        assert np.array_equal(part.index, log["time_s"])
        assert part.index.name == "time_s"
        assert part["thrust_1_N"].to_numpy().tobytes() == log["thrust_1_N"].tobytes()
        assert part.attrs["units"] == {"thrust_1_N": "N", "rate_p_rad_s": "rad/s"}
        assert part.attrs["frames"]["rate_p_rad_s"] == "body"
        assert len(whole.attrs["meanings"]) == len(log.columns)
        with pytest.raises(InputError, match="no column 'rol_rad'; did you mean 'roll_rad'"):
            log.table("rol_rad")


def log_table(run: Run) -> Any:
    return np.array([run.log[name] for name in run.log.columns])


def test_without_pandas_it_says_how_to_get_it(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"a table needs pandas, .*: pip install pandas"):
        run.log.table()


def test_without_plotly_it_says_how_to_get_it(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    with pytest.raises(InputError, match=r"a plot needs plotly, .*: pip install plotly"):
        plot(run)


def test_a_log_shows_what_its_columns_are() -> None:
    columns = (Column("x_rad", "rad", "body", "an <angle>"), Column("gone", "", "", ""))
    log = MemoryLog([np.array([[1.0, -2.0], [np.nan, np.nan]])], ("x_rad", "gone"), columns)
    shown = log._repr_html_()
    assert "<b>2 steps</b>" in shown
    row = "<td>x_rad</td><td>rad</td><td>body</td><td>an &lt;angle&gt;</td><td>-2</td><td>1</td>"
    assert row in shown
    assert "<td>gone</td><td></td><td></td><td></td><td></td><td></td>" in shown


def test_a_plot_has_what_was_asked_for(run: Run) -> None:
    figure = plot(run, "roll_rad", "thrust_1_N", "roll_setpoint_rad")
    assert [trace.name for trace in figure.data] == ["roll_rad", "thrust_1_N", "roll_setpoint_rad"]
    assert [trace.yaxis for trace in figure.data] == ["y", "y2", "y"]  # one panel a unit
    assert (figure.layout.yaxis.title.text, figure.layout.yaxis2.title.text) == ("[rad]", "[N]")
    np.testing.assert_array_equal(figure.data[1].y, run.log["thrust_1_N"].astype(np.float32))
    assert figure.data[1].dx == 0.004
    both = plot([run, run], "roll_rad")
    assert [(trace.name, trace.line.dash) for trace in both.data] == [("1: roll_rad", "solid"), ("2: roll_rad", "dash")]
    assert len(plot(run).data) == 9  # three angles, each true, measured and asked for
    assert len(plot([run, run]).data) == 9  # two runs and what was asked for
    with pytest.raises(InputError, match="no column 'rol_rad'"):
        plot(run, "rol_rad")
