"""Rotations against scipy's, which is another implementation, and against algebra."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cosim.base import frames

angles = st.floats(-pi, pi)
steep = st.floats(-1.5, 1.5)  # short of the pole, where roll and yaw are not told apart
parts = st.floats(-10.0, 10.0)
vectors = st.tuples(parts, parts, parts)
quaternions = st.tuples(parts, parts, parts, parts).filter(lambda q: sum(x * x for x in q) > 1e-3).map(frames.normalize)
EXACT = 1e-12  # a few dozen operations on numbers of order 10


def scipy_of(q: tuple[float, float, float, float]) -> Rotation:
    return Rotation.from_quat([q[1], q[2], q[3], q[0]])


@given(angles, steep, angles)
def test_from_euler_is_yaw_pitch_roll(roll: float, pitch: float, yaw: float) -> None:
    ours = scipy_of(frames.from_euler(roll, pitch, yaw)).as_matrix()
    assert ours == pytest.approx(Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), abs=EXACT)


@given(st.floats(-3.1, 3.1), steep, st.floats(-3.1, 3.1))
def test_to_euler_undoes_from_euler(roll: float, pitch: float, yaw: float) -> None:
    # asin loses half the digits towards the pole; at 1.5 rad some 1e-15 / cos(1.5)
    assert frames.to_euler(frames.from_euler(roll, pitch, yaw)) == pytest.approx((roll, pitch, yaw), abs=1e-10)


@given(quaternions, vectors)
def test_rotation_is_scipys(q: tuple[float, float, float, float], v: tuple[float, float, float]) -> None:
    assert frames.rotate(q, v) == pytest.approx(scipy_of(q).apply(v), abs=EXACT * 10)
    assert frames.rotate(frames.conjugate(q), frames.rotate(q, v)) == pytest.approx(v, abs=EXACT * 10)


@given(quaternions, quaternions)
def test_multiply_rotates_by_the_second_first(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    ours = scipy_of(frames.multiply(a, b)).as_matrix()
    assert ours == pytest.approx((scipy_of(a) * scipy_of(b)).as_matrix(), abs=EXACT)


@given(vectors, vectors)
def test_the_cross_product_is_numpys(a: tuple[float, float, float], b: tuple[float, float, float]) -> None:
    assert frames.cross(a, b) == pytest.approx(np.cross(a, b), abs=EXACT * 100)


@given(st.floats(-pi / 2, pi / 2))
def test_jet_axis_tilts_up_to_forward(tilt: float) -> None:
    x, y, z = frames.jet_axis(tilt)
    assert (x, y, z) == (sin(tilt), 0.0, -cos(tilt))
    assert (x > 0.0) == (tilt > 0.0)
