"""The engine that bench logs leave: its parameters, what is uncertain of them, and why there may be none."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from cosim.base.arrays import Array
from cosim.base.storage.toml import read_toml
from cosim.engine.fmu.uncertainty import Uncertainty
from hexjet_identify.bench.engine_form import STEP_S, EngineForm
from hexjet_identify.bench.identification import Identification
from hexjet_identify.engine_file import DEVIATIONS_95, FITTED_STEP_S, MAX_DELAY_SAMPLES, round_delay, uncertainty_table
from hexjet_identify.fit.estimate import Estimate
from hexjet_identify.fit.forms import Limits

# The parameter of an engine's delay, in its internal steps.
DELAY_PARAMETER = "delay_samples"


class Parameters(NamedTuple):
    """Parameters of the library's engine ``fitted``, with their covariance.

    ``miss``: by how much its power law is off a static level at most, beyond its bounds, as a share of the range.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    miss: float

    @property
    def deviations(self) -> Array:
        """Standard deviations of the values."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    def find(self, name: str) -> tuple[float, float]:
        """Return the value and standard deviation of a named parameter; zeros if the engine has no such parameter."""
        if name not in self.names:
            return 0.0, 0.0
        row = self.names.index(name)
        return float(self.values[row]), float(self.deviations[row])


def engine_parameters(found: Identification) -> Parameters:
    """Return parameters of the engine ``fitted`` nearest to the estimate: its power law is laid through the levels."""
    chosen, knots = found.chosen, np.maximum(found.problem.knots, 0.0)
    unit, levels = found.records[0].newtons or 1.0, chosen.levels(found.problem)
    rows, first = len(levels), len(chosen.x) - len(levels) if isinstance(chosen.form, Limits) else len(chosen.x)
    used = [*range(first), *range(first, first + rows)]
    covariance = chosen.covariance[np.ix_(used, used)]
    unknown = np.isinf(np.diag(covariance))
    covariance = np.where(unknown | unknown[:, None], 0.0, covariance) + np.diag(unknown.astype(float))
    sizes = np.sqrt(np.maximum(np.diag(covariance)[first:], 0.0))
    weights = 1.0 / np.hypot(sizes, 0.003 * max(float(np.ptp(levels)), 1e-300))

    def values_of(theta: Array) -> dict[str, float]:
        x = np.concatenate([theta[:first], theta[first:]]) if isinstance(chosen.form, Limits) else theta[:first]
        named, law = chosen.form.natural(x), fit_power_law(knots, theta[first:], weights)
        told = {DELAY_PARAMETER: named["delay_s"] / FITTED_STEP_S, "lag": named["lag_s"]}
        told |= {"lag_2": named["second_lag_s"]} if "second_lag_s" in named else {}
        told |= {name: named[name] / max(abs(law[0]), 1e-300) for name in ("rise", "fall") if name in named}
        told |= {"exponent": law[2]} if rows > 2 else {}
        return told | {"gain": unit * law[0], "offset": unit * law[1]}

    theta = np.concatenate([chosen.x[:first], levels])
    at = values_of(theta)
    law = fit_power_law(knots, levels, weights)
    miss = levels - law[1] - law[0] * knots ** law[2]
    if rows > 3:
        # The misfit of the power law at the levels counts as noise of theirs, weighted by how well each is known.
        covariance[first:, first:] += np.diag(float(np.sum((miss * weights) ** 2)) / (rows - 3) / weights**2)
    values = np.array(list(at.values()))
    steps = np.concatenate([np.full(first, 1e-4), np.full(rows, 1e-3 * max(float(np.ptp(levels)), 1e-300))])
    slopes = [
        (np.array(list(values_of(theta + row).values())) - values) / step
        for row, step in zip(np.diag(steps), steps, strict=True)
    ]
    slope = np.array(slopes).T
    share = max(float(np.max(np.abs(miss) - DEVIATIONS_95 * sizes)), 0.0) / max(float(np.ptp(levels)), 1e-300)
    return Parameters(tuple(at), values, slope @ covariance @ slope.T, share)


def fit_power_law(
    knots: Array, levels: Array, weights: Array, ends: tuple[float, float] = (0.2, 6.0)
) -> tuple[float, float, float]:
    """Return gain, offset and exponent of the power law nearest to weighted levels; a straight line of two."""
    from scipy.optimize import minimize_scalar

    def fit_line(exponent: float) -> tuple[Array, float]:
        matrix = np.column_stack([knots**exponent, np.ones(len(knots))]) * weights[:, None]
        linear = np.linalg.lstsq(matrix, levels * weights)[0]
        return np.asarray(linear), float(np.sum((levels * weights - matrix @ linear) ** 2))

    exponent = 1.0
    if len(knots) > 2:
        tried = np.geomspace(*ends, 12)
        best = int(np.argmin([fit_line(float(one))[1] for one in tried]))
        bounds = tried[max(best - 1, 0)], tried[min(best + 1, 11)]
        exponent = float(minimize_scalar(lambda one: fit_line(one)[1], bounds=bounds, options={"xatol": 1e-8}).x)
    gain, offset = fit_line(exponent)[0].tolist()
    return gain, offset, exponent


def why_no_engine(found: Identification) -> str:
    """Return why no engine file is written, or an empty string if one is."""
    record = found.records[0]
    if found.refused:
        return found.refused[0]
    if found.engine is not None:
        return ""
    if record.newtons is None:
        how = "" if record.output_unit else f": {record.output_name}_N or {record.output_name} [kN] in the head says so"
        return f"{record.output_name} is in {record.output_unit or 'no unit'}; an engine's output is a thrust in N{how}"
    if not found.limits_known:
        return "what throttle 0 and 1 are is not known: throttle_range LOW HIGH"
    if not engine_parameters(found).find("gain")[0] > 0.0:
        return "the thrust falls where the throttle rises"
    if found.chosen.delay > MAX_DELAY_SAMPLES * FITTED_STEP_S:
        return f"its delay is longer than {MAX_DELAY_SAMPLES * FITTED_STEP_S:g} s"
    return ""


def engine_table(found: Identification) -> dict[str, object]:
    """Return ``engine.toml`` of the library's engine ``fitted`` as a table, with ``[uncertainty]``."""
    told = engine_parameters(found)
    parameters: dict[str, object] = dict(zip(told.names, told.values.tolist(), strict=True))
    deviations = told.deviations
    parameters[DELAY_PARAMETER], deviations[0] = _round_delay(found.chosen, FITTED_STEP_S)
    names = ", ".join(record.path.name for record in found.records)
    moves = sum(int(np.count_nonzero(np.diff(record.command))) for record in found.records)
    seconds = sum(float(record.times[-1] - record.times[0]) for record in found.records)
    source = f"{names}: {seconds:.4g} s, {moves} rows in which the command moves, {found.chosen.form.label}"
    table = uncertainty_table(source, told.names, told.covariance, deviations)
    if found.spread:
        table["spread"] = [float(f"{found.spread.get(name, 0.0):.6g}") for name in told.names]
    return {"fmu": "engine.fmu", "title": f"Engine fitted to {names}", "parameters": parameters, "uncertainty": table}


