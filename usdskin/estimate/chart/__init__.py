"""The patches of a color chart: their camera values and their spectra."""
