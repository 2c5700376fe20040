"""Warp kernels: arrays in, arrays out; no USD, no files."""
