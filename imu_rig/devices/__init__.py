"""Drivers: ports, inertial sensors, the servo controller and the jig it moves."""
