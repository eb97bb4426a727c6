"""Engines: one engine is one FMU behind ``reset / step / close``; the bank steps all of them.

The only package that imports FMPy, and only where it is needed, because that import takes a fifth of a second.  Its
names come when they are asked for: the process of isolated engines needs a few of its modules alone.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.engine.bank import EngineBank as EngineBank
    from cosim.engine.check import check_fmu as check_fmu
    from cosim.engine.check_report import CheckReport as CheckReport
    from cosim.engine.fmu.air import Air as Air
    from cosim.engine.isolated import IsolatedBank as IsolatedBank
    from cosim.engine.isolated import make_bank as make_bank
    from cosim.engine.load_checked import load_engine as load_engine
    from cosim.engine.source import EngineSource as EngineSource
    from cosim.engine.source import build_engines as build_engines
    from cosim.engine.source import find_source as find_source
    from cosim.engine.source import list_engine_names as list_engine_names
    from cosim.engine.spec import EngineSpec as EngineSpec
    from cosim.engine.spec import file_label as file_label

_MODULES = {  # module of each lazily imported name
    "Air": "fmu.air", "CheckReport": "check_report", "EngineBank": "bank", "EngineSource": "source",
    "EngineSpec": "spec", "IsolatedBank": "isolated", "build_engines": "source", "check_fmu": "check",
    "file_label": "spec", "find_source": "source", "list_engine_names": "source", "load_engine": "load_checked",
    "make_bank": "isolated",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
