"""From camera values to spectra: the generalised inverses, and how good they are."""
