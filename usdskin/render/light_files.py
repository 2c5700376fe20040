"""Files that lights name, and the color spaces they and other inputs are in."""

from __future__ import annotations

from pathlib import Path

from pxr import Sdf, Usd

from usdskin.colorimetry import color_space_names
from usdskin.errors import ImageError, LayerError
from usdskin.layers import describe

DEFAULT_COLOR_SPACE = "lin_rec709_scene"

# Names that predate USD's list, and those that say there is nothing to convert.
_COLOR_SPACE_ALIASES = {
    "sRGB": "srgb_rec709_scene",
    "linear": DEFAULT_COLOR_SPACE,
    "lin_srgb": DEFAULT_COLOR_SPACE,
    "raw": DEFAULT_COLOR_SPACE,
    "data": DEFAULT_COLOR_SPACE,
    "identity": DEFAULT_COLOR_SPACE,
}
_UNSAID_COLOR_SPACES = ("", "auto", "unknown")
_INTEGER_SAMPLES = ("uint8", "uint16", "int8", "int16")


def said_color_space(attribute: Usd.Attribute | None, inherited: bool = True) -> str | None:
    """Return the colour space that an attribute is said to be in, by the name we know it by.

    Args:
        attribute: The attribute.
        inherited: Whether ``ColorSpaceAPI`` on the prim or its ancestors counts.

    Raises:
        LayerError: An unknown colour space.
    """
    if not attribute:
        return None
    name = str(attribute.GetColorSpace())
    if name in _UNSAID_COLOR_SPACES and inherited:
        name = str(Usd.ColorSpaceAPI.ComputeColorSpaceName(attribute, None))
    if name in _UNSAID_COLOR_SPACES:
        return None
    name = _COLOR_SPACE_ALIASES.get(name, name)
    if name not in color_space_names():
        raise LayerError(
            f"{describe(attribute)}: {attribute.GetName()} is in color space {name!r}, which is "
            f"unknown; use one of {', '.join(color_space_names())}"
        )
    return name


def map_color_space(attribute: Usd.Attribute, of_file: str | None, sample_type: str) -> str:
    """Return the colour space of a light map's pixels.

    The strongest of: what the attribute says, what the file says, what ``ColorSpaceAPI`` says (of
    a map in floating point), and sRGB for integers, linear Rec. 709 for the rest.
    """
    is_integer = sample_type in _INTEGER_SAMPLES
    own = said_color_space(attribute, inherited=False)
    if own is None and of_file is not None:
        of_file = _COLOR_SPACE_ALIASES.get(of_file, of_file)
        own = of_file if of_file in color_space_names() else None
    if own is None and not is_integer:
        own = said_color_space(attribute)
    return own or ("srgb_rec709_scene" if is_integer else DEFAULT_COLOR_SPACE)


def asset_file(attribute: Usd.Attribute | None, time: Usd.TimeCode) -> Path | None:
    """Return the file an asset attribute names, None where it names none.

    Raises:
        ImageError: The file is not there; the message names layer, prim and path.
    """
    asset = attribute.Get(time) if attribute else None
    if not isinstance(asset, Sdf.AssetPath) or not asset.path or attribute is None:
        return None
    if not asset.resolvedPath:
        raise ImageError(
            f"{describe(attribute)}: {attribute.GetName()} names @{asset.path}@, which is not "
            "there; restore it or correct the path"
        )
    return Path(asset.resolvedPath)
