"""Constants of nature and of law, and the words that scenarios, logs and summaries share, each once."""

from __future__ import annotations

from typing import Final, Literal, get_args

# m/s^2, the standard acceleration of free fall: exact by definition (CGPM 1901).
GRAVITY: Final = 9.80665

Side = Literal["left", "right"]  # tilt servo, as seen by the pilot
Sensor = Literal["gyro", "attitude", "gnss", "barometer"]  # sensors that can fail
SERVOS: Final[tuple[Side, ...]] = get_args(Side)  # names of the tilt servos
SENSORS: Final[tuple[Sensor, ...]] = get_args(Sensor)  # names of the sensors
