"""From a captured or any other panorama to a spectral DomeLight."""
