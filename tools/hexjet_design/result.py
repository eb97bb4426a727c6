"""What a design came to: as JSON, as words and tables, as files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, fields
from math import degrees, exp, inf, isfinite
from pathlib import Path
from typing import Any

from cosim.base.signals import AXES
from cosim.base.storage.files import to_json_record, write_files
from cosim.base.storage.toml import toml_text
from cosim.spec.vehicle import EngineLead
from hexjet_design.assessment import Assessment, AxisDesign
from hexjet_design.candidates import WITH_LEAD
from hexjet_design.controller_table import make_controller_table
from hexjet_design.design import Design
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import window_s
from hexjet_design.loop.firmware import Firmware
from hexjet_design.proof.comparison import comparison_lines, worse_lines
from hexjet_design.proof.result import Proof

NOT_PROVED = "NOT PROVED"  # mark of a design whose proof failed
RELAXING_OPTIONS = ("engine_spread", "gain_tolerance", "delay_tolerance")  # options that may allow a failed design


def write(design: Design, file: Path) -> dict[str, Path]:
    """Write the controller file, if there is a design, and the page; return which files exist.

    Raises FlightError if a file cannot be written.
    """
    from hexjet_design.page import make_page

    paths = {}
    if design.is_written:
        mark = "" if design.ok else f"# {NOT_PROVED}: {design.reason}\n\n"
        write_files({file: mark + toml_text(make_controller_table(design, file.parent))})
        paths["controller"] = file
    paths["report"] = file.with_suffix(".html")
    make_page(design).write(paths["report"])
    return paths


def to_dict(design: Design, paths: Mapping[str, Path] | None = None) -> dict[str, Any]:
    """Return the design without curves as a table for JSON; None for numbers that are not finite."""
    identification = design.identification
    return {
        "ok": design.ok,
        "proved": design.ok and design.proof is not None,
        "reason": design.reason,
        "allowing": dict(design.allowing),
        "aircraft": design.vehicle.name,
        "engine": design.engine.name,
        "engine_sha256": design.engine.identity,
        "engine_parameters": dict(design.scenario.engine_parameters),
        "controller": design.controller,
        "requirements": design.need.model_dump(),
        "tolerances": design.tolerances or None,
        "model_source": design.model_source,
        "identification": identification.to_dict() if identification else None,
        "axes": {axis: _axis_to_dict(axis_design) for axis, axis_design in design.axes.items()},
        "limit": {
            axis: {"reason": limit} if isinstance(limit, str) else limit.to_dict()
            for axis, limit in design.performance.items()
        },
        "levels": [
            {
                "fuel": level.level.fuel,
                "mass_kg": level.level.mass_kg,
                "share": level.level.thrust_fraction,
                "designed": level.designed,
                "held": {axis: _assessment_to_dict(state) for axis, state in level.unscheduled.items()},
                "after": {axis: _assessment_to_dict(state) for axis, state in level.after.items()},
                "kept": dict(level.is_kept),
            }
            for level in design.levels
        ],
        "schedule": design.schedule.model_dump(exclude_none=True) if design.schedule else None,
        "file": make_controller_table(design) if design.is_written else None,
        "proof": _proof_record(design.proof) if design.proof else None,
        "worse": worse_lines(design.proof.compared) if design.proof else [],
        "paths": {name: str(path) for name, path in (paths or {}).items()},
    }


def _axis_to_dict(axis_design: AxisDesign) -> dict[str, Any]:
    channel = axis_design.channel
    return {
        "command_unit": channel.unit,
        "gain": channel.gain,
        "actuator": channel.actuator.name,
        "actuator_poles_rad_s": [[p.real, p.imag] for p in channel.actuator.dynamics.poles],
        "actuator_zeros_rad_s": [[z.real, z.imag] for z in channel.actuator.dynamics.zeros],
        "actuator_misfit": channel.actuator.dynamics.misfit,
        "actuator_unsure": [list(point) for point in channel.actuator.dynamics.unsure],
        "transport_delay_samples": channel.transport_samples,
        "all_delay_s": channel.slowness_s,
        "room": channel.room,
        "before": _assessment_to_dict(axis_design.before),
        "after": _assessment_to_dict(axis_design.after),
        "candidates": {name: value if isfinite(value) else None for name, value in axis_design.candidates.items()},
        "bandwidth_without_hz": dict(axis_design.limits),
        "checks": dict(axis_design.checks),
    }


def _proof_record(proof: Proof) -> dict[str, Any]:
    """Return a proof as a table, by the keys of the JSON result."""
    record = {"share" if key == "stability_fraction" else key: value for key, value in to_json_record(proof).items()}
    for pair in record["compared"]:
        for measures in (pair["shipped"], pair["designed"]):
            measures["lost"] = measures.pop("failure")
    return record


def _assessment_to_dict(assessment: Assessment | None) -> dict[str, Any] | None:
    if assessment is None:
        return None
    values = {field.name: getattr(assessment, field.name) for field in fields(assessment)}
    values["margins"] = None if assessment.margins is None else asdict(assessment.margins)
    tuning = assessment.tuning
    values["tuning"] = {
        "attitude_gain_1_s": tuning.angle_gain,
        "rate": tuning.gains.model_dump(),
        "predictor": tuning.predictor.model_dump(),
        "model": tuning.model.model_dump(),
        "lead": tuning.lead.model_dump() if tuning.lead else None,
        "parameters": None if tuning.law is None else dict(tuning.law),
    }
    return values


def summary_lines(design: Design) -> list[str]:
    """Return the main findings, a sentence each, with the result first."""
    return [*answer_lines(design), *detail_lines(design)]


def answer_lines(design: Design) -> list[str]:
    """Return the result: controller, proof, worse measures and limits; or why there is none."""
    if not design.is_written:
        return [f"no acceptable design: {design.reason}", *_relaxation_lines(design)]
    roll = design.axes["roll"]
    lines = [] if design.ok else [f"{NOT_PROVED}: {design.reason}", *_relaxation_lines(design)]
    lines += [f"controller: {design.controller}; {_compare_candidates(roll)}"]
    if design.proof is not None:
        lines += [*design.proof.lines(), *comparison_lines(design.proof.compared)]
    elif design.firmware is None:
        lines.append("not flown: the proof was left out")
    return [*lines, *_limit_lines(roll)]


def detail_lines(design: Design) -> list[str]:
    """Return the evidence behind the result: models, loops, limits and proof."""
    lines = _model_lines(design)
    if not design.is_written:
        return [*lines, *(design.proof.lines() if design.proof else [])]
    if design.firmware is not None:
        lines += _firmware_lines(design, design.firmware)
    lines += [
        f"{axis}: {_lead_words(axis_design.after.tuning.lead)}"
        for axis, axis_design in design.axes.items()
        if axis_design.after is not None and axis_design.after.tuning.lead is not None
    ]
    lines.append(_describe_saturation(design))
    lines += _describe_fuel_levels(design)
    checks = [
        (axis, f"{'stable' if fine else 'NOT stable'} for {check}")
        for axis, axis_design in design.axes.items()
        for check, fine in axis_design.checks.items()
    ]
    limits = [
        f"no limit of performance: {limit}" if isinstance(limit, str) else f"{axis}: {limit.describe()}"
        for axis, limit in design.performance.items()
    ]
    return [*lines, *_merge_same_values(checks), *limits]


def _merge_same_values(entries: Iterable[tuple[str, str]]) -> list[str]:
    """Return one line per text, preceded by its axes."""
    axes: dict[str, list[str]] = {}
    for axis, text in entries:
        axes.setdefault(text, []).append(axis)
    return [f"{', '.join(names)}: {text}" for text, names in axes.items()]


def _firmware_lines(design: Design, firmware: Firmware) -> list[str]:
    """Describe the firmware's loops, what they share, and their margins before flight."""
    lines = [
        f"the loops of roll, pitch and yaw are {firmware.name}'s, with its filters and delays; the height's is ours. "
        "The design has no proof in flight: hexjet sitl flies it"
    ]
    if firmware.common_angle:
        whose = "roll's, which holds back the quicker pitch"
        if firmware.angle_gain is not None:
            whose = "pitch's, which has no gains with that of roll"
        lines.append(f"roll and pitch have one attitude gain: {whose}")
    for axis, axis_design in design.axes.items():
        if axis_design.after is not None and axis_design.after.margins is not None and axis != "altitude":
            m = axis_design.after.margins
            more = "" if m.delay_s is None else f", {1e3 * m.delay_s:.1f} ms more delay"
            less = None if m.gain_down_db is None else -m.gain_down_db
            lines.append(
                f"{axis}: it takes {_format_decimals(m.gain_db, 1)} dB more gain, {_format_decimals(less, 1)} dB less, "
                f"{_format_decimals(m.phase_deg, 1)} deg of phase{more} until it is unstable"
            )
    return lines


