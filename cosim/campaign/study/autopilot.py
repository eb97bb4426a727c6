"""The table ``[autopilot]`` of a study: what a campaign asks of a tool that flies in the place of the controller."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from cosim.base.plugins.entry_points import load_hook
from cosim.base.storage.toml import validate

if TYPE_CHECKING:
    from cosim.results.run import Run
    from cosim.spec.scenario import Scenario


class StudyAutopilot(Protocol):
    """The autopilot that flies every flight of a study in the place of the controller.

    It is a model of pydantic, the entry point ``study.autopilot`` of the group ``hexjet.hooks``, or
    ``study.autopilot.NAME`` for one name alone.
    """

    name: str

    @property
    def columns(self) -> Mapping[str, type[float | int | str | bool | None]]:
        """Columns that the autopilot adds to a row, with their types."""

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Return the table, as pydantic does."""

    @property
    def before_s(self) -> float:
        """Time from the autopilot's first frame to a flight's first step, s."""

    def program(self, folder: Path) -> Path | None:
        """Return the path of the autopilot's program, relative to the study's folder; None if none is stated."""

    def seen_from(self, folder: Path) -> StudyAutopilot:
        """Return a copy that names the program by absolute path."""

    def check(self, scenario: Scenario, folder: Path) -> None:
        """Raise InputError for a missing program or a scenario that the autopilot cannot fly."""

    def fly(
        self, scenario: Scenario, study_folder: Path, folder: Path, page: bool
    ) -> tuple[Run, dict[str, float | int | str | bool | None]]:
        """Fly a scenario into ``folder``; return its run and the autopilot's values for the row.

        Raises InputError and FlightError.
        """


def read_autopilot(table: Any) -> StudyAutopilot:
    """Return the autopilot that a study's table states.  Raises InputError for a wrong key, and without the tool."""
    if not isinstance(table, Mapping):
        raise ValueError("must be a table")
    model = load_hook(f"study.autopilot.{table.get('name')}") or load_hook("study.autopilot")
    if model is None:
        raise ValueError("needs hexjet_sitl, which is not installed; the sources of hexjet-cosim have it")
    autopilot: StudyAutopilot = validate(model, table, "")
    return autopilot
