"""Spectral pictures of human skin under measured light, through USD layers."""

from __future__ import annotations

import importlib.util

__version__ = "0.1.0"


def plugin_path() -> str:
    """Return the folder of the ``usdSkin`` schema plugin, without importing pxr.

    Hosts that start USD themselves (usdview, Blender, Houdini) find the schema when
    ``PXR_PLUGINPATH_NAME`` names this folder before they start.
    """
    spec = importlib.util.find_spec("usdskin.schemas")
    if spec is None or not spec.submodule_search_locations:
        raise ImportError("the package usdskin.schemas is missing; reinstall usdskin")
    return next(iter(spec.submodule_search_locations))
