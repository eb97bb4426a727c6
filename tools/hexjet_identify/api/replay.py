"""A recorded flight flown again, and the model judged by it: what ``hexjet replay`` calls."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api.call import FolderResult, Limits, Progress, Table, check_types, note_lines
from cosim.api.call.choices import apply_choices
from cosim.base.errors import InputError
from cosim.spec.scenario import Scenario

if TYPE_CHECKING:
    from hexjet_identify.replay import Replay

WRITTEN_FILES = ("replay.json", "replay.csv", "report.html")


class ReplayResult(FolderResult):
    """Result of a replay: verdict on the model, causes of the misfit, and evidence.

    ``write`` leaves ``replay.json``, ``replay.csv`` and ``report.html``.

    Attributes
    ----------
    replayed : Replay
        Everything.
    """

    def __init__(self, replayed: Replay) -> None:
        self.replayed = replayed
        self.files = {}

    @property
    def explained(self) -> bool:
        """Whether the model explains the flight."""
        return self.replayed.verdict == "explained"

    def _write(self, folder: Path) -> dict[str, Path]:
        from hexjet_identify.replay.page import write

        return write(self.replayed, folder)

    def to_dict(self) -> dict[str, Any]:
        return self.replayed.to_dict()

    def lines(self) -> list[str]:
        """Return the verdict, what is wrong with the model where the log tells, and the evidence."""
        found = self.replayed
        first = f"{found.verdict}: {found.aircraft} with {found.engine} beside {found.log}"
        notes = note_lines(found.notes)
        return [first, *([found.fault] if found.fault else []), *found.evidence, *notes]

    def tables(self) -> list[Table]:
        """Return the channels, with how long each is within the envelope, and what each number would explain."""
        from hexjet_identify.replay.page import CAUSE_COLUMNS, cause_rows, channel_rows

        titles = ("channel", "within", "error rms", "movement", "Theil's U", "bias / var / cov %", "told")
        channels = Table("", titles, channel_rows(self.replayed))
        return [channels, Table("what each number would explain", CAUSE_COLUMNS, cause_rows(self.replayed))]

    def _figures(self) -> Mapping[str, Any]:
        from hexjet_identify.replay.page import figures

        return figures(self.replayed)


@check_types(
    window_s=Limits(0.1, 10.0),
    draws=Limits(1, 1000),
    inertia_tolerance=Limits(0.0, 0.5),
    mass_tolerance=Limits(0.0, 0.5),
    thrust_tolerance=Limits(0.0, 0.5),
    seed=Limits(0),
)
def replay(
    log: str | Path,
    scenario: Scenario | str | Path | None = None,
    *,
    aircraft: str | Path | None = None,
    engine: str | Path | Sequence[str] | None = None,
    settings: Sequence[str] | Mapping[str, object] = (),
    throttle: Mapping[int, str] | None = None,
    throttle_range: tuple[float, float] | None = None,
    time_column: str | None = None,
    time_unit: str | None = None,
    begin: float | None = None,
    end: float | None = None,
    window_s: float | None = None,
    draws: int = 20,
    inertia_tolerance: float = 0.05,
    mass_tolerance: float = 0.02,
    thrust_tolerance: float = 0.03,
    seed: int = 1,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> ReplayResult:
    """Fly a recorded flight again, in six degrees of freedom, and judge the model by it.

    The recorded commands drive the vehicle in short windows, each started from the recorded state; the vehicle is drawn
    within its tolerances.

    Parameters
    ----------
    log : str or Path
        ULog, DataFlash, blackbox, Crazyflie, a table, or the folder of a run.
    scenario : Scenario or str or Path or None
        With aircraft, air and mass where they are not given; None: of a run's folder its own, else hover.
    aircraft : str or Path or None
        What flies again, with the engine that it is made for.
    engine : str or Path or sequence of str or None
        In place of that; ``N=NAME`` is the one at station N alone.
    settings : sequence of str or mapping
        Written over the scenario's.
    throttle : mapping or None
        The channel of the log, or a sum of some, that is the command of an engine, by its number from 1; None: the
        one called so.
    throttle_range : tuple of float or None
        What throttle 0 and 1 are in the log.
    time_column : str or None
        A table's column of time; None: the one called so.
    time_unit : str or None
        Unit of that column: s, ms, us, ns, min, h or d.
    begin : float or None
        The log is used from here on, in its own time [s].
    end : float or None
        And to here [s].
    window_s : float or None
        The vehicle starts anew after so long [s]; None: by its size.
    draws : int
        Vehicles that are drawn within their tolerances.
    inertia_tolerance : float
        Standard deviation of each moment of inertia, as a share of it.
    mass_tolerance : float
        Standard deviation of the mass, as a share of it.
    thrust_tolerance : float
        Standard deviation of the thrust, as a share of it, of an engine that states no uncertainty.
    seed : int
        Seed of the draws.
    out : str or Path or None
        A folder for page and data; without it nothing is written.
    progress : Progress or None
        Hears notes and how far it is.

    Returns
    -------
    ReplayResult
        Whether the model explains the flight, and what is wrong with it.

    Raises
    ------
    InputError
        For a log that cannot be read, or one that does not say what was commanded.
    """
    from cosim.base.storage.files import check_results_folder
    from cosim.results.run import SCENARIO
    from hexjet_identify.logs import read_flight_log
    from hexjet_identify.replay import Choices, ThrottleChannels, hash_log, is_simulated, record_flight
    from hexjet_identify.replay import replay as fly_again

    hears, path = progress or Progress(), Path(log)
    check_results_folder(out, *WRITTEN_FILES)
    if throttle_range is not None and not throttle_range[0] < throttle_range[1]:
        low, high = throttle_range
        raise InputError(f"throttle_range {low:g} {high:g}: the second must be the larger")
    read = read_flight_log(path, time_column, time_unit)
    if scenario is None:
        scenario = path / SCENARIO if path.is_dir() else "hover"
    channels = ThrottleChannels(dict(throttle or {}), throttle_range)
    # No controller flies, and none of the scenario's is loaded.
    chosen = apply_choices(scenario, "baseline", aircraft, engine, settings, note=hears.note)
    vehicle, _ = chosen.resolved_vehicle()
    flight = record_flight(read, vehicle, chosen.step_s, channels, (begin, end))
    choices = Choices(window_s, draws, inertia_tolerance, mass_tolerance, thrust_tolerance, seed)
    replayed = fly_again(path.name, chosen, flight, choices, hears.update)
    result = ReplayResult(dataclasses.replace(replayed, log_sha256=hash_log(read), simulated=is_simulated(read)))
    return result if out is None else result.write(out)
