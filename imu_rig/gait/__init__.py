"""Feet that walk: zero-velocity intervals, trajectories of a foot-worn sensor, strides."""
