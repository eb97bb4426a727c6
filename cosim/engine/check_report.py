"""Report of an engine check: its findings, and their text for the terminal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

# Names of the tests of an engine, most of them short flights.
QUESTIONS = ("loads", "runs", "is finite", "responds", "repeats", "runs six at once", "resets")


@dataclass
class CheckReport:
    """Findings of a check; ``problems`` is empty for a sound engine, ``notes`` do not prevent a flight.

    Times are in s, thrusts in N.  A field is None where an earlier problem prevented its measurement.
    """

    path: str
    name: str
    fmi_version: str
    sha256: str
    step: float
    ports: list[dict[str, Any]]
    inputs: list[dict[str, Any]]
    outputs: list[dict[str, Any]]
    parameters: list[dict[str, Any]]  # ``start`` as stated, ``value`` measured
    throttle: list[float] | None = None  # throttles of the static curve
    thrust: list[float] | None = None
    delay_samples_up: int | None = None  # delay in communication steps
    delay_samples_down: int | None = None
    tenth_up: float | None = None  # time to 10 % of the change, s
    tenth_down: float | None = None
    rise_time_up: float | None = None  # time from 10 to 90 % of it, s
    rise_time_down: float | None = None
    course_up: list[float] | None = None  # thrust every ``course_step_up`` s
    course_down: list[float] | None = None
    course_step_up: float | None = None
    course_step_down: float | None = None
    answers: dict[str, bool | None] = field(default_factory=lambda: dict.fromkeys(QUESTIONS))
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        return not self.problems

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain lists, numbers and strings, for JSON."""
        return {"ok": self.ok, **asdict(self)}

    def lines(self) -> list[tuple[str, str]]:
        """Return the report as (label, text) rows without the problems."""
        words = {True: "yes", False: "no", None: "not asked"}
        rows = [
            ("file", self.path),
            ("model", f"{self.name}, FMI {self.fmi_version}, sha256 {self.sha256[:12]}"),
            *((port["port"].replace("_", " "), _describe_port(port)) for port in self.ports),
            *(("input", _describe_variable(v)) for v in self._list_other_variables(self.inputs)),
            *(("output", _describe_variable(v)) for v in self._list_other_variables(self.outputs)),
            *(("parameter", _describe_variable(v)) for v in self._list_other_variables(self.parameters)),
            ("step", f"{self.step:g} s"),
            *self._response_lines(),
            *((question, words[answer]) for question, answer in self.answers.items()),
        ]
        return [*rows, *(("note", note) for note in self.notes)]

    def _list_other_variables(self, variables: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
        used = {port["name"] for port in self.ports}
        return [v for v in variables if v["name"] not in used]

    def _response_lines(self) -> list[tuple[str, str]]:
        """Return rows with static thrust, delay and rise time."""
        rows = []
        if self.throttle is not None and self.thrust is not None:
            shown = range(0, len(self.throttle), len(self.throttle) // 5)
            points = (f"{self.throttle[k]:g}: {round(self.thrust[k], 3) + 0.0:g}" for k in shown)
            rows.append(("static thrust [N]", ", ".join(points)))
        for way in ("up", "down"):
            delay, tenth, rise = (getattr(self, f"{what}_{way}") for what in ("delay_samples", "tenth", "rise_time"))
            if delay is not None and rise is not None:
                first = "" if tenth is None else f", 10 % after {tenth:.4g} s"
                text = f"delay {delay} samples ({delay * self.step:g} s){first}, then 10 to 90 % in {rise:.4g} s"
                rows.append((f"throttle {way}", text))
        return rows


def _describe_port(port: dict[str, Any]) -> str:
    unit = f" [{port['unit']}]" if port["unit"] else ""
    if port["from"] is not None:
        what = f", {port['from']:g} to {port['to']:g} are 0 to 1"
    elif (port["scale"], port["offset"]) != (1.0, 0.0):
        what = f", 1 is {port['scale'] + port['offset']:g} {port['si']}, 0 is {port['offset']:g}"
    else:
        what = ""
    return f"{port['name']}{unit}{what}, found {port['found']}"


def _describe_variable(v: dict[str, Any]) -> str:
    unit = "" if v["unit"] in (None, "1") else f" {v['unit']}"
    value = v.get("value", v["start"])
    start = "" if value is None else f" = {value if isinstance(value, str) else f'{value:g}'}{unit}"
    start += f", from {v['start']:g}" if isinstance(value, float) and v["start"] not in (None, value) else ""
    limits = "" if v["min"] is None and v["max"] is None else f", {_show_limit(v['min'])} to {_show_limit(v['max'])}"
    what = f": {v['description']}" if v["description"] else ""
    return f"{v['name']}{start or unit}{limits}{what}"


def _show_limit(value: float | None) -> str:
    return "any" if value is None else f"{value:g}"
