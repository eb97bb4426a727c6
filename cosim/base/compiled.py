"""Which modules are compiled, and whether what was compiled is still what the source says.

A control step runs in modules that mypyc turns into C.  Their source is plain Python: it is what runs where nothing was
compiled, where ``HEXJET_PURE`` is set, and where a file was edited since.  The results are the same to the last bit.

Imported before everything else of the package, so it imports little; ``setup.py`` and the Makefile read it too.
"""

from __future__ import annotations

import os
import sys
from hashlib import sha256
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1]
MODULES = (
    "vehicle/airframe.py",
    "vehicle/jsbsim_units.py",
    "vehicle/effects/effect.py",
    "vehicle/effects/jets.py",
    "vehicle/effects/intakes.py",
    "vehicle/effects/banks.py",
    "vehicle/effects/hinges.py",
    "simulation/script/command_script.py",
    "simulation/controllers/guard.py",
    "control/allocation/allocation.py",
    "control/allocation/effectiveness.py",
    "control/allocation/hinged_recovery.py",
    "control/altitude.py",
    "control/attitude.py",
    "control/bumpless.py",
    "control/phases/recovery.py",
    "control/phases/hinged.py",
    "control/phases/law.py",
    "control/phases/shut_opposite.py",
    "control/phases/spun.py",
    "control/phases/wing.py",
    "control/cascade.py",
    "control/lead.py",
    "control/allocation/engine_monitor.py",
    "control/predictors/smith.py",
    "control/rate.py",
    "control/schedule.py",
    "control/predictors/state.py",
    "control/allocation/thrust_map.py",
    "simulation/script/disturbance_script.py",
    "simulation/ending.py",
    "engine/wrappers.py",
    "simulation/script/fault_schedule.py",
    "base/frames.py",
    "base/layout.py",
    "base/limits.py",
    "vehicle/tank.py",
    "vehicle/effects/ground_effect.py",
    "control/autopilot/estimation/kalman.py",
    "control/autopilot/estimation/estimator.py",
    "control/autopilot/estimation/position.py",
    "control/autopilot/geometry.py",
    "control/autopilot/guidance/tracker.py",
    "control/autopilot/guidance/position_control.py",
    "vehicle/propulsion.py",
    "engine/rundown.py",
    "vehicle/sensors.py",
    "vehicle/servo.py",
    "base/signals.py",
    "simulation/step.py",
    "simulation/guided_pilot.py",
    "vehicle/effects/rotors.py",
)
# In the package's folder, one of each for every Python that it was compiled for:
SHARED = f"_native__mypyc{EXTENSION_SUFFIXES[0]}"  # mypyc's shared library of all compiled modules
STAMP = f"_compiled{EXTENSION_SUFFIXES[0]}.sha256"  # hashes of the compiled sources, in the format of sha256sum
PURE = "HEXJET_PURE"  # environment: set, build without and run without


def fingerprint(package: Path) -> str:
    """Return one line a module: the hash of its source, and its path in the package."""
    return "".join(f"{sha256((package / name).read_bytes()).hexdigest()}  {name}\n" for name in MODULES)


def edited_modules() -> list[str]:
    """Return the modules whose source is not what was compiled; all where nothing was, for this Python."""
    if not (PACKAGE / SHARED).is_file():
        return list(MODULES)
    try:
        built = (PACKAGE / STAMP).read_text(encoding="ascii").splitlines()
    except OSError:
        return list(MODULES)
    return [line.split("  ")[1] for line in fingerprint(PACKAGE).splitlines() if line not in built]


def select_modules() -> None:
    """Import the compiled modules from here on if they are up to date, else all of them from source.

    One line on standard error says so where an edit is why.
    """
    changed = edited_modules()
    if not changed and not os.environ.get(PURE):
        return
    sys.meta_path.insert(0, _FromSource())
    if 0 < len(changed) < len(MODULES) and not os.environ.get(PURE):
        more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
        print(
            f"hexjet: {PACKAGE / changed[0]}{more} changed since it was compiled; all runs from source, which is "
            "slower, until: make setup",
            file=sys.stderr,
        )


def from_source() -> bool:
    """Return whether this process runs the modules from source."""
    return any(isinstance(finder, _FromSource) for finder in sys.meta_path)


def child_environment() -> dict[str, str]:
    """Return the environment for a child process, which runs the modules as this one does, without a second notice."""
    return {**os.environ, PURE: "1"} if from_source() else dict(os.environ)


class _FromSource:
    """Finds the modules' source, where the compiled ones would be found first."""

    def __init__(self) -> None:
        self._paths = {f"cosim.{name.removesuffix('.py').replace('/', '.')}": PACKAGE / name for name in MODULES}

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        source = self._paths.get(fullname)
        return spec_from_file_location(fullname, source) if source else None
