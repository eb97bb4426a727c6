"""The paper beside ours: rows and claims, from one or two fidelities.

:func:`linear_part` is everything that the linear plant has to say; the six-degree-of-freedom runs join as a second
:class:`hexjet_paper.claims.Evidence`.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import log, radians
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from hexjet_paper import extensions, numbers
from hexjet_paper.claims import ClaimRow, Evidence
from hexjet_paper.conditions import Condition, conditions
from hexjet_paper.experiments import COMPARED, Metrics, Result, experiments, hexjet_ratios, quadrotor_axis
from hexjet_paper.experiments import linear as on_linear_plant
from hexjet_paper.frozen import Frozen, load
from hexjet_paper.linear import STATE_AS_PRINTED
from hexjet_paper.loops import LOW_END_HZ, Sweep, gain_at, margins, open_loop, sweep
from hexjet_paper.numbers import Basis, Record

Origin = Basis | Literal["given", "derived"]
TITLES = {  # controllers' names in tables
    "baseline": "baseline",
    "smith": "Smith predictor",
    "state": "state predictor, G_n(z) realised",
    STATE_AS_PRINTED: "state predictor, matrices as printed",
}


class Row(Record):
    """One printed number of the paper, and ours in each fidelity.

    ``origin``: what ours rests on (:data:`hexjet_paper.numbers.Basis`); or the number is an input of the experiments
    (given), or derived from other printed numbers alone.  A deviation is ours relative to the paper's, in percent.
    """

    key: str
    quantity: str
    unit: str
    place: str
    paper: float
    linear: float | None
    flight: float | None
    origin: Origin
    note: str = ""

    @property
    def linear_deviation(self) -> float | None:
        return _deviation_percent(self.linear, self.paper)

    @property
    def flight_deviation(self) -> float | None:
        return _deviation_percent(self.flight, self.paper)


def _parse_loop(key: object) -> object:
    """Return vehicle and controller from a JSON key."""
    return tuple(key.split(",")) if isinstance(key, str) else key


Loop = Annotated[tuple[str, str], BeforeValidator(_parse_loop)]  # (vehicle, controller)


@dataclass(frozen=True)
class LinearPart:
    """All results that are computed on the linear plant."""

    frozen: Frozen
    results: dict[str, Result]
    evidence: Evidence
    sweeps: dict[str, Sweep]  # responses measured in the loop
    conditions: list[Condition]
    maps: list[extensions.RobustnessMap]
    delays: dict[Loop, list[extensions.DelayPoint]]
    offsets: list[extensions.Offset]
    smith_offset: float  # rad, in closed form
    noise: dict[Loop, float | None]
    turbojet: list[extensions.Reach]


def linear_part(say: Callable[[str], None] = lambda stage: None) -> LinearPart:
    """Compute all results on the linear plant from the frozen calibration; ``say`` gets each part's name."""
    frozen = load()
    calibration = frozen.parameters
    say("experiments on the linear plant")
    run = on_linear_plant(calibration)
    results = {e.name: run(e) for e in experiments()}
    say("frequency response")
    loops = {name: quadrotor_axis(calibration, name, 5) for name in COMPARED}
    sweeps = {name: sweep(loop) for name, loop in loops.items()}
    evidence = Evidence(
        metrics={name: result.metrics for name, result in results.items()},
        margins={name: margins(open_loop(loop), loop.step) for name, loop in loops.items()},
        gain_at_low_end={name: gain_at(loop, LOW_END_HZ) for name, loop in loops.items()},
        gain_at_8_hz={name: gain_at(loop, 8.0) for name, loop in loops.items()},
    )
    say("what would make it true")
    values = conditions(calibration)
    say("robustness maps")
    maps = extensions.robustness_maps(calibration)
    say("delay sweep")
    delays = extensions.delay_sweep(calibration)
    say("constant disturbance and noise")
    offsets = extensions.constant_disturbance(calibration)
    noise = extensions.noise_gains(calibration)
    say("true turbojet")
    return LinearPart(
        frozen=frozen,
        results=results,
        evidence=evidence,
        sweeps=sweeps,
        conditions=values,
        maps=maps,
        delays=delays,
        offsets=offsets,
        smith_offset=extensions.smith_offset(calibration),
        noise=noise,
        turbojet=extensions.turbojet(calibration),
    )


