"""Photographs of one view become linear image values with their noise."""
