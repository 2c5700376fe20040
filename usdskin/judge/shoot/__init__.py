"""A virtual photographer: brackets, charts and readings of a light that is known."""
