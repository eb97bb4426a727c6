"""The predictors of an exported controller: of each its title, constants and states as the C has them.

A form has ``kind``, ``title``, the samples of its delay ``line``, its constants by their names, and the lists
``values`` (name and value), ``constants`` and ``states`` (name and size in C, None for a single number).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from cosim import InputError
from cosim.blocks import (
    DelayLine,
    DiscreteModel,
    DoubleIntegratorObserver,
    FilteredSmithPredictor,
    LinearPredictor,
    ModalPredictor,
    ModelObserver,
    NoPredictor,
    SmithPredictor,
    StatePredictor,
)

Form = dict[str, Any]
States = list[tuple[str, int | None]]


def make_predictor_form(predictor: object, axis: str = "roll") -> Form:
    """Return a predictor's constants and states for C.  Raises InputError for one without a C form."""
    for kind, write in _FORM_MAKERS.items():
        if type(predictor) is kind:
            return write(predictor)
    supported = ", ".join(kind.__name__ for kind in _FORM_MAKERS)
    raise InputError(f"{axis}: the predictor {type(predictor).__name__} has no C form; those that have: {supported}")


def _assemble_form(kind: str, title: str, values: Mapping[str, Any], states: States, line: int = 0) -> Form:
    """Return a predictor's form; one with ``weights`` also has the sent commands as a state."""
    sent = [("sent", len(values["weights"]))] if "weights" in values else []
    constants = [(name, _format_array_size(value)) for name, value in values.items()]
    head: Form = {"kind": kind, "title": title, "line": line, "values": values, "constants": constants}
    return {**head, "states": [*states, *sent], **values}


def _format_array_size(value: Any) -> str | None:
    if not isinstance(value, list):
        return None
    rows = len(value)
    return f"{rows}][{len(value[0])}" if isinstance(value[0], list) else str(rows)


def _make_smith_form(predictor: SmithPredictor) -> Form:
    then = predictor.then
    line, late = (then.samples, None) if isinstance(then, DelayLine) else (then.line.samples, then.model)
    values, states = _list_model_coefficients(now=predictor.now, then=late)
    return _assemble_form("early-late", "Smith's predictor", values, [*states, *_make_delay_line_state(line)], line)


def _make_filtered_smith_form(predictor: FilteredSmithPredictor) -> Form:
    then, before = predictor.then, [("before", None)] if predictor.rest else []
    values, states = _list_model_coefficients(now=predictor.now, then=then.model, rest=predictor.rest)
    title, line = "Smith's predictor with a robustness filter", then.line.samples
    values |= {"through": predictor.through}
    return _assemble_form("early-late-filtered", title, values, [*states, *before, *_make_delay_line_state(line)], line)


def _list_model_coefficients(**models: DiscreteModel | None) -> tuple[dict[str, Any], States]:
    """Return the coefficients of the models that are not None, and one state for each."""
    there = {name: model for name, model in models.items() if model}
    pairs = [(name, letter) for name in there for letter in "ba"]
    values = {f"{name}_{letter}": list(getattr(there[name], letter)) for name, letter in pairs}
    return values, [(name, len(model.a)) for name, model in there.items()]


def _make_delay_line_state(samples: int) -> States:
    return [("line", samples)] if samples else []


def _make_state_form(predictor: StatePredictor) -> Form:
    observer, push = predictor.observer, list(predictor.push)
    common = {"of_state": list(predictor.of_state)}
    weights = {"weights": list(predictor.weights)}
    if type(observer) is DoubleIntegratorObserver:
        of_observer = {name: list(getattr(observer, name)) for name in ("transition", "of_rate", "of_command")}
        title = "state predictor with a double-integrator observer"
        values: Form = {"f": predictor.f} | of_observer | common | weights
        return _assemble_form("double-integrator", title, values, [("x", 2)])
    if type(observer) is ModelObserver:
        disturbance = {"of_disturbance": predictor.of_disturbance} if observer.with_disturbance else {}
        gain, title = list(observer.gain), "state predictor with an observer of the identified model"
        values = {"transition": [list(row) for row in observer.F], "gain": gain, "push": push} | common | disturbance
        return _assemble_form("model-observer", title, values | weights, [("x", len(gain))])
    raise InputError(f"the observer {type(observer).__name__} has no C form; allowed: the built-in ones")


def _make_linear_form(predictor: LinearPredictor) -> Form:
    names = ("transition", "of_rate", "of_command", "of_state", "weights")
    values = {name: getattr(predictor, name) for name in names}
    return _assemble_form("linear", "linear predictor", values, [("x", len(predictor.of_state))])


def _make_modal_form(predictor: ModalPredictor) -> Form:
    vectors = {
        "poles": predictor.poles,
        "residues": predictor.residues,
        "shares": predictor.shares,
        "gain": predictor.gain,
        "ahead": predictor.state_weights,
    }  # complex where the model has pole pairs
    paired = any(complex(x).imag != 0.0 for vector in vectors.values() for x in vector)
    values: dict[str, Any] = {}
    for name, vector in vectors.items():
        values[name] = [complex(x).real for x in vector]
        values |= {f"{name}_im": [complex(x).imag for x in vector]} if paired else {}
    order = len(predictor.poles)
    states: States = [("x", order), *([("x_im", order)] if paired else [])]
    if predictor.with_disturbance:
        values["gathered"] = predictor.command_weight
        states.append(("disturbance", None))
    values["weights"] = list(predictor.weights)
    title = "state predictor with an observer of the identified model, mode by mode"
    return _assemble_form("modes", title, values, states)


_FORM_MAKERS: dict[type, Callable[[Any], Form]] = {  # by predictor class
    NoPredictor: lambda predictor: _assemble_form("none", "none", {}, []),
    SmithPredictor: _make_smith_form,
    FilteredSmithPredictor: _make_filtered_smith_form,
    StatePredictor: _make_state_form,
    LinearPredictor: _make_linear_form,
    ModalPredictor: _make_modal_form,
}
