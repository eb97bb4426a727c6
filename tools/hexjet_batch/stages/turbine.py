"""The turbines of the library over a batch, and the kind of each engine: the equations of ``engines/turbine.c``."""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

import numpy as np

from hexjet_batch.numbers import Numbers, is_absent, limit
from hexjet_batch.stages.delays import make_ring, push
from hexjet_batch.stages.engines import RPM, Air, Report, bisect, or_infinite, runge_kutta

R_AIR, CP_AIR, CP_GAS = 287.0, 3.5 * 287.0, 4.0 * 287.0  # J/(kg K)
P_STD, T_STD = 101325.0, 288.15  # Pa, K
# J/kg of Jet A-1, stated at this temperature [K].
HEATING_VALUE, T_REFERENCE = 43.1e6, 298.15


class Inlet(NamedTuple):
    """What does not change within a step: the air before the compressor, and scales of speed and flow."""

    pressure: Any
    speed: Any
    t2: Any
    p2: Any
    unit_speed: Any
    unit_flow: Any


class Turbine:
    """A single-spool turbojet that runs: compressor, combustor, turbine and nozzle in balance, one rotor, one ECU.

    An engine whose mixture gets too lean to burn is marked ``out``: what follows is not flown in a batch.
    """

    def _inlet_state(self, n: Numbers, air: Air) -> Inlet:
        xp = n.xp
        temperature = limit(air.temperature, 150.0, 400.0, xp)
        pressure, v = limit(air.pressure, 1e3, 2e5, xp), limit(air.speed, 0.0, 300.0, xp)
        t2 = temperature + v * v / (2.0 * CP_AIR)
        ram = t2 / temperature
        p2 = pressure * (1.0 + n.ram_recovery * (ram * ram * ram * xp.sqrt(ram) - 1.0))
        root = xp.sqrt(t2 / T_STD)
        return Inlet(pressure, v, t2, p2, n.full_speed * RPM * root, n.air_flow * (p2 / P_STD) / root)

    def _relative_flow(self, n: Numbers, speed: Any) -> Any:
        return speed * (1.0 - n.flow_droop * (1.0 - speed))

    def _air_flow(self, n: Numbers, a: Inlet, w: Any) -> Any:
        return a.unit_flow * self._relative_flow(n, w / a.unit_speed)

    def _gas_path(self, n: Numbers, a: Inlet, w: Any, fuel: Any) -> tuple[Any, Any, Any]:
        """Return torque, thrust and the temperature behind the turbine of engines that burn."""
        xp, speed = n.xp, w / a.unit_speed
        flow = self._relative_flow(n, speed)
        m = a.unit_flow * flow
        gas = m + fuel
        rise = n.full_rise * speed * speed
        x = 1.0 + n.compressor_efficiency * rise
        t3 = a.t2 * (1.0 + rise)
        p4 = a.p2 * x * x * x * xp.sqrt(x) * (1.0 - n.pressure_loss * flow * flow)
        load = (n.full_speed * speed - n.idle_speed) / (n.full_speed - n.idle_speed)
        idle = n.idle_combustion_efficiency
        burnt = idle + (n.combustion_efficiency - idle) * load
        t4 = T_REFERENCE + (m * CP_AIR * (t3 - T_REFERENCE) + burnt * HEATING_VALUE * fuel) / (gas * CP_GAS)
        k = gas * R_AIR / (a.pressure * n.nozzle_area)
        kappa = 2.0 * k * k / CP_GAS
        kept = t4 * (1.0 - n.turbine_efficiency)
        half = t4 * n.turbine_efficiency * xp.sqrt(xp.sqrt(a.pressure / p4)) / 2.0
        b = kappa * half / 2.0
        s = b + xp.sqrt((b + 1.0) * (b + 1.0) + kappa * kept)
        t5 = kept + half * (1.0 + s)
        jet = 2.0 * k * t5 / (1.0 + s)
        power = gas * CP_GAS * (t4 - t5) - m * CP_AIR * (t3 - a.t2)
        return power / w, gas * jet - m * a.speed, t5

    def _rotor_acceleration(self, n: Numbers, a: Inlet, w: Any, fuel: Any) -> Any:
        full = n.full_speed * RPM
        return (self._gas_path(n, a, w, fuel)[0] - n.windage_power * w / (full * full)) / n.rotor_inertia

    def _demanded_speed(self, n: Numbers, throttle: Any) -> Any:
        idle = (n.idle_speed / n.full_speed) ** n.thrust_exponent
        return n.full_speed * RPM * (idle + (1.0 - idle) * throttle) ** (1.0 / n.thrust_exponent)

    def _most_fuel(self, n: Numbers, a: Inlet, w: Any, command: Any) -> Any:
        """Return the ECU's most fuel: a richest mixture and, where it is limited, the temperature."""
        flow = self._air_flow(n, a, w)
        richest, low = n.richest_command * flow, n.leanest_command * flow
        if is_absent(n.exhaust_limit):
            return richest
        most = or_infinite(n.exhaust_limit, n.xp)
        high = limit(command, low, richest, n.xp)
        hot = self._gas_path(n, a, w, high)[2] > most
        if isinstance(hot, np.ndarray) and not hot.any():
            return richest
        cool = bisect(lambda fuel: self._gas_path(n, a, w, fuel)[2] <= most, low, high, n.xp)
        return n.xp.where(hot, cool, richest)

    def _fuel_command(self, n: Numbers, a: Inlet, s: Any) -> tuple[Any, Any, Any]:
        """Return the ECU's fuel command, integral and last error, by the one of two control laws that it has."""
        xp = n.xp
        _, w, _, reference, integral, asked, last = s
        error = (reference - w) / (n.full_speed * RPM)
        low, speed = n.leanest_command * self._air_flow(n, a, w), w / (n.full_speed * RPM)
        if is_absent(n.fuel_integral):
            command = integral - n.speed_gain * w / (n.full_speed * RPM)
            high = self._most_fuel(n, a, w, command)
            free = ((command > low) | (error > 0.0)) & ((command < high) | (error < 0.0))
            integral = integral + xp.where(free, n.step * n.integral_gain * error, 0.0)
            return limit(command, low, high, xp), integral, last
        gain = n.step * n.fuel_integral * speed**n.fuel_integral_exponent
        change = gain * error + n.fuel_response * (error - last)
        least, most = or_infinite(n.fuel_fall, xp), or_infinite(n.fuel_ramp, xp)
        command = asked + limit(change, -n.step * asked * least, n.step * most, xp)
        return limit(command, low, self._most_fuel(n, a, w, command), xp), integral, error

    def start(self, n: Numbers, throttle: Any, air: Air) -> tuple[Any, Report]:
        """Return engines in equilibrium at their throttle: the speed demanded, or the nearest that mixtures allow."""
        xp, a = n.xp, self._inlet_state(n, air)
        demand = self._demanded_speed(n, throttle) + 0.0 * throttle

        def speeds_up(w: Any, fuel: Any) -> Any:
            return self._rotor_acceleration(n, a, w, fuel) > 0.0

        def leanest_fuel(w: Any) -> Any:
            return n.leanest_command * self._air_flow(n, a, w)

        def richest_fuel(w: Any) -> Any:
            return self._most_fuel(n, a, w, inf + 0.0 * w)

        slowest, fastest = n.light_speed * RPM + 0.0 * demand, 2.0 * demand
        slower = bisect(lambda w: speeds_up(w, richest_fuel(w)), slowest, demand, xp)
        faster = bisect(lambda w: speeds_up(w, leanest_fuel(w)), demand, fastest, xp)
        w = xp.where(self._rotor_acceleration(n, a, demand, richest_fuel(demand)) < 0.0, slower, demand)
        w = xp.where(speeds_up(demand, leanest_fuel(demand)), faster, w)
        richest = n.richest_command * self._air_flow(n, a, w)
        fuel = bisect(lambda f: self._rotor_acceleration(n, a, w, f) < 0.0, leanest_fuel(w), richest, xp)
        state = (
            make_ring(n.delay, throttle, xp),
            w,
            fuel,
            demand,
            fuel + n.speed_gain * w / (n.full_speed * RPM),
            fuel,
            0.0 * fuel,
        )
        return state, self._make_report(n, a, w, fuel)

    def step(self, n: Numbers, s: Any, k: Any, throttle: Any, air: Air) -> tuple[Any, Report]:
        ring, w, fuel, reference, *governor = s
        xp, a, h = n.xp, self._inlet_state(n, air), n.step
        ring, u = push(ring, k, n.delay, limit(throttle, 0.0, 1.0, xp), xp)
        fall, rise = h * n.deceleration * reference, h * n.acceleration * reference
        if not is_absent(n.reference_fall):
            fall = xp.minimum(fall, h * RPM * or_infinite(n.reference_fall, xp))
        if not is_absent(n.reference_rise):
            rise = xp.minimum(rise, h * RPM * or_infinite(n.reference_rise, xp))
        reference = reference + limit(self._demanded_speed(n, u) - reference, -fall, rise, xp)
        asked, integral, last = self._fuel_command(n, a, (ring, w, fuel, reference, *governor))
        w, fuel = runge_kutta(
            lambda w, f: (self._rotor_acceleration(n, a, w, f), (asked - f) / n.pump_time_constant), w, fuel, h
        )
        return (ring, w, fuel, reference, integral, asked, last), self._make_report(n, a, w, fuel)

    def _make_report(self, n: Numbers, a: Inlet, w: Any, fuel: Any) -> Report:
        out = fuel < n.lean_limit * self._air_flow(n, a, w)
        return Report(self._gas_path(n, a, w, fuel)[1], w, fuel, out)
