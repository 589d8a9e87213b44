"""Sensitivity of mean S to gains and thresholds."""
