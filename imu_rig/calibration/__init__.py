"""Calibration: still intervals, solvers, results with honest uncertainties, certificates.

Every calibrated value is ``K @ raw - b``, with ``raw`` nominally scaled to m/s^2 or rad/s.
"""
