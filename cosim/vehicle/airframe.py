"""The airframe: JSBSim behind SI units, FRD body axes and NED.

With :mod:`cosim.vehicle.jsbsim_model` the only place with lbf, ft and slug; :mod:`cosim.vehicle.executive` has JSBSim
itself.  One control step is ``substeps`` runs of JSBSim with every input held.

JSBSim moves the state first and evaluates forces after, so a force that is written before a step is first felt in the
run after the next: the method from acceleration to velocity makes up half a run of this (Adams and Bashforth) or none
(rectangular rule).  The rest is corrected here: in the first of several runs forces carry :data:`FORCE_EXTRAPOLATION`
of their change on top, which gives the velocities the impulse of forces that act from the step's beginning, exactly and
within the step.  With a single run a step there is no first run to correct, and a force acts half a run late, which the
delay ledger lists.

Where a payload comes or goes the mass jumps, not the force: :meth:`Airframe._step_mass_jump`.  With a single run a
step it is half a run late like the forces, as being late together costs least.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Sequence
from math import cos, isfinite, pi, radians, sin
from pathlib import Path
from typing import Any, Final

import numpy as np

from cosim.base.constants import GRAVITY
from cosim.base.errors import FlightError
from cosim.base.frames import cross, from_euler, rotate
from cosim.base.signals import ZERO3, Disturbance, PerServo, State, Vector3
from cosim.base.storage.scratch import scratch
from cosim.spec.scenario import Environment, Initial
from cosim.spec.vehicle import Vehicle
from cosim.vehicle._properties import Properties
from cosim.vehicle.executive import Complaint, Executive, Property
from cosim.vehicle.jsbsim_model import MOMENTUM_PROPERTY, PRODUCT_SIGN, PRODUCTS_OF_INERTIA, render, to_structural
from cosim.vehicle.jsbsim_units import FOOT, INCH, JSBSIM_POUNDS_PER_SLUG, POUND_FOOT, POUND_FORCE, SLUG, SLUG_FT2
from cosim.vehicle.mass_change import MassChange, PointMass, find_centre
from cosim.vehicle.model_file import read_model
from cosim.vehicle.model_trial import check_model_loads

# JSBSim's numbers of integration methods.
RECTANGULAR: Final = 1.0
ADAMS_BASHFORTH_2: Final = 3.0  # of second order
ADAMS_BASHFORTH_3: Final = 4.0  # of third order
BUSS_2: Final = 7.0  # exact at a constant angular rate
INTEGRATION_METHOD_NAMES: Final = {  # in summary and report
    RECTANGULAR: "rectangular rule",
    ADAMS_BASHFORTH_2: "Adams-Bashforth 2",
    ADAMS_BASHFORTH_3: "Adams-Bashforth 3",
    BUSS_2: "Buss 2",
}
POSITION_METHODS: Final = {"rotational": BUSS_2, "translational": ADAMS_BASHFORTH_3}  # for attitude and position
RATE_KINDS: Final = ("rotational", "translational")  # kinds of rates in property names
AIR_METHOD: Final = ADAMS_BASHFORTH_2  # integration of rates in the air
# JSBSim's friction is the force that stops a contact within one run of the rectangular rule. Adams and Bashforth's
# method would apply half as much again, and rates would oscillate from run to run for ever.
GROUND_METHOD: Final = RECTANGULAR  # of rates with ground contact
# Step that measures a surface's effect, as a fraction of its range, and its duration [s]: so small that tables are
# straight over it, and longer than the lags of actuators.
SURFACE_TEST_STEP: Final = (0.05, 2.0)
# Fraction of a force's change that the first run of a step adds, by integration method.
FORCE_EXTRAPOLATION: Final = {AIR_METHOD: 0.5, GROUND_METHOD: 1.0}

_POUND_PER_SQUARE_FOOT: Final = POUND_FORCE / FOOT**2  # Pa
_NED = ("north", "east", "down")  # axes of NED
_ZERO: Final[Any] = ZERO3  # shared zero vector
_STATE: Final = State  # direct access in compiled code
_number = itertools.count()  # counts the airframes of this process

Node = Callable[[str], Property]  # returns a property by name
Payload = tuple[float, float, float, float]  # kg, m from the nominal centre, body
Get = Callable[[], float]
Set = Callable[[float], object]


class _PropertyReader:
    """Reads three properties of JSBSim, ``name`` with each of ``parts``, as a vector in SI units."""

    def __init__(self, node: Node, name: str, parts: Sequence[str], unit: float = 1.0) -> None:
        # Typed as a callable of float, so that compiled code multiplies without making an object.
        x, y, z = [node(name.format(part)).get_double_value for part in parts]
        self._x: Get = x
        self._y: Get = y
        self._z: Get = z
        self._unit = unit

    def get(self) -> Vector3:
        unit = self._unit
        return (self._x() * unit, self._y() * unit, self._z() * unit)


class _PropertyWriter:
    """Writes a vector in SI units to three properties of JSBSim, ``name`` with each of ``parts``."""

    def __init__(self, node: Node, name: str, parts: Sequence[str], unit: float = 1.0) -> None:
        x, y, z = [node(name.format(part)).set_double_value for part in parts]
        self._x: Set = x
        self._y: Set = y
        self._z: Set = z
        self._unit = unit

    def put(self, x: float, y: float, z: float) -> None:
        """Write a vector in SI units to the three JSBSim properties."""
        unit = self._unit
        self._x(x / unit)
        self._y(y / unit)
        self._z(z / unit)


def _group_properties(node: Node, name: str, parts: Sequence[str], unit: float = 1.0) -> tuple[Any, Any, Any, float]:
    """Return three properties and their unit, which are read or written with others in one call."""
    x, y, z = [node(name.format(part)) for part in parts]
    return (x, y, z, unit)


class Airframe:
    """Airframe of one vehicle, simulated by JSBSim.

    ``step`` and ``substeps``: control step [s] and JSBSim runs in it.  ``rotors``: spinning rotors are modelled;
    without them the model is the file's own.  Raises InputError if the model does not load.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        folder: Path,
        environment: Environment,
        step: float,
        substeps: int,
        seed: int,
        rotors: bool = False,
    ) -> None:
        self.substeps = substeps
        self.moving = True  # False: without JSBSim, to time the rest
        self._rotors = rotors
        self._vehicle = vehicle
        self._environment = environment
        self._file = scratch() / f"{vehicle.name}-{next(_number)}.xml"
        self._source = None if vehicle.model is None else folder / vehicle.model
        self._dt = step / substeps
        # JSBSim has two generators with a seed each, a C int: one for turbulence, one for the model's sensors and
        # <random/>. Equal seeds would give equal numbers in both, and close seeds begin alike, so the second seed is
        # drawn with a key of its own (0 to 6 belong to sensors, plug-ins and the stand). The generator takes its seed
        # modulo 2^31 - 1, and 0 as 1.
        drawn = np.random.SeedSequence(seed, spawn_key=(7,)).generate_state(1)[0]
        self._seeds = {
            "atmosphere/randomseed": float(seed % 2**31),
            "simulation/randomseed": float(1 + drawn % (2**31 - 2)),
        }
        try:
            xml = render(vehicle, self._source, rotors)
            self.sha256 = hashlib.sha256(xml).hexdigest()  # hash of the model that is flown
            text = read_model(self._source)
            self.file_sha256 = hashlib.sha256(text).hexdigest()
            if self._source is not None:
                check_model_loads(xml, self._source, text)
            self._file.write_bytes(xml)
            self._load_model()
        except BaseException:
            self.close()
            raise

    def _load_model(self) -> None:
        self._jsbsim = Executive(self._file, self._source, self._vehicle.name, self._dt)
        self._fdm = self._jsbsim.fdm
        self._run: Callable[[], bool] = self._jsbsim.run if self.moving else _skip_run
        self._fresh = True
        self._bind_properties()
        for name, seed in self._seeds.items():
            self._set_property(name, seed)
        for kind, position_method in POSITION_METHODS.items():
            self._set_property(f"simulation/integrator/position/{kind}", position_method)
        self._set_methods(AIR_METHOD)

    def _bind_properties(self) -> None:
        node = self._property
        self._place = _PropertyReader(node, "position/from-start-neu-{}-ft", "neu", FOOT)
        motion = [
            _group_properties(node, "position/from-start-neu-{}-ft", "neu", FOOT),
            _group_properties(node, "velocities/v-{}-fps", _NED, FOOT),
            _group_properties(node, "attitude/{}-rad", ("phi", "theta", "psi")),
            _group_properties(node, "velocities/{}-rad_sec", "pqr"),
            _group_properties(node, "accelerations/a-pilot-{}-ft_sec2", "xyz", FOOT),
        ]
        self._motion: Callable[[], tuple[Any, ...] | None] = Properties(motion, 4).read
        # JSBSim's height above the ground is this minus the ground's, to the last bit. Reading that height directly
        # would also compute the point on the ground below, which costs some hundredths of a run.
        self._over_ellipsoid: Get = node("position/geod-alt-ft").get_double_value
        self._ground = self._environment.ground_m / FOOT
        self._wind = _PropertyReader(node, "atmosphere/total-wind-{}-fps", _NED, FOOT)
        self._air_rate = _PropertyReader(node, "atmosphere/{}-turb-rad_sec", "pqr")
        self._get_mass: Get = node("inertia/mass-slugs").get_double_value
        names = [f"external_reactions/jet{jet}" for jet in range(1, len(self._vehicle.jets) + 1)]
        jets = Properties([_group_properties(node, f"{name}/{{}}", "xyz", POUND_FORCE) for name in names])
        self._put: Callable[..., object] = jets.write
        self._push = _PropertyWriter(node, "external_reactions/push/{}", "xyz", POUND_FORCE)
        self._twist = _PropertyWriter(node, "external_reactions/twist/{}", "lmn", POUND_FOOT)
        self._methods = [node(f"simulation/integrator/rate/{kind}").set_double_value for kind in RATE_KINDS]
        for name in [*names, "external_reactions/push"]:
            node(f"{name}/magnitude").set_double_value(1.0)
            node(f"{name}/y").set_double_value(0.0)
        node("external_reactions/twist/magnitude-lbsft").set_double_value(1.0)
        self._push.put(0.0, 0.0, 0.0)  # replaces the directions in the file
        self._twist.put(0.0, 0.0, 0.0)
        self._legs, self._hull = self._contact_getters("leg"), self._contact_getters("hull")
        self._set_wind = _PropertyWriter(node, "atmosphere/wind-{}-fps", _NED, FOOT)
        self._set_payload = node("inertia/pointmass-weight-lbs").set_double_value
        self._payload_place = _PropertyWriter(node, "inertia/pointmass-location-{}-inches", "XYZ")
        self._mass_change = MassChange(self._jsbsim)
        self._momentum = _PropertyWriter(node, MOMENTUM_PROPERTY, "xyz", SLUG_FT2) if self._rotors else None
        self._pressure: Get = node("atmosphere/P-psf").get_double_value
        self._temperature: Get = node("atmosphere/T-R").get_double_value
        self._surfaces: list[Set] = [node(surface.property).set_double_value for surface in self._vehicle.surfaces]
        if self._vehicle.fuel:
            # :func:`render` adds the payload as the last point mass.
            weights = self._fdm.query_property_catalog("inertia/pointmass-weight-lbs").splitlines()
            self._set_burnt = node(f"inertia/pointmass-weight-lbs[{len(weights) - 1}]").set_double_value

    def _contact_getters(self, kind: str) -> list[Get]:
        """Return the functions that tell whether each contact of this kind touches the ground."""
        kinds = enumerate(contact.kind for contact in self._vehicle.contacts)
        return [self._property(f"contact/unit[{unit}]/WOW").get_double_value for unit, other in kinds if other == kind]

    def _property(self, name: str) -> Property:
        return self._jsbsim.node(name)

    def _set_property(self, name: str, value: float) -> None:
        self._property(name).set_double_value(value)

    def reset(
        self,
        initial: Initial,
        forces: list[Vector3],
        wind: Vector3,
        momentum: Vector3 | None = None,
        burnt: float = 0.0,
    ) -> State:
        """Place the vehicle at its initial state with ``forces`` (N, body, one per jet) acting.

        ``momentum``: of the rotors, as for :meth:`set_momentum`; ``burnt``: fuel [kg] that it lacks from the start.
        Raises InputError where the model's forces are not finite there.
        """
        if not self._fresh:
            # JSBSim's own reset leaves traces in the initial state; a new instance is the same to the last bit.
            self._load_model()
        self._fresh = False
        place = self._environment
        height = start_height(self._vehicle, initial)
        settings = {
            "ic/lat-geod-deg": place.latitude_deg,
            "ic/long-gc-deg": place.longitude_deg,
            "ic/terrain-elevation-ft": place.ground_m / FOOT,
            "ic/h-agl-ft": height / FOOT,
        }
        for axis, angle in zip(("phi-deg", "theta-deg", "psi-true-deg"), initial.attitude_deg, strict=True):
            settings[f"ic/{axis}"] = angle
        for axis, speed in zip(("vn", "ve", "vd"), initial.velocity_ned_m_s, strict=True):
            settings[f"ic/{axis}-fps"] = speed / FOOT
        for axis, rate in zip("pqr", initial.rate_deg_s, strict=True):
            settings[f"ic/{axis}-rad_sec"] = radians(rate)
        for name, value in settings.items():
            self._set_property(name, value)
        self._disturbance = Disturbance()
        self._forces, self._pushed, self._twisted = forces, ZERO3, ZERO3
        self._full = self._mass = self._get_mass() * SLUG
        self._burnt = 0.0
        self._spin = ZERO3
        self._is_extrapolated = False  # True: has the first run's extra change
        if burnt:
            self.burn(burnt)
        turbulence = 4.0 if place.turbulence_severity else 0.0  # 4: MIL-F-8785C, Tustin form
        # JSBSim settles without time passing, and its turbulence divides by that time if there is a speed.
        self._set_property("atmosphere/turb-type", 0.0 if any(initial.velocity_ned_m_s) else turbulence)
        self._set_property("atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps", place.turbulence_wind_m_s / FOOT)
        self._set_property("atmosphere/turbulence/milspec/severity", float(place.turbulence_severity))
        self._write_loads(forces, ZERO3, ZERO3)
        self._apply_disturbance(Disturbance(wind=wind))
        if momentum and self._rotors:
            self.set_momentum(momentum)
        self._jsbsim.start()
        self._set_property("atmosphere/turb-type", turbulence)
        self._still = not (place.turbulence_severity or any(wind))
        self._turbulent = place.turbulence_severity > 0
        # JSBSim's "up" has a datum of its own; ours is the ground below the start.
        self._datum = self._place.get()[2] - height
        state = self._read_state()
        if not all(map(isfinite, state.specific_force)):
            raise self._jsbsim.explain_not_finite()
        return state

    def step(self, forces: list[Vector3], disturbance: Disturbance, moment: Vector3 = ZERO3) -> State:
        """Advance one control step with ``forces`` (N, body, at the stations) and ``disturbance`` held.

        ``moment``: of the rotors on the frame, N m, body, without the gyroscopic part (see :meth:`set_momentum`).
        Raises FlightError when JSBSim stops or the state is no longer finite.
        """
        if self._touching != (self._method == GROUND_METHOD):
            self._set_methods(GROUND_METHOD if self._touching else AIR_METHOD)
        old: Payload | None = None  # the previous payload, if it differs
        if disturbance is not self._disturbance:
            if disturbance.payload != self._disturbance.payload:
                old = self._disturbance.payload
            self._apply_disturbance(disturbance)
        push, twist = disturbance.force, _add(disturbance.moment, moment)
        run, runs = self._run, self.substeps
        try:
            if old is not None and runs > 1:
                self._end_extrapolation()
                ended = not self._step_mass_jump(old, forces, push, twist)
                runs -= 1
            elif runs > 1:
                self._write_extrapolated(forces, push, twist, self._extrapolation)
                ended = not run()
                runs -= 1
                if self._is_extrapolated:
                    self._end_extrapolation()
            else:
                ended = False
            self._write_loads(forces, push, twist)
            for _ in range(runs):
                ended = not run() or ended
        except Complaint as error:
            raise self._jsbsim.flight_error(error) from None
        if ended:
            raise FlightError("JSBSim ended the run")
        return self._read_state()

    def _step_mass_jump(self, old: Payload, forces: list[Vector3], push: Vector3, twist: Vector3) -> bool:
        """Run the first part of a step in which the payload changed from ``old``; return whether JSBSim continues.

        See :mod:`cosim.vehicle.mass_change`.  The new centre of gravity gets its velocity by a force in the first run's
        accelerations alone, of twice the size: the method of Adams and Bashforth takes half of it back in the run
        after.  Over these runs the place gains half a run of that velocity, which it is begun behind by.  On the ground
        nothing turns, and the velocity stays.
        """
        before, after = self._find_centre(old), self._find_centre(self._disturbance.payload)
        shift = (after[0] - before[0], after[1] - before[1], after[2] - before[2])
        x, y, z = cross(self.inertial_rate(), shift)
        size = 0.0
        if not self._touching:
            size = 2.0 * self._mass / self._dt
            shift = _extrapolate(shift, (shift[0] + x, shift[1] + y, shift[2] + z), 0.5 * self._dt)
        jolt = (size * x, size * y, size * z)
        # The impulse acts at the centre of gravity as built, without moment about the present one.
        self._write_loads(forces, _add(push, jolt), _add(twist, cross(after, jolt)))
        self._mass_change.shift_centre(rotate(self._read_state().attitude, shift))
        self._mass_change.evaluate(self._run)
        self._set_methods(GROUND_METHOD)
        self._write_loads(forces, push, twist)
        goes_on = self._run()
        if not self._touching:
            self._set_methods(AIR_METHOD)
        return goes_on

    def _find_centre(self, payload: Payload) -> Vector3:
        """Return the centre of gravity [m, body] with a payload, relative to that of the vehicle as built."""
        others: list[PointMass] = [(payload[0], payload[1:])]
        if self._vehicle.fuel:
            others.append((-self._burnt, self._vehicle.fuel.position_m))
        return find_centre(self._vehicle.mass_kg, others)

    def jsbsim_run(self) -> Callable[[], bool]:
        """Return JSBSim's ``run``, valid until the next reset: one step with inputs held, for timing."""
        return self._run

    def _set_methods(self, method: float) -> None:
        """Set the integration method of rotational and translational rates from the next run on."""
        for set_method in self._methods:
            set_method(method)
        self._method, self._extrapolation = method, FORCE_EXTRAPOLATION[method]

    def _write_loads(self, forces: list[Vector3], push: Vector3, twist: Vector3) -> None:
        """Write jet forces [N], and force and moment at the centre of gravity as built, for the end of the next run."""
        self._put(forces)
        self._write_body_load(push, twist)
        self._forces = forces

    def _write_extrapolated(self, forces: list[Vector3], push: Vector3, twist: Vector3, share: float) -> None:
        """Write loads with ``share`` of their change since the last ones on top; the last jet forces stay stored."""
        self._put(forces, self._forces, share)
        if push != self._pushed:
            push = _extrapolate(push, self._pushed, share)
        if twist != self._twisted:
            twist = _extrapolate(twist, self._twisted, share)
        self._write_body_load(push, twist)

    def _write_body_load(self, push: Vector3, twist: Vector3) -> None:
        if push != self._pushed:
            self._push.put(push[0], push[1], push[2])
        if twist != self._twisted:
            self._twist.put(twist[0], twist[1], twist[2])
        self._pushed, self._twisted = push, twist

    def _apply_disturbance(self, disturbance: Disturbance) -> None:
        """Apply changes of disturbances other than force and moment."""
        old = self._disturbance
        self._set_wind.put(*disturbance.wind)
        if any(disturbance.wind) or disturbance.gust:
            self._still = False
        if disturbance.payload != old.payload:
            self._apply_payload(disturbance.payload)
        if disturbance.gust:
            self._start_gust(*disturbance.gust)
        self._disturbance = disturbance

    def _apply_payload(self, payload: Payload) -> None:
        mass, x, y, z = payload
        self._set_payload(mass / SLUG * JSBSIM_POUNDS_PER_SLUG)
        self._payload_place.put(*to_structural((x, y, z)))
        self._full = sum((self._vehicle.mass_kg, mass))
        self._mass = self._full - self._burnt

    def prepare_step(self, momentum: Vector3, burnt: float, tilt: PerServo = ()) -> None:
        """Set the rotors' ``momentum`` [kg m^2/s, body], the ``burnt`` fuel [kg] and the surfaces of the next step.

        Momentum and fuel act from its beginning, as forces do: the first run has :data:`FORCE_EXTRAPOLATION` of their
        change on top.  ``tilt``: the angles of all servos; the last are those of the surfaces.
        """
        if self._surfaces:
            first = len(tilt) - len(self._surfaces)
            for number, surface in enumerate(self._surfaces):
                surface(tilt[first + number])
        if burnt != self._burnt:
            self._set_burnt_fuel(burnt + self._first_run_extra() * (burnt - self._burnt))
            self._burnt, self._mass = burnt, self._full - burnt
            self._is_extrapolated = True
        if self._momentum is not None and momentum != self._spin:
            x, y, z = _extrapolate(momentum, self._spin, self._first_run_extra())
            self._momentum.put(x, y, z)
            self._spin = momentum
            self._is_extrapolated = True

    def _first_run_extra(self) -> float:
        """Return the fraction of a load's change that the first run of a step adds to it."""
        return self._extrapolation if self.substeps > 1 else 0.0

    def _end_extrapolation(self) -> None:
        """Write fuel and rotor momentum without the first run's extra change."""
        self._is_extrapolated = False
        if self._burnt:
            self._set_burnt_fuel(self._burnt)
        if self._momentum is not None:
            self.set_momentum(self._spin)

    def set_momentum(self, momentum: Vector3) -> None:
        """Set the rotors' angular momentum (kg m^2/s, body, relative to the airframe) from the next run on.

        At every run JSBSim then adds the gyroscopic moment ``momentum x omega`` with the inertial body rates omega, and
        integrates it with all other moments, in the air by the method of Adams and Bashforth of second order: a
        nutation neither grows nor dies to speak of, where the rectangular rule would feed energy into it.
        """
        assert self._momentum is not None
        self._momentum.put(momentum[0], momentum[1], momentum[2])
        self._spin = momentum

    def burn(self, mass: float) -> None:
        """Remove ``mass`` [kg] of fuel from the next run on: mass, centre of gravity and inertia follow.

        The fuel is a point mass in its tank, and what is burnt a negative one beside the vehicle as built.
        """
        self._set_burnt_fuel(mass)
        self._burnt = mass
        self._mass = self._full - mass

    def _set_burnt_fuel(self, mass: float) -> None:
        """Set the burnt fuel [kg], a negative point mass of JSBSim."""
        self._set_burnt(-mass / SLUG * JSBSIM_POUNDS_PER_SLUG)

    def air(self) -> tuple[float, float]:
        """Return static pressure [Pa] and temperature [K] of the air where the vehicle is."""
        return self._pressure() * _POUND_PER_SQUARE_FOOT, self._temperature() * (5.0 / 9.0)

    def _start_gust(self, velocity: Vector3, rise: float, hold: float, fall: float) -> None:
        gust = "atmosphere/cosine-gust"
        size = sum(v * v for v in velocity) ** 0.5
        self._set_property(f"{gust}/startup-duration-sec", rise)
        self._set_property(f"{gust}/steady-duration-sec", hold)
        self._set_property(f"{gust}/end-duration-sec", fall)
        self._set_property(f"{gust}/magnitude-ft_sec", size / FOOT)
        self._set_property(f"{gust}/frame", 3.0)  # local frame: NED
        for axis, speed in zip("XYZ", velocity, strict=True):
            self._set_property(f"{gust}/{axis}-velocity-ft_sec", speed / FOOT)
        self._set_property(f"{gust}/start", 1.0)

    def _read_state(self) -> State:
        motion = self._motion()
        if motion is None:
            raise FlightError("the airframe's state is not finite")
        # Kept as objects, because compiled code would otherwise unpack all of them.
        place: tuple[Any, Any, float] = motion[0]
        euler: Any = motion[2]
        north, east, up = place
        angles: Vector3 = euler
        roll, pitch, yaw = angles
        height = (self._over_ellipsoid() - self._ground) * FOOT
        # Contacts are checked below 2 m only.
        near = height < 2.0
        on_ground = near and any(touches() > 0.0 for touches in self._legs)
        hull_contact = near and any(touches() > 0.0 for touches in self._hull)
        self._touching = on_ground or hull_contact
        return _STATE(
            (north, east, self._datum - up),
            motion[1],
            from_euler(roll, pitch, yaw),
            euler if yaw < pi else (roll, pitch, yaw - 2.0 * pi),
            motion[3],
            motion[4],
            height,
            _ZERO if self._still else self._wind.get(),
            self._mass,
            on_ground,
            hull_contact,
            self._air_rate.get() if self._turbulent else _ZERO,
        )

    def external_wrench(self) -> tuple[Vector3, Vector3]:
        """Return the wrench of JSBSim's external forces: N, and N m about the present centre of gravity, body."""
        get = self._fdm.get_property_value
        force = [get(f"forces/fb{axis}-external-lbs") * POUND_FORCE for axis in "xyz"]
        moment = [get(f"moments/{axis}-external-lbsft") * POUND_FOOT for axis in "lmn"]
        return (force[0], force[1], force[2]), (moment[0], moment[1], moment[2])

    def mass_properties(self) -> tuple[float, Vector3, Vector3]:
        """Mass (kg), centre of gravity (m, body, from that of the vehicle as built), moments of inertia (kg m^2)."""
        get = self._fdm.get_property_value
        cg = [get(f"inertia/cg-{axis}-in") * INCH for axis in "xyz"]
        inertia = [get(f"inertia/i{axis}{axis}-slugs_ft2") * SLUG_FT2 for axis in "xyz"]
        return get("inertia/mass-slugs") * SLUG, (-cg[0], cg[1], -cg[2]), (inertia[0], inertia[1], inertia[2])

    def products_of_inertia(self) -> Vector3:
        """Return JSBSim's products of inertia: integrals of x y, x z and y z over the mass [kg m^2, body]."""
        names = zip(PRODUCTS_OF_INERTIA, ("xy", "xz", "yz"), strict=True)
        xy, xz, yz = [
            PRODUCT_SIGN[name] * self._fdm.get_property_value(f"inertia/i{axes}-slugs_ft2") * SLUG_FT2
            for name, axes in names
        ]
        return (xy, xz, yz)

    def aerodynamic_wrench(self) -> tuple[Vector3, Vector3]:
        """Return the model's aerodynamic wrench: N, and N m about the present centre of gravity, body."""
        get = self._fdm.get_property_value
        force = [get(f"forces/fb{axis}-aero-lbs") * POUND_FORCE for axis in "xyz"]
        moment = [get(f"moments/{axis}-aero-lbsft") * POUND_FOOT for axis in "lmn"]
        return (force[0], force[1], force[2]), (moment[0], moment[1], moment[2])

    def surface_effects(self) -> list[tuple[float, ...]]:
        """Return each surface's force [N] and moment [N m] per unit of its property and Pa of dynamic pressure.

        In body axes, about the centre of gravity as built, by what the model says a little to either side of zero, each
        surface at its ``at_m_s`` straight ahead and level, with the state held until its own actuators have settled.
        """
        effects = []
        for surface in self._vehicle.surfaces:
            ends = []
            size = SURFACE_TEST_STEP[0] * max(-surface.range[0], surface.range[1])
            for deflection in (size, -size):
                flying = Initial(altitude_m=100.0, velocity_ned_m_s=(surface.at_m_s, 0.0, 0.0))
                self.reset(flying, [ZERO3] * len(self._vehicle.jets), ZERO3)
                for kind in ("rotational", "translational"):
                    self._set_property(f"simulation/integrator/rate/{kind}", 0.0)
                    self._set_property(f"simulation/integrator/position/{kind}", 0.0)
                self._set_property(surface.property, deflection)
                for _ in range(round(SURFACE_TEST_STEP[1] / self._dt)):
                    self._fdm.run()
                force, moment = self.aerodynamic_wrench()
                ends.append((*force, *moment))
            pressure = self._fdm.get_property_value("aero/qbar-psf") * _POUND_PER_SQUARE_FOOT
            effects.append(tuple((a - b) / (2.0 * size * pressure) for a, b in zip(*ends, strict=True)))
        return effects

    def wing_effects(self, alphas: Sequence[float], at_m_s: float) -> tuple[list[float], list[float], list[float]]:
        """Return lift and drag [N] and pitching moment [N m] per Pa of dynamic pressure, by angle of attack [rad].

        The moment is about the centre of gravity as built, in level flight at ``at_m_s``; surfaces at zero, no rates.
        """
        self.reset(
            Initial(altitude_m=100.0, velocity_ned_m_s=(at_m_s, 0.0, 0.0)), [ZERO3] * len(self._vehicle.jets), ZERO3
        )
        answer: tuple[list[float], list[float], list[float]] = ([], [], [])
        for alpha in alphas:
            self._set_property("ic/theta-rad", alpha)
            self._set_property("ic/vn-fps", at_m_s / FOOT)
            self._set_property("ic/vd-fps", 0.0)
            self._jsbsim.start()
            force, moment = self.aerodynamic_wrench()
            pressure = self._fdm.get_property_value("aero/qbar-psf") * _POUND_PER_SQUARE_FOOT
            c, s = cos(alpha), sin(alpha)
            values = (force[0] * s - force[2] * c, -force[0] * c - force[2] * s, moment[1])
            for column, value in zip(answer, values, strict=True):
                column.append(value / pressure)
        return answer

    def inertial_rate(self) -> Vector3:
        """Body rates against inertial space, rad/s."""
        p, q, r = (self._fdm.get_property_value(f"velocities/{axis}i-rad_sec") for axis in "pqr")
        return (p, q, r)

    def latitude_longitude_deg(self) -> tuple[float, float]:
        """Geodetic latitude and longitude, degrees."""
        get = self._fdm.get_property_value
        return get("position/lat-geod-deg"), get("position/long-gc-deg")

    def close(self) -> None:
        """Remove the temporary model; may be called twice."""
        self._file.unlink(missing_ok=True)


def _skip_run() -> bool:
    """Do nothing in place of a run of JSBSim, for an airframe that does not move."""
    return True


def _add(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _extrapolate(new: Vector3, old: Vector3, share: float) -> Vector3:
    """Return ``new`` extrapolated by ``share`` of the way from ``old`` to it."""
    x, y, z = new
    return (x + share * (x - old[0]), y + share * (y - old[1]), z + share * (z - old[2]))


def standing_height(vehicle: Vehicle) -> float:
    """Return the height of the centre of gravity above the ground [m] of a vehicle at rest on its legs."""
    legs = [contact for contact in vehicle.contacts if contact.kind == "leg"]
    lowest = max(leg.position_m[2] for leg in legs)
    standing = [leg for leg in legs if leg.position_m[2] == lowest]
    sink = vehicle.mass_kg * GRAVITY / sum(leg.spring_n_m for leg in standing)
    return lowest - sink


def start_height(vehicle: Vehicle, initial: Initial) -> float:
    """Return the height of the centre of gravity above the ground [m] at the start of a flight."""
    return standing_height(vehicle) if initial.on_ground else initial.altitude_m
