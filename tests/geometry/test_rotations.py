"""Rotations: round trips at every angle, and derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from metrocli.arrays import Array
from metrocli.geometry.rotations import (
    cross_matrix,
    euler_by_vector,
    euler_from_rotation,
    nearest_rotation,
    rotation_from_euler,
    rotation_from_vector,
    vector_by_left_turn,
    vector_from_rotation,
)

PI = np.pi
UNIT = st.floats(-1, 1, allow_subnormal=False)
DIRECTIONS = (
    arrays(float, 3, elements=UNIT).filter(lambda v: np.linalg.norm(v) > 1e-2).map(lambda v: v / np.linalg.norm(v))
)
TRICKY = st.sampled_from([0.0, 1e-300, 1e-12, 9e-6, 1.1e-5, 9.99e-4, 1.01e-3, 1.0, PI / 2, PI - 1e-4, PI - 1e-9, PI])
ANGLES = st.one_of(TRICKY, st.floats(0, PI))
VECTORS = st.builds(lambda direction, angle: direction * angle, DIRECTIONS, ANGLES)
FULL_TURN = st.one_of(st.sampled_from([0.0, 1e-12, PI / 2, -PI / 2, PI, -PI + 1e-9]), st.floats(-PI, PI))
NEAR_LOCK = st.sampled_from([sign * (PI / 2 - off) for sign in (1, -1) for off in (0, 1e-14, 1e-12, 1e-9, 1e-6, 1e-3)])
BETA = st.one_of(NEAR_LOCK, st.floats(-PI / 2, PI / 2))


def axis_turn(axis: int, angle: float) -> Array:
    """A turn about one axis, written out."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array(
        [[[1, 0, 0], [0, c, -s], [0, s, c]], [[c, 0, s], [0, 1, 0], [-s, 0, c]], [[c, -s, 0], [s, c, 0], [0, 0, 1]]][
            axis
        ]
    )


@settings(deadline=None)
@given(VECTORS)
def test_vector_to_matrix_and_back(vector: Array) -> None:
    rotation = rotation_from_vector(vector)
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=4e-16 * 4)
    assert np.linalg.det(rotation) == pytest.approx(1, abs=1e-14)
    back = vector_from_rotation(rotation)
    angle = np.linalg.norm(vector)
    if angle > PI - 1e-7 and back @ vector < 0:  # half a turn has two vectors
        back = -back
    assert np.allclose(back, vector, rtol=0, atol=2e-15 + 1e-15 * angle + (1e-14 if angle > 3 else 0))
    assert np.linalg.norm(back) <= PI * (1 + 1e-15)


@settings(deadline=None)
@given(VECTORS)
def test_rotation_vector_keeps_its_axis_and_turns_by_its_length(vector: Array) -> None:
    rotation = rotation_from_vector(vector)
    assert np.allclose(rotation @ vector, vector, atol=1e-14)
    assert np.trace(rotation) == pytest.approx(1 + 2 * np.cos(np.linalg.norm(vector)), abs=1e-14)


def test_a_quarter_turn_about_z_carries_x_to_y() -> None:
    quarter = rotation_from_vector(np.array([0, 0, PI / 2]))
    assert np.allclose(quarter @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@settings(deadline=None)
@given(FULL_TURN, BETA, FULL_TURN)
def test_euler_to_matrix_and_back(alpha: float, beta: float, gamma: float) -> None:
    rotation = rotation_from_euler(alpha, beta, gamma)
    assert np.allclose(rotation, axis_turn(2, gamma) @ axis_turn(1, beta) @ axis_turn(0, alpha), atol=1e-15)
    found = euler_from_rotation(rotation)
    again = rotation_from_euler(found[0], found[1], found[2])
    assert np.allclose(again, rotation, rtol=0, atol=5e-15)
    assert -PI / 2 <= found[1] <= PI / 2
    if abs(beta) < PI / 2 - 1e-3:
        turn = (found - [alpha, beta, gamma] + PI) % (2 * PI) - PI
        assert np.allclose(turn, 0, atol=1e-12)


@settings(deadline=None)
@given(FULL_TURN, st.floats(-1.5, 1.5), FULL_TURN)
def test_euler_angles_change_as_the_derivative_says(alpha: float, beta: float, gamma: float) -> None:
    rotation = rotation_from_euler(alpha, beta, gamma)
    h = 1e-6
    for axis in range(3):
        step = np.eye(3)[axis] * h
        ahead, behind = (euler_from_rotation(rotation_from_vector(sign * step) @ rotation) for sign in (1, -1))
        difference = ((ahead - behind + PI) % (2 * PI) - PI) / (2 * h)
        assert np.allclose(euler_by_vector(rotation)[:, axis], difference, rtol=1e-5, atol=1e-7)


@settings(deadline=None)
@given(
    st.builds(lambda d, a: d * a, DIRECTIONS, st.one_of(st.sampled_from([0.0, 1e-9, 9e-4, 1.1e-3]), st.floats(0, 3.1)))
)
def test_left_turn_of_a_vector_as_the_derivative_says(vector: Array) -> None:
    h = 1e-5
    rotation = rotation_from_vector(vector)
    for axis in range(3):
        step = np.eye(3)[axis] * h
        ahead, behind = (vector_from_rotation(rotation_from_vector(sign * step) @ rotation) for sign in (1, -1))
        expected = (ahead - behind) / (2 * h)
        assert np.allclose(vector_by_left_turn(vector)[:, axis], expected, rtol=1e-4, atol=1e-7)


@given(arrays(float, (2, 4, 3), elements=UNIT), VECTORS)
def test_the_matrix_of_a_cross_product(vectors: Array, other: Array) -> None:
    assert np.allclose(cross_matrix(vectors) @ other, np.cross(vectors, other), rtol=0, atol=1e-14)


def test_left_turn_is_smooth_up_to_half_a_turn() -> None:
    """Near pi the formula has the form 0/0; the factor of [v]x^2 there is 1/pi^2."""
    for angle in (PI - 1e-9, PI - 1e-15, PI):
        found = vector_by_left_turn(np.array([angle, 0, 0]))
        cross = cross_matrix(np.array([angle, 0, 0]))
        assert np.allclose(found, np.eye(3) - cross / 2 + cross @ cross / angle**2, atol=1e-8)


@settings(deadline=None)
@given(arrays(float, (3, 3), elements=UNIT), VECTORS)
def test_nearest_rotation_is_nearer_than_others(matrix: Array, vector: Array) -> None:
    nearest = nearest_rotation(matrix)
    assert np.allclose(nearest @ nearest.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(nearest) == pytest.approx(1)
    other = rotation_from_vector(vector)
    assert ((nearest - matrix) ** 2).sum() <= ((other - matrix) ** 2).sum() + 1e-12


def test_whole_arrays_are_worked_as_single_ones() -> None:
    vectors = np.random.default_rng(1).normal(size=(4, 5, 3))
    many = rotation_from_vector(vectors)
    assert many.shape == (4, 5, 3, 3)
    assert np.array_equal(many[2, 3], rotation_from_vector(vectors[2, 3]))
    for function in (vector_from_rotation, euler_from_rotation, euler_by_vector, nearest_rotation):
        assert np.allclose(function(many)[1, 4], function(many[1, 4]), atol=1e-15), function
    assert np.allclose(vector_by_left_turn(vectors)[1, 4], vector_by_left_turn(vectors[1, 4]), atol=1e-15)
