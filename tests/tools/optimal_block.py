"""A proportional gain behind the predictor of a target, as :mod:`hexjet_design.loop.optimal` makes it for an axis."""

from __future__ import annotations

from math import inf

from cosim.base.signals import Vector3
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.optimal import Target, make_predictor


class Behind:
    """The loop of a channel's own model, whose command stays within ``room`` of 0."""

    def __init__(self, channel: Channel, target: Target, room: float = inf) -> None:
        predictor, gain, self.attitude = make_predictor(channel.model("exact"), target)
        self._predictor, self._gain, self._room = predictor, gain, room

    def reset(self) -> None:
        self._predictor.reset()

    def update(self, setpoint: Vector3, measured: Vector3, applied: Vector3) -> Vector3:
        asked = self._gain * (setpoint[0] - self._predictor.update(measured[0], applied[0]))
        return (max(-self._room, min(self._room, asked)), 0.0, 0.0)
