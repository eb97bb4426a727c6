"""JSBSim with a model loaded: the only module that imports ``jsbsim``.

Whatever JSBSim throws or prints becomes one line.  It evaluates a model's functions once more when it is
destroyed, and what it throws there ends the process: so a model that was refused is never destroyed.
"""

from __future__ import annotations

import ctypes
import os
import re
import threading
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from math import isfinite
from pathlib import Path
from typing import Final

import jsbsim

from cosim.base.errors import FlightError, InputError, notify
from cosim.base.storage.cache import RecentCache
from cosim.base.storage.files import read_file
from cosim.vehicle.model_file import ACTING_PROPERTIES, find_acting_property, find_line

Property = jsbsim.FGPropertyNode
VERSION: Final[str] = jsbsim.__version__  # version of JSBSim
_DEBUG_VARIABLE: Final = "JSBSIM_DEBUG"  # variable that sets JSBSim's messages
# JSBSim's exceptions, and C++ exceptions that its binding converts.
Complaint: Final = RuntimeError
# Form of property names that JSBSim can look up: others end the process.
_PATH_SEGMENT: Final = r"(?:\.{1,2}|[A-Za-z_][A-Za-z0-9_.-]*(?:\[[0-9]{1,6}\])?)"
_PROPERTY_PATH: Final = re.compile(rf"/?{_PATH_SEGMENT}(?:/{_PATH_SEGMENT})*")
_MISSING_PROPERTY: Final = re.compile(r"property,? (\S+) (?:does not exist|specified for channel)")  # JSBSim's message
_XML_NUMBER: Final = re.compile(rb">-?[0-9][0-9.e+-]*<")  # a number between XML tags
_property_cache: RecentCache[tuple[str, ...]] = RecentCache(64)


class _LogCapture(jsbsim.FGLogger):
    """Collects a limited number of JSBSim's warnings and errors of a model instead of printing them."""

    max_lines = 20

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._text = ""

    def message(self, message: str) -> None:
        if jsbsim.LogLevel.WARN <= self.log_level < jsbsim.LogLevel.STDOUT:
            self._text += message

    def flush(self) -> None:
        line, self._text = " ".join(self._text.split()), ""
        if line and line not in self.lines and len(self.lines) < self.max_lines:
            self.lines.append(line)


_log = _LogCapture()
if threading.current_thread() is threading.main_thread():
    jsbsim.set_logger(_log)  # logger of this thread only


def _quiet_executive(folder: str) -> jsbsim.FGFDMExec:
    """Return a new JSBSim, made with JSBSIM_DEBUG at 0 so that it prints no banner."""
    was_set = _DEBUG_VARIABLE in os.environ
    os.environ.setdefault(_DEBUG_VARIABLE, "0")
    try:
        return jsbsim.FGFDMExec(folder, None)
    finally:
        if not was_set:
            os.environ.pop(_DEBUG_VARIABLE, None)


