"""imu-rig: calibrate inertial sensors on a servo jig and record trials that nothing can lose.

Conventions of the whole package: SI units inside (microtesla for the magnetic field), sample axis
first, scalar-first body-to-navigation quaternions, navigation frame with z up, accelerometers read
+g upward at rest, and a calibrated value is ``K @ raw - b``.
"""

__version__ = "0.1.0"
