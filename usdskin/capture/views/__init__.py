"""Views become one panorama."""
