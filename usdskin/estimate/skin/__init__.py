"""From readings of skin to its reflectance, wrap and scattering, and how sure they are."""
