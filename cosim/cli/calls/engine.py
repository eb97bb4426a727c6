"""What ``hexjet engine check`` does beside ``cosim.check_engine``: it looks at the FMU of a controller too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.api.call import Result, Table
from cosim.api.checks import check_engine
from cosim.engine.make.controller_fmu import describe_controller, is_controller, read_controller_fmu
from cosim.flight import fly_watched
from cosim.spec.scenario import Scenario


def check(engine: str, **choices: Any) -> Result:
    """Tell whether an FMU is fit to be an engine, and how it answers its throttle; of a controller, what it is.

    It runs in a process of its own: if it crashes, hangs or eats memory, that is told, and nothing else happens.
    Leaves check.json and a page with its static curve and step responses.
    """
    path = Path(engine)
    return ControllerCheckResult(path) if is_controller(path) else check_engine(engine, **choices)


class ControllerCheckResult(Result):
    """Inputs and outputs of a controller's FMU, and whether a hover of 1 s repeats exactly."""

    def __init__(self, path: Path) -> None:
        fmu = read_controller_fmu(path)
        description = describe_controller(fmu)
        hover = Scenario.load("hover").replace(duration_s=1.0, expect=[], controller=str(path.absolute()))
        self.files = {}
        self.run = fly_watched(hover)
        record = self.run.summary.own_controller
        self.found = {
            "controller": path.name,
            "fmi": fmu.fmi,
            "level": fmu.level,
            "inputs": list(fmu.inputs),
            "outputs": list(fmu.outputs),
            "parameters": [name for name, *_ in description["parameters"]],
            "columns": [name for name, *_ in description["columns"]],
            "notes": list(fmu.notes),
            "hover of 1 s": f"{self.run.outcome}, {self.run.reason}",
            "repeatable": record.repeatable if record is not None else None,
        }

    @property
    def is_fit(self) -> bool:
        """Whether the hover was completed and repeats exactly."""
        return self.run.outcome == "completed" and bool(self.found["repeatable"])

    def to_dict(self) -> dict[str, Any]:
        return dict(self.found)

    def lines(self) -> list[str]:
        return [f"{self.found['controller']}: {'fit to fly' if self.is_fit else 'not fit to fly'}"]

    def tables(self) -> list[Table]:
        texts = {key: ", ".join(each) if isinstance(each, list) else str(each) for key, each in self.found.items()}
        return [Table("", ("finding", "what it is"), list(texts.items()))]
