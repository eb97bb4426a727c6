"""Named quantities at the border of an exported controller or vehicle, and the FMU's variables that carry them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from cosim.engine.library import VariableDefinition


class Quantity(NamedTuple):
    """One input, output or parameter of an FMU; ``start`` is unused for outputs."""

    name: str
    unit: str
    text: str
    start: float = 0.0


def define_variables(
    parameter: VariableDefinition, inputs: Iterable[Quantity], outputs: Iterable[Quantity]
) -> tuple[VariableDefinition, ...]:
    """Return the variables of an FMU: its one parameter, then the inputs with their start values, then the outputs."""
    variables = [parameter]
    for causality, quantities in (("input", inputs), ("output", outputs)):
        for name, unit, text, start in quantities:
            value = start if causality == "input" else None
            reference = len(variables) + 1
            variables.append(VariableDefinition(name, reference, causality, False, unit, None, None, value, text))
    return tuple(variables)
