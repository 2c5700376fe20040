"""Spectra from the files of instruments: CSV, CGATS, SPDX and TM-27."""
