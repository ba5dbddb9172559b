"""Trials written as the formats of other programs, after the recording has ended."""
