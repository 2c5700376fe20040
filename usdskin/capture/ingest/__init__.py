"""Photographs in folders become the layer of a shoot."""
