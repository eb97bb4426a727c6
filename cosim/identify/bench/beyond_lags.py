"""What is tried of an engine that no lag explains: limits of its acceleration, or a lag that changes with the thrust.

Both are the library's engine ``fitted``, simulated; the one with the least of Schwarz' criterion is taken, if it
explains the logs.  Where lags leave so little that they explain them too, it has to be clearly the better one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError, NotIdentifiedError
from cosim.identify.bench.evidence import Misfit, test_residuals
from cosim.identify.bench.grey_box import GreyIdentification, fit_engine
from cosim.identify.bench.grey_model import GreyChoices
from cosim.identify.bench.timing.readings import CLEAR
from cosim.identify.engine_file import FITTED

if TYPE_CHECKING:
    from cosim.identify.bench.identify import BenchIdentification

FORMS = {  # the parameters that each form adds to gain, offset and lag
    "limits of acceleration": ("rise", "fall"),
    "a lag that changes with the thrust": ("lag_full",),
}
BEGIN_STEP = 0.3  # of the throttle's range, as which the limits begin over delay and lags together
BEGIN_LAG = 0.5  # of the lags together, as which the lag itself begins below limits


def fit_beyond_lags(found: BenchIdentification, longest_delay: float) -> GreyIdentification | None:
    """Return the form that explains logs better than lags, or None where none does or the thrust is not in N.

    None, too, where what lags leave over is no more than chance: nothing else is tried.
    """
    if (
        not found.misfit.is_significant
        or found.misfit.cause  # what is left over is no answer to the command at all
        or not found.limits_known
        or any(record.newtons is None for record in found.records)
    ):
        return None
    tried = []
    for words, own in FORMS.items():
        choices = _choices(found, own, longest_delay)
        try:
            fitted = fit_engine(found.records, choices, is_strict=True)
        except (NotIdentifiedError, InputError):  # a clock that wobbles, or such an engine cannot be loaded
            continue
        if not (fitted.misfit.failed or _misfit_of_lags(fitted).failed):
            verb = "explain the log poorly" if found.is_explained else "do not explain the log"
            note = f"lags {verb}, {100.0 * found.misfit.size:.2g} % of the swing (rms) is left over; {words}"
            tried.append(replace(fitted, notes=(*fitted.notes, note)))
    best = min(tried, key=_schwarz, default=None)
    return None if best is None or (found.is_explained and not _is_clearly_better(best, found)) else best


def _choices(found: BenchIdentification, own: tuple[str, ...], longest_delay: float) -> GreyChoices:
    newtons = found.records[0].newtons or 1.0
    gain, offset, lags = newtons * found.chosen.gain, newtons * found.offset, sum(found.chosen.lags)
    begin = {"gain": gain, "offset": offset, "lag": lags}
    if "rise" in own:
        begin |= {"lag": BEGIN_LAG * lags, "rise": BEGIN_STEP / lags, "fall": BEGIN_STEP / lags}
    else:
        begin["lag_full"] = lags
    common = ("gain", "offset", "lag") if offset > 0.0 else ("gain", "lag")
    return GreyChoices(FITTED, (*common, *own), begin, found.limits, found.straight, longest_delay)


def _misfit_of_lags(fitted: GreyIdentification) -> Misfit:
    """Return what is left over in blocks as short as those of a form of lags: a dead band does not pass here."""
    named = dict(zip(fitted.names, map(float, fitted.values), strict=True))
    total = named["delay_s"] + max(named["lag"], named.get("lag_full", 0.0))
    return test_residuals(fitted.parts, fitted.residual, named["delay_s"], total)


def _is_clearly_better(fitted: GreyIdentification, found: BenchIdentification) -> bool:
    """Return whether Schwarz' criterion, per row, is lower than that of the lags by what refutes a form."""
    residual = found.problem.residual(found.chosen)
    lags = _criterion(residual, found.chosen.parameters - 2)  # without those of the noise
    return _schwarz(fitted) / len(fitted.residual) < (lags - CLEAR) / len(residual)


def _schwarz(fitted: GreyIdentification) -> float:
    return _criterion(fitted.residual, len(fitted.values))


def _criterion(residual: Array, parameters: int) -> float:
    power = max(float(np.mean(residual**2)), 1e-300)
    return len(residual) * float(np.log(power)) + parameters * float(np.log(len(residual)))
