"""The compiled inner loops: true recurrences over samples, on plain arrays of SI numbers.

They know numpy and numba, and nothing else of imu-rig but its array types.
"""
