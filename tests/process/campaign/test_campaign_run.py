"""A campaign from its command line or from Python, and any of its flights flown again from its folder alone."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

import campaign_tools as tools
import pytest
import tomli_w
from campaign_tools import without_chance
from command_tools import Hexjet
from places import DESIGNS

from cosim.api.studies import report_tally
from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.base.storage.toml import read_toml
from cosim.campaign import Campaign, fly_again, open_campaign, run_campaign
from cosim.campaign.folder import ASKED, FLIGHTS, JOURNAL, SCENARIO, STUDY
from cosim.campaign.store import Store, Tally
from cosim.campaign.study.plan import Flight, flights
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import Row, fly_one
from cosim.cli.console import TerminalProgress
from cosim.results.log.arrow import read_table, write_table
from cosim.results.summary import versions

SHORT = ("--set", "duration_s=0.2", "--workers", "1")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Six flights, in a folder that no test changes."""
    return run_campaign(tools.study(3), tmp_path_factory.mktemp("flown") / "c", workers=1)


@pytest.fixture
def moved(flown: Campaign, tmp_path: Path) -> Path:
    """The same folder elsewhere."""
    shutil.copytree(flown.folder, tmp_path / "elsewhere" / "c")
    return tmp_path / "elsewhere" / "c"


def test_a_campaign_has_every_flight_in_the_order_of_their_numbers(flown: Campaign) -> None:
    assert (len(flown), flown.of) == (6, 6)
    assert flown.columns["flight"] == [0, 1, 2, 3, 4, 5]
    planned = flights(tools.study(3))
    for number in range(6):
        assert without_chance(flown.row(number)) == without_chance(fly_one(tools.study(3), planned[number]))


def test_progress_is_told_and_a_second_call_flies_what_is_left(tmp_path: Path) -> None:
    told: list[tuple[int, int, int, int]] = []
    halted = tools.study(3)

    def tell(tally: Tally, done: int, of: int) -> None:
        told.append((tally.flights["smith"], tally.successes["smith"], done, of))

    class Few:
        def fly(self, study: Study, planned: Iterable[Flight]) -> Iterator[Row]:
            return (fly_one(study, flight) for flight in islice(planned, 2))

    assert len(run_campaign(halted, tmp_path, Few(), progress=tell)) == 2  # type: ignore[arg-type]
    assert told == [(0, 0, 0, 6), (1, 1, 1, 6), (1, 1, 2, 6)]
    told.clear()
    run_campaign(halted, tmp_path, 1, True, tell)
    assert (told[0], told[-1], len(told)) == ((1, 1, 2, 6), (3, 3, 6, 6), 5)


def test_to_resume_what_was_never_begun_begins_it(tmp_path: Path) -> None:
    assert len(run_campaign(tools.study(1), tmp_path / "c", 1, resume=True)) == 2


def test_a_flight_flies_again_from_its_folder_alone(moved: Path, hexjet: Hexjet, tmp_path: Path) -> None:
    told = hexjet("fly", str(moved), "--flight", "3", "--out", "again").told
    assert "flight 3: the same, bit for bit" in told
    assert (tmp_path / "again" / "flight.parquet").is_file()
    answer = json.loads(hexjet("fly", str(moved), "--flight", "2", "--json").out)
    assert (answer["flight"], answer["same"], answer["otherwise"], answer["controller"]) == (2, True, [], "smith")
    assert (tmp_path / "runs" / "hover-flight-2-001" / "summary.json").is_file()


def test_a_changed_number_of_the_aircraft_is_told(moved: Path) -> None:
    scenario = read_toml(moved / SCENARIO)
    scenario["vehicle"]["sensors"]["gyro"]["noise_rad_s"] *= 1.0 + 1e-12
    (moved / SCENARIO).write_text(tomli_w.dumps(scenario))
    said = r"scenario.toml: vehicle.sensors.gyro.noise_rad_s was 0.005 and is 0.00500000"
    with pytest.raises(InputError, match=said):
        open_campaign(moved)
    (moved / ASKED).unlink()  # a folder of version 0.2.0 does not tell before it is flown
    again = fly_again(open_campaign(moved), 0)
    assert (again.same, again.verdict) == (False, "not the same")
    assert again.otherwise[0] == "the numbers of the aircraft or of an engine are others"
    assert again.otherwise[1].startswith("it ended completed")


def test_a_changed_version_is_told(moved: Path, monkeypatch: pytest.MonkeyPatch, hexjet: Hexjet) -> None:
    held = versions()
    monkeypatch.setattr("cosim.results.setup.versions", lambda: held | {"jsbsim": "9.9.9"})
    assert fly_again(open_campaign(moved), 0).same  # another version, and the same flight all the same
    monkeypatch.setattr("cosim.campaign.run.log_digest", lambda log: "another")
    done = hexjet("fly", str(moved), "--flight", "0")
    assert done.status == 1
    assert "flight 0: not the same" in done.out
    assert f"jsbsim was {held['jsbsim']} and is 9.9.9" in done.out


