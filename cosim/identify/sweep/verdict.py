"""Whether a model that was fitted to a sweep may be used: what it leaves over, and which of its numbers are known."""

from __future__ import annotations

from cosim.identify.sweep.fit import Fit

MISFIT = 0.1  # root mean square of |ln(model / response)| above which a form is not found: 10 % or 6 deg; ours
NO_LAG = 0.05  # of a step: a shorter lag is none, because no sample shows it
ONE_SAMPLE = 1.0  # a delay counts as known within its value or this, whichever is more


def half_width(fit: Fit, name: str) -> float:
    """Return how far the further 95 % bound of a free parameter is from its value, in the parameter's unit."""
    low, high = fit.bounds[name]
    return max(high - fit.values[name], fit.values[name] - low)


def is_none(fit: Fit, name: str) -> bool:
    """Return whether a free lag is shorter than any sample can show: it ran to the end of its range."""
    return name in fit.bounds and name.startswith("lag") and fit.values[name] < NO_LAG * fit.model.step


def is_determined(fit: Fit, name: str) -> bool:
    """Return whether the bounds of a parameter are narrower than its value; of a delay, than a sample at least."""
    if name not in fit.bounds:
        return True
    least = ONE_SAMPLE if name == "delay_samples" else 0.0
    return bool(half_width(fit, name) <= max(abs(fit.values[name]), least))


def all_delay_is_determined(fit: Fit) -> bool:
    """Return whether delay and lags together are known better than their sum is long."""
    total = fit.model.delay_samples + sum(fit.model.lags) / fit.model.step
    return bool(fit.all_delay_half <= max(total, ONE_SAMPLE))


def why_refused(fit: Fit, engine: bool) -> list[str]:
    """Return why a fit is no model that may be used, a line a reason, with what to do; empty where it may.

    Refused are a misfit above ``MISFIT`` and a gain, a lag, a delay or an engine's time constant whose bound exceeds
    its value.  The slow pole of an axis may be anything near 0, and a lag shorter than ``NO_LAG`` steps is none.
    """
    reasons = []
    if not fit.misfit <= MISFIT:
        reasons.append(
            f"the form is {100.0 * fit.misfit:.0f} % off the response, {100.0 * MISFIT:.0f} % at most: another --lags, "
            "a narrower band (--from-hz, --to-hz) or another --amplitude"
        )
    words = {"gain": "gain", "rate_1_s": "time constant", "delay_samples": "delay", "lag_s": "lag"}
    unknown = [
        words.get(name, "further lag")
        for name in fit.bounds
        if (engine or name != "rate_1_s") and not is_none(fit, name) and not is_determined(fit, name)
    ]
    if unknown:
        few = "" if len(fit.model.lags) <= (0 if engine else 1) else "fewer --lags, "
        reasons.append(
            f"not determined by this sweep, as the bounds exceed the value: {', '.join(unknown)}: {few}a wider band "
            "(--from-hz, --to-hz), more --amplitude, or state what is known by --hold"
        )
    return reasons
