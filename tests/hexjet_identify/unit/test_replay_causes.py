"""What of the table of numbers is named, and the measures that it rests on."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from cosim.base.frames import from_euler, rotate
from hexjet_identify.replay import Choices
from hexjet_identify.replay.causes import CauseRow, Causes, FittedNumber, name_rows
from hexjet_identify.replay.flown import delay_rows
from hexjet_identify.replay.measures import LEVEL_CHANNEL, ChannelMeasures, measure_bands, measure_ratio, theil
from hexjet_identify.replay.misfit import Scores
from hexjet_identify.replay.replay import are_beyond_tolerances, is_uncommanded
from hexjet_identify.replay.wind import level_part


def row(name: str, value: float, stated: float = 1.0, **others: Any) -> CauseRow:
    part = FittedNumber(name, "", stated, value, 0.01, 0.3)
    given: dict[str, Any] = {"removed": 1.0, "windows": np.zeros(8), "over_noise": 1.0, "fits": True, "changes": 9.0}
    return CauseRow(name, (part,), **given | others)


def test_a_named_number_beyond_the_tolerances_is_not_explained() -> None:
    """Though every channel is inside the envelope, which engines that are hardly known make wide."""

    def beyond(draws_engine: bool, *rows: CauseRow) -> bool:
        return are_beyond_tolerances(Causes(7.0, rows, (), ""), Choices(), draws_engine, 0.4)

    inertia, little = (row("moment of inertia about z", value) for value in (0.7, 0.95))
    lag, late = row("lag of the engines", 0.12, 0.1), row("further delay of the attitude", 0.03, 0.0)
    near, far = (row("centre of gravity z", value, 0.0) for value in (0.003, 0.006))
    assert beyond(True, inertia)
    assert not beyond(False, little)
    assert beyond(False, lag)
    assert not beyond(True, lag)
    assert not beyond(True, inertia, lag)
    assert beyond(False, far)
    assert not beyond(False, near)
    assert not beyond(False, late)
    assert beyond(True, replace(inertia, parts=()))
    assert not beyond(True)


def test_what_explains_about_as_well_is_named_beside() -> None:
    """By a twentieth of the misfit and three standard errors, or by leaving noise alone."""
    misfit = np.full(8, 100.0)
    best, near = row("mass", 1.1, windows=np.full(8, 1.0)), row("thrust", 0.9, windows=np.full(8, 4.0))
    assert [one.name for one in name_rows([best, near], misfit)[0]] == ["mass", "thrust"]
    far = replace(near, windows=np.full(8, 20.0), removed=0.8)
    assert [one.name for one in name_rows([best, far], misfit)[0]] == ["mass"]
    noisy = replace(near, over_noise=2.0)
    assert [one.name for one in name_rows([best, noisy], misfit)[0]] == ["mass"]


@pytest.mark.parametrize(
    ("others", "said"),
    [
        ({"removed": 0.4}, "nothing alone removes half of it"),
        ({"fits": False}, "not in the envelope"),
        ({"at_limit": True}, "at the end of what was tried"),
        ({"windows": np.array([0.0, 400.0] * 4)}, "the windows do not agree"),
    ],
)
def test_what_explains_too_little_is_not_named(others: dict[str, Any], said: str) -> None:
    named, reason = name_rows([row("mass", 1.1, **others)], np.full(8, 100.0))
    assert not named
    assert said in reason


def test_the_digits_of_a_number_tell_its_bounds_apart() -> None:
    assert FittedNumber("mass", "", 1.0, 1.15994, 0.00032, 0.3).text.endswith("(95 %: 1.15962 to 1.16026)")
    assert FittedNumber("delay", "s", 0.0, 0.01249, 0.00012, 0.02).text == "delay: 12.49 ms (95 %: 12.37 to 12.61)"


def test_what_no_command_moves_is_foreign() -> None:
    """Not a model that is alike but too small, nor a thrust over mass that is off."""
    rng = np.random.default_rng(1)
    blown, flown = (x - x.mean(axis=1, keepdims=True) for x in rng.standard_normal((2, 20, 100)).cumsum(axis=2))

    def channel(measured: np.ndarray, modelled: np.ndarray, name: str = "rate_p") -> ChannelMeasures:
        ratio = measure_ratio(measured, modelled, 0.004, 0.01)
        bands = measure_bands(ratio, 0.01)
        return ChannelMeasures(name, "rad/s", 0.1, 1.0, 1.0, 0.01, theil(measured, modelled), bands, True, ratio)

    assert is_uncommanded(channel(blown, 0.01 * flown))
    assert not is_uncommanded(channel(blown, 0.4 * blown))
    assert not is_uncommanded(channel(blown, -0.4 * blown))
    assert not is_uncommanded(channel(blown, 0.01 * flown + 100.0, LEVEL_CHANNEL))


def test_forces_are_turned_as_an_attitude_turns_them() -> None:
    rng = np.random.default_rng(1)
    for angles, force in zip(rng.uniform(-1.0, 1.0, (5, 3)), rng.standard_normal((5, 3)), strict=True):
        assert level_part(force, angles) == pytest.approx(rotate(from_euler(*angles), tuple(force))[:2])


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_bounds_hold_the_truth(memory: float) -> None:
    """In some 95 of 100 fits of one number by ten windows of 100 rows, with noise that is white and that is not."""
    rng = np.random.default_rng(1)
    slopes = np.sin(0.1 * np.arange(100.0))[:, None, None] * rng.standard_normal((10, 1, 1, 1))
    information, none, held = np.sum(slopes**2, axis=(1, 2))[..., None], np.zeros((10, 3)), []
    root, prior = np.array([[information.sum() ** -0.5]]), np.zeros((1, 1))
    for _ in range(200):
        left = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], rng.standard_normal((10, 200, 1)), axis=1)[:, 100:]
        value = float(np.sum(slopes[..., 0] * left) / information.sum())
        rest = left - value * slopes[..., 0]
        scores = Scores(root, slopes, rest, none[..., None], none, np.ones(7), prior, information)
        held.append(abs(value) <= float(scores.bounds()[0]))
    assert 0.92 <= np.mean(held) <= 0.995


def test_signals_are_later_by_whole_rows_and_parts_of_them() -> None:
    values = np.arange(12.0).reshape(2, 6)
    assert delay_rows(values, 1.5, axis=1)[:, 2:].tolist() == (values[:, 2:] - 1.5).tolist()
    assert delay_rows(values.T, -2.0)[:4].tolist() == (values.T[:4] + 2.0).tolist()
