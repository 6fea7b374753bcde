"""Strain by numbers that can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decomo_runtime.measure.strain import strain_of

STEPS = st.floats(-0.4, 0.4)


def turned(degrees: float) -> np.ndarray:
    angle = np.radians(degrees)
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def test_a_stretch():
    strain = strain_of(np.diag([1.2, 0.9]))
    np.testing.assert_allclose(strain.green_lagrange, [0.22, -0.095, 0])
    np.testing.assert_allclose(strain.small, [0.2, -0.1, 0])
    np.testing.assert_allclose(strain.principal, [0.22, -0.095])
    np.testing.assert_allclose([strain.direction, strain.rotation, strain.area_change], [0, 0, 0.08], atol=1e-12)


def test_a_shear():
    strain = strain_of(np.array([[1, 0.2], [0, 1]]))
    np.testing.assert_allclose(strain.green_lagrange, [0, 0.02, 0.1])
    np.testing.assert_allclose(strain.small, [0, 0, 0.1], atol=1e-12)
    np.testing.assert_allclose(strain.rotation, -np.degrees(np.arctan(0.1)))
    np.testing.assert_allclose(strain.area_change, 0, atol=1e-12)


def test_a_rotation_is_no_strain_but_small_strain_takes_it_for_one():
    strain = strain_of(turned(30))
    np.testing.assert_allclose(strain.green_lagrange, 0, atol=1e-12)
    np.testing.assert_allclose(strain.rotation, 30)
    np.testing.assert_allclose(strain.small[:2], np.cos(np.radians(30)) - 1)


@given(STEPS, STEPS, STEPS, st.floats(-170, 170))
def test_rotating_afterwards_changes_rotation_alone(xx: float, yy: float, xy: float, degrees: float):
    stretch = np.array([[1 + xx, xy], [xy, 1 + yy]])
    if np.linalg.det(stretch) < 0.05:
        return
    plain, both = strain_of(stretch), strain_of(turned(degrees) @ stretch)
    np.testing.assert_allclose(both.green_lagrange, plain.green_lagrange, atol=1e-12)
    np.testing.assert_allclose(both.area_change, plain.area_change, atol=1e-12)
    np.testing.assert_allclose(both.rotation, degrees, atol=1e-6)  # a stretch by itself turns nothing


@given(STEPS, STEPS, STEPS, STEPS)
def test_principal_strains_are_eigenvalues(a: float, b: float, c: float, d: float):
    gradient = np.array([[1 + a, b], [c, 1 + d]])
    if np.linalg.det(gradient) < 0.05:
        return
    strain = strain_of(gradient)
    tensor = (gradient.T @ gradient - np.eye(2)) / 2
    np.testing.assert_allclose(strain.principal[::-1], np.linalg.eigvalsh(tensor), atol=1e-9)
    angle = np.radians(strain.direction)
    along = np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(tensor @ along, strain.principal[0] * along, atol=1e-9)


@pytest.mark.parametrize("gradient", [np.diag([-1.0, 1.0]), np.zeros((2, 2)), np.full((2, 2), np.nan)])
def test_what_folds_has_no_strain(gradient: np.ndarray):
    strain = strain_of(np.stack([gradient, np.eye(2)]))
    for values in (strain.green_lagrange, strain.small, strain.principal, strain.rotation, strain.area_change):
        assert np.isnan(values[0]).all()
        np.testing.assert_allclose(values[1], 0, atol=1e-12)
