"""What ``hexjet fly`` does beside ``cosim.fly``: it names the run's folder, and repeats a flight of a campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.api.call import Progress
from cosim.api.flights import FlightResult, load
from cosim.api.flights import fly as fly_scenario
from cosim.base.errors import InputError

_LOAD_ARGUMENTS = (  # passed on to load()
    "controller", "aircraft", "engine", "settings", "model", "seed", "metrics", "observers", "sensors", "wind",
    "unchecked_engine",
)  # fmt: skip


class RepeatedResult(FlightResult):
    """Result of a campaign's flight that was flown again."""

    def __init__(self, repeated: Any) -> None:
        super().__init__(repeated.run)
        self.repeated = repeated

    def to_dict(self) -> dict[str, Any]:
        """Return the summary, and whether the flight repeated exactly."""
        again = self.repeated
        return super().to_dict() | {"flight": again.number, "same": again.same, "otherwise": again.otherwise}

    def lines(self) -> list[str]:
        first, *others = super().lines()
        return [first, f"flight {self.repeated.number}: {self.repeated.verdict}", *self.repeated.otherwise, *others]


def fly(
    scenario: str,
    *,
    realtime: bool = False,
    flight: int | None = None,
    out: str | None = None,
    realtime_factor: float | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> FlightResult:
    """Fly a scenario to its end; leave a folder with summary, resolved scenario, log and report.

    Parameters
    ----------
    scenario : str
        The name of a scenario, the path of its file, or with ``flight`` the folder of a campaign.
    realtime : bool
        Pace the flight in real time.
    flight : int or None
        Fly this flight of the campaign in the folder again, as it was.
    out : str or None
        The run's folder; by default a new one in runs/.
    """
    from cosim.flight import new_folder
    from cosim.results.run import recover_killed_run
    from cosim.spec.controller_name import folder_name, short_name

    if flight is not None:
        from cosim.campaign import fly_again, open_campaign

        stated = choices | {"realtime": realtime or None, "realtime_factor": realtime_factor}
        for name in (name for name, value in stated.items() if value is not None):
            raise InputError(f"{name}: a flight of a campaign is flown as it was; leave it out with flight")
        campaign = open_campaign(Path(scenario))
        folder = Path(out) if out else new_folder(Path("runs"), f"{campaign.study.name}-flight-{flight}")
        return RepeatedResult(fly_again(campaign, flight, folder))
    if realtime and realtime_factor is not None:
        raise InputError("realtime and realtime_factor (--rtf): give one of them")
    recover_killed_run(Path(scenario))
    chosen = {name: choices.pop(name) for name in _LOAD_ARGUMENTS if name in choices}
    loaded = load(scenario, progress=progress, **chosen)
    label = short_name(chosen["controller"]) if "controller" in chosen else loaded.controller
    run = fly_scenario(
        loaded,
        out or new_folder(Path("runs"), f"{loaded.name}-{folder_name(label)}"),
        realtime_factor=1.0 if realtime else realtime_factor,
        progress=progress,
        **choices,
    )
    return FlightResult(run)
