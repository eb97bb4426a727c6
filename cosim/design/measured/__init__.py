"""Margins of any controller, measured in flight.

``excitation`` breaks a loop and flies a multisine through the break, ``estimate`` turns the periods into margins with
bounds, ``computed`` has those of a built-in controller from its design, ``margins`` is the whole, ``page`` writes it.
"""

from cosim.design.measured.axis_margins import AxisMargins
from cosim.design.measured.margins import MeasuredMargins, measure_margins
from cosim.design.measured.page import write

__all__ = ["AxisMargins", "MeasuredMargins", "measure_margins", "write"]
