"""Flights that can be compiled, mapped and differentiated: the same ``step`` with JAX, which the extra ``jax`` brings.

The only module that imports ``jax``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cosim.base.errors import InputError
from cosim.spec.scenario import Scenario
from hexjet_batch.fly import prepare
from hexjet_batch.numbers import Numbers
from hexjet_batch.stages.step import Outputs, start, step

try:
    import jax
except ModuleNotFoundError as error:
    if error.name != "jax":
        raise
    raise ModuleNotFoundError("hexjet_batch.with_jax needs jax, which is not installed: pip install jax") from None


def make_flight(scenarios: Sequence[Scenario]) -> tuple[Numbers, Callable[[Numbers], Outputs]]:
    """Return the numbers of flights of one structure and the function that flies them: pure, in double precision.

    What it returns has a row a step and a column a flight.  Replace any number by one that JAX traces, such as
    ``numbers.replace(attitude=...)``, inside a function that ``jax.jit``, ``jax.grad`` or ``jax.vmap`` takes; delays
    must stay what they are.  Noise is drawn beforehand, by the generators of the scenarios' seeds.  Raises InputError
    for what a batch does not cover, and for no scenario.
    """
    if not scenarios:
        raise InputError("scenarios = []: a batch has at least 1 flight")
    jax.config.update("jax_enable_x64", True)
    xp, (numbers, script, noise, heights, _, _, begin) = jax.numpy, prepare(scenarios)
    rows = [
        script.at(k)[1]._replace(draws=None if noise is None else noise.at(k).copy()) for k in range(scenarios[0].steps)
    ]
    inputs = jax.tree.map(lambda *values: xp.asarray(np.array(values)), *rows)
    motion = jax.tree.map(xp.asarray, begin)

    def fly(n: Numbers) -> Outputs:
        # After the first step the state has the types and shapes that it keeps.
        begun = step(n, start(n, motion, xp.asarray(heights), rows[0]), rows[0])
        kept = jax.eval_shape(lambda s: step(n, s, rows[0])[0], begun[0])
        state = jax.tree.map(lambda value, like: xp.broadcast_to(value, like.shape).astype(like.dtype), begun[0], kept)
        rest = jax.tree.map(lambda values: values[1:], inputs)
        _, outputs = jax.lax.scan(lambda s, u: step(n, s, u), state, rest)
        whole: Outputs = jax.tree.map(
            lambda first, more: xp.concat([xp.broadcast_to(first, more.shape[1:])[None], more]), begun[1], outputs
        )
        return whole

    return numbers.replace(xp=xp, engine=numbers.engine.replace(xp=xp)), fly
