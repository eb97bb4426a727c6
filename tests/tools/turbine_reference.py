"""The turbojet of engines/turbine.c once more, from its README: gas path by root finding, rotor and pump by scipy's DOP853.

Nothing is taken from the C source but the names of the parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi, sqrt

from scipy.integrate import solve_ivp
from scipy.optimize import brentq

STEP = 0.004
R, LHV, T_REF = 287.0, 43.1e6, 298.15
CP_AIR, CP_GAS = 1004.5, 1148.0
RPM = pi / 30.0


@dataclass
class Gas:
    """Every station of the gas path."""

    air: float
    T2: float
    T3: float
    T4: float
    T5: float
    T8: float
    p2: float
    p4: float
    p5: float
    jet: float
    released: float  # W
    thrust: float
    power: float  # W, turbine less compressor


@dataclass
class Ambient:
    pressure: float = 101325.0
    temperature: float = 288.15
    air_speed: float = 0.0


class Turbine:
    """One engine with its ECU; `step` advances by 4 ms."""

    def __init__(self, parameters: Mapping[str, float], ambient: Ambient | None = None) -> None:
        self.p = dict(parameters)
        self.ambient = ambient or Ambient()
        self.full, self.idle = self.p["full_speed"] * RPM, self.p["idle_speed"] * RPM

    def gas(self, w: float, fuel: float, lit: bool = True) -> Gas:
        p, a = self.p, self.ambient
        slow = min(w / (0.02 * self.full), 1.0)
        w = max(w, 0.02 * self.full)
        speed = max(a.air_speed, 0.0)
        T2 = a.temperature + speed**2 / 2.0 / CP_AIR
        p2 = a.pressure * (1.0 + p["ram_recovery"] * ((T2 / a.temperature) ** 3.5 - 1.0))
        theta, delta = T2 / 288.15, p2 / 101325.0
        n = w / self.full / sqrt(theta)
        flow = n - p["flow_droop"] * n * (1.0 - n)
        air = p["air_flow"] * flow * delta / sqrt(theta)
        eta_c = p["compressor_efficiency"]
        rise = (p["pressure_ratio"] ** (2 / 7) - 1.0) / eta_c * n**2
        T3 = T2 + T2 * rise
        p4 = p2 * (1.0 + eta_c * rise) ** 3.5 * (1.0 - p["pressure_loss"] * flow**2)
        n_idle = self.idle / self.full
        low, high = p["idle_combustion_efficiency"], p["combustion_efficiency"]
        released = (low + (high - low) * (n - n_idle) / (1.0 - n_idle)) * LHV * fuel * lit
        gas = air + fuel
        T4 = T_REF + (air * CP_AIR * (T3 - T_REF) + released) / (gas * CP_GAS)

        def jet_of(T5: float) -> float:
            # continuity through the nozzle: gas = p / (R T8) A jet, T8 = T5 - jet^2 / (2 c_p)
            k = gas * R / (a.pressure * p["nozzle_area"])
            return 2.0 * k * T5 / (1.0 + sqrt(1.0 + 2.0 * k * k * T5 / CP_GAS))

        def p5_of(T5: float) -> float:
            return a.pressure * (T5 / (T5 - jet_of(T5) ** 2 / 2.0 / CP_GAS)) ** 4

        def turbine(T5: float) -> float:
            return T5 - T4 * (1.0 - p["turbine_efficiency"] * (1.0 - (p5_of(T5) / p4) ** 0.25))

        T5 = brentq(turbine, 0.3 * T4, 1.5 * T4, xtol=1e-11, rtol=1e-15)
        jet = jet_of(T5)
        power = gas * CP_GAS * (T4 - T5) - air * CP_AIR * (T3 - T2)
        thrust = slow * (gas * jet - air * speed)
        return Gas(air, T2, T3, T4, T5, T5 - jet**2 / 2 / CP_GAS, p2, p4, p5_of(T5), jet, released, thrust, power)

    def torque(self, w: float, fuel: float, lit: bool = True, starter: bool = False) -> float:
        """Net torque on the rotor [N m]."""
        p = self.p
        torque = (
            self.gas(w, fuel, lit).power * w / max(w, 0.02 * self.full) ** 2 - p["windage_power"] * w / self.full**2
        )
        if starter:
            torque += p["starter_torque"] * min(max(1.0 - w / (p["starter_speed"] * RPM), 0.0), 1.0)
        return torque

    def demand(self, throttle: float) -> float:
        b = self.p["thrust_exponent"]
        share = (self.idle / self.full) ** b
        return self.full * (share + (1.0 - share) * throttle) ** (1.0 / b)

    def start(self, throttle: float) -> None:
        """In equilibrium at a throttle."""
        self.w = self.reference = self.demand(throttle)
        air = self.gas(self.w, 0.0, False).air
        self.fuel = brentq(
            lambda f: self.torque(self.w, f), 0.0, self.p["richest_command"] * air, xtol=1e-16, rtol=1e-15
        )
        self.integral, self.phase = self.fuel + self.damping, "running"
        self.delayed = [throttle] * round(self.p["delay_samples"])
        self.on, self.waited = True, 0

    def start_cold(self) -> None:
        self.w = self.fuel = self.reference = self.integral = 0.0
        self.phase, self.on, self.waited = "off", False, 0
        self.delayed = [0.0] * round(self.p["delay_samples"])

    def _sequence(self, throttle: float, on: bool) -> None:
        p = self.p
        if not on:
            self.phase = "off"
        elif not self.on:
            self.phase = "cranking"
        self.on = on
        if self.phase == "off":
            self.fuel, self.waited = 0.0, 0
        elif self.phase == "cranking":
            if self.w >= p["light_speed"] * RPM:
                self.waited += 1
                if self.waited >= p["ignition_time"] / STEP:
                    self.phase = "spooling"
                    self.fuel = p["leanest_command"] * self.gas(self.w, 0.0, False).air
                    self.integral = self.fuel + self.damping
                    self.reference = self.w
        elif self.phase == "spooling":
            rising = self.reference + STEP * self.idle / p["spooling_time"]
            self.reference = min(rising, max(self.reference, self.idle))
            if self.w >= 0.99 * self.idle:
                self.phase = "running"
        else:
            change = self.demand(throttle) - self.reference
            most, least = STEP * p["acceleration"] * self.reference, -STEP * p["deceleration"] * self.reference
            self.reference += min(max(change, least), most)

    @property
    def damping(self) -> float:
        return self.p["speed_gain"] * self.w / self.full

    def _command(self) -> float:
        p = self.p
        if self.phase not in ("spooling", "running"):
            return 0.0
        air = self.gas(self.w, self.fuel).air
        low, high = p["leanest_command"] * air, p["richest_command"] * air
        error = (self.reference - self.w) / self.full
        command = self.integral - self.damping
        hottest = p["exhaust_limit"]
        asked = min(max(command, low), high)
        if hottest and hottest < self.gas(self.w, asked).T5:
            high = brentq(lambda fuel: self.gas(self.w, fuel).T5 - hottest, low, asked, xtol=1e-16, rtol=1e-15)
        if not (command <= low and error <= 0.0) and not (command >= high and error >= 0.0):
            self.integral += STEP * p["integral_gain"] * error
        return min(max(command, low), high)

    def step(self, throttle: float, run: float = 1.0) -> None:
        self.delayed.append(min(max(throttle, 0.0), 1.0))
        self._sequence(self.delayed.pop(0), run >= 0.5)
        command = self._command()
        lit = self.phase in ("spooling", "running")
        starter = self.phase in ("cranking", "spooling")
        tau = self.p["pump_time_constant"]

        def rates(t: float, x: list[float]) -> list[float]:
            torque = self.torque(x[0], x[1], lit, starter)
            return [torque / self.p["rotor_inertia"], (command - x[1]) / tau if lit else 0.0]

        # relative 1e-10 of the state; the comparison asks for 1e-6
        done = solve_ivp(rates, (0.0, STEP), [self.w, self.fuel], method="DOP853", rtol=1e-10, atol=[1e-8, 1e-14])
        self.w, self.fuel = float(done.y[0, -1]), float(done.y[1, -1])
        if lit and self.fuel < self.p["lean_limit"] * self.gas(self.w, self.fuel).air:
            self.phase = "off"

    @property
    def lit(self) -> bool:
        return self.phase in ("spooling", "running")

    def outputs(self) -> tuple[float, float, float, float]:
        """Thrust [N], speed [rpm], exhaust temperature [K], fuel flow [kg/s]."""
        gas = self.gas(self.w, self.fuel, self.lit)
        return gas.thrust, self.w / RPM, gas.T5, self.fuel
