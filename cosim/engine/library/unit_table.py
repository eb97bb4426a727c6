"""The units of an engine's variables in SI base units: what the build writes into an FMU and what is read of one.

Imports nothing, because the package's own build loads it by its path.
"""

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")  # FMI's base units in its order
# Exponents of the base units, and a factor if it is not 1, as FMI states them.
UNITS: dict[str, dict[str, float]] = {
    "1": {},
    "N": {"kg": 1, "m": 1, "s": -2},
    "K": {"K": 1},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "kg": {"kg": 1},
    "kg/s": {"kg": 1, "s": -1},
    "kg/s2": {"kg": 1, "s": -2},
    "kg/m3": {"kg": 1, "m": -3},
    "kg.m2": {"kg": 1, "m": 2},
    "m": {"m": 1},
    "m2": {"m": 2},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "rpm": {"rad": 1, "s": -1, "factor": 0.10471975511965977},  # 2 pi / 60
    "rpm/s": {"rad": 1, "s": -2, "factor": 0.10471975511965977},
    "s": {"s": 1},
    "1/s": {"s": -1},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
}