_METRICS_BY_KEY_END: dict[str, Callable[[Metrics], float | None]] = {
    "rmse": lambda m: m.rmse if m.stable else None,
    "max": lambda m: m.max if m.stable else None,
}
_DERIVED_NUMBERS: dict[str, Callable[[], float]] = {  # by key, from other printed numbers
    "turbojet.time_constant": lambda: -numbers.value("hexjet.step") / log(numbers.value("turbojet.pole")),
    "edf.time_constant": lambda: -numbers.value("hexjet.step") / log(numbers.value("edf.pole")),
    "turbojet.delay": lambda: numbers.value("hexjet.delay") * numbers.value("hexjet.step"),
    "hexjet.thrust": lambda: 6.0 * numbers.value("edf.gain") / (1.0 - numbers.value("edf.pole")),
    "quadrotor.payload_percent": lambda: 100.0 * numbers.value("quadrotor.payload") / numbers.value("quadrotor.mass"),
}
# Keys that begin so are inputs of the experiments, unless ours is computed.
_INPUT_PREFIXES = ("hexjet.", "quadrotor.", "turbojet.", "edf.", "roll.", "step.", "disturbance.amplitude")
_STICKS_NOTE = "the pilot's sticks are not printed; ours are calm, and there is no wind"
_RMSE_NOTE = '; printed as "RMSE and MAE for pitch and yaw", and taken for one RMSE of each'
# Keys that begin so follow from our choices: gains, lengths and sticks; in flight also lags and inertia of roll.
_CHOSEN, _CHOSEN_IN_FLIGHT = ("hexjet-doublet.", "hexjet-manual."), ("roll.", "hexjet.delay")
_NOTES = {  # notes on numbers, by key
    "frequency.dc_gain": "ours at 1 Hz: with an integral the gain has no end towards 0 Hz",
    "hexjet-doublet.smith.rmse": "gains, and length of doublet and record, not printed: chosen; see the conditions",
    "hexjet-doublet.smith.max": f"{radians(2.0 * numbers.value('hexjet.amplitude')):.4f} rad is the height of the "
    "middle step: the largest error of any loop that has settled before it",
    **{f"hexjet-manual.{a}.{what}": _STICKS_NOTE for a in ("roll", "pitch", "yaw") for what in ("rmse", "rate_rmse")},
    **{f"hexjet-manual.{axis}.rmse": _STICKS_NOTE + _RMSE_NOTE for axis in ("pitch", "yaw")},
    "step.time_constant": "63.2 % of the first step, mean of baseline and Smith",
    "hexjet.thrust": "six times the EDF's gain at rest",
    "hexjet.delay": "identified on the roll axis beside the paper's lag",
    "roll.pole_fast": "identified on the roll axis behind 25 samples of delay",
    "roll.pole_slow": "identified on the roll axis behind 25 samples of delay",
    **{
        f"step-{delay}.{controller}.rmse": "half of ours is near it: see the claim about the doublet's amplitude"
        for delay, controller in ((5, "baseline"), (5, "smith"), (10, "smith"), (25, "smith"))
    },
}


def comparison_rows(
    frozen: Frozen, linear: Evidence, flight: Evidence | None = None, extra: Mapping[str, float] | None = None
) -> list[Row]:
    """Return the comparison of each printed number with ours; ``extra`` has flights' values without evidence."""
    used = {used_row.key for used_row in frozen.used}
    rows = []
    for printed in numbers.PRINTED.values():
        for variant in _variants(printed.key):
            rows.append(_make_row(printed, variant, linear, flight, extra or {}, used))
    return rows


def _variants(key: str) -> list[str]:
    """Return the keys whose values are compared with a printed number: two for the paper's state predictor."""
    return [key, key.replace(".state.", f".{STATE_AS_PRINTED}.")] if ".state." in key else [key]


def _make_row(
    printed: numbers.Printed,
    key: str,
    evidence: Evidence,
    flight: Evidence | None,
    extra: Mapping[str, float],
    used: set[str],
) -> Row:
    value = _find_value(key, evidence)
    in_flight = extra.get(key, _find_value(key, flight) if flight else None)
    origin: Origin = "predicted"
    # The printed numbers of the state predictor were fitted with the matrices as printed.
    if printed.key in used and (".state." not in printed.key or key != printed.key):
        origin = "calibrated"
    elif printed.key in _DERIVED_NUMBERS:
        origin, value = "derived", _DERIVED_NUMBERS[printed.key]()
    elif printed.key.startswith(_CHOSEN) or (printed.key.startswith(_CHOSEN_IN_FLIGHT) and in_flight is not None):
        origin = "follows from a choice"
    elif value is None and printed.key.startswith(_INPUT_PREFIXES):
        origin = "given"
    note = _NOTES.get(printed.key, "")
    if ".state." in printed.key:
        note = TITLES["state" if key == printed.key else STATE_AS_PRINTED]
    note += _describe_payload_growth(printed.key, key, evidence, flight)
    return Row(
        key=key,
        quantity=printed.meaning,
        unit=printed.unit,
        place=printed.place,
        paper=printed.value,
        linear=value,
        flight=in_flight,
        origin=origin,
        note=note,
    )


