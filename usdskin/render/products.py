"""The files a render writes: the stage's RenderProducts and RenderVars, or the one named.

Reads: a RenderSettings prim's products with their ordered vars, and the flags.
Makes: ``Product``, one per picture, with every file's name.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath, PureWindowsPath

from usdskin.errors import ImageError, LayerError, UsageError
from usdskin.layers import describe, named_files
from usdskin.notes import Note
from usdskin.render.aovs import Aov, WantedParts, read_vars, requested_aovs
from usdskin.render.cameras import find_camera
from usdskin.render.opinions import (
    RESOLUTION_LIMIT,
    choose,
    data_window,
    one_of,
    real_number,
    resolution,
    text,
    truth,
)
from usdskin.render.overrides import RenderOverrides
from usdskin.replacing import check_writable

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom, UsdRender

DEFAULT_WIDTH = 1024
"""Width of a picture nobody gave a size [px]."""

FALLBACK_RESOLUTION = (2048, 1080)
"""UsdRender's, for a RenderSettings prim without one [px]."""

WHOLE_PICTURE = (0.0, 0.0, 1.0, 1.0)

CONFORM_POLICIES = (
    "expandAperture",
    "cropAperture",
    "adjustApertureWidth",
    "adjustApertureHeight",
    "adjustPixelAspectRatio",
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Product:
    """One picture of every frame, and its files. File names may hold ``####``."""

    prim_path: str | None
    """The RenderProduct prim, if any."""

    camera: str
    """Path of the camera prim."""

    resolution: tuple[int, int]
    """Width and height [px]."""

    pixel_aspect_ratio: float
    conform_policy: str
    motion_blur: bool
    """Whether what moves while the shutter is open is blurred."""

    depth_of_field: bool
    """Whether what is out of focus is blurred."""

    exr: Path | None
    png: Path | None
    spectral: Path | None
    beauty: bool
    """Whether the EXR begins with the beauty; data parts alone otherwise."""

    aovs: tuple[Aov, ...]
    half: bool
    """Whether the beauty is stored as half floats."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Names of all files."""
        return tuple(file for file in (self.exr, self.png, self.spectral) if file is not None)


def read_products(
    stage: Usd.Stage,
    settings: Usd.Prim | None,
    overrides: RenderOverrides,
    output: Path | None,
    *,
    spectral: bool,
    time: Usd.TimeCode,
    traced: bool,
    notes: list[Note],
) -> tuple[Product, ...]:
    """Return the pictures to render.

    Args:
        stage: Stage to render.
        settings: RenderSettings prim, if any.
        overrides: The flags.
        output: File to write in place of the products; it takes the first one's camera and size,
            and the vars of all that share them.
        spectral: Whether spectral files are asked for by a flag or by the settings.
        time: Time at which to read the camera's aspect.
        traced: Whether light is traced, which measures more parts.
        notes: Takes products and vars that are not written.

    Raises:
        UsageError: A flag's value is wrong.
        LayerError: An authored value is wrong, or a product's name leaves the output folder.
    """
    prims: list[Usd.Prim] = _product_prims(settings, notes) if settings else []
    base = [settings] if settings else []
    pairs = [
        _read_product(stage, [*own, *base], overrides, time, traced, notes)
        for own in [[prim] for prim in prims] or [[]]
    ]
    if output is not None:
        named = [_name_output(pairs, output, overrides, spectral, notes)]
    elif prims:
        wanted = spectral and not any(asked.spectral for _, asked in pairs)
        named = [
            _name_product(prim, product, asked, overrides, wanted)
            for prim, (product, asked) in zip(prims, pairs, strict=True)
        ]
    else:
        stem = Path(stage.GetRootLayer().GetDisplayName()).stem or "render"
        many = overrides.frames is not None and len(overrides.frames) > 1
        file = Path(f"{stem}.####.exr" if many else f"{stem}.exr")
        named = [_name_output(pairs, file, overrides, spectral, notes)]
    products = tuple(product for product in named if product.files)
    _check_files(products)
    return products


def _product_prims(settings: Usd.Prim, notes: list[Note]) -> list[Usd.Prim]:
    prims = []
    for path in UsdRender.Settings(settings).GetProductsRel().GetForwardedTargets():
        prim = settings.GetStage().GetPrimAtPath(path)
        if not prim or not prim.IsA(UsdRender.Product):
            raise LayerError(
                f"{describe(settings)}: products names <{path}>, which is no RenderProduct; "
                "correct the relationship."
            )
        kind = UsdRender.Product(prim).GetProductTypeAttr().Get()
        if kind == "raster":
            prims.append(prim)
        else:
            notes.append(
                Note("product-not-written", str(path), f"productType {kind!r}; only raster is.")
            )
    return prims


def _read_product(
    stage: Usd.Stage,
    prims: Sequence[Usd.Prim],
    overrides: RenderOverrides,
    time: Usd.TimeCode,
    traced: bool,
    notes: list[Note],
) -> tuple[Product, WantedParts]:
    """Return a picture without file names, and its vars. The prims are the strongest first."""
    camera = find_camera(stage, overrides.camera or _authored_camera(prims))
    pixel_aspect = choose(prims, "pixelAspectRatio", real_number(0.01, 100.0), 1.0)
    if choose(prims, "dataWindowNDC", data_window, WHOLE_PICTURE) != WHOLE_PICTURE:
        where = str(prims[0].GetPath())
        notes.append(Note("data-window-ignored", where, "dataWindowNDC; all of it is rendered."))
    product = Product(
        prim_path=str(prims[0].GetPath()) if prims else None,
        camera=str(camera.GetPath()),
        resolution=_resolution(prims, overrides, camera, pixel_aspect, time),
        pixel_aspect_ratio=pixel_aspect,
        conform_policy=choose(
            prims, "aspectRatioConformPolicy", one_of(CONFORM_POLICIES), CONFORM_POLICIES[0]
        ),
        motion_blur=not choose(
            prims, "disableMotionBlur", truth, choose(prims, "instantaneousShutter", truth, False)
        ),
        depth_of_field=not choose(prims, "disableDepthOfField", truth, False),
        exr=None,
        png=None,
        spectral=None,
        beauty=True,
        aovs=(),
        half=overrides.half,
    )
    asked = WantedParts(beauty=True, spectral=False, half=False, aovs=())
    if prims and prims[0].IsA(UsdRender.Product):
        asked = read_vars(UsdRender.Product(prims[0]), traced, notes)
    if overrides.aovs is not None:
        asked = replace(asked, aovs=requested_aovs(overrides.aovs, traced))
    return product, asked


def _authored_camera(prims: Sequence[Usd.Prim]) -> str | None:
    for prim in prims:
        targets = prim.GetRelationship("camera").GetForwardedTargets()
        if len(targets) > 1:
            raise LayerError(
                f"{describe(prim)}: camera names {len(targets)} prims; a picture has one camera."
            )
        if targets:
            return str(targets[0])
    return None


def _resolution(
    prims: Sequence[Usd.Prim],
    overrides: RenderOverrides,
    camera: Usd.Prim,
    pixel_aspect: float,
    time: Usd.TimeCode,
) -> tuple[int, int]:
    if overrides.resolution is not None and overrides.width is not None:
        raise UsageError("-r/--resolution and -w/--width exclude each other; give one of them.")
    width = overrides.width
    if width is None and overrides.resolution is None:
        fallback = FALLBACK_RESOLUTION if prims else None
        authored = choose(prims, "resolution", resolution, fallback)
        if authored is not None:
            return authored
        width = DEFAULT_WIDTH
    if width is None:
        return choose((), "", resolution, (1, 1), "-r/--resolution", overrides.resolution)
    if not 1 <= width <= RESOLUTION_LIMIT:
        raise UsageError(f"-w/--width {width}: must be from 1 to {RESOLUTION_LIMIT} pixels.")
    size = width, max(1, round(width * pixel_aspect / _camera_aspect(camera, time)))
    return choose((), "", resolution, (1, 1), "-w/--width", size)


def _camera_aspect(prim: Usd.Prim, time: Usd.TimeCode) -> float:
    camera = UsdGeom.Camera(prim)
    horizontal = camera.GetHorizontalApertureAttr().Get(time)
    vertical = camera.GetVerticalApertureAttr().Get(time)
    try:
        aspect = float(horizontal / vertical)
    except (TypeError, ZeroDivisionError):
        aspect = 0.0
    if not 1e-3 <= aspect <= 1e3:
        raise LayerError(
            f"{describe(prim)}: an aperture of {horizontal} by {vertical} is no picture's; correct "
            "horizontalAperture and verticalAperture, or give the size with -r."
        )
    return aspect


def _name_output(
    pairs: Sequence[tuple[Product, WantedParts]],
    output: Path,
    overrides: RenderOverrides,
    spectral: bool,
    notes: list[Note],
) -> Product:
    """Return the first product written to ``output``, with the parts of all that share its view."""
    first = pairs[0][0]
    aovs: dict[str, Aov] = {}
    half = spectral_asked = False
    for product, asked in pairs:
        if (product.camera, product.resolution) != (first.camera, first.resolution):
            where = product.prim_path or ""
            notes.append(
                Note("product-not-written", where, f"its view is not that of {output.name}.")
            )
            continue
        aovs |= {aov.name: aov for aov in asked.aovs}
        half |= asked.half
        spectral_asked |= asked.spectral
    if output.suffix.lower() not in (".exr", ".png"):
        raise UsageError(f"{output}: a picture's name ends in .exr or .png.")
    if output.suffix.lower() == ".png":
        _check_png_alone(output, overrides)
    everything = WantedParts(
        beauty=True, spectral=spectral_asked, half=half, aovs=tuple(aovs.values())
    )
    return _with_files(first, output, everything, overrides, spectral)


def _check_png_alone(output: Path, overrides: RenderOverrides) -> None:
    exr = output.with_suffix(".exr").name
    if overrides.png is False:
        raise UsageError(f"{output}: --no-png leaves nothing to write; name an EXR, such as {exr}.")
    if overrides.aovs and tuple(overrides.aovs) != ("none",):
        listed = ",".join(overrides.aovs)
        raise UsageError(
            f"{output}: --aov {listed}: a PNG holds no other parts; name an EXR, such as {exr}."
        )


def _name_product(
    prim: Usd.Prim, product: Product, asked: WantedParts, overrides: RenderOverrides, spectral: bool
) -> Product:
    name = choose([prim], "productName", text, "") or f"{prim.GetName()}.exr"
    if Path(name).suffix.lower() not in (".exr", ".png"):
        raise LayerError(
            f"{describe(prim)}: productName = {name!r}: a picture's name ends in .exr or .png."
        )
    if not overrides.allow_outside and _leaves_folder(name):
        raise LayerError(
            f"{describe(prim)}: productName = {name!r} lies outside the current folder; rename it, "
            "name the picture on the command line, or allow it with --allow-outside."
        )
    return _with_files(product, Path(name), asked, overrides, spectral)


def _leaves_folder(name: str) -> bool:
    """Return whether a relative name, read as either system reads it, leads out of its folder."""
    for path in (PurePosixPath(name), PureWindowsPath(name)):
        if path.anchor or ".." in path.parts:
            return True
    return name.startswith("~")


def _with_files(
    product: Product, file: Path, asked: WantedParts, overrides: RenderOverrides, spectral: bool
) -> Product:
    """Return the product with the names of its files, beside ``file``.

    A product of nothing but spectra is one spectral file of the name given.
    """
    unwanted = overrides.spectral_output is False
    if asked.spectral and not asked.beauty and not asked.aovs:
        return replace(product, beauty=False, spectral=None if unwanted else file)
    picture_only = file.suffix.lower() == ".png"
    wants_png = asked.beauty and (picture_only or overrides.png is not False)
    wants_spectral = (asked.spectral or (spectral and asked.beauty)) and not unwanted
    return replace(
        product,
        exr=None if picture_only else file,
        png=file.with_suffix(".png") if wants_png else None,
        spectral=file.with_suffix(".spectral.exr") if wants_spectral else None,
        beauty=asked.beauty,
        aovs=() if picture_only else asked.aovs,
        half=overrides.half or asked.half,
    )


def _check_files(products: Sequence[Product]) -> None:
    if not products:
        raise UsageError("--no-spectral leaves nothing to write: all products are spectral.")
    owners: dict[Path, Product] = {}
    for product in products:
        for file in product.files:
            if owners.setdefault(file, product) is not product:
                raise LayerError(
                    f"<{owners[file].prim_path}> and <{product.prim_path}> both write {file}; "
                    "give them different productNames."
                )


def check_pictures(files: Iterable[Path], source: Path) -> None:
    """Refuse pictures that could not be written in the end, or that the layer is made of.

    Args:
        files: To be written.
        source: The layer that is rendered.

    Raises:
        UsageError: A name is that of a folder, or of a file that the layer names.
        UsdSkinError: A folder cannot be made or written to.
    """
    files = list(files)
    for file in files:
        check_writable(file)
    there = [file for file in files if file.exists()]
    named = named_files(source) if there else set()
    for file in there:
        if file.resolve() in named:
            raise UsageError(
                f"{file}: is an input of this picture, named in {source.name} or below it; write "
                "to another name or folder"
            )


def prepare_folders(files: Iterable[Path], source: Path) -> None:
    """Make the folders of pictures, and check them as ``check_pictures``, before rendering.

    Raises:
        UsdSkinError: As ``check_pictures`` does, or a folder cannot be made.
    """
    files = list(files)
    check_pictures(files, source)
    for file in files:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ImageError(f"{file.parent}: cannot make this folder: {error.strerror}.") from None