def _round_delay(estimate: Estimate, step: float) -> tuple[int, float]:
    """Return the delay in whole engine steps, and a standard deviation that covers its 95 % bounds and the rounding."""
    low, high = estimate.delay_bounds
    deviation = max(estimate.delay - low, high - estimate.delay) / DEVIATIONS_95
    return round_delay(estimate.delay / step, deviation / step)


def own_engine_table(found: Identification, form: EngineForm) -> dict[str, object]:
    """Return ``engine.toml`` of a fitted engine model as a table: settings, fitted parameters, ``[uncertainty]``."""
    chosen, spec, step = found.chosen, form.spec, form.spec.internal_step or STEP_S
    table: dict[str, object] = dict(read_toml(spec.mapping)) if spec.mapping else {}
    known = table.get("parameters")
    parameters: dict[str, object] = dict(known) if isinstance(known, dict) else {}
    parameters |= dict(form.choices.settings) | dict(zip(form.choices.fitted, chosen.x[1:].tolist(), strict=True))
    names, keep = list(form.choices.fitted), list(range(1, len(chosen.x)))
    deviations = [chosen.deviation(row) for row in keep]
    if DELAY_PARAMETER in spec.parameters:
        parameters[DELAY_PARAMETER], off = _round_delay(chosen, step)
        names, deviations, keep = [DELAY_PARAMETER, *names], [off, *deviations], [0, *keep]
    kept, covariance = _keep_unfitted(spec.uncertainty, {*names, *form.choices.settings})
    covariance = block_diag(chosen.covariance[np.ix_(keep, keep)], covariance)
    deviations += np.sqrt(np.diag(covariance))[len(names) :].tolist()
    source = f"delay_s, {', '.join(form.choices.fitted)} of {form.label}".replace(",  of", " of")
    source += f"; not fitted, as that states them: {', '.join(kept)}" if kept else ""
    logs = ", ".join(record.path.name for record in found.records)
    return table | {
        "fmu": f"engine{spec.archive.path.suffix}",
        "title": f"{spec.title}, fitted to {logs}",
        "parameters": parameters,
        "uncertainty": uncertainty_table(f"{logs}: {source}", [*names, *kept], covariance, np.array(deviations)),
    }


def _keep_unfitted(stated: Uncertainty | None, taken: set[str]) -> tuple[list[str], Array]:
    """Return the uncertain parameters that the engine states and the fit did not take, with their covariance."""
    if stated is None:
        return [], np.empty((0, 0))
    rows = [row for row, name in enumerate(stated.parameters) if name not in taken]
    deviations, correlation = np.array(stated.deviation)[rows], np.array(stated.correlations)[np.ix_(rows, rows)]
    return [stated.parameters[row] for row in rows], np.outer(deviations, deviations) * correlation
