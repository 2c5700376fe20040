"""What a caller asks of a render beyond what the stage says, and how it reaches the stage.

Reads:  the flags of ``usdskin render`` and ``usdskin map``.
Writes: variants and attribute values, into the session layer of the opened stage.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError
from usdskin.layers import describe

# isort: split
# After usdskin.layers, which registers the schemas.
from pxr import Sdf, Tf, Usd


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RenderOverrides:
    """What was asked for by flags or by a caller; None where nothing was.

    The values are checked by ``resolve_settings``.
    """

    frames: Sequence[float] | None = None
    """Frame numbers in the order to render them."""

    camera: str | None = None
    """Path or name of the camera prim."""

    width: int | None = None
    """Width [px]; the camera's aspect gives the height."""

    resolution: tuple[int, int] | None = None
    """Width and height [px]."""

    settings: str | None = None
    """Path of the RenderSettings prim."""

    spectral_output: bool | None = None
    """Whether a spectral file is written."""

    spectral_method: Literal["factorised", "brute"] | None = None
    """Shade the light's few channels, or every band by itself."""

    integrator: str | None = None
    samples: int | None = None
    """Samples per pixel."""

    target_error: float | None = None
    """Relative error at which the sampling of a traced pixel stops [1]."""

    bounces: int | None = None
    """How often reflected light falls on other surfaces, 0 or 1; traced only."""

    pixel_filter: str | None = None
    seed: int | None = None
    illuminant: str | None = None
    """Lamp of RGB lights without one: a name or a table's path."""

    bad_pixels: Literal["error", "clamp"] | None = None
    ev: float | Literal["auto"] | None = None
    """Exposure of the preview [stops], or ``auto``."""

    white: str | None = None
    """White the preview is adapted from: ``none``, ``scene`` or an illuminant."""

    view: str | None = None
    """OCIO view of the preview."""

    png: bool | None = None
    """Whether a preview is written beside each EXR."""

    half: bool = False
    """Whether beauty is stored as half floats."""

    attributes: Sequence[str] = ()
    """``/prim.attr=value`` each."""

    variants: Sequence[str] = ()
    """``/prim{set=variant}`` each."""

    mask: Sequence[str] | None = None
    """Paths of the prims whose geometry is rendered, with all below them."""

    purposes: Sequence[str] | None = None
    dome: str | None = None
    aovs: Sequence[str] | None = None
    """Names of data parts; ``all`` or ``none`` alone."""

    subdivision_level: int | None = None
    wavelength_nm: NDArray[np.float64] | None = None
    """Band centres [nm], shape [band_count]."""

    observer: str | None = None
    skip_existing: bool = False
    resume: bool = False
    """Whether an interrupted picture goes on where it ended."""

    snapshot_s: float | None = None
    """Time between previews of an unfinished picture [s]."""

    compression: str | None = None
    allow_outside: bool = False
    """Whether products may be written outside the current folder."""

    threads: int | None = None
    """CPU threads; all when None."""

    device: str = "auto"
    """``auto``, ``cpu`` or ``cuda:N``."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MapOverrides:
    """What was asked of ``usdskin map``; None where nothing was."""

    frame: float | None = None
    light_prim: str | None = None
    """Path of the one light to take; all when None."""

    material: str | None = None
    """Path of the skin material; the stage's only one, or a white surface, when None."""

    wrap: float | None = None
    """Wrap l of the white surface [1]."""

    width: int | None = None
    """Width [px], twice the height."""

    wavelength_nm: NDArray[np.float64] | None = None
    """Band centres [nm], shape [band_count]."""

    observer: str | None = None
    illuminant: str | None = None
    bad_pixels: Literal["error", "clamp"] | None = None
    ev: float | Literal["auto"] | None = None
    white: str | None = None
    view: str | None = None
    threads: int | None = None
    device: str = "auto"


def apply_overrides(stage: Usd.Stage, overrides: RenderOverrides) -> None:
    """Select the variants and set the attributes that flags ask for, in the session layer.

    Args:
        stage: Opened stage; its layers on disk are not touched.
        overrides: The flags.

    Raises:
        UsageError: A flag names what the stage has not, or a value does not fit its attribute.
    """
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for selection in overrides.variants:
            _select_variant(stage, selection)
        for assignment in overrides.attributes:
            _assign(stage, assignment)


