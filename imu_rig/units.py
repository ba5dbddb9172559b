"""Constants and the one table of units that people may write in files and options.

Inside the code every quantity is in SI units (microtesla for the magnetic field); these factors
are used only where text or foreign data come in or go out.
"""

import math

STANDARD_GRAVITY = 9.80665
"""Conventional standard gravity [m/s^2]: what "g" means as a unit. Local gravity differs."""

DEG = math.pi / 180.0
"""One degree [rad]."""

MILLI_G = STANDARD_GRAVITY / 1000.0
"""One thousandth of standard gravity [m/s^2]."""

ACCELERATION_UNITS = {"m/s2": 1.0, "m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": MILLI_G}
RATE_UNITS = {"rad/s": 1.0, "deg/s": DEG, "dps": DEG, "mrad/s": 1e-3}
FIELD_UNITS = {"uT": 1.0, "G": 100.0, "gauss": 100.0, "mG": 0.1, "nT": 1e-3, "T": 1e6}
TEMPERATURE_UNITS = {"degC": 1.0}
PRESSURE_UNITS = {"Pa": 1.0, "hPa": 100.0, "mbar": 100.0, "kPa": 1000.0, "bar": 1e5}
LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
