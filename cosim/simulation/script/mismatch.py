"""A vehicle that is not the one its controller was made for: of another mass, off balance, with other engines.

Controller, predictor, allocation and engine monitor are made from what aircraft, identified models and engines state.
Here is what flies instead.  Without a mismatch every block is the one that it is without this module.
"""

from __future__ import annotations

from math import exp

from cosim.base.errors import InputError
from cosim.base.signals import PerJet, Vector3
from cosim.spec.scenario import Mismatch
from cosim.spec.vehicle import Vehicle


def apply_mismatch(vehicle: Vehicle, mismatch: Mismatch) -> Vehicle:
    """Return the vehicle that really flies where the controller assumes ``vehicle``; without a mismatch the same.

    Its body axes start from the true centre of gravity, to which the moments of inertia stated belong then.
    Raises InputError if there is more fuel than mass, or more inertia in a part than in the whole.
    """
    deformed = any((*mismatch.stretch, *mismatch.shear))
    if mismatch.mass_factor == mismatch.inertia_factor == 1.0 and not (deformed or any(mismatch.centre_m)):
        return vehicle
    mass = vehicle.mass_kg * mismatch.mass_factor
    fuel = vehicle.fuel
    if fuel is not None and fuel.mass_kg >= mass:
        raise InputError(
            f"mismatch.mass_factor = {mismatch.mass_factor:g}: {vehicle.name} would have {mass:g} kg, with "
            f"{fuel.mass_kg:g} kg of fuel in them"
        )

    def shift(place: Vector3) -> Vector3:
        x, y, z = mismatch.centre_m
        return (place[0] - x, place[1] - y, place[2] - z)

    changed = vehicle.model_copy(
        update={
            "mass_kg": mass,
            "inertia_kg_m2": tuple(mismatch.inertia_factor * moment for moment in vehicle.inertia_kg_m2),
            "products_kg_m2": tuple(mismatch.inertia_factor * product for product in vehicle.products_kg_m2),
            "jets": [jet.model_copy(update={"position_m": shift(jet.position_m)}) for jet in vehicle.jets],
            "hinges": [
                hinge.model_copy(
                    update={
                        "position_m": shift(hinge.position_m),
                        "centre_m": None if hinge.centre_m is None else shift(hinge.centre_m),
                    }
                )
                for hinge in vehicle.hinges
            ],
            "contacts": [
                contact.model_copy(update={"position_m": shift(contact.position_m)}) for contact in vehicle.contacts
            ],
            "aero": vehicle.aero.model_copy(update={"centre_m": shift(vehicle.aero.centre_m)}),
            "fuel": fuel and fuel.model_copy(update={"position_m": shift(fuel.position_m)}),
        }
    )
    if mismatch.inertia_factor != 1.0:
        _check_inertia(changed, f"mismatch.inertia_factor = {mismatch.inertia_factor:g}")
    return _deform(changed, mismatch) if deformed else changed


def _deform(vehicle: Vehicle, mismatch: Mismatch) -> Vehicle:
    """Return the vehicle with the mass of its structure stretched and sheared, its mass and centre kept.

    Where mass was at x it is at U x, U upper triangular: the second moments S, the integral of x x^T, become U S U^T,
    which are a body's again for every U.  The moments of inertia are tr(S) - S (Rucker, Wensing: Smooth
    Parameterization of Rigid-Body Inertia, IEEE RA-L 7 (2022) 2771).  Fuel stays where it is.
    """
    (xx, yy, zz), (xy, xz, yz) = vehicle.with_fuel(0.0).inertia_kg_m2, vehicle.products_kg_m2
    half = (xx + yy + zz) / 2.0
    second = ((half - xx, xy, xz), (xy, half - yy, yz), (xz, yz, half - zz))
    (x, y, z), (x_by_y, x_by_z, y_by_z) = map(exp, mismatch.stretch), mismatch.shear
    upper = ((x, x_by_y, x_by_z), (0.0, y, y_by_z), (0.0, 0.0, z))

    def change_of_moment(i: int, j: int) -> float:
        moved = (upper[i][m] * second[m][n] * upper[j][n] for m in range(3) for n in range(3))
        return sum(moved) - second[i][j]

    own = [change_of_moment(axis, axis) for axis in range(3)]
    moments = tuple(moment + sum(own) - part for moment, part in zip(vehicle.inertia_kg_m2, own, strict=True))
    products = (xy + change_of_moment(0, 1), xz + change_of_moment(0, 2), yz + change_of_moment(1, 2))
    deformed = vehicle.model_copy(update={"inertia_kg_m2": moments, "products_kg_m2": products})
    _check_inertia(deformed, f"mismatch.stretch = {list(mismatch.stretch)}, shear = {list(mismatch.shear)}")
    return deformed


def _check_inertia(vehicle: Vehicle, changed: str) -> None:
    """Raise InputError if a change leaves no inertia for the structure without fuel and banks."""
    a, b, c = sorted(vehicle.with_fuel(0.0).inertia_kg_m2)
    banks = 2.0 * vehicle.servo.bank_inertia_kg_m2 if vehicle.servo else 0.0
    # A flat body has a + b = c, which rounding may miss by some 1e-16.
    if a <= 0.0 or (a + b) * (1.0 + 1e-12) < c or banks >= vehicle.inertia_kg_m2[1]:
        raise InputError(
            f"{changed}: {vehicle.name} without its fuel and banks would have moments of inertia that no body has"
        )


def compute_engine_mismatch(mismatch: Mismatch, jets: int) -> tuple[PerJet | None, int]:
    """Return the factors on the engines' thrusts, None if all are 1, and their added delays in steps.

    Raises InputError for a factor of a jet that the vehicle has not.
    """
    factors_by_jet = mismatch.single_factors
    for number, factor in enumerate(factors_by_jet[jets:], jets + 1):
        if factor != 1.0:
            raise InputError(f"mismatch.thrust_factor_{number} = {factor:g}: the aircraft has jets 1 to {jets}")
    factors_by_jet += (1.0,) * (jets - len(factors_by_jet))
    factors = tuple(mismatch.thrust_factor * factor for factor in factors_by_jet[:jets])
    return (None if all(factor == 1.0 for factor in factors) else factors), mismatch.delay_samples
