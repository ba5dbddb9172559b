"""Simulated hardware that speaks real bytes through real ports, with a known truth behind it."""
