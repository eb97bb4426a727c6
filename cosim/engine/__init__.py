"""Engines: one engine is one FMU behind ``reset / step / close``; the bank steps all of them.

The only package that imports FMPy, and only where it is needed, because that import takes a fifth of a second.
"""

from cosim.engine.bank import EngineBank
from cosim.engine.fmu.air import Air
from cosim.engine.isolated import IsolatedBank, make_bank
from cosim.engine.qualify.check import check_fmu, load_engine, make_limits
from cosim.engine.qualify.report import CheckReport
from cosim.engine.spec import EngineSpec, build_engines, file_label, list_engine_names
