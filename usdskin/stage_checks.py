"""What ``usdskin validate`` checks beyond the values of single schemas.

Each check gets a prim whose schemas are in order and yields findings; it may raise LayerError.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdShade

from usdskin.errors import ImageError, UsdSkinError
from usdskin.findings import Finding, finding
from usdskin.prims import SkinParameters, SpectralLight, read_skin, read_spectral_light
from usdskin.render.materials import THICKNESS_PRIMVAR
from usdskin.render.polygons import is_closed, open_edge_count
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, Spectrum

if TYPE_CHECKING:
    from usdskin.images import Image

_FIRST = Usd.TimeCode.EarliestTime()
_IMAGE_SUFFIXES = (
    ".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".tga", ".bmp", ".tx", ".pic",
)  # fmt: skip
_FURNACE_TOLERANCE = 1e-6  # of float32 attributes
_TEXELS_AT_ONCE = 1 << 16

# Files of these attributes are looked into by a check of their own.
_SPECIAL_FILES = (
    "inputs:spectral:bands:file",
    "inputs:spectral:coefficients:file",
    "inputs:spectral:illuminant:file",
)


def _check_skin(prim: Usd.Prim) -> Iterator[Finding]:
    if not prim.HasAPI("SkinMaterialAPI"):
        return
    skin = read_skin(prim, _FIRST)
    yield from _check_furnace(prim, skin)
    if not UsdShade.Material(prim).ComputeSurfaceSource()[0]:
        text = (
            "has no surface for other tools, which will show it grey; connect a UsdPreviewSurface "
            "to outputs:surface"
        )
        yield finding("warning", prim, "no-rgb-rendition", text)
    if skin.reflectance is None and skin.albedo_file is None and skin.weights_file is None:
        text = (
            "has neither SpectralDistributionAPI:reflectance nor a texture, so its reflectance is "
            "1; author one"
        )
        yield finding("warning", prim, "no-reflectance", text)


def _check_furnace(prim: Usd.Prim, skin: SkinParameters) -> Iterator[Finding]:
    """Check that no band reflects more than it gets in a uniform environment.

    There the wrapped term (N.L + l) / (1 + l) integrates to (1 + l) times what N.L does, so that
    the skin reflects alpha S (1 + (1 + l) Ss). What a texture says is not looked at.
    """
    if skin.albedo_file is not None or skin.weights_file is not None:
        return
    grid = DEFAULT_WAVELENGTHS_NM
    reflectance = _on(grid, skin.reflectance, 1.0)
    scattering = _on(grid, skin.scattering, 0.0)
    gain = 1.0 + skin.wrap if skin.wrap_normalization == "paper" else 1.0
    furnace = skin.alpha * reflectance * (1.0 + gain * scattering)
    at = int(np.argmax(furnace))
    if furnace[at] > 1.0 + _FURNACE_TOLERANCE:
        law = "1 + (1 + l) Ss" if skin.wrap_normalization == "paper" else "1 + Ss"
        text = (
            f"reflects {furnace[at]:.3g} times the light of a uniform environment at "
            f"{grid[at]:g} nm, as alpha S ({law}) does; lower inputs:skin:alpha to "
            f"{skin.alpha / furnace[at]:.3g} or less"
        )
        yield finding("warning", prim, "gains-energy", text)


def _on(
    grid: NDArray[np.float64], spectrum: Spectrum | None, otherwise: float
) -> NDArray[np.float64]:
    return np.full(grid.shape, otherwise) if spectrum is None else spectrum.resample(grid)


def _check_light(prim: Usd.Prim) -> Iterator[Finding]:
    if not prim.HasAPI(UsdLux.LightAPI):
        return
    light = read_spectral_light(prim, _FIRST)
    if light is not None and light.source == "rgb":
        yield from _check_illuminant(prim, light)
    elif light is not None:
        yield from _check_rendition(prim, light)
        if light.source == "basis":
            yield from _check_coefficients(prim, light)
        elif light.source == "bands":
            yield from _check_bands(prim, light)
    yield from _check_place(prim)


def _check_place(prim: Usd.Prim) -> Iterator[Finding]:
    """Check the size, transform and shaping of a light that has a place."""
    from usdskin.render.light_inputs import Context, read_light_prim
    from usdskin.render.local_light_prims import is_local, read_local

    if not is_local(prim):
        return
    context = Context(DEFAULT_WAVELENGTHS_NM, _FIRST, places=True)
    to_world = np.array(UsdGeom.XformCache(_FIRST).GetLocalToWorldTransform(prim)).T
    meters = UsdGeom.GetStageMetersPerUnit(prim.GetStage())
    try:
        read_local(read_light_prim(prim, context), to_world, meters, context)
    except ImageError:
        return  # as any picture, it is found by the check of files
    for note in context.notes:
        if note.code == "light-without-area":
            yield finding("warning", prim, note.code, note.message)


def _check_rendition(prim: Usd.Prim, light: SpectralLight) -> Iterator[Finding]:
    texture = prim.GetAttribute("inputs:texture:file")
    color = prim.GetAttribute("inputs:color")
    if light.source in ("basis", "bands"):
        if not (texture and texture.HasAuthoredValue()):
            text = "has no RGB map, so other tools show a white dome; author inputs:texture:file"
            yield finding("warning", prim, "no-rgb-rendition", text)
    elif not color.HasAuthoredValue():
        temperature = prim.GetAttribute("inputs:enableColorTemperature").Get(_FIRST)
        if not (temperature and light.source in ("blackbody", "illuminantD")):
            text = "has no RGB color, so other tools show it white; author inputs:color"
            yield finding("warning", prim, "no-rgb-rendition", text)


def _check_illuminant(prim: Usd.Prim, light: SpectralLight) -> Iterator[Finding]:
    from usdskin.colorimetry import illuminant

    name = "inputs:spectral:illuminant" + (":file" if light.illuminant_file else "")
    try:
        illuminant(str(light.illuminant_file or light.illuminant), DEFAULT_WAVELENGTHS_NM)
    except UsdSkinError as error:
        yield finding("error", prim, "unknown-illuminant", f"cannot be used: {error}", name)


def _check_coefficients(prim: Usd.Prim, light: SpectralLight) -> Iterator[Finding]:
    from usdskin.images import read_image

    name = "inputs:spectral:coefficients:file"
    assert light.coefficients_file is not None and light.basis is not None
    channels = [f"c{index}" for index in range(len(light.basis))]
    try:
        image = read_image(light.coefficients_file, channels=channels)
    except UsdSkinError as error:
        text = f"does not fit the {len(light.basis)} rows of the basis: {error}"
        yield finding("error", prim, "unreadable-file", text, name)
        return
    texels = image.pixels.reshape(-1, len(light.basis))
    bad = 0
    for start in range(0, len(texels), _TEXELS_AT_ONCE):
        with np.errstate(invalid="ignore", over="ignore"):
            radiance = texels[start : start + _TEXELS_AT_ONCE] @ light.basis
        # Linearly recovered spectra dip below 0 in places; light as a whole does not.
        bad += int((~np.isfinite(radiance).all(axis=1) | (radiance.sum(axis=1) < 0.0)).sum())
    yield from _bad_texels(prim, name, bad, len(texels))


def _check_bands(prim: Usd.Prim, light: SpectralLight) -> Iterator[Finding]:
    from usdskin.images import read_spectral

    name = "inputs:spectral:bands:file"
    assert light.bands_file is not None
    try:
        _, pixels = read_spectral(light.bands_file)
    except UsdSkinError as error:
        yield finding("error", prim, "unreadable-file", f"cannot be used: {error}", name)
        return
    bad = (~np.isfinite(pixels) | (pixels < 0.0)).any(axis=-1)
    yield from _bad_texels(prim, name, int(bad.sum()), bad.size)


def _bad_texels(prim: Usd.Prim, name: str, bad: int, count: int) -> Iterator[Finding]:
    if bad:
        text = (
            f"has negative or non-finite radiance in {bad} of {count} pixels; correct them, or "
            "render with --bad-pixels clamp"
        )
        yield finding("warning", prim, "bad-pixels", text, name)


def _check_files(prim: Usd.Prim) -> Iterator[Finding]:
    """Check that the pictures an attribute names can be read.

    That they exist is checked by USD's MissingReferenceValidator, and for our own attributes when
    they are examined.
    """
    for attribute in prim.GetAuthoredAttributes():
        if attribute.GetTypeName() != Sdf.ValueTypeNames.Asset:
            continue
        if attribute.GetName() not in _SPECIAL_FILES:
            for path in _pictures(attribute):
                yield from _check_picture(prim, attribute.GetName(), path)


def _pictures(attribute: Usd.Attribute) -> list[str]:
    asset = attribute.Get(_FIRST)
    if not isinstance(asset, Sdf.AssetPath) or not asset.path:
        return []
    paths = [asset.resolvedPath]
    if "<UDIM>" in asset.path:
        layer = attribute.GetPropertyStack()[0].layer
        paths = [path for path, _ in UsdShade.UdimUtils.ResolveUdimTilePaths(asset.path, layer)]
    return [p for p in paths if Path(p.rstrip("]")).suffix.lower() in _IMAGE_SUFFIXES]


def _check_picture(prim: Usd.Prim, name: str, path: str) -> Iterator[Finding]:
    from usdskin.images import read_image

    try:
        image = read_image(path)
    except UsdSkinError as error:
        yield finding("error", prim, "unreadable-file", f"cannot be used: {error}", name)
        return
    if name == "inputs:texture:file" and prim.HasAPI(UsdLux.LightAPI):
        color = image.pixels[..., :3]
        bad = (~np.isfinite(color) | (color < 0.0)).any(axis=-1)
        yield from _bad_texels(prim, name, int(bad.sum()), bad.size)
        yield from _check_layout(prim, name, image)


def _check_layout(prim: Usd.Prim, name: str, image: Image) -> Iterator[Finding]:
    """Check that the map that a dome shines with is a latlong one."""
    from usdskin.render.domes import layout_fault

    light = read_spectral_light(prim, _FIRST)
    is_dome = prim.IsA(UsdLux.DomeLight) or prim.IsA(UsdLux.DomeLight_1)
    if not is_dome or image.pixels.shape[:2] == (1, 1) or (light and light.source != "rgb"):
        return
    token = prim.GetAttribute("inputs:texture:format").Get(_FIRST)
    fault = layout_fault(str(token or "automatic"), image.pixels.shape, image.attributes)
    if fault is not None:
        yield finding("error", prim, "not-latlong", f"cannot be used: {fault}", name)


def _check_mesh(prim: Usd.Prim) -> Iterator[Finding]:
    mesh = UsdGeom.Mesh(prim)
    if not mesh:
        return
    points = np.array(mesh.GetPointsAttr().Get(_FIRST) or [], np.float64).reshape(-1, 3)
    counts = mesh.GetFaceVertexCountsAttr().Get(_FIRST) or []
    indices = mesh.GetFaceVertexIndicesAttr().Get(_FIRST) or []
    sound, reason = UsdGeom.Mesh.ValidateTopology(indices, counts, len(points))
    if not sound:
        text = f"is broken: {' '.join(reason.split()).rstrip('.')}; export the mesh again"
        yield finding("error", prim, "bad-topology", text, "faceVertexIndices")
        return
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        text = f"is not finite at index {bad[0]}; correct the {bad.size} points that are not"
        yield finding("error", prim, "not-finite", text, "points")
    face_counts, corners = np.array(counts, np.intp), np.array(indices, np.intp)
    holes = np.array(mesh.GetHoleIndicesAttr().Get(_FIRST) or [], np.intp)
    shown = ~np.isin(np.arange(len(face_counts)), holes)
    corners, face_counts = corners[np.repeat(shown, face_counts)], face_counts[shown]
    if not is_closed(face_counts, corners, points):
        open_edges = open_edge_count(face_counts, corners, points)
        for material in _open_skins(mesh):
            text = (
                f"is not closed ({open_edges} open edges), so it has no inside for the opacity of "
                f"<{material}>; author primvars:{THICKNESS_PRIMVAR} on it or "
                "inputs:skin:thickness on the material [m]"
            )
            yield finding("warning", prim, "open-mesh", text)


def _open_skins(mesh: UsdGeom.Mesh) -> Iterator[Sdf.Path]:
    """Yield the skins on a mesh that attenuate light inside but do not say how thick it is."""
    thickness = UsdGeom.PrimvarsAPI(mesh).FindPrimvarWithInheritance(THICKNESS_PRIMVAR)
    if thickness and thickness.HasAuthoredValue():
        return
    parts = [mesh.GetPrim()]
    parts += [
        subset.GetPrim() for subset in UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets()
    ]
    seen = set()
    for part in parts:
        material = UsdShade.MaterialBindingAPI(part).ComputeBoundMaterial()[0]
        if material and material.GetPath() not in seen:
            seen.add(material.GetPath())
            if _needs_thickness(material.GetPrim()):
                yield material.GetPath()


def _needs_thickness(material: Usd.Prim) -> bool:
    if not material.HasAPI("SkinMaterialAPI"):
        return False
    try:
        skin = read_skin(material, _FIRST)
    except UsdSkinError:
        return False  # reported at the material
    opacity = skin.opacity.value if isinstance(skin.opacity, Spectrum) else skin.opacity
    return bool(np.any(np.asarray(opacity) > 0.0)) and skin.thickness == 0.0


def _check_instancer(prim: Usd.Prim) -> Iterator[Finding]:
    """Check that no prototype holds its own instancer, on which usd-core crashes."""
    instancer = UsdGeom.PointInstancer(prim)
    if not instancer:
        return
    prototypes = instancer.GetPrototypesRel().GetForwardedTargets()
    if _reaches(prim, prim.GetPath(), set()):
        text = "holds the instancer itself; point it at other prims"
        yield finding("error", prim, "instancer-cycle", text, "prototypes")
    indices = np.asarray(instancer.GetProtoIndicesAttr().Get(_FIRST) or [], dtype=np.int64)
    bad = np.flatnonzero((indices < 0) | (indices >= len(prototypes)))
    if bad.size:
        text = f"is {indices[bad[0]]} at index {bad[0]}, but there are {len(prototypes)} prototypes"
        yield finding("error", prim, "out-of-range", f"{text}; correct it", "protoIndices")


def _reaches(prim: Usd.Prim, goal: Sdf.Path, seen: set[Sdf.Path]) -> bool:
    """Return whether the prototypes of the instancers in a subtree lead to a prim."""
    for inner in Usd.PrimRange(prim):
        instancer = UsdGeom.PointInstancer(inner)
        if not instancer or inner.GetPath() in seen:
            continue
        seen.add(inner.GetPath())
        for target in instancer.GetPrototypesRel().GetForwardedTargets():
            prototype = inner.GetStage().GetPrimAtPath(target)
            if goal.HasPrefix(target) or (prototype and _reaches(prototype, goal, seen)):
                return True
    return False


def _check_recovery(prim: Usd.Prim) -> Iterator[Finding]:
    """Check that a camera's recovery matrices have a row for each of its wavelengths."""
    attribute = prim.GetAttribute("spectral:wavelengths")
    grid = (attribute.Get(_FIRST) or ()) if attribute else ()
    for applied in prim.GetAppliedSchemas():
        schema, _, instance = applied.partition(":")
        if schema != "SpectralRecoveryAPI":
            continue
        name = f"recovery:{instance}:matrix"
        matrix = prim.GetAttribute(name).Get(_FIRST)
        if matrix is not None and len(matrix) != 3 * len(grid):
            text = (
                f"has {len(matrix)} values but spectral:wavelengths {len(grid)}; give 3 for each "
                "of them"
            )
            yield finding("error", prim, "unequal-lengths", text, name)


CHECKS: tuple[Callable[[Usd.Prim], Iterator[Finding]], ...] = (
    _check_skin,
    _check_light,
    _check_files,
    _check_mesh,
    _check_instancer,
    _check_recovery,
)
"""All checks, in the order their findings are made."""
