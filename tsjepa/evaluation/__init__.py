"""Closed-loop scores, prediction horizons, metrics and figures."""
