"""How softly a vehicle could touch down without an engine, whatever law flew it: trajectory optimisation.

    python docs/engine_out.py quadjet jetwing [--height 3] [--write]

What no law has: the optimiser knows every state, all of the future and an engine that is out at once, or as soon as
the monitor finds it.  It plans thrusts and hinges together, from hover in still air to the first leg on the ground,
so that the fastest leg sinks as slowly as can be; once with any speed sideways, and once within the speed that the
vehicle may have when its legs catch.  What it finds is an optimum nearby, from several starts, and no proof; a law
that does better than that would show an error here.

Rigid body of six degrees of freedom, Euler angles; drag by ``[aero]``; jets by ``[[jets]]`` and ``[[hinges]]``, hinges
within range and rate, without lag; engines by the gas path of ``engines/turbine.c`` with their ECU, whose reference may
be led along anything within its ramps, the transport delay after the loss is detected.  Left out, all of it to the good
of the optimum: the lag of hinges, noise, the gyroscopic moments of the spools.  Needs CasADi with its Ipopt:
``pip install -e '.[bounds]'``.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from math import atan2, ceil, hypot, inf, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.constants import GRAVITY
from cosim.results.report.marks import table, write_marks
from cosim.spec.vehicle import Vehicle, load_vehicle

try:
    import casadi as ca
except ImportError:
    sys.exit("docs/engine_out.py needs CasADi: pip install -e '.[bounds]'")

PAGE = Path(__file__).parent / "failsafes.md"
ENGINES = Path(__file__).parent.parent / "engines"
BEFORE, AFTER = 8, 45  # intervals before throttles act, and after
STEEPEST, FLATTEST = 1.2, 0.35  # rad: of the flight, and with which it may touch
DENSITY = 1.225  # kg/m^3
VEHICLES = {"quadjet": (1,), "jetwing": (1, 3)}  # engines that are lost: the others are their mirror images

R, CP_AIR, CP_GAS = 287.0, 3.5 * 287.0, 4.0 * 287.0  # J/(kg K)
AMBIENT_PA, AMBIENT_K, HEATING_VALUE, REFERENCE_K = 101325.0, 288.15, 43.1e6, 298.15


class Turbine:
    """The gas path and ECU of ``engines/turbine.c`` on a standard day at rest, in symbols.

    States: speed ``n`` over full speed; fuel and the ECU's integral [g/s]; the ECU's reference over full speed.
    """

    def __init__(self, name: str) -> None:
        variables = tomllib.loads((ENGINES / name / "engine.toml").read_text())["variables"]
        p = {key: value["start"] for key, value in variables.items() if "start" in value}
        self.p = p
        self.full, self.idle = p["full_speed"] * pi / 30.0, p["idle_speed"] / p["full_speed"]
        self.delay = p["delay_samples"] * 0.004
        self._rise = (p["pressure_ratio"] ** (2.0 / 7.0) - 1.0) / p["compressor_efficiency"]

    def air(self, n: Any) -> Any:
        """Flow of air, kg/s."""
        return self.p["air_flow"] * n * (1.0 - self.p["flow_droop"] * (1.0 - n))

    def gas(self, n: Any, fuel: Any) -> tuple[Any, Any]:
        """The change of ``n`` [1/s] and the thrust [N], with ``fuel`` in g/s."""
        p, flow = self.p, self.air(n)
        burnt, share = 1e-3 * fuel, self.air(n) / self.p["air_flow"]
        mixed = flow + burnt
        rise = self._rise * n * n
        x = 1.0 + p["compressor_efficiency"] * rise
        hot, pressure = AMBIENT_K * (1.0 + rise), AMBIENT_PA * x**3.5 * (1.0 - p["pressure_loss"] * share * share)
        load = (n - self.idle) / (1.0 - self.idle)
        low, high = p["idle_combustion_efficiency"], p["combustion_efficiency"]
        heat = (low + (high - low) * load) * HEATING_VALUE * burnt
        before = REFERENCE_K + (flow * CP_AIR * (hot - REFERENCE_K) + heat) / (mixed * CP_GAS)
        k = mixed * R / (AMBIENT_PA * p["nozzle_area"])
        bend = 2.0 * k * k / CP_GAS
        kept = before * (1.0 - p["turbine_efficiency"])
        half = before * p["turbine_efficiency"] * (AMBIENT_PA / pressure) ** 0.25 / 2.0
        b = bend * half / 2.0
        s = b + ca.sqrt((b + 1.0) ** 2 + bend * kept)
        after = kept + half * (1.0 + s)
        torque = (mixed * CP_GAS * (before - after) - flow * CP_AIR * (hot - AMBIENT_K)) / (n * self.full)
        windage = p["windage_power"] * n / self.full
        return (torque - windage) / p["rotor_inertia"] / self.full, mixed * 2.0 * k * after / (1.0 + s)

    def running(self, state: Any, ramp: Any) -> tuple[Any, Any, Any]:
        """Derivatives of the four states, thrust [N] and what the ECU asks of the pump [g/s]."""
        n, fuel, integral, reference = state[0], state[1], state[2], state[3]
        faster, thrust = self.gas(n, fuel)
        command = integral - 1e3 * self.p["speed_gain"] * n
        pump = (command - fuel) / self.p["pump_time_constant"]
        error = 1e3 * self.p["integral_gain"] * (reference - n)
        return ca.vertcat(faster, pump, error, ramp * reference), thrust, command

    def steady(self, thrust: float) -> list[float]:
        """The states in which it gives ``thrust`` [N] for ever."""
        n, fuel = ca.SX.sym("n"), ca.SX.sym("fuel")
        faster, given = self.gas(n, fuel)
        find = ca.rootfinder("find", "newton", {"x": ca.vertcat(n, fuel), "g": ca.vertcat(faster, given - thrust)})
        speed, flow = (float(value) for value in np.asarray(find([0.8, 14.0 * self.p["air_flow"]], [])).ravel())
        return [speed, flow, flow + 1e3 * self.p["speed_gain"] * speed, speed]


def _turned(axis: Any, angle: Any, vector: Any) -> Any:
    """Rodrigues' formula."""
    axis = ca.DM(axis)
    c, s = ca.cos(angle), ca.sin(angle)
    return vector * c + ca.cross(axis, vector) * s + axis * ca.dot(axis, vector) * (1.0 - c)


