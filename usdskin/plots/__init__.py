"""Figures of calibrations and lights."""