def _delay_words(channel: Channel) -> str:
    """Return a channel's delay, and its time scale if low-frequency delay is meaningless."""
    delay = f"all delay {1e3 * channel.slowness_s:.4g} ms at low frequency"
    if channel.time_scale_s == channel.slowness_s:
        return delay
    why = f"rotors that hinges turn lead by {1e3 * channel.lead_s:.3g} ms"
    if channel.lead_s <= 0.0:
        why = "a slow pole has a zero beside it"
    return f"{delay} and {1e3 * channel.time_scale_s:.4g} ms where a loop is closed: {why}"


def _model_lines(design: Design) -> list[str]:
    lines = []
    roll = design.axes["roll"].channel
    if design.identification is not None:
        dynamics = design.engine_dynamics
        lines.append(
            f"engine {design.engine.name}: {dynamics.describe()}, delay {dynamics.delay_samples:.4g} samples "
            f"({1e3 * dynamics.delay_samples * dynamics.step:.4g} ms); {design.identification.source}"
        )
        lines.append(
            f"the model is within {100.0 * dynamics.misfit:.2g} % of the response (1 % is 1 % or 0.6 deg), coherence "
            f"at least {design.identification.response.coherence.min():.4f}"
        )
        if dynamics.unsure:
            lines.append(
                f"designed for every engine that differs from the model by {dynamics.unsure_words()}: peak |S| and "
                "what is tolerated are the worst among them"
            )
        lines += [f"note: {note}" for note in design.identification.notes]
    lines += [design.tolerances] if design.tolerances else []
    delay = _delay_words(roll)
    if roll.unit == "share":
        room = f"{roll.room:.2f} of share to either side at hover"
        return [*lines, f"roll: {roll.gain:.4g} rad/s^2 per unit of share, {delay}, {room}"]
    said = []
    for axis in AXES:
        channel = design.axes[axis].channel
        delay = _delay_words(channel)
        room = f"{channel.room:.3g} rad/s^2 to either side at hover"
        by, dynamics = "thrust", channel.actuator.dynamics
        if channel.is_by_servo:
            by, room = f"hinges, lag {1e3 * dynamics.lag_s:.4g} ms", f"{room} that their rates and ranges follow"
        line = f"by {by}, {delay}, {room}"
        if channel.is_by_servo and dynamics.unsure:
            at, most = max(dynamics.unsure, key=lambda point: point[1])
            line += f"; designed for what others and all that turns add, up to {100.0 * most:.2g} % at {at:.2g} Hz"
            if most > 1.0:
                first = next(hertz for hertz, misfit in dynamics.unsure if misfit > 1.0)
                line += f", more than itself from {first:.2g} Hz on"
        said.append((axis, line))
    return [*lines, *_merge_same_values(said)]


