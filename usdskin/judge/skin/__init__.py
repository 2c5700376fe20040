"""Virtual measurements of a skin that is known."""
