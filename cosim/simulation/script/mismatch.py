"""A vehicle that is not the one its controller was made for: of another mass, off balance, with other engines.

Controller, predictor, allocation and engine monitor are made from what aircraft, identified models and engines state.
Here is what flies instead.  Without a mismatch every block is the one that it is without this module.
"""

from __future__ import annotations

from cosim.base.errors import InputError
from cosim.base.signals import PerJet, Vector3
from cosim.spec.scenario import Mismatch
from cosim.spec.vehicle import Vehicle


def apply_mismatch(vehicle: Vehicle, mismatch: Mismatch) -> Vehicle:
    """Return the vehicle that really flies where the controller assumes ``vehicle``; without a mismatch the same.

    Its body axes start from the true centre of gravity, to which the moments of inertia stated belong then.
    Raises InputError if there is more fuel than mass, or more inertia in a part than in the whole.
    """
    if mismatch.mass_factor == 1.0 and mismatch.inertia_factor == 1.0 and not any(mismatch.centre_m):
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
        _check_inertia(changed, mismatch.inertia_factor)
    return changed


def _check_inertia(vehicle: Vehicle, factor: float) -> None:
    """Raise InputError if an inertia factor leaves no inertia for the structure without fuel and banks."""
    a, b, c = sorted(vehicle.with_fuel(0.0).inertia_kg_m2)
    banks = 2.0 * vehicle.servo.bank_inertia_kg_m2 if vehicle.servo else 0.0
    if a <= 0.0 or a + b < c or banks >= vehicle.inertia_kg_m2[1]:
        raise InputError(
            f"mismatch.inertia_factor = {factor:g}: {vehicle.name} without its fuel and banks would have moments of "
            "inertia that no body has"
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
