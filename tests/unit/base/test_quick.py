"""What compiled code remembers of names and methods ends where they change: see ``cosim/base/quick.h``."""

from __future__ import annotations

import pytest

from cosim.base.signals import Actuation, Unallocated
from cosim.control.allocation import allocation
from cosim.control.allocation.allocation import RotorAllocator
from cosim.control.allocation.thrust_map import StaticCurve, ThrustMap
from cosim.control.predictors.smith import NoPredictor
from cosim.control.rate import RateAxis
from cosim.spec.vehicle import RateGains, load_vehicle


class Slotted:
    """A predictor without a dict of its own: its method is the type's."""

    __slots__ = ()

    def reset(self) -> None: ...

    def update(self, measured: float, applied: float) -> float:
        return 1.0


class Other(Slotted):
    __slots__ = ()

    def update(self, measured: float, applied: float) -> float:
        return 2.0


class Loose(Slotted):
    """With a dict, in which it may have a method of its own."""


def _axis() -> RateAxis:
    return RateAxis(RateGains(p=1.0, i=0.0, d=0.0, d_filter_s=0.02, integral_limit=1.0), NoPredictor(), 0.004)


def test_a_method_is_that_of_the_object_that_is_there() -> None:
    axis = _axis()
    seen = []
    for predictor in (Slotted(), Slotted(), Other(), Slotted(), Loose(), Other(), Other()):
        axis._use(predictor)
        axis.update(0.0, 0.0, 0.0)
        seen.append(axis.predicted)
    assert seen == [1.0, 1.0, 2.0, 1.0, 1.0, 2.0, 2.0]


def test_a_method_may_be_replaced_in_its_class_or_in_what_that_inherits_and_in_the_object() -> None:
    class Mine(Slotted):
        __slots__ = ()

    axis, loose = _axis(), Loose()
    axis._use(Mine())

    def answer() -> float:
        axis.update(0.0, 0.0, 0.0)
        return axis.predicted

    assert (answer(), answer()) == (1.0, 1.0)
    Mine.update = lambda self, measured, applied: 3.0  # type: ignore[method-assign]
    assert (answer(), answer()) == (3.0, 3.0)
    del Mine.update
    assert answer() == 1.0
    axis._use(loose)
    assert answer() == 1.0
    loose.update = lambda measured, applied: 4.0  # type: ignore[method-assign]
    assert answer() == 4.0


def test_what_a_dict_has_by_keys_that_are_gone_is_not_remembered() -> None:
    """The map looks its curves up by numbers, each made for that and let go of."""
    curves = [StaticCurve("one", (0.0, 0.4, 1.0), (0.0, bend, 10.0)) for bend in (3.0, 5.0, 7.0)]
    throttles = ThrustMap(curves[0], [curves[at] for at in (0, 1, 2, 0, 2, 1)]).throttle((0.5,) * 6)
    alone = [ThrustMap(curves[0], [curve]).throttle((0.5,))[0] for curve in curves]
    assert len(set(alone)) == 3
    assert throttles == tuple(alone[at] for at in (0, 1, 2, 0, 2, 1))


def test_a_name_is_what_the_module_has_by_it_now(monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle, _ = load_vehicle("quadrotor")
    allocator = RotorAllocator(vehicle.jets, vehicle.control.allocation, 0.5)
    told = []

    def noted(*fields: float) -> Unallocated:
        told.append(fields)
        return Unallocated(*fields)

    def allocate() -> Actuation:
        return allocator.allocate(0.5, (0.0, 0.0, 0.0))

    assert allocate() == allocate()
    assert not told
    monkeypatch.setattr(allocation, "Unallocated", noted)
    assert allocate() == allocate()
    assert len(told) == 2
    monkeypatch.undo()
    allocate()
    assert len(told) == 2
