"""Functions of time with their first two derivatives, so that motion need be written only once.

A `Jet` holds value, rate and acceleration at many moments. Sums, products, sines and cosines of
jets are jets by the rules of calculus: what a chain of rotations and lever arms does to position,
speed and acceleration comes out exactly, without differences of neighbouring samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Jet:
    """Values of a function at ``n`` moments, with derivatives by time.

    Attributes
    ----------
    value, rate, acceleration : shape (n,)
        The function and its first and second derivative [per s, per s^2].
    """

    value: FloatArray
    rate: FloatArray
    acceleration: FloatArray

    def __add__(self, other: Jet | float) -> Jet:
        if isinstance(other, Jet):
            return Jet(
                self.value + other.value,
                self.rate + other.rate,
                self.acceleration + other.acceleration,
            )
        return Jet(self.value + other, self.rate, self.acceleration)

    __radd__ = __add__

    def __neg__(self) -> Jet:
        return Jet(-self.value, -self.rate, -self.acceleration)

    def __sub__(self, other: Jet | float) -> Jet:
        return self + (-other)

    def __rsub__(self, other: float) -> Jet:
        return -self + other

    def __mul__(self, other: Jet | float) -> Jet:
        if isinstance(other, Jet):
            return Jet(
                self.value * other.value,
                self.rate * other.value + self.value * other.rate,
                self.acceleration * other.value
                + 2.0 * self.rate * other.rate
                + self.value * other.acceleration,
            )
        return Jet(self.value * other, self.rate * other, self.acceleration * other)

    __rmul__ = __mul__


Vector = tuple[Jet, Jet, Jet]
"""A vector that moves: its components on x, y and z."""


def sine(angle: Jet) -> Jet:
    """Sine of an angle [rad]."""
    return _of_angle(angle, np.sin(angle.value), np.cos(angle.value))


def cosine(angle: Jet) -> Jet:
    """Cosine of an angle [rad]."""
    return _of_angle(angle, np.cos(angle.value), -np.sin(angle.value))


def constant(vector: tuple[float, float, float], like: Jet) -> Vector:
    """Return a vector that rests, at the moments of another jet."""
    zero = np.zeros_like(like.value)
    x, y, z = (Jet(np.full_like(zero, value), zero, zero) for value in vector)
    return x, y, z


def add(a: Vector, b: Vector) -> Vector:
    """Sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vector, b: Vector) -> Vector:
    """Difference of two vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _of_angle(angle: Jet, value: FloatArray, slope: FloatArray) -> Jet:
    return Jet(value, slope * angle.rate, slope * angle.acceleration - value * angle.rate**2)
