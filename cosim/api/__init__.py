"""Every command of ``hexjet`` as a function, and what each gives back.

from cosim import sweep

swept = sweep("roll-doublet", vary=["vehicle.mass_kg=5:6.5"], controllers=["smith", "baseline"], runs=100)
swept.columns["success"], swept.folder

A result shows itself in a notebook, knows its files, and ``to_dict()`` is what the command prints as JSON.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.api.call import Progress, Result, Table
    from cosim.api.checks import AircraftCheckResult, EngineCheckResult, MappingResult
    from cosim.api.compare import CompareResult
    from cosim.api.identify import IdentifyResult
    from cosim.api.show import ShowResult
    from cosim.api.studies import SweepResult
    from hexjet_design.api import DesignResult
    from hexjet_design.measured.api import MarginsResult
    from hexjet_export.controller.export import ControllerExport
    from hexjet_export.vehicle.export import VehicleExport
    from hexjet_identify.api.replay import ReplayResult
    from hexjet_identify.bench.result import BenchIdentifyResult
    from hexjet_identify.prediction_error.result import LogIdentifyResult
    from hexjet_identify.prediction_error.validate import ValidateResult
    from hexjet_prove.api.prove import ProofResult
    from hexjet_prove.api.searches import RareResult, SearchResult
    from hexjet_prove.api.surveys import FailsafesResult, FaultsResult

_LAZY_MODULES = {  # module of each lazily imported name
    "AircraftCheckResult": "checks",
    "CompareResult": "compare",
    "EngineCheckResult": "checks",
    "IdentifyResult": "identify",
    "MappingResult": "checks",
    "Progress": "call",
    "Result": "call",
    "ShowResult": "show",
    "SweepResult": "studies",
    "Table": "call",
}

__all__ = [
    "AircraftCheckResult",
    "BenchIdentifyResult",
    "CompareResult",
    "ControllerExport",
    "DesignResult",
    "EngineCheckResult",
    "FailsafesResult",
    "FaultsResult",
    "IdentifyResult",
    "LogIdentifyResult",
    "MappingResult",
    "MarginsResult",
    "Progress",
    "ProofResult",
    "RareResult",
    "ReplayResult",
    "Result",
    "SearchResult",
    "ShowResult",
    "SweepResult",
    "Table",
    "ValidateResult",
    "VehicleExport",
]


def __getattr__(name: str) -> Any:
    """Load what is asked for and nothing else."""
    if name in _LAZY_MODULES:
        from importlib import import_module

        return getattr(import_module(f"{__name__}.{_LAZY_MODULES[name]}"), name)
    if name in __all__:
        from cosim.base.plugins.entry_points import load_tool_member

        return load_tool_member(name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
