"""The autopilot of others that flies every flight of a study, as the study's table ``[autopilot]`` states it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, model_validator

from cosim.files import Model
from hexjet_sitl.ardupilot import parse_channel
from hexjet_sitl.lockstep import Setup, check_words
from hexjet_sitl.prepare import AUTOPILOTS, check_faults, prepare, require_program, reserve_instance
from hexjet_sitl.run import fly_autopilot

if TYPE_CHECKING:
    from cosim import Run, Scenario


class AutopilotTable(Model):
    """A study's table [autopilot]: the autopilot that flies in place of the controller; see ``hexjet sitl``.

    The gains of the scenario's controller go into it: those of the vehicle, or of a file of ``hexjet design``.
    The methods are those of ``StudyAutopilot`` in ``cosim/campaign/study/autopilot.py``.
    """

    name: Literal["betaflight", "px4", "ardupilot"]
    binary: str = ""  # path relative to the study
    gains: Literal["vehicle", "stock"] = "vehicle"  # stock: gains as shipped
    lines: list[str] = Field(default_factory=list)  # lines for Betaflight's console
    # Parameters of PX4 and ArduPilot that override those of the vehicle.
    parameters: dict[str, float] = Field(default_factory=dict)
    channels: list[str] = Field(default_factory=list)  # ArduPilot: NUMBER=PULSE[@SECONDS]
    timeout_s: Annotated[float, Field(ge=0.1, le=600.0)] = 30.0  # s of wall time for one answer

    @model_validator(mode="after")
    def _refuse_foreign_options(self) -> AutopilotTable:
        owned = {"lines": ("betaflight",), "parameters": ("px4", "ardupilot"), "channels": ("ardupilot",)}
        for key, owners in owned.items():
            if getattr(self, key) and self.name not in owners:
                raise ValueError(f"{key}: allowed for {' and '.join(owners)}, and this is {self.name}")
        check_words(self.parameters, self.lines)
        for text in self.channels:
            parse_channel(text, "channels")
        return self

    @property
    def before_s(self) -> float:
        """Time [s] from the autopilot's first frame to the first step of a flight."""
        return AUTOPILOTS[self.name].timing.before_s

    def program(self, folder: Path) -> Path | None:
        """Return the path of the autopilot's program, seen from the study's folder; None if not stated."""
        return Path(self.seen_from(folder).binary) if self.binary else None

    def seen_from(self, folder: Path) -> AutopilotTable:
        """Return a copy whose program has an absolute path; a relative one is resolved against ``folder``."""
        return self.model_copy(update={"binary": str((folder / self.binary).absolute())}) if self.binary else self

    def check(self, scenario: Scenario, folder: Path) -> None:
        """Raise InputError for a program that is not here, and for a fault that would not reach the autopilot."""
        check_faults(self.name, scenario)
        require_program(self.name, self.program(folder))

    @property
    def columns(self) -> dict[str, type[int]]:
        """Columns that a flight's row gets: frames sent, and answers that never came."""
        return {"autopilot_frames": int, "autopilot_missing": int}

    def fly(self, scenario: Scenario, study_folder: Path, folder: Path, page: bool) -> tuple[Run, dict[str, Any]]:
        """Fly a scenario into ``folder``; return its run, and the values of its :attr:`columns`."""
        with reserve_instance() as instance:
            stated = self.model_dump(include={"gains", "lines", "parameters", "channels"})
            setup = Setup(instance, self.timeout_s, **stated)
            program = require_program(self.name, self.program(study_folder))
            flown = fly_autopilot(scenario, prepare(self.name, scenario, folder, program, setup), folder, page=page)
        counts = flown.counts
        return flown.run, {"autopilot_frames": counts.frames, "autopilot_missing": counts.missing}