def _compare_candidates(roll: AxisDesign) -> str:
    """Compare the candidates' speed of response in words, the best as 100 %."""
    best = min(roll.candidates.values())
    changes = []
    for name, value in sorted(roll.candidates.items(), key=lambda item: item[1]):
        # The objective contains the bandwidth twice, for set-point and load.
        changes.append(f"{name} {100.0 * exp(0.5 * (best - value)):.0f} %" if isfinite(value) else f"{name} none")
    return "speed of response reached: " + ", ".join(changes)


def _lead_words(lead: EngineLead) -> str:
    """Describe a lead's effect on the engine's poles and its first command."""
    w, a = lead.natural_rad_s, lead.pole_rad_s
    if lead.damping is None:
        moved, times = f"lag of {1e3 / w:.4g} ms to {1e3 / a:.4g} ms", a / w
    else:
        moved = f"poles of {w:.4g} rad/s and damping {lead.damping:.2f} to {a:.4g} rad/s"
        times = (a / w) ** 2
    return f"a lead moves the engine's {moved}; it asks at first for {times:.1f} times what it wants"


def _limit_lines(roll: AxisDesign, negligible_percent: float = 3.0) -> list[str]:
    after = roll.after
    assert after is not None
    assert after.bandwidth_hz is not None
    reached = f"roll: bandwidth {after.bandwidth_hz:.2f} Hz"
    if not roll.limits:
        return [reached]
    most = max(roll.limits, key=lambda name: roll.limits[name])
    limits = []
    for limit, value in roll.limits.items():
        gain = 100.0 * (value / after.bandwidth_hz - 1.0)
        more = f"{value:.2f} Hz ({gain:+.0f} %)" if gain > negligible_percent else "the same"
        limits.append(f"without {limit} {more}")
    return [f"{reached}, limited most by {most}: {', '.join(limits)}"]


