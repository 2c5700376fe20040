"""A proof as one self-contained HTML file that a person opens: ``usdskin report``."""