def _select_variant(stage: Usd.Stage, selection: str) -> None:
    flag = f"--variant {selection}"
    match = re.fullmatch(r"(?P<prim>/[^{}]*)\{(?P<set>[^{}=]+)=(?P<variant>[^{}=]*)\}", selection)
    if match is None:
        raise UsageError(f"{flag}: write /prim{{set=variant}}.")
    prim = _prim(stage, match["prim"], flag)
    sets = prim.GetVariantSets()
    if match["set"] not in sets.GetNames():
        found = ", ".join(sets.GetNames()) or "none"
        raise UsageError(f"{flag}: no variant set {match['set']!r} there; it has {found}.")
    chosen = sets.GetVariantSet(match["set"])
    if match["variant"] not in chosen.GetVariantNames():
        found = ", ".join(chosen.GetVariantNames())
        raise UsageError(f"{flag}: no variant {match['variant']!r} there; it has {found}.")
    chosen.SetVariantSelection(match["variant"])


def _prim(stage: Usd.Stage, path: str, flag: str) -> Usd.Prim:
    prim = stage.GetPrimAtPath(path) if Sdf.Path.IsValidPathString(path) else None
    if not prim:
        raise UsageError(f"{flag}: the stage has no prim <{path}>.")
    if prim.IsInstanceProxy():
        raise UsageError(f"{flag}: <{path}> is inside an instance; change its prototype's layer.")
    return prim


def _assign(stage: Usd.Stage, assignment: str) -> None:
    flag = f"--set {assignment}"
    target, equals, spelled = assignment.partition("=")
    path, dot, name = target.partition(".")
    if not (equals and dot and path.startswith("/") and name):
        raise UsageError(f"{flag}: write /prim.attribute=value.")
    prim = _prim(stage, path, flag)
    relationship = prim.GetRelationship(name)
    if relationship:
        targets = [item.strip(" <>") for item in spelled.split(",") if item.strip()]
        for item in targets:
            if not Sdf.Path.IsValidPathString(item):
                raise UsageError(f"{flag}: {item!r} is no path.")
        relationship.SetTargets([Sdf.Path(item) for item in targets])
        return
    attribute = prim.GetAttribute(name)
    if not attribute:
        close = difflib.get_close_matches(name, prim.GetPropertyNames(), n=1)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise UsageError(f"{flag}: {describe(prim)} has no attribute {name!r}.{hint}")
    attribute.Set(_parse_value(attribute, spelled, flag))
    if attribute.HasAuthoredConnections():
        attribute.SetConnections([])  # else the connection would go on winning


def _parse_value(attribute: Usd.Attribute, spelled: str, flag: str) -> Any:
    """Return the value as the attribute's type; text needs no quotes, tuples no parentheses."""
    kind = attribute.GetTypeName()
    allowed = attribute.GetMetadata("allowedTokens")
    if allowed and not kind.isArray and spelled not in allowed:
        raise UsageError(f"{flag}: must be one of {', '.join(allowed)}.")
    if kind in (Sdf.ValueTypeNames.String, Sdf.ValueTypeNames.Token):
        return spelled
    if kind == Sdf.ValueTypeNames.Asset:
        return Sdf.AssetPath(_asset_path(spelled.strip("@")))
    written = spelled.strip()
    if kind == Sdf.ValueTypeNames.Bool:
        written = written.lower()
    if kind.isArray and not written.startswith("["):
        written = f"[{written}]"
    elif not kind.isArray and "," in written and not written.startswith("("):
        written = f"({written})"
    layer = Sdf.Layer.CreateAnonymous(".usda")
    try:
        if "\n" in written:
            raise ValueError("a value is one line")
        layer.ImportFromString(f'#usda 1.0\ndef "v"\n{{\n    custom {kind} v = {written}\n}}\n')
        value = layer.GetAttributeAtPath("/v.v").default
    except (Tf.ErrorException, AttributeError, ValueError):
        value = None
    if value is None:
        raise UsageError(f"{flag}: {spelled!r} is no {kind}.")
    return value


def _asset_path(spelled: str) -> str:
    """Return an existing file's absolute path: the session layer has no folder of its own."""
    here = Path(spelled)
    return str(here.absolute()) if here.exists() else spelled
