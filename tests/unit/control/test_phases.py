"""Which law flies: hover where no other wants to, the first that does, and none that the engines' idling has ended."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from cosim.base.signals import NO_JETS, ZERO3, Command
from cosim.control.cascade import Cascade
from cosim.control.phases.hinged import HingedLean, SurfaceHover
from cosim.control.phases.law import Demand, FlightLaw, Selector
from cosim.control.phases.shut_opposite import ShutOpposite
from cosim.control.phases.spun import SpunFlight
from cosim.control.phases.wing import WingFlight
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario

LAWS = {
    "hover": [FlightLaw],
    "full-scale-hover": [ShutOpposite, FlightLaw],
    "octojet-hover": [ShutOpposite, FlightLaw],
    "trijet-hover": [FlightLaw],
    "quadjet-hover": [HingedLean, FlightLaw],
    "jetwing-hover": [HingedLean, WingFlight, SurfaceHover, FlightLaw],
}


@contextmanager
def cascade_of(scenario: str, **more: object) -> Iterator[Cascade]:
    with build(Scenario.load(scenario).replace(expect=[], command=[], monitor=True, **more)) as simulation:
        yield simulation.cascade


def asked(**more: object) -> Demand:
    step = Demand()
    step.command = Command(ZERO3, 10.0)._replace(**more)
    return step


def law_of(cascade: Cascade, kind: type[FlightLaw]) -> FlightLaw:
    (law,) = [law for law in cascade.selector.laws if type(law) is kind]
    return law


@pytest.mark.parametrize(("scenario", "kinds"), LAWS.items())
def test_a_vehicle_has_its_laws_and_hovers_by_the_last_or_its_surfaces(scenario: str, kinds: list) -> None:
    with cascade_of(scenario) as cascade:
        assert [type(law) for law in cascade.selector.laws] == kinds
        flying = type(Selector(cascade.selector.laws).select(asked()))
        assert flying is (SurfaceHover if SurfaceHover in kinds else FlightLaw)


def test_a_speed_ahead_is_for_the_wing_until_it_is_asked_for_no_more() -> None:
    with cascade_of("jetwing-hover") as cascade:
        wing, selector = law_of(cascade, WingFlight), Selector(cascade.selector.laws)
        assert isinstance(wing, WingFlight)
        step = asked(ahead=8.0)
        assert selector.select(step) is wing
        wing.steer(step)
        assert wing.is_flying
        for other in (asked(), asked(ahead=8.0, rate=ZERO3), asked(ahead=8.0, collective=0.5)):
            assert selector.select(asked(ahead=8.0)) is wing
            wing.steer(asked(ahead=8.0))
            assert selector.select(other) is not wing
            assert not wing.is_flying  # it has left
        step.is_idle = True
        assert selector.select(step) is not wing


def test_the_catch_waits_while_rates_are_asked_for_and_ends_with_idle_engines() -> None:
    with cascade_of("octojet-hover") as cascade:
        law, monitor, selector = law_of(cascade, ShutOpposite), cascade.monitor, Selector(cascade.selector.laws)
        monitor.mark_shut_off(0)
        across = law.handle_loss(monitor, 0.0)
        assert len(across) == 1
        assert [gain for jet, gain in enumerate(monitor.gains) if jet in across] == [0.0]
        assert law.handle_loss(monitor, 0.0) == NO_JETS  # of the second nobody shuts off another
        assert selector.select(asked()) is law
        assert selector.select(asked(rate=ZERO3)) is cascade.selector.laws[-1]
        assert selector.select(asked()) is law  # it goes on where it was
        selector.idle()
        assert selector.select(asked()) is cascade.selector.laws[-1]


def test_a_quadrotor_spins_with_its_first_rotor_lost_until_its_engines_idle() -> None:
    with cascade_of("hover", aircraft="quadrotor", engine="motor", controller="baseline") as cascade:
        law, monitor, selector = law_of(cascade, SpunFlight), cascade.monitor, Selector(cascade.selector.laws)
        assert selector.select(asked()) is cascade.selector.laws[-1]
        monitor.mark_shut_off(2)
        assert law.handle_loss(monitor, 0.0) == NO_JETS
        assert selector.select(asked(rate=ZERO3)) is law
        selector.idle()
        assert selector.select(asked()) is cascade.selector.laws[-1]
