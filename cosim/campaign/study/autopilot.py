"""The autopilot of others that flies every flight of a study, as the study's table ``[autopilot]`` states it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from cosim.base.storage.toml import Model


class StudyAutopilot(Model):
    """The autopilot that flies in place of the controller; see ``hexjet sitl`` for the options that each takes.

    The gains of the scenario's controller go into it: those of the vehicle, or of a file of ``hexjet design``.
    """

    name: Literal["betaflight", "px4", "ardupilot"]
    binary: str = ""  # its program, as seen from the study's folder; none: as found without --binary
    gains: Literal["vehicle", "stock"] = "vehicle"  # stock: as it ships
    lines: list[str] = Field(default_factory=list)  # commands for Betaflight's console
    parameters: dict[str, float] = Field(
        default_factory=dict
    )  # parameters of PX4 and ArduPilot, over those from the vehicle
    channels: list[str] = Field(default_factory=list)  # channels of ArduPilot's transmitter, as --channel takes them
    timeout_s: Annotated[float, Field(ge=0.1, le=600.0)] = 30.0  # for an answer, of the clock

    @model_validator(mode="after")
    def _fits(self) -> StudyAutopilot:
        """Refuse options that the autopilot does not take."""
        owned = {"lines": ("betaflight",), "parameters": ("px4", "ardupilot"), "channels": ("ardupilot",)}
        for key, owners in owned.items():
            if getattr(self, key) and self.name not in owners:
                raise ValueError(f"{key}: allowed for {' and '.join(owners)}, and this is {self.name}")
        if self.parameters or self.lines:
            from cosim.autopilots.lockstep import check_words

            check_words(self.parameters, self.lines)
        if self.channels:
            from cosim.autopilots.ardupilot import parse_channel
        for text in self.channels:
            parse_channel(text, "channels")
        return self

    @property
    def before_s(self) -> float:
        """Time from the autopilot's first frame to a flight's first step, s."""
        from cosim.autopilots.prepare import start_timing

        return start_timing(self.name).before_s

    def program(self, folder: Path) -> Path | None:
        """Return the path of its program, as a study in ``folder`` states it; None where it states none."""
        return Path(self.seen_from(folder).binary) if self.binary else None

    def seen_from(self, folder: Path) -> StudyAutopilot:
        """Return a copy with its program by absolute path."""
        return self.model_copy(update={"binary": str((folder / self.binary).absolute())}) if self.binary else self