def _describe_fuel_levels(design: Design) -> list[str]:
    """Return lines on what burnt fuel does to the loops, and on the gain schedule against it."""
    if not design.levels:
        return []
    least = design.levels[-1]
    peaks = ", ".join(
        f"{axis} {state.peak_sensitivity:.2f}" if state.peak_sensitivity else f"{axis} unstable"
        for axis, state in least.unscheduled.items()
    )
    text = (
        f"with an empty tank ({least.level.mass_kg:.4g} kg) the gains of a full one have a peak sensitivity of {peaks}"
    )
    if design.schedule is None:
        return [f"{text}; they are kept"]
    fractions = " to ".join(f"{level.share:.3f}" for level in (design.schedule.level[0], design.schedule.level[-1]))
    between = [
        state.peak_sensitivity or inf for level in design.levels if not level.designed for state in level.after.values()
    ]
    most = max(between, default=0.0)
    worst = f"; between the levels that are designed the peak sensitivity is at most {most:.2f}" if between else ""
    return [f"{text}: gains and leads follow the collective from {fractions} of the engines' range{worst}"]


def _describe_saturation(design: Design) -> str:
    roll = design.axes["roll"]
    after = roll.after
    assert after is not None
    assert after.step_peak is not None
    rate = design.vehicle.control.attitude.rate_limit_rad_s[0] / after.tuning.angle_gain
    return (
        f"roll steps above {degrees(roll.channel.room / after.step_peak):.0f} deg saturate the "
        f"{'throttles' if roll.channel.unit == 'share' else 'actuators'}, above {degrees(rate):.0f} deg the rate limit"
    )


def _relaxation_lines(design: Design) -> list[str]:
    lines = []
    if "delay_s" in design.allowing:
        lines.append(f"with a delay of at most {1e3 * design.allowing['delay_s']:.4g} ms there would be one")
    if "lag_factor" in design.allowing:
        part = design.allowing["lag_factor"]
        lines.append(
            f"with an engine {1.0 / part:.2g} times as fast there would be one"
            if part
            else "without any lag of the engine there would be one"
        )
    lines += [
        f"{name} {value:g} would allow it: with these gains that flight keeps what is promised"
        for name, value in design.allowing.items()
        if name in RELAXING_OPTIONS
    ]
    if not design.allowing and design.axes["roll"].after is None:
        lines.append("neither less delay nor less lag of the engine alone would allow one")
    return lines


