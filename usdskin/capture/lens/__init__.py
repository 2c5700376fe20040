"""Lenses: measured with a board, or taken from other tools."""