def trip_speed(vehicle: Vehicle) -> float:
    """Return the speed over the ground [m/s] whose energy lifts a vehicle over legs that catch, all thrust gone.

    About the line between two legs, ``d`` from under the centre of gravity and ``h`` below it, the moment of momentum
    ``m v h`` stays, and the turning that it becomes has to lift the weight over the legs:

        ``(m v h)^2 / (2 I) = m g (sqrt(h^2 + d^2) - h)``,  ``I = I_c + m (h^2 + d^2)``

    It is what the evaluation of road vehicles calls critical sliding velocity; the least of all pairs of neighbours.
    Legs that slide, with the friction that the ground has, tip over later or never.
    """
    legs = [contact.position_m for contact in vehicle.contacts if contact.kind == "leg"]
    legs.sort(key=lambda place: atan2(place[1], place[0]))
    jx, jy, _ = vehicle.inertia_kg_m2
    slowest = inf
    for (ax, ay, az), (bx, by, bz) in zip(legs, [*legs[1:], *legs[:1]], strict=True):
        length, h = hypot(bx - ax, by - ay), 0.5 * (az + bz)
        d = abs(ax * by - ay * bx) / length
        inertia = (jx * (bx - ax) ** 2 + jy * (by - ay) ** 2) / length**2 + vehicle.mass_kg * (h * h + d * d)
        lift = sqrt(h * h + d * d) - h
        slowest = min(slowest, sqrt(2.0 * GRAVITY * lift * inertia / vehicle.mass_kg) / h)
    return slowest