def test_an_unexplained_change_is_told_as_such(flown: Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.campaign.run.log_digest", lambda log: "another")
    again = fly_again(flown, 0)
    assert again.otherwise[0].startswith("versions, aircraft and engines are the same: the program or the machine")


def test_a_flight_that_was_lost_cannot_be_compared(moved: Path, hexjet: Hexjet) -> None:
    part = moved / FLIGHTS / "part-00000.parquet"
    columns = read_table(part)
    columns["log_sha256"][0], columns["outcome"][0], columns["reason"][0] = None, "failed", "the process was lost"
    write_table(part, columns, kinds={name: float for name in columns if name == "touchdown_m_s"})
    done = hexjet("fly", str(moved), "--flight", str(columns["flight"][0]))
    assert done.status == 1
    assert "the first time was not recorded to its end" in done.out
    assert "failed, the process was lost" in done.out


OWN = """
name = "own"
duration_s = 0.2
engine = "own.fmu"
engine_unchecked = true
controller = "baseline"

[[command]]
kind = "table"
file = "roll.csv"
"""


def test_files_of_ones_own_travel_with_the_campaign(tmp_path: Path, hexjet: Hexjet) -> None:
    """An engine, another one as a value of a key, a table of commands and a controller file; from elsewhere, alone."""
    source = tmp_path / "source"
    (source / "more").mkdir(parents=True)
    shutil.copy(data_folder("fmus") / "edf.fmu", source / "own.fmu")
    shutil.copy(data_folder("fmus") / "edf-as-flown.fmu", source / "more" / "own.fmu")
    (source / "roll.csv").write_text("time_s,roll_deg\n0,0\n0.1,5\n")
    (source / "own.toml").write_text(OWN)
    shutil.copy(DESIGNS / "edf.toml", source / "mine.toml")
    text = {"name": "own", "scenario": "own.toml", "design": "grid", "controllers": ["baseline", "mine.toml"]}
    vary = [{"key": "engine", "values": ["own.fmu", "more/own.fmu"]}]
    (source / "study.toml").write_text(tomli_w.dumps(text | {"vary": vary}))
    assert hexjet("sweep", str(source / "study.toml"), "--out", "c", "--workers", "1").told
    shutil.rmtree(source)
    shutil.move("c", "moved")
    campaign = open_campaign("moved")
    engines = campaign.columns["engine"]
    assert campaign.columns["controller"] == ["baseline", "mine.toml"] * 2
    assert engines[0] != engines[2]
    assert campaign.columns["outcome"] == ["completed"] * 4
    assert len(set(campaign.columns["log_sha256"])) == 4
    assert all(fly_again(campaign, number).same for number in range(4))
    shutil.copy(data_folder("fmus") / "turbojet.fmu", tmp_path / "moved" / str(engines[0]))
    again = fly_again(campaign, 0)
    assert not again.same
    assert any(line.startswith(f"{engines[0]} was ") for line in again.otherwise)


def test_a_sweep_leaves_a_data_set_and_a_page(hexjet: Hexjet, tmp_path: Path) -> None:
    done = hexjet("sweep", "hover", "--vary", "vehicle.mass_kg=5.4:5.8", "--runs", "3", "--controller", "smith", *SHORT)
    assert "report: runs/hover-001/" in done.told
    assert "3 flights" in done.told
    assert done.err == ""  # quiet in a pipe
    made = {path.name for path in (tmp_path / "runs" / "hover-001").iterdir()}
    assert {STUDY, SCENARIO, JOURNAL, FLIGHTS, "report.html"} <= made


def test_json_of_a_sweep_is_one_object(hexjet: Hexjet) -> None:
    """That a flight fails is what a study is for."""
    vary = ("--vary", "vehicle.mass_kg=5.4,5.8,50")
    answer = json.loads(hexjet("sweep", "hover", *vary, "--controller", "smith", "--out", "c", *SHORT, "--json").told)
    assert (answer["folder"], answer["flights"], answer["finished"]) == ("c", 3, True)
    assert answer["controllers"]["smith"]["flights"] == 3
    assert answer["controllers"]["smith"]["success"] == pytest.approx(2 / 3, abs=1e-12)
    assert "vehicle.mass_kg" in open_campaign("c").columns


def test_a_folder_is_resumed_by_its_name_alone(hexjet: Hexjet) -> None:
    arguments = ("sweep", "hover", "--vary", "vehicle.mass_kg=5.4:5.8", "--runs", "3", "--controller", "smith", *SHORT)
    assert hexjet(*arguments, "--out", "c").status == 0
    before = Path("c", FLIGHTS, "part-00000.parquet").read_bytes()
    assert hexjet("sweep", "c", "--resume").status == 0
    assert hexjet(*arguments, "--out", "c", "--resume").status == 0
    assert Path("c", FLIGHTS, "part-00000.parquet").read_bytes() == before
    Path("c", "report.html").unlink()
    assert hexjet("show", "c", "--page").status == 0
    assert Path("c", "report.html").is_file()


def test_what_is_shipped_is_meant_where_a_folder_is_called_the_same(flown: Campaign, hexjet: Hexjet) -> None:
    """But for its path, and where there is nothing else that could be resumed."""
    shutil.copytree(flown.folder, "hover")
    done = hexjet("sweep", "hover", "--vary", "vehicle.mass_kg=5.4:5.8:2", "--controller", "smith", *SHORT)
    assert (done.status, done.err) == (0, "")
    assert len(open_campaign("runs/hover-001")) == 2
    assert "./hover: already holds a campaign; resume goes on with it" in hexjet("sweep", "./hover").err
    assert "6 flights" in hexjet("sweep", "hover", "--resume").out


VARY = ("--vary", "vehicle.mass_kg=5.4:5.8", "--runs", "2")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sweep", "hover", *VARY, "--workers", "0"], "workers = 0: at least 1"),
        (["sweep", "hover", *VARY, "--time-limit", "0"], "time limit = 0 s: must be above 0"),
        (["sweep", "hover", *VARY, "--resume"], "resume: give the folder of the campaign"),
        (["sweep", "hover", *VARY, "--out", "c"], "c: already holds a campaign (study.toml); resume goes on with it"),
        (["sweep", "hover", *VARY, "--out", "c", "--resume"], "c: holds another study; study.toml: "),
        (["sweep", "hover", *VARY, "--out", "file"], "file: "),
        (["sweep", "hover", *VARY, "--out", "empty", "--resume", "--controller", "smiht"], "smiht"),
        ("sweep c", "c: already holds a campaign; resume goes on with it"),
        ("sweep c --resume --runs 5", "c: runs = 5: its latin-hypercube has 3 draws; only a random or a sobol"),
        ("sweep c --resume --seed 5", "c: is a campaign and goes on as it began; leave out seed"),
        ("sweep c --resume --set seed=5", "c: is a campaign and goes on as it began; leave out settings"),
        ("sweep c --resume --out d", "c: is a campaign and goes on as it began; leave out out"),
        ("fly hover --flight 0", "hover: no campaign here (study.toml is missing)"),
        ("fly c --flight 6", "c: flight 6: there are 0 to 5"),
        ("fly c --flight -1", "c: flight -1: there are 0 to 5"),
        ("fly c --flight 0 --seed 3", "seed: a flight of a campaign is flown as it was"),
        ("fly c --flight 0 --controller smith", "controller: a flight of a campaign is flown as it was"),
    ],
)
def test_wrong_input_is_one_line(flown: Campaign, hexjet: Hexjet, arguments: list[str] | str, message: str) -> None:
    shutil.copytree(flown.folder, "c")
    Path("file").touch()
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    assert message in hexjet(*(arguments.split() if isinstance(arguments, str) else arguments)).refusal
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before