class Executive:
    """JSBSim with one model, after a check that all properties which the model reads exist.

    ``file``: what JSBSim loads.  ``model``: the user's file that it was made of; where that is None, ``name`` stands in
    errors.  Raises InputError if the model does not load.
    """

    def __init__(self, file: Path, model: Path | None, name: str, step: float) -> None:
        self._model, self._label = model, str(model or name)
        _log.lines.clear()
        fdm = _quiet_executive(str(file.parent))
        self.fdm = fdm
        self._manager = fdm.get_property_manager()
        fdm.set_debug_level(0)
        fdm.set_aircraft_path(".")
        for forbidden in filter(None, map(self._manager.get_node, ACTING_PROPERTIES)):
            forbidden.set_attribute(jsbsim.Attribute.WRITE, False)  # applies to all aliases of the property
        try:
            if not fdm.load_model(file.stem, add_model_to_path=False):  # returns False instead of raising
                raise Complaint("")
        except Complaint as error:
            raise self._make_error(str(error)) from None
        self._xml = read_file(file)
        self._check_properties(self._xml)
        fdm.set_dt(step)
        self.run: Callable[[], bool] = fdm.run
        for line in _log.lines:
            notify(f"{self._label}: JSBSim: {line}")

    def start(self) -> None:
        """Start JSBSim from the initial state.  Raises InputError for the model, FlightError without a state."""
        try:
            if self.fdm.run_ic():
                return
        except Complaint as error:
            raise self._make_error(str(error)) from None
        raise FlightError("JSBSim could not start from the initial state")

    def flight_error(self, error: Exception) -> FlightError:
        return FlightError(str(self._make_error(str(error))))

    def explain_not_finite(self) -> InputError:
        """Return the error for a start with forces that are not finite, with the first property that is not."""
        for element in ET.fromstring(self._xml).iter():
            name = element.get("name", "")
            node = self._manager.get_node(name) if _PROPERTY_PATH.fullmatch(name) else None
            if node is not None and not isfinite(value := node.get_double_value()):
                where = self._locate([name])
                return InputError(f"{where}: {name} is {value:g} at the start; it has to be finite, at rest too")
        return InputError(f"{self._label}: the forces of this JSBSim model are not finite at the start")

    def node(self, name: str) -> Property:
        """Return a property by name.  Raises InputError if it does not exist, because JSBSim would create it."""
        if find_acting_property(name):
            raise InputError(
                f"{self._label}: {name}: JSBSim does something when it is written; nothing here may write it"
            )
        node = self._manager.get_node(name) if _PROPERTY_PATH.fullmatch(name) else None
        if node is None:
            raise InputError(f"{self._label}: this JSBSim model has no property {name}")
        return node

    def _check_properties(self, xml: bytes) -> None:
        """Raise InputError for a model that reads properties which do not exist."""
        without_numbers = _XML_NUMBER.sub(b"><", xml)  # no property name is a number
        names = _property_cache.get(without_numbers, lambda: tuple(dict.fromkeys(_property_names(ET.fromstring(xml)))))
        missing = [name for name in names if not (_PROPERTY_PATH.fullmatch(name) and self._manager.get_node(name))]
        if missing:
            raise self._make_error("", missing)

    def _make_error(self, text: str, missing: list[str] | None = None) -> InputError:
        """Return the error for JSBSim's message or for missing properties, and keep JSBSim from being destroyed."""
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self.fdm))
        text = _clean_message(text) or "; ".join(map(_clean_message, _log.lines))
        name, *others = missing or _MISSING_PROPERTY.findall(text)[:1] or [""]
        if not name:
            words = [*re.findall(r"'([^']+)'", text), *(word for word in text.split() if "/" in word)]
            return InputError(f"{self._locate(words)}: JSBSim could not load the model{f': {text}' if text else ''}")
        rest = f" (nor {', '.join(others)})" if others else ""
        return InputError(
            f"{self._locate([name])}: the model has no property {name}{rest}: take out what reads it, or give it a "
            f'value, with <property value="0">{name}</property> in flight_control'
        )

    def _locate(self, words: list[str]) -> str:
        """Return the user's file, with the line of the first of these words."""
        locations = [] if self._model is None else [find_line(self._model, word) for word in words]
        return next((location for location in locations if location != self._label), self._label)


def _clean_message(text: str) -> str:
    """Return JSBSim's text in one line, without the name of the temporary file."""
    return re.sub(r'( in)? (file:? )?(Path )?"?[^ "]*hexjet-scratch[^ "]*"?', "", " ".join(text.split())).strip()


def _property_names(root: ET.Element) -> Iterator[str]:
    """Yield the properties that a model's functions, tables and components read."""
    inside = (
        element for function in root.iter("function") for tag in ("property", "p") for element in function.iter(tag)
    )
    for element in (*inside, *root.iter("independentVar"), *root.iter("input")):
        name = (element.text or "").strip().removeprefix("-")
        if name and "#" not in name:  # "#" stands for an engine's number
            yield name
