"""What a change of the autopilot's parameters does to the loops that they tune: stable or not, and with which margins.

The loops are those of :mod:`hexjet_design.measured.computed`: the vehicle's own channels with the engine as it is
swept, once, in a second or two; a change then costs some milliseconds.  What is not linear, a limit of the
throttle or of a rate, is not in it: a loop that is called unstable leaves its rest, how far is not said.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from math import inf
from threading import Lock
from typing import TYPE_CHECKING, NamedTuple

from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.control.autopilot.parameters import Caution
from cosim.control.autopilot.tuning import control_of, controller_of
from cosim.control.predictors.registry import BASELINE, PREDICTORS
from cosim.spec.scenario import Scenario

if TYPE_CHECKING:
    # Functions import the mathematics of designs when they need it, as most sessions never do.
    from hexjet_design.loop.closed_loop import FrequencyGrid
    from hexjet_design.loop.tuning import Tuning
    from hexjet_design.measured.computed import Plants

CHANNELS = (*AXES, "altitude")  # loops that are judged
# Margins below these are reported if they got smaller; chosen by us: half of the usual 6 dB and 40 deg.
MIN_MARGIN_DB, LEAST_DEG = 3.0, 20.0
_PREFIXES = {axis: (f"HJ_{axis.upper()}_", f"HJ_ATT_{axis.upper()}", "HJ_PRED_") for axis in AXES}  # prefixes per axis
_LOOPS = {**_PREFIXES, "altitude": ("HJ_ALT_P", "HJ_CLIMB_P", "HJ_CLIMB_I")}  # prefixes of each loop's parameters


class _LoopState(NamedTuple):
    """Stability and margins of one loop."""

    stable: bool
    bound_ratio: float  # smallest ratio of a margin to its bound
    text: str  # margins below bounds, or why unstable


# A loop with a predictor that cannot be computed counts as good.
_UNKNOWN = _LoopState(True, inf, "")


class LoopJudge:
    """Judges the parameters of one vehicle with its engine; thread-safe."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._vehicle, _ = scenario.resolved_vehicle()
        self._built_in = scenario.controller in PREDICTORS  # False: only the height loop is known
        self._plants: Plants | str | None = None
        self._points: dict[str, FrequencyGrid] = {}
        self._lock = Lock()

    def prepare(self) -> None:
        """Sweep the engine, which every verdict needs; an error is reported with the first verdict."""
        with self._lock, suppress(InputError, ValueError, ArithmeticError):
            self._load_plants()

    def tunes_loop(self, name: str) -> bool:
        """Return whether a parameter tunes a loop that can be computed."""
        return not isinstance(self._plants, str) and any(name.startswith(_LOOPS[axis]) for axis in self._channels)

    @property
    def _channels(self) -> tuple[str, ...]:
        return CHANNELS if self._built_in else ("altitude",)

    def find_cautions(self, before: Mapping[str, float], after: Mapping[str, float]) -> list[Caution]:
        """Return warnings on loops that a change makes worse; none if that cannot be computed."""
        changed = [name for name, value in after.items() if value != before[name]]
        axes = [axis for axis in self._channels if any(name.startswith(_LOOPS[axis]) for name in changed)]
        if not axes:
            return []
        with self._lock:
            try:
                old, new = self._judge_loops(before, axes), self._judge_loops(after, axes)
            except (InputError, ValueError, ArithmeticError):
                return []
        cautions = []
        for axis, now in new.items():
            then = old.get(axis, _UNKNOWN)
            if not now.stable:
                cautions.append(Caution(axis, True, then.stable, f"{axis}: {now.text}"))
            elif now.bound_ratio < min(1.0, then.bound_ratio):
                cautions.append(Caution(axis, False, False, f"{axis}: {now.text}"))
        return cautions

    def _judge_loops(self, values: Mapping[str, float], axes: list[str]) -> dict[str, _LoopState]:
        """Return the loops of the axes whose predictors have a frequency response."""
        from hexjet_design.measured.computed import find_tunings

        plants = self._load_plants()
        if isinstance(plants, str):
            return {}
        scenario = self._replace_controller(controller_of(values) or BASELINE.name)
        family = plants.spec.family
        vehicle = self._vehicle.model_copy(update={"control": control_of(self._vehicle.control, values)})
        models = dict(plants.spec.models_in(vehicle.identified))
        if "roll" in models:
            # The parameter contains the controller's added delay, which the channel adds again.
            samples = values["HJ_PRED_DELAY"] - scenario.added_delay_samples
            models["roll"] = models["roll"].model_copy(update={"delay_samples": max(0.0, samples)})
            vehicle = vehicle.model_copy(update={"identified": {**vehicle.identified, family: models}})
        tunings = find_tunings(plants, scenario, vehicle, axes)
        linear = [axis for axis in axes if PREDICTORS[tunings[axis].controller].response is not None]
        return {axis: self._judge_loop(plants, axis, tunings[axis]) for axis in linear}

    def _replace_controller(self, controller: str) -> Scenario:
        return self._scenario.replace(controller=controller, controller_parameters={})

    def _load_plants(self) -> Plants | str:
        from cosim.engine import find_source, load_engine
        from hexjet_design.measured.computed import make_plants

        if self._plants is None:
            scenario = self._scenario if self._built_in else self._replace_controller(BASELINE.name)
            source, parameters = find_source(scenario.engine, scenario.folder), scenario.engine_parameters
            unchecked, apart = scenario.engine_unchecked, scenario.engine_isolated
            spec = load_engine(source, parameters, scenario.step_s, unchecked=unchecked, isolated=apart)
            self._plants = make_plants(scenario, self._vehicle, spec)
        return self._plants

    def _judge_loop(self, plants: Plants, axis: str, tuning: Tuning, points: int = 1500) -> _LoopState:
        from hexjet_design.assessment import margins
        from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid

        if axis not in self._points:
            self._points[axis] = FrequencyGrid(plants.channels[axis], close=points)
        closed = ClosedLoop(self._points[axis], tuning)
        if closed.unstable_poles:
            return _LoopState(False, 0.0, "the loop is unstable")
        if not tuning.angle_gain:  # a gain of 0 leaves the pole at 1
            return _LoopState(False, 0.0, "a gain of 0: nothing brings it back")
        loop = margins(closed)
        up, down, phase = loop.gain_db, loop.gain_down_db, loop.phase_deg
        sizes = [
            (_fraction_of_bound(up, MIN_MARGIN_DB), f"gain margin {_format_margin(up)} dB"),
            (_fraction_of_bound(down, MIN_MARGIN_DB), f"gain margin {_format_margin(down)} dB downwards"),
            (_fraction_of_bound(phase, LEAST_DEG), f"phase margin {_format_margin(phase)} deg"),
        ]
        return _LoopState(True, min(sizes)[0], ", ".join(text for ratio, text in sizes if ratio < 1.0))


def _fraction_of_bound(margin: float | None, bound: float) -> float:
    return inf if margin is None else abs(margin) / bound


def _format_margin(margin: float | None) -> str:
    return "none" if margin is None else f"{abs(margin):.1f}"
