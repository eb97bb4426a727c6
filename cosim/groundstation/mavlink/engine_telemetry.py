"""Messages on engines, servos and fuel, each a function of one snapshot."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, isfinite, isnan, nan, pi

from cosim.base.signals import PerServo
from cosim.groundstation.mavlink.telemetry_state import I16, I32, U16, U32, TelemetryState, to_field
from cosim.groundstation.mavlink.wire.dialect import Message, mav

# Density of kerosene, as MAVLink states fuel by volume: middle of the range of Jet A-1 at 15 degC (ASTM D1655).
KEROSENE_KG_M3 = 808.0
_TO_RPM = 30.0 / pi  # from rad/s


def servo_output_raw(v: TelemetryState) -> list[Message]:
    """Return SERVO_OUTPUT_RAW: throttles, then servos from output 7 on, as pulses of 1000 to 2000 us.

    1500 us is straight up, or the middle of a hinge's range; as many as the message has.
    """
    actuation, reach = v.sample.actuation, v.vehicle.tilt_range
    pulses = [0] * 16
    for i, throttle in enumerate(actuation.throttle[: v.vehicle.jets]):
        pulses[i] = to_field(1000.0 + 1000.0 * throttle, 0, U16)
    first = max(6, v.vehicle.jets)
    if v.vehicle.ranges:
        for i, position in enumerate(_normalise_tilts(actuation.tilt, v.vehicle.ranges)[: len(pulses) - first]):
            pulses[first + i] = to_field(1500.0 + 500.0 * position, 0, U16)
    else:
        for i, tilt in enumerate(actuation.tilt[: len(pulses) - first]):
            pulses[first + i] = 0 if isnan(reach) else to_field(1500.0 + 500.0 * tilt / reach, 0, U16)
    return [mav.MAVLink_servo_output_raw_message(v.us & U32, 0, *pulses)]


def actuator_output_status(v: TelemetryState) -> list[Message]:
    """Return ACTUATOR_OUTPUT_STATUS: throttles 0 to 1, then from index 6 on servos, -1 to 1 or in rad."""
    actuation, reach = v.sample.actuation, v.vehicle.tilt_range
    values = [0.0] * 32
    jets = v.vehicle.jets
    values[:jets] = actuation.throttle[:jets]
    first = max(6, jets)
    if v.vehicle.ranges:
        moved = _normalise_tilts(actuation.tilt, v.vehicle.ranges)[: len(values) - first]
    else:
        moved = [tilt if isnan(reach) else tilt / reach for tilt in actuation.tilt]
    values[first : first + len(moved)] = moved
    active = (1 << jets) - 1 | ((1 << len(moved)) - 1) << first
    return [mav.MAVLink_actuator_output_status_message(v.us, active, values)]


def _normalise_tilts(tilt: PerServo, ranges: tuple[tuple[float, float], ...]) -> list[float]:
    """Return servo positions normalised to their ranges, -1 to 1."""
    return [(2.0 * at - least - most) / (most - least) for at, (least, most) in zip(tilt, ranges, strict=True)]


def fuel_status(v: TelemetryState) -> list[Message]:
    """Return FUEL_STATUS: kerosene by volume in ml and ml/s, from mass and mass flow.

    The tank's gauge measures what remains; what was consumed may not be made of it.
    """
    full, left = v.vehicle.fuel_capacity, v.remaining
    if isnan(full) or left is None:
        return []
    flow = sum(flow for flow in v.sample.engines.fuel_flow[: v.vehicle.jets])
    capacity, rate = (mass / KEROSENE_KG_M3 * 1e6 for mass in (full, flow))
    percent = to_field(100.0 * left, 0, 100)
    # The last argument is MAV_FUEL_TYPE; 1 is liquid.
    return [mav.MAVLink_fuel_status_message(0, capacity, nan, left * capacity, percent, rate, nan, 1)]


def _first_engines(v: TelemetryState) -> list[int]:
    """Return the index of the first engine in each message, as a message holds four."""
    return [4 * i for i in range(ceil(v.vehicle.jets / 4))]


def _spool_speeds_rpm(v: TelemetryState) -> list[float]:
    return [speed * _TO_RPM for speed in v.sample.engines.spool_speed[: v.vehicle.jets]]


def esc_status(v: TelemetryState) -> list[Message]:
    """Return ESC_STATUS: spool speeds [rpm]; no message if no engine reports one, as the field has no unknown."""
    rpm = _spool_speeds_rpm(v)
    if not any(isfinite(speed) for speed in rpm):
        return []
    unknown = [nan] * 4
    return [
        mav.MAVLink_esc_status_message(
            first, v.us, [to_field(speed, -I32, I32) for speed in _pad_to_four(rpm, first, 0.0)], unknown, unknown
        )
        for first in _first_engines(v)
    ]


def esc_info(v: TelemetryState) -> list[Message]:
    """Return ESC_INFO: which engines run, without exhaust temperatures, which exceed the field."""
    health = [1.0 if fraction > 0.0 else 0.0 for fraction in v.sample.health[: v.vehicle.jets]]
    counter = v.sample.k & U16
    return [
        mav.MAVLink_esc_info_message(
            first, v.us, counter, v.vehicle.jets, 0,
            sum(1 << i for i, alive in enumerate(_pad_to_four(health, first, 0.0)) if alive),
            [0] * 4, [0] * 4, [I16] * 4,
        )
        for first in _first_engines(v)
    ]  # fmt: skip


def _pad_to_four(values: Sequence[float], first: int, missing: float) -> list[float]:
    return [values[i] if i < len(values) else missing for i in range(first, first + 4)]


def efi_status(v: TelemetryState) -> list[Message]:
    """Return EFI_STATUS of each engine; unknown is NaN, for voltage and pressure 0 as MAVLink defines."""
    sample, engines = v.sample, v.sample.engines
    messages = []
    for i in range(v.vehicle.jets):
        full = v.vehicle.full_thrust[i] if i < len(v.vehicle.full_thrust) else nan
        flow = engines.fuel_flow[i] / KEROSENE_KG_M3 * 1e6 * 60.0  # cm^3/min
        throttle = 100.0 * sample.actuation.throttle[i]
        load = 100.0 * engines.thrust[i] / full
        burnt = v.events.burnt[i] / KEROSENE_KG_M3 * 1e6 if v.events.burnt else nan  # cm^3
        exhaust = engines.exhaust_temperature[i] - 273.15
        messages.append(
            mav.MAVLink_efi_status_message(
                int(sample.health[i] > 0.0), float(i), engines.spool_speed[i] * _TO_RPM, burnt, flow, load, throttle,
                nan, nan, nan, nan, nan, nan, nan, exhaust, throttle, nan, 0.0, 0.0,
            )
        )  # fmt: skip
    return messages


def raw_rpm(v: TelemetryState) -> list[Message]:
    """Return RAW_RPM of the first four engines, as no station shows more."""
    return [mav.MAVLink_raw_rpm_message(i, rpm) for i, rpm in enumerate(_spool_speeds_rpm(v)[:4]) if isfinite(rpm)]
