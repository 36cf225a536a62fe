"""Poses: they compose, turn back, and differ by the step that leads from one to the other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from metrocli.arrays import Array
from metrocli.geometry import poses
from metrocli.geometry.rotations import rotation_from_euler, rotation_from_vector

SHIFTS = arrays(float, 3, elements=st.floats(-2000, 2000, allow_subnormal=False))
TURNS = arrays(float, 3, elements=st.floats(-1.7, 1.7, allow_subnormal=False))
POSES = st.builds(lambda shift, turn: np.concatenate([shift, turn]), SHIFTS, TURNS)


def apart(one: Array, other: Array) -> float:
    """Largest difference of two poses as 3 x 4 matrices, shifts in units of 2000."""
    turn = np.abs(poses.rotation_of(one) - poses.rotation_of(other)).max()
    return float(max(turn, np.abs(one[..., :3] - other[..., :3]).max() / 2000))


@settings(deadline=None)
@given(POSES, POSES, SHIFTS)
def test_composed_poses_act_one_after_the_other(outer: Array, inner: Array, point: Array) -> None:
    once = poses.apply(poses.compose(outer, inner), point)
    assert np.allclose(once, poses.apply(outer, poses.apply(inner, point)), rtol=0, atol=1e-10)


@settings(deadline=None)
@given(POSES, SHIFTS)
def test_inverse_undoes(pose: Array, point: Array) -> None:
    assert np.allclose(poses.apply(poses.inverse(pose), poses.apply(pose, point)), point, rtol=0, atol=1e-10)
    assert apart(poses.compose(pose, poses.inverse(pose)), np.zeros(6)) < 1e-14


@settings(deadline=None)
@given(POSES, POSES)
def test_difference_is_the_step_between(pose: Array, reference: Array) -> None:
    assert apart(poses.moved(reference, poses.difference(pose, reference)), pose) < 1e-13


@settings(deadline=None)
@given(POSES, POSES)
def test_difference_changes_as_the_derivative_says(pose: Array, reference: Array) -> None:
    if np.linalg.norm(poses.difference(pose, reference)[3:]) > 3.1:
        return  # the vector jumps at half a turn
    h = 1e-5
    for k in range(6):
        step = np.eye(6)[k] * h
        ahead, behind = (poses.difference(poses.moved(pose, sign * step), reference) for sign in (1, -1))
        expected = (ahead - behind) / (2 * h)
        assert np.allclose(poses.difference_by_step(pose, reference)[:, k], expected, rtol=1e-4, atol=1e-6)


@settings(deadline=None)
@given(SHIFTS, st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3))
def test_euler_form_and_its_derivative(shift: Array, alpha: float, beta: float, gamma: float) -> None:
    angles = np.array([alpha, beta, gamma])
    pose = poses.pose_from_euler(shift, angles)
    assert np.allclose(poses.rotation_of(pose), rotation_from_euler(alpha, beta, gamma), atol=1e-14)
    assert np.allclose(poses.euler_form(pose), [*shift, *angles], atol=1e-11)
    h = 1e-6
    for k in range(6):
        step = np.eye(6)[k] * h
        ahead, behind = (poses.euler_form(poses.moved(pose, sign * step)) for sign in (1, -1))
        difference = (ahead - behind) / (2 * h)
        assert np.allclose(poses.euler_form_by_step(pose)[:, k], difference, rtol=1e-5, atol=1e-6)


@settings(deadline=None)
@given(POSES, st.integers(0, 2**32 - 1), st.integers(3, 8))
def test_fit_finds_the_pose(pose: Array, seed: int, count: int) -> None:
    points = np.random.default_rng(seed).normal(size=(count, 3)) * 300
    assert apart(poses.fit_pose(points, poses.apply(pose, points)), pose) < 1e-10


def test_fit_is_least_squares_and_never_a_mirror() -> None:
    rng = np.random.default_rng(7)
    points = rng.normal(size=(6, 3))
    targets = points * [1, 1, -1] + 0.3 * rng.normal(size=(6, 3))
    found = poses.fit_pose(points, targets)
    cost = ((poses.apply(found, points) - targets) ** 2).sum()
    assert np.linalg.det(poses.rotation_of(found)) == pytest.approx(1)
    for _ in range(200):
        step = rng.normal(size=6) * 10 ** rng.uniform(-3, 0)
        assert ((poses.apply(poses.moved(found, step), points) - targets) ** 2).sum() >= cost


def test_a_step_turns_from_the_left() -> None:
    pose = np.array([1.0, 2.0, 3.0, 0.1, -0.4, 0.7])
    step = np.array([0.5, 0.0, 0.0, 0.0, 0.0, np.pi / 2])
    moved = poses.moved(pose, step)
    assert np.allclose(moved[:3], [1.5, 2, 3])
    assert np.allclose(poses.rotation_of(moved), rotation_from_vector(step[3:]) @ rotation_from_vector(pose[3:]))
