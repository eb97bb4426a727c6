"""Co-simulation of the Hex-Jet: JSBSim airframe, FMU engines, predictor-based control.

from cosim import Scenario, fly

run = fly(Scenario.load("roll-doublet").replace(engine="edf"))
run.outcome, run.metrics["roll"].rmse_rad, run.log["roll_rad"]

with Stepper("hover") as flight:  # one control step at a time
    flight.step(Command((0.1, 0.0, 0.0), 10.0))
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from cosim.base.compiled import select_modules
from cosim.base.errors import EngineError, FlightError, InputError
from cosim.base.runtime.kernels import load_with_reference

if TYPE_CHECKING:
    from cosim.api.checks import check_aircraft, check_engine, map_engine
    from cosim.api.compare import compare
    from cosim.api.export import export
    from cosim.api.flights import fly
    from cosim.api.identify import identify
    from cosim.api.show import show
    from cosim.api.studies import sweep
    from cosim.base.signals import Command
    from cosim.base.trust import trust
    from cosim.results.report.time_plot import plot
    from cosim.results.run import Run, open_run
    from cosim.results.summary import versions
    from cosim.spec.scenario import Scenario
    from cosim.spec.vehicle import load_vehicle
    from cosim.stepper import Snapshot, Stepper
    from hexjet_design.api import design
    from hexjet_design.measured.api import margins
    from hexjet_export.controller.export import export_controller
    from hexjet_export.vehicle.export import export_vehicle
    from hexjet_identify.api.bench import identify_bench
    from hexjet_identify.api.logs import identify_log, validate
    from hexjet_identify.api.replay import replay
    from hexjet_prove.api.prove import prove
    from hexjet_prove.api.searches import rare, search
    from hexjet_prove.api.surveys import failsafes, faults

__all__ = [
    "Command",
    "EngineError",
    "FlightError",
    "InputError",
    "Run",
    "Scenario",
    "Snapshot",
    "Stepper",
    "check_aircraft",
    "check_engine",
    "compare",
    "design",
    "export",
    "export_controller",
    "export_vehicle",
    "failsafes",
    "faults",
    "fly",
    "identify",
    "identify_bench",
    "identify_log",
    "load_vehicle",
    "map_engine",
    "margins",
    "open_run",
    "plot",
    "prove",
    "rare",
    "replay",
    "search",
    "show",
    "sweep",
    "trust",
    "validate",
    "versions",
]

_LAZY_MODULES = {  # module of each lazily imported name
    "Command": "cosim.base.signals",
    "Snapshot": "cosim.stepper",
    "Stepper": "cosim.stepper",
    "Scenario": "cosim.spec.scenario",
    "check_aircraft": "cosim.api.checks",
    "check_engine": "cosim.api.checks",
    "compare": "cosim.api.compare",
    "export": "cosim.api.export",
    "fly": "cosim.api.flights",
    "map_engine": "cosim.api.checks",
    "load_vehicle": "cosim.spec.vehicle",
    "Run": "cosim.results.run",
    "open_run": "cosim.results.run",
    "show": "cosim.api.show",
    "sweep": "cosim.api.studies",
    "plot": "cosim.results.report.time_plot",
    "trust": "cosim.base.trust",
    "versions": "cosim.results.summary",
}

_CALLABLE_PACKAGES = ("identify",)  # packages that are functions too


class _CallablePackage(ModuleType):
    """Package that can be called: ``cosim.identify(...)`` calls the function of that name in ``cosim.api``."""

    @property
    def __signature__(self) -> Any:
        from inspect import signature

        return signature(self._load_function())

    def _load_function(self) -> Any:
        from importlib import import_module

        name = self.__name__.rpartition(".")[2]
        return getattr(import_module(f"cosim.api.{name}"), name)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return self._load_function()(*arguments, **named)


class _LazyPackage(ModuleType):
    """Module type of the package: importing a submodule must not replace a function of the same name."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _CALLABLE_PACKAGES and isinstance(value, ModuleType):
            value.__class__ = _CallablePackage
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _LazyPackage

select_modules()  # must precede every other import
load_with_reference()  # must precede the import of numpy


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])


def __getattr__(name: str) -> Any:
    """Load what is asked for and nothing else: half of a short flight's time would go into imports."""
    from importlib import import_module

    if name in _CALLABLE_PACKAGES:
        return import_module(f"{__name__}.{name}")
    if name in _LAZY_MODULES:
        return getattr(import_module(_LAZY_MODULES[name]), name)
    if name in __all__:
        from cosim.base.plugins.entry_points import load_tool_member

        return load_tool_member(name)
    raise AttributeError(f"module 'cosim' has no attribute {name!r}")
