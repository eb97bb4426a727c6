"""docs/metrics.md names every metric, every limit and every verdict."""

from __future__ import annotations

from typing import get_args

from places import DOCS

from cosim.base.outcomes import RunVerdict
from cosim.results import wording
from cosim.results.metrics import metric_names
from cosim.spec.scenario import FlightLimits

PAGE = (DOCS / "metrics.md").read_text(encoding="utf-8")


def test_every_metric_is_defined() -> None:
    for name in metric_names():
        assert f"`{name.replace('pitch.', 'roll.').replace('yaw.', 'roll.')}`" in PAGE, name


def test_every_metric_is_shown() -> None:
    assert wording.DIGITS.keys() == set(metric_names())


def test_every_limit_is_there() -> None:
    rows = [line.split("|")[1] for line in PAGE.splitlines() if line.startswith("| `")]
    for key in FlightLimits.model_fields:
        assert any(f"`{key}`" in cell for cell in rows), key


def test_every_verdict_is_there() -> None:
    for verdict in get_args(RunVerdict):
        assert f"| `{verdict}` |" in PAGE
