"""Co-simulation of the Hex-Jet: JSBSim airframe, FMU engines, predictor-based control.

from cosim import Scenario, fly

run = fly(Scenario.load("roll-doublet").replace(engine="edf"))
run.outcome, run.metrics["roll"].rmse_rad, run.log["roll_rad"]

with Stepper("hover") as flight:  # one control step at a time
    flight.step(Command((0.1, 0.0, 0.0), 10.0))
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cosim.base.compiled import select_modules
from cosim.base.errors import EngineError, FlightError, InputError
from cosim.base.runtime.kernels import load_with_reference

if TYPE_CHECKING:
    from cosim.base.signals import Command
    from cosim.base.trust import trust
    from cosim.flight import fly
    from cosim.results.report.time_plot import plot
    from cosim.results.run import Run, open_run
    from cosim.results.summary import versions
    from cosim.spec.scenario import Scenario
    from cosim.spec.vehicle import load_vehicle
    from cosim.stepper import Snapshot, Stepper

__all__ = [
    "Command",
    "EngineError",
    "FlightError",
    "InputError",
    "Run",
    "Scenario",
    "Snapshot",
    "Stepper",
    "fly",
    "load_vehicle",
    "open_run",
    "plot",
    "trust",
    "versions",
]

_WHERE = {
    "Command": "cosim.base.signals",
    "Snapshot": "cosim.stepper",
    "Stepper": "cosim.stepper",
    "Scenario": "cosim.spec.scenario",
    "fly": "cosim.flight",
    "load_vehicle": "cosim.spec.vehicle",
    "Run": "cosim.results.run",
    "open_run": "cosim.results.run",
    "plot": "cosim.results.report.time_plot",
    "trust": "cosim.base.trust",
    "versions": "cosim.results.summary",
}

select_modules()  # before any module that may be compiled is imported
load_with_reference()  # before numpy is


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])


def __getattr__(name: str) -> Any:
    """Load what is asked for and nothing else: half of a short flight's time would go into imports."""
    if name in _WHERE:
        from importlib import import_module

        return getattr(import_module(_WHERE[name]), name)
    raise AttributeError(f"module 'cosim' has no attribute {name!r}")
