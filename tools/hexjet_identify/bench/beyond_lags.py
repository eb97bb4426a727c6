"""What is tried of an engine that no lag explains: limits of its acceleration.

It is the library's engine ``fitted``, simulated, and taken if it explains the logs.  Where lags leave so little that
they explain them too, it has to be clearly the better one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError, NotIdentifiedError
from hexjet_identify.bench.evidence import test_residuals
from hexjet_identify.bench.grey_box import GreyIdentification, fit_engine
from hexjet_identify.bench.grey_model import GreyChoices
from hexjet_identify.engine_file import FITTED

if TYPE_CHECKING:
    from hexjet_identify.bench.identify import BenchIdentification

BEGIN_STEP = 0.3  # of the throttle's range, as which the limits begin over delay and lags together
BEGIN_LAG = 0.5  # of the lags together, as which the lag itself begins below limits
CLEAR = 10.0  # by which Schwarz' criterion has to fall


def fit_beyond_lags(found: BenchIdentification, longest_delay: float) -> GreyIdentification | None:
    """Return limits of acceleration where they explain logs better than lags, else None; so for no thrust in N.

    None, too, where what lags leave over is no more than chance: nothing else is tried.
    """
    if (
        not found.misfit.is_significant
        or found.misfit.cause  # what is left over is no answer to the command at all
        or not found.limits_known
        or any(record.newtons is None for record in found.records)
    ):
        return None
    try:
        fitted = fit_engine(found.records, _choices(found, longest_delay), is_strict=True)
    except (NotIdentifiedError, InputError):  # the logs do not tell them, or such an engine cannot be loaded
        return None
    # In blocks as short as those of a form of lags: a dead band does not pass here.
    named = dict(zip(fitted.names, map(float, fitted.values), strict=True))
    misfit = test_residuals(fitted.parts, fitted.residual, named["delay_s"], named["delay_s"] + named["lag"])
    if fitted.misfit.failed or misfit.failed or (found.is_explained and not _is_clearly_better(fitted, found)):
        return None
    verb = "explain the log poorly" if found.is_explained else "do not explain the log"
    note = f"lags {verb}, {100.0 * found.misfit.size:.2g} % of the swing (rms) is left over; limits of acceleration"
    return replace(fitted, notes=(*fitted.notes, note))


def _choices(found: BenchIdentification, longest_delay: float) -> GreyChoices:
    newtons = found.records[0].newtons or 1.0
    gain, offset, lags = newtons * found.chosen.gain, newtons * found.offset, sum(found.chosen.lags)
    begin = {"gain": gain, "offset": offset, "lag": BEGIN_LAG * lags}
    begin |= {"rise": BEGIN_STEP / lags, "fall": BEGIN_STEP / lags}
    names = ("gain", *(("offset",) if offset > 0.0 else ()), "lag", "rise", "fall")
    return GreyChoices(FITTED, names, begin, found.limits, found.straight, longest_delay)


def _is_clearly_better(fitted: GreyIdentification, found: BenchIdentification) -> bool:
    """Return whether Schwarz' criterion, per row, is lower than that of the lags by what refutes a form."""
    residual = found.problem.residual(found.chosen)
    lags = _criterion(residual, found.chosen.parameters - 2)  # without those of the noise
    own = _criterion(fitted.residual, len(fitted.values))
    return own / len(fitted.residual) < (lags - CLEAR) / len(residual)


def _criterion(residual: Array, parameters: int) -> float:
    power = max(float(np.mean(residual**2)), 1e-300)
    return len(residual) * float(np.log(power)) + parameters * float(np.log(len(residual)))