class Problem:
    """A vehicle in hover at a height [m] that loses an engine, numbered from 1."""

    def __init__(self, vehicle: Vehicle, engine: str, lost: int) -> None:
        self.vehicle, self.lost = vehicle, lost - 1
        self.turbine = Turbine(engine)
        self.jets = [jet for jet in range(len(vehicle.jets)) if jet != self.lost]
        self.hinges = len(vehicle.hinges)
        self.legs = [c.position_m for c in vehicle.contacts if c.kind == "leg"]
        j = vehicle.inertia_kg_m2
        xy, xz, yz = vehicle.products_kg_m2
        self.inertia = ca.DM([[j[0], -xy, -xz], [-xy, j[1], -yz], [-xz, -yz, j[2]]])
        # height; velocity north, east, down; Euler angles; rates; hinges; speed of the lost engine; four a running one
        self.size = 10 + self.hinges + 1 + 4 * len(self.jets)
        self.slip = trip_speed(vehicle)

    def rotation(self, roll: Any, pitch: Any, yaw: Any) -> Any:
        """From body to world."""
        cr, sr, cp, sp, cy, sy = ca.cos(roll), ca.sin(roll), ca.cos(pitch), ca.sin(pitch), ca.cos(yaw), ca.sin(yaw)
        return ca.vertcat(
            ca.horzcat(cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy),
            ca.horzcat(cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy),
            ca.horzcat(-sp, sr * cp, cr * cp),
        )

    def change(self, x: Any, u: Any) -> tuple[Any, list[Any]]:
        """The derivative of the state, and the fuel commands of the running engines."""
        vehicle, hinges = self.vehicle, self.hinges
        velocity, angles, rates, turned = x[1:4], x[4:7], x[7:10], x[10 : 10 + hinges]
        at = 10 + hinges
        run_down, left = self.turbine.gas(x[at], 0.0)
        thrust: dict[int, Any] = {self.lost: left}
        engines, commands = [], []
        for number, jet in enumerate(self.jets):
            begin = at + 1 + 4 * number
            slopes, thrust[jet], command = self.turbine.running(x[begin : begin + 4], u[hinges + number])
            engines.append(slopes)
            commands.append(command)
        force, moment = ca.SX.zeros(3), ca.SX.zeros(3)
        for number, jet in enumerate(vehicle.jets):
            axis, place = ca.SX(ca.DM(jet.axis or (0.0, 0.0, -1.0))), ca.SX(ca.DM(jet.position_m))
            for index in reversed(range(hinges)):
                hinge = vehicle.hinges[index]
                if number + 1 in hinge.carries:
                    axis = _turned(hinge.axis, turned[index], axis)
                    point = ca.DM(hinge.position_m)
                    place = point + _turned(hinge.axis, turned[index], place - point)
                elif number + 1 in hinge.deflects:
                    axis = _turned(hinge.axis, hinge.effect * turned[index], axis)
            push = thrust[number] * axis
            force += push
            moment += ca.cross(place, push) - jet.reaction_m * push
        world = self.rotation(angles[0], angles[1], angles[2])
        wind = ca.mtimes(world.T, velocity)
        drag = 0.5 * DENSITY * ca.DM(vehicle.aero.drag_area_m2) * wind * ca.sqrt(wind * wind + 1e-6)
        pull = ca.mtimes(world, force - drag) / vehicle.mass_kg + ca.DM([0.0, 0.0, GRAVITY])
        sr, cr, tp, cp = ca.sin(angles[0]), ca.cos(angles[0]), ca.tan(angles[1]), ca.cos(angles[1])
        p, q, r = rates[0], rates[1], rates[2]
        euler = ca.vertcat(p + (q * sr + r * cr) * tp, q * cr - r * sr, (q * sr + r * cr) / cp)
        spin = ca.solve(self.inertia, moment - ca.cross(rates, ca.mtimes(self.inertia, rates)))
        return ca.vertcat(-velocity[2], pull, euler, spin, u[:hinges], run_down, *engines), commands

    def solve(
        self,
        height: float,
        detected: float,
        leg: int,
        slip: float | None = None,
        begin: tuple[Any, Any, Any] | None = None,
    ) -> tuple[float, tuple[Any, Any, Any]] | None:
        """The speed with which the fastest leg sinks as ``leg`` touches [m/s], with the trajectory.

        ``detected``: s after the loss at which hinges may move and throttles be set; ``slip``: most speed over the
        ground as it touches [m/s]; ``begin``: another trajectory to start from.  None where the optimiser finds none.
        """
        hinges, count, size = self.hinges, len(self.jets), self.size
        x, u = ca.SX.sym("x", size), ca.SX.sym("u", hinges + count)
        h = ca.SX.sym("h")
        slope = ca.Function("slope", [x, u], [self.change(x, u)[0]])
        k1 = slope(x, u)
        k2 = slope(x + h / 2 * k1, u)
        k3 = slope(x + h / 2 * k2, u)
        k4 = slope(x + h * k3, u)
        step = ca.Function("step", [x, u, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
        fuel = ca.Function("fuel", [x, u], [ca.vertcat(*self.change(x, u)[1])])
        feet = ca.Function("feet", [x], [ca.vertcat(*self._feet(x))])
        sinking = ca.Function(
            "sinking", [x], [-ca.jtimes(ca.vertcat(*self._feet(x)), x, slope(x, ca.SX.zeros(hinges + count)))]
        )

        opti, intervals, act = ca.Opti(), BEFORE + AFTER, detected + self.turbine.delay
        states, controls = opti.variable(size, intervals + 1), opti.variable(hinges + count, intervals)
        end, speed = opti.variable(), opti.variable()
        start = self._hover(height)
        scale = np.maximum(np.abs(start), 0.3)
        opti.subject_to((states[:, 0] - start) / scale == 0)
        least = [hinge.angle_limits[0] for hinge in self.vehicle.hinges]
        most = [hinge.angle_limits[1] for hinge in self.vehicle.hinges]
        rate = [hinge.rate_limit_rad_s for hinge in self.vehicle.hinges]
        p = self.turbine.p
        for k in range(intervals):
            length = act / BEFORE if k < BEFORE else (end - act) / AFTER
            opti.subject_to((states[:, k + 1] - step(states[:, k], controls[:, k], length)) / scale == 0)
            waiting = (k + 0.5) * act / BEFORE
            if k < BEFORE:
                opti.subject_to(controls[hinges:, k] == 0)
            else:
                opti.subject_to(opti.bounded(-p["deceleration"], controls[hinges:, k], p["acceleration"]))
            if k < BEFORE and waiting < detected:
                opti.subject_to(controls[:hinges, k] == 0)
            else:
                opti.subject_to(opti.bounded([-limit for limit in rate], controls[:hinges, k], rate))
            if k >= BEFORE:
                if k % 2 == 0:  # the ECU's mixtures
                    asked = fuel(states[:, k], controls[:, k])
                    for number in range(count):
                        air = 1e3 * self.turbine.air(states[10 + hinges + 1 + 4 * number, k])
                        opti.subject_to(
                            opti.bounded(p["leanest_command"] * air, asked[number], p["richest_command"] * air)
                        )
                opti.subject_to(feet(states[:, k]) >= 0)
        for number in range(hinges):
            opti.subject_to(opti.bounded(least[number], states[10 + number, :], most[number]))
        for number in range(count):
            opti.subject_to(opti.bounded(self.turbine.idle, states[10 + hinges + 4 + 4 * number, :], 1.0))
        for row in (4, 5):
            opti.subject_to(opti.bounded(-STEEPEST, states[row, :], STEEPEST))
            opti.subject_to(opti.bounded(-FLATTEST, states[row, intervals], FLATTEST))
        opti.subject_to(opti.bounded(0.5, end, 3.0))
        last = states[:, intervals]
        opti.subject_to(feet(last)[leg] == 0)
        opti.subject_to(feet(last) >= 0)
        opti.subject_to(sinking(last) <= speed)
        if slip is not None:
            opti.subject_to(last[1] ** 2 + last[2] ** 2 <= slip * slip)
        opti.minimize(speed + 1e-6 * ca.sumsqr(controls[:hinges, :]))
        opti.set_initial(end, 1.4)
        opti.set_initial(speed, 3.0)
        opti.set_initial(states, np.tile(np.array(start)[:, None], (1, intervals + 1)))
        opti.set_initial(states[0, :], np.linspace(height, self.legs[0][2], intervals + 1))
        opti.set_initial(states[3, :], np.linspace(0.0, 3.0, intervals + 1))
        opti.set_initial(controls[hinges:, BEFORE:], 0.2)
        if begin is not None:
            for variable, value in zip((states, controls, end), begin, strict=True):
                opti.set_initial(variable, value)
        opti.solver("ipopt", {"print_time": 0}, {"print_level": 0, "sb": "yes", "max_iter": 1500, "tol": 1e-6})
        try:
            solution = opti.solve()
        except RuntimeError:
            return None
        return float(solution.value(speed)), tuple(solution.value(v) for v in (states, controls, end))

    def _feet(self, x: Any) -> list[Any]:
        """Heights of the legs, m."""
        down = self.rotation(x[4], x[5], x[6])[2, :]
        return [x[0] - ca.mtimes(down, ca.DM(place)) for place in self.legs]

    def _hover(self, height: float) -> list[float]:
        engine = self.turbine.steady(self.vehicle.mass_kg * GRAVITY / len(self.vehicle.jets))
        rest = [hinge.rest_rad for hinge in self.vehicle.hinges]
        return [height, *[0.0] * 9, *rest, engine[0], *engine * len(self.jets)]


def best(vehicle: Vehicle, engine: str, lost: int, height: float, detected: float) -> tuple[float | None, float | None]:
    """The optimum with any speed sideways, and within what legs that catch allow [m/s]; None: none was found.

    It is followed from an engine that is known to be out at once to one that is detected after ``detected`` s.
    """
    problem = Problem(vehicle, engine, lost)
    place = vehicle.jets[lost - 1].position_m
    leg = max(range(len(problem.legs)), key=lambda k: place[0] * problem.legs[k][0] + place[1] * problem.legs[k][1])
    begin = upright = None
    answers: list[float | None] = [None, None]
    for late in np.linspace(0.0, detected, 1 + ceil(detected / 0.004 - 1e-9)):
        for number, slip in enumerate((None, problem.slip)):
            trials = [problem.solve(height, float(late), leg, slip, start) for start in (begin, upright)]
            solved = sorted((trial for trial in trials if trial), key=lambda trial: trial[0])
            answer = solved[0] if solved else None
            # it may be rising again as the leg touches
            answers[number] = max(0.0, answer[0]) if answer else None
            if answer:
                begin = answer[1]
            upright = trials[1][1] if trials[1] else upright
            said = f"{answer[0]:.2f} m/s" if answer else "nothing found"
            where = f"{vehicle.name}, engine {lost}, {height:g} m, detected after {late:.3f} s"
            print(f"{where}, sideways {slip or 'any'} m/s: {said}", flush=True)
    return answers[0], answers[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("aircraft", nargs="*", help=f"{', '.join(VEHICLES)}; without any: all of them")
    parser.add_argument("--height", type=float, default=3.0, help="m")
    parser.add_argument("--detected", type=float, default=0.016, help="s until the monitor has detected the loss")
    parser.add_argument("--write", action="store_true", help="write the table of docs/failsafes.md")
    options = parser.parse_args()
    for name in options.aircraft:
        if name not in VEHICLES:
            parser.error(f"aircraft {name!r}: must be one of {', '.join(VEHICLES)}")
    rows = []
    for name in options.aircraft or VEHICLES:
        vehicle, _ = load_vehicle(name)
        for lost in VEHICLES[name]:
            row = [name, str(lost), f"{vehicle.limits.touchdown_m_s:.1f}", f"{trip_speed(vehicle):.1f}"]
            for detected in (0.0, options.detected):
                values = best(vehicle, vehicle.engine, lost, options.height, detected)
                row += ["-" if value is None else f"{value:.1f}" for value in values]
            rows.append(row)
    heads = ["aircraft", "engine", "limit, m/s", "sideways, m/s"]
    for when in ("at once", f"after {1e3 * options.detected:g} ms"):
        heads += [f"detected {when}", f"detected {when}, sideways within"]
    lines = table(heads, rows)
    print(lines)
    if options.write:
        write_marks(PAGE, {"engine out, optimum": lines})


if __name__ == "__main__":
    main()
