"""Which modules are compiled, and when their source runs in their place.

A control step runs in modules that mypyc turns into C.  Their source is plain Python: it is what runs where nothing was
compiled, where ``HEXJET_PURE`` is set, and in a checkout where a source is newer than what was compiled.  The results
are the same to the last bit.

Imported before everything else of the package, so it imports little; ``setup.py`` and the Makefile read it too.
"""

from __future__ import annotations

import os
import sys
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1]  # folder of the package
MODULES = (  # modules that mypyc compiles
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
# mypyc's shared library with all compiled modules, one for each Python version.
SHARED = f"_native__mypyc{EXTENSION_SUFFIXES[0]}"
PURE_VARIABLE = "HEXJET_PURE"  # if set: build and run without mypyc


def is_current() -> bool:
    """Return whether the modules were compiled for this Python, and no source was changed since.

    What is installed stays as it was built; a checkout is edited.
    """
    shared = PACKAGE / SHARED
    if not shared.is_file() or not (PACKAGE.parent / "setup.py").is_file():
        return shared.is_file()
    built = shared.stat()
    sources = [(PACKAGE / name).stat() for name in MODULES]
    # The change time (ctime) detects a file that was copied here with its old modification time.
    return all(each.st_mtime_ns <= built.st_mtime_ns and each.st_ctime_ns <= built.st_ctime_ns for each in sources)


def select_modules() -> None:
    """Import the compiled modules from now on if they are current, else all modules from source."""
    if os.environ.get(PURE_VARIABLE) or not is_current():
        sys.meta_path.insert(0, _SourceFinder())


class _SourceFinder:
    """Import finder that returns the source of a module that was also compiled."""

    def __init__(self) -> None:
        self._paths = {f"cosim.{name.removesuffix('.py').replace('/', '.')}": PACKAGE / name for name in MODULES}

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        source = self._paths.get(fullname)
        return spec_from_file_location(fullname, source) if source else None
