"""How right a panorama is: lamps, scale, figures, picture."""
