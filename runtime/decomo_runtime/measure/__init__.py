"""Deformation and motion in numbers: strain, displacement, velocity, acceleration, in the clip's units of length."""
