"""Calibrate a camera: from the charts of each light to the matrices that recover its spectra."""
