"""The user's blocks: predictors, loops and whole controllers, sensors behind the built-in ones, and winds."""

from __future__ import annotations

from typing import Any, Protocol

from cosim.base.protocols.records import Applied
from cosim.base.signals import Command, Measured, State, Vector3


class Predictor(Protocol):
    """Predicts the rate without the engines' delay, between measured rate and rate controller of one axis.

    One that has a ``diagnostics: Diagnostics`` is shown with it.
    """

    def reset(self) -> None:
        """Reset to rest with no command applied."""

    def update(self, measured: float, applied: float) -> float:
        """Return the predicted rate [rad/s] to feed back at ``t_k``; called once a step.

        Parameters
        ----------
        measured : float
            The body rate there [rad/s].
        applied : float
            The command over the step before as allocation gave it: throttle on roll, rad of tilt on pitch and yaw.
        """


class RateLoop(Protocol):
    """A user's rate loop, ``level = "rate"``, between the built-in attitude loop and allocation.

    As every block from outside it may have ``prepare(belief)``, called once before the first reset, ``parameters`` and,
    as :class:`Shows` says, ``columns`` and ``shown``; see docs/own-controller.md.
    """

    def reset(self) -> None:
        """Reset to rest with no torque applied."""

    def update(self, setpoint: Vector3, measured: Vector3, applied: Vector3) -> Vector3:
        """Return the torque for a step: roll in throttle, pitch and yaw in rad of tilt; called once a step.

        Parameters
        ----------
        setpoint : Vector3
            Body rates asked for [rad/s].
        measured : Vector3
            Body rates at ``t_k`` [rad/s].
        applied : Vector3
            Last step's answer, less what could not be given of it.
        """


class AttitudeLoop(Protocol):
    """A user's attitude loop, ``level = "attitude"``, above the built-in rate loop.

    That is fed by the predictor that its attribute ``predictor`` names.  What else it may have: see :class:`RateLoop`.
    """

    def reset(self) -> None:
        """Reset to rest."""

    def update(self, command: Command, measured: Measured) -> Vector3:
        """Return the set-point of body rates [rad/s] for a step; not called while rates are commanded.

        Parameters
        ----------
        command : Command
            Its ``attitude`` is asked for.
        measured : Measured
            What is seen at ``t_k``.
        """


class WholeController(Protocol):
    """A user's complete controller, ``level = "controller"``.  For optional methods see :class:`RateLoop`.

    It may have ``signals: ControlSignals`` too, for the log's columns of a cascade.
    """

    def reset(self) -> None:
        """Reset for a new flight, in which the engines hover, or idle on the ground."""

    def update(self, command: Command, measured: Measured, applied: Applied) -> Any:
        """Return the actuator commands for a step; called once a step.

        That is an :class:`Actuation`, or throttles, 0 to 1 per jet, and tilts [rad] of the left and the right servo, or
        of each hinge [rad] and then each surface [unit of its property]; tilts are left out where nothing moves.

        Parameters
        ----------
        command : Command
            What is asked for.
        measured : Measured
            What is seen at ``t_k``.
        applied : Applied
            What became of the step before.
        """


class OwnSensors(Protocol):
    """A user's sensors, which receive the built-in ones' measurements; named by a scenario's ``sensors``.

    It may have ``prepare(told)``, called once: ``told.step_s``, ``told.vehicle`` and ``told.random()``, a generator
    that nobody else draws from and that is the same at every call; and, as :class:`Shows` says, ``columns`` and
    ``shown``.
    """

    def reset(self, state: State, measured: Measured) -> Measured:
        """Start a new flight and return the measurement before step 0.

        Parameters
        ----------
        state : State
            The truth.
        measured : Measured
            What the built-in sensors say of it.
        """

    def sample(self, state: State, measured: Measured) -> Measured:
        """Return one measurement; called once a step with the parameters given to :meth:`reset`.

        Parameters
        ----------
        state : State
            The truth at ``t_k+1``.
        measured : Measured
            What the built-in sensors say of it.
        """


class Wind(Protocol):
    """A user's wind over time and position, added to the environment's, as named by a scenario's ``wind``.

    It may have ``prepare(told)`` as :class:`OwnSensors`, and ``reset()``, called before every flight.
    """

    def velocity(self, time: float, north: float, east: float, height: float) -> Vector3:
        """Return the air's velocity [m/s, NED]; called once a step for the centre of gravity and each engine's station.

        Parameters
        ----------
        time : float
            ``t_k`` [s].
        north : float
            From the starting point [m].
        east : float
            From the starting point [m].
        height : float
            Above the ground [m].
        """