COLUMNS = (  # heads of the table of channels
    "channel",
    "controller",
    "attitude 1/s",
    "P",
    "I",
    "D",
    "peak |S|",
    "gain up dB",
    "gain down dB",
    "phase deg",
    "delay ms",
    "bandwidth Hz",
    "overshoot %",
    "settled s",
    "tolerated",
)


def rows(design: Design) -> list[list[str]]:
    """Return table rows of each channel before and after the design, and by fuel, under :data:`COLUMNS`."""
    return [*channel_rows(design), *level_rows(design)]


def channel_rows(design: Design) -> list[list[str]]:
    """Return table rows of every channel before and after the design, under the headings :data:`COLUMNS`."""
    return [
        [f"{axis}, {when}", *_make_cells(state, axis_design.channel)]
        for axis, axis_design in design.axes.items()
        for when, state in (("shipped", axis_design.before), ("designed", axis_design.after))
        if state is not None
    ]


def level_rows(design: Design) -> list[list[str]]:
    """Return table rows of the channels by fuel level, under :data:`COLUMNS`; equal rows are merged."""
    full = {row[0].removesuffix(", designed"): row[1:] for row in channel_rows(design)}
    different: dict[tuple[str, ...], list[str]] = {}
    for axis, when, fuel, cells in _level_cells(design):
        if cells != full[axis]:
            different.setdefault((axis, when, *cells), []).append(f"{fuel:.0%}")
    return [
        [f"{axis}, {', '.join(fuels)} of fuel, {when}", *cells] for (axis, when, *cells), fuels in different.items()
    ]


def row_lines(design: Design) -> list[str]:
    """Return notes on what the table of channels omits and why cells are empty."""
    states = [
        state for axis_design in design.axes.values() for state in (axis_design.before, axis_design.after) if state
    ]
    lines = []
    if any(state.stable and state.settling_s is None for state in states):
        lines.append(
            "settled > N s: a step is not within 5 % after N s, as long as the linear loop is looked at (50 times the "
            "channel's delay)"
        )
    full = {axis: _make_cells(each.after, each.channel) for axis, each in design.axes.items() if each.after is not None}
    changed = {axis for axis, _, _, cells in _level_cells(design) if cells != full[axis]}
    fuels = [level.level.fuel for level in design.levels]
    lines += [
        f"{axis}, designed: the same at {100.0 * fuels[0]:.0f} to {100.0 * fuels[-1]:.0f} % of the fuel"
        for axis in (design.levels[0].unscheduled if design.levels else ())
        if axis not in changed
    ]
    return lines


def _level_cells(design: Design) -> Iterator[tuple[str, str, float, list[str]]]:
    """Yield each fuel level by axis: with full-tank gains, and as scheduled."""
    for level in design.levels:
        for axis, state in level.unscheduled.items():
            channel = level.level.channels[axis]
            yield axis, "held", level.level.fuel, _make_cells(state, channel)
            if design.schedule is not None:
                yield axis, "scheduled", level.level.fuel, _make_cells(level.after[axis], channel)


def _make_cells(state: Assessment, channel: Channel) -> list[str]:
    gains = state.tuning.gains
    first = [
        state.controller + (WITH_LEAD if state.tuning.lead else ""),
        f"{state.tuning.angle_gain:.3g}",
        *(f"{value:.3g}" for value in (gains.p, gains.i, gains.d)),
    ]
    if not state.stable or state.margins is None:
        return [*first, "unstable", *[""] * 8]
    m = state.margins
    return [
        *first,
        _format_decimals(state.peak_sensitivity, 2),
        _format_decimals(m.gain_db, 1),
        _format_decimals(m.gain_down_db, 1),
        _format_decimals(m.phase_deg, 1),
        _format_decimals(None if m.delay_s is None else 1e3 * m.delay_s, 0),
        _format_decimals(state.bandwidth_hz, 2),
        _format_decimals(None if state.overshoot is None else 100.0 * state.overshoot, 1),
        f"> {window_s(channel):.2g}" if state.settling_s is None else _format_decimals(state.settling_s, 2),
        _format_decimals(state.tolerated, 2),
    ]


def _format_decimals(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
