"""Input clocks of FMI 3.0, and whether an FMU is stepped with event mode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple
from xml.etree import ElementTree

from cosim.engine.fmu.variables import Port

MOST_CLOCKS = 16  # of the C loop


class InputClock(NamedTuple):
    """Input clock of FMI 3.0, ticked by the simulation at ``shift`` and every ``interval`` [s] from there on."""

    name: str
    reference: int
    interval: float
    shift: float

    def count_substeps(self, step: float, substeps: int) -> tuple[int, int] | None:
        """Return interval and shift as counts of ``step / parts``, or None where they are not whole numbers."""
        counts = [value * substeps / step for value in (self.interval, self.shift)]
        whole = [round(count) for count in counts]
        fits = all(abs(count - n) <= 1e-6 for count, n in zip(counts, whole, strict=True)) and whole[0] >= 1
        return (whole[0], whole[1]) if fits else None


def find_clocks(
    root: ElementTree.Element, reason_against: str | None, ports: Mapping[str, Port]
) -> tuple[bool, tuple[InputClock, ...], list[str]]:
    """Return whether event mode can be used, the input clocks ticked in it, and notes on the other clocks.

    An input may be set in step mode where it is continuous, and at its clock's ticks where it has one; one that is
    discrete without a clock may be set in event mode alone, so with such a port event mode is left off.
    ``reason_against``: why there is no event mode anyway, or None.
    """
    ticked, notes = [], []
    for element in root.iterfind("ModelVariables/Clock[@causality='input']"):
        name, kind = element.get("name", ""), element.get("intervalVariability")
        interval, shift = _seconds(element, "interval", None), _seconds(element, "shift", 0.0)
        if (
            kind in ("constant", "fixed", "tunable")
            and interval
            and interval > 0.0
            and shift is not None
            and shift >= 0.0
        ):
            ticked.append(InputClock(name, int(element.get("valueReference", "0")), interval, shift))
        else:
            notes.append(
                f"its clock {name} never ticks: it is {kind or 'of no kind'}, and only one that states its interval "
                "beforehand is ticked"
            )
    inputs = [port.variable for name, port in ports.items() if port.variable.causality == "input"]
    port_clocks = {v.clocks for v in inputs if v.clocks}
    ticked_references = {clock.reference for clock in ticked}
    settable = all(v.variability == "continuous" or set(v.clocks) & ticked_references for v in inputs)
    switch = any(port.variable.clocks for name, port in ports.items() if name.startswith("run"))
    events = reason_against is None and settable and len(port_clocks) <= 1 and not switch and len(ticked) <= MOST_CLOCKS
    if ticked and not events:
        why = (
            reason_against if reason_against is not None
            else "a port is discrete, without a clock that ticks" if not settable
            else "its ports have several clocks" if len(port_clocks) > 1
            else "its run switch has a clock" if switch
            else f"it has more than {MOST_CLOCKS}"
        )  # fmt: skip
        notes += [f"its clock {clock.name} never ticks: {why}" for clock in ticked]
    elif ticked:
        notes += [f"its clock {clock.name} ticks every {clock.interval:g} s" for clock in ticked]
    first = port_clocks.pop() if port_clocks else ()
    return events, tuple(sorted(ticked, key=lambda clock: clock.reference not in first)), notes


def _seconds(element: ElementTree.Element, what: str, default: float | None) -> float | None:
    """Return a clock's interval or shift [s], stated as a decimal or as counts of a resolution."""
    decimal, count, resolution = (element.get(key) for key in (f"{what}Decimal", f"{what}Counter", "resolution"))
    try:
        if decimal is not None:
            return float(decimal)
        return int(count) / int(resolution) if count and resolution else default
    except (ValueError, ZeroDivisionError):
        return None