def test_a_flight_that_is_not_finished(tmp_path: Path, hexjet: Hexjet) -> None:
    Store.create(tmp_path / "c", tools.study(1)).close()
    assert "c: flight 0 is not finished; resume goes on" in hexjet("fly", "c", "--flight", "0").err


def test_a_flight_that_could_not_be_flown_is_told_so_again(tmp_path: Path, hexjet: Hexjet) -> None:
    run_campaign(tools.study(None, vary=["vehicle.mass_kg=5.4,50"], controllers=["smith"]), tmp_path / "c", 1)
    done = hexjet("fly", "c", "--flight", "1")
    assert done.status == 1
    assert "flight 1 cannot be flown, as the first time: engine edf-as-flown: hexjet (50 kg) would hover" in done.err


@pytest.mark.parametrize("quiet", [False, True])
def test_a_terminal_shows_how_far_it_is(monkeypatch: pytest.MonkeyPatch, quiet: bool) -> None:
    """Done of all and successes by controller; what was flown in another session counts for no rate."""

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal, tally = Terminal(), Tally()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("TERM", "xterm")
    with TerminalProgress(quiet) as progress:
        tell = report_tally(progress)
        for done in range(90, 101):
            tally.add("smith", done < 100, "completed")
            tell(tally, done, 200)
    shown = terminal.getvalue()
    assert ("100/200" in shown, "smith 91%" in shown, shown == "") == (not quiet, not quiet, quiet)
