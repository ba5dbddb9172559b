"""Jig sessions: the protocol file, its dry run, and the engine that steps an IMU through it."""