def _describe_payload_growth(printed: str, key: str, evidence: Evidence, flight: Evidence | None) -> str:
    """Return a note on how a printed number with payload grows over that without it; else an empty text."""
    if not printed.startswith("disturbance-5-payload."):
        return ""

    def format_growth(value: Callable[[str], float | None], name: str) -> str:
        with_it, without = value(name), value(name.replace("-payload", ""))
        return f"{100.0 * (with_it / without - 1.0):+.1f} %" if with_it and without else "not flown"

    growths = [f"growth with payload {format_growth(numbers.value, printed)} in the paper"]
    growths += [f"{format_growth(lambda name: _find_value(name, evidence), key)} on the linear plant"]
    if flight:
        growths += [f"{format_growth(lambda name: _find_value(name, flight), key)} in flight"]
    return ("; " if ".state." in printed else "") + ", ".join(growths)


def _find_value(key: str, evidence: Evidence) -> float | None:
    """Return our value for a printed key in one fidelity; None if it was not computed."""
    metrics = evidence.metrics
    head, _, last = key.rpartition(".")
    if key.startswith("frequency."):
        if key == "frequency.dc_gain":
            return evidence.gain_at_low_end.get("baseline")
        row = evidence.margins.get(head.removeprefix("frequency."))
        return getattr(row, last) if row else None
    if head in metrics and last in _METRICS_BY_KEY_END:
        return _METRICS_BY_KEY_END[last](metrics[head])
    if key == "step.time_constant":
        times = [metrics[f"step-5.{c}"].time_constant_s for c in ("baseline", "smith") if f"step-5.{c}" in metrics]
        finite = [t for t in times if t is not None]
        return sum(finite) / 2.0 if len(finite) == 2 else None
    if key == "step-25.smith.increase" and {"step-25.smith", "step-5.smith"} <= metrics.keys():
        return 100.0 * (metrics["step-25.smith"].rmse / metrics["step-5.smith"].rmse - 1.0)
    if key in ("hexjet.less_overshoot", "hexjet.faster_settling"):
        names = [f"hexjet-doublet-calibrated.{c}" for c in ("baseline", "smith")]
        if all(name in metrics for name in names):
            a, b = (metrics[name] for name in names)
            return hexjet_ratios(a.overshoot_percent, b.overshoot_percent, a.settling_s, b.settling_s)[key]
    return None


def _deviation_percent(value: float | None, paper: float) -> float | None:
    return None if value is None else 100.0 * (value / paper - 1.0)


def write_csv(rows: list[Row], path: Path) -> None:
    """Write the comparison as CSV: one line per quantity, numbers with six significant digits."""
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(
            ["key", "quantity", "unit", "place", "paper", "linear", "linear_deviation_percent", "flight",
             "flight_deviation_percent", "origin", "note"]
        )  # fmt: skip
        for row in rows:
            values = (row.paper, row.linear, row.linear_deviation, row.flight, row.flight_deviation)
            out.writerow([row.key, row.quantity, row.unit, row.place, *map(_format_csv, values), row.origin, row.note])


def _format_csv(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


def as_data(part: LinearPart, rows: list[Row], judged: list[ClaimRow]) -> dict[str, Any]:
    """Return results, comparison and claims of the linear plant as plain data, for a JSON file or a template."""
    dumped = [
        row.model_dump() | {"linear_deviation": row.linear_deviation, "flight_deviation": row.flight_deviation}
        for row in rows
    ]
    return {
        "calibration": part.frozen.model_dump(),
        "comparison": dumped,
        "claims": [row.model_dump() for row in judged],
        "conditions": [condition.model_dump() for condition in part.conditions],
        "measured_margins": {name: s.margins.model_dump() for name, s in part.sweeps.items()},
        "robustness": [robustness_map.model_dump() for robustness_map in part.maps],
        "delay_sweep": {f"{v}.{c}": [p.model_dump() for p in points] for (v, c), points in part.delays.items()},
        "offsets": [offset.model_dump() for offset in part.offsets],
        "smith_offset_rad": part.smith_offset,
        "noise_gain": {f"{v}.{c}": value for (v, c), value in part.noise.items()},
        "turbojet": [reach.model_dump() for reach in part.turbojet],
    }
