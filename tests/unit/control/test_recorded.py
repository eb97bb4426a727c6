"""A record of actuators: what is written is read to the last bit, and what is no record is refused in one line."""

from __future__ import annotations

from math import nextafter
from pathlib import Path

import pytest

from cosim.base.errors import FlightError, InputError
from cosim.base.protocols import Applied
from cosim.base.signals import Command, EngineOutput, Measured
from cosim.simulation.controllers.recorded import COLUMNS, RecordedController, format_header, format_row, read_commands
from cosim.simulation.controllers.source import find_controller_source

ROWS = [
    ((0.1, 1.0 / 3.0, nextafter(0.5, 1.0), 0.0), (-0.2, nextafter(0.1, 0.0)), (0.0, 6.004)),
    ((1.0, 0.7, 0.30000000000000004, 1e-300), (0.0, -0.0), (1.0, 6.008)),
]
TOLD = (
    Command((0.0, 0.0, 0.0), 10.0),
    Measured((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 10.0),
    Applied((0.0,) * 4, (0.0, 0.0), EngineOutput((), (), (), ()), 0.0),
)


def table(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def test_what_is_written_is_read_to_the_last_bit(tmp_path: Path) -> None:
    path = table(tmp_path / "actuators.csv", format_header(4, True), *[format_row(row, True) for row in ROWS])
    rows, columns = read_commands(path, "controller")
    assert repr(rows) == repr(ROWS)
    assert columns == COLUMNS


def test_a_vehicle_without_servos_has_no_tilts(tmp_path: Path) -> None:
    path = table(tmp_path / "actuators.csv", format_header(4, False), *[format_row(row, False) for row in ROWS])
    rows, _ = read_commands(path, "controller")
    assert [row[0] for row in rows] == [row[0] for row in ROWS]
    assert {row[1] for row in rows} == {(0.0, 0.0)}


def test_it_gives_its_rows_in_order_and_says_where_they_end(tmp_path: Path) -> None:
    source = find_controller_source(
        str(table(tmp_path / "a.csv", format_header(4, True), *[format_row(row, True) for row in ROWS])), tmp_path, ""
    )
    assert (source.level, tuple(source.columns), list(source.hashes)) == ("controller", COLUMNS, ["a.csv"])
    block = source.make()
    assert isinstance(block, RecordedController)
    for throttle, tilt, shown in ROWS:
        given = block.update(*TOLD)
        assert (given.throttle, given.tilt, block.shown) == (throttle, tilt, shown)
    with pytest.raises(FlightError, match="the record ends after 2 steps"):
        block.update(*TOLD)
    block.reset()
    assert block.update(*TOLD).throttle == ROWS[0][0]


def test_a_line_that_a_kill_cut_off_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "actuators.csv"
    path.write_text("\n".join([format_header(4, True), *[format_row(row, True) for row in ROWS], "0.5,0.5,0.4"]))
    assert len(read_commands(path, "controller")[0]) == 2


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([], "is no table"),
        (["time_s,throttle_1"], "line 1: 'time_s': must be throttle_1"),
        (["throttle_1,throttle_2,tilt_lft_rad", "0,0,0"], "did you mean 'tilt_left_rad'"),
        (["throttle_1,throttle_2", "0.1,0.2", "0.1,x", "0.1,0.2"], "line 3: must be 2 finite numbers"),
        (["throttle_1,throttle_2", "0.1", "0.1,0.2"], "line 2: must be 2 finite numbers"),
    ],
)
def test_what_is_no_record_is_refused(tmp_path: Path, lines: list[str], said: str) -> None:
    path = tmp_path / "actuators.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=said):
        read_commands(path, "controller actuators.csv")
