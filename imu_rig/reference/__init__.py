"""Estimates beside a reference: alignment of frames, errors, and tables of them."""
