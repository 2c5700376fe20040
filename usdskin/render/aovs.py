"""Data parts of a picture, and the RenderVars that ask for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from usdskin.errors import LayerError, UsageError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.render.opinions import choose, text

# isort: split
# After ours, which register the schemas.
from pxr import UsdRender

MATTES = ("crypto_object", "crypto_material")
"""Those of them that are mattes (``usdskin.render.cryptomatte``): of prims and of materials."""

MAP_SOURCES = ("N", "P", "Z", "albedo", "st", "primId", "irradiance", *MATTES)
"""Data parts of any integrator, in the order they are written."""

TRACED_SOURCES = (
    "diffuse", "specular", "emission", "direct", "indirect", "visibility", "variance", "sampleCount"
)  # fmt: skip
"""Data parts that only the traced integrator measures."""

AOV_SOURCES = MAP_SOURCES + TRACED_SOURCES

_SOURCE_NAMES = {
    "beauty": ("beauty", "color", "ci", "c", "rgb", "rgba"),
    "spectral": ("spectralradiance", "spectral", "s0"),
    "N": ("n", "normal", "normals"),
    "P": ("p", "position", "worldposition"),
    "Z": ("z", "depth", "cameradepth"),
    "albedo": ("albedo", "diffusealbedo", "basecolor"),
    "st": ("st", "uv"),
    "primId": ("primid",),
    "irradiance": ("irradiance",),
    "diffuse": ("diffuse",),
    "specular": ("specular", "glossy", "reflection"),
    "emission": ("emission", "emissive"),
    "direct": ("direct", "directlighting"),
    "indirect": ("indirect", "indirectlighting"),
    "visibility": ("visibility", "shadow"),
    "variance": ("variance",),
    "sampleCount": ("samplecount",),
    "crypto_object": ("crypto_object", "cryptoobject"),
    "crypto_material": ("crypto_material", "cryptomaterial"),
}
_SOURCES = {name: source for source, names in _SOURCE_NAMES.items() for name in names}
"""What a RenderVar's sourceName, or its prim's name, in lower case, stands for."""

_GROUPS = {"cryptomatte": MATTES}
"""Names that ``--aov`` takes for several parts."""

_BEAUTY_EXPRESSIONS = ("C.*", "C.*L", "C.*[LO]", "C.*O", "C[DS]*L", "C[DS]*[LO]", "C<.*>[LO]")
"""Light path expressions that name everything the camera sees."""

_HALF_TYPES = ("half", "half3", "half4", "color3h", "color4h")


@dataclass(frozen=True, slots=True)
class Aov:
    """A data part beside the beauty."""

    name: str
    """Name of the part in the file."""

    source: str
    """What it holds: one of ``AOV_SOURCES``."""


@dataclass(frozen=True, slots=True, eq=False)
class WantedParts:
    """What the RenderVars of a product ask for."""

    beauty: bool
    spectral: bool
    half: bool
    """Whether the beauty is stored as half floats."""

    aovs: tuple[Aov, ...]


def read_vars(product: UsdRender.Product, traced: bool, notes: list[Note]) -> WantedParts:
    """Return what a product's ordered vars ask for; without any it is its beauty.

    Args:
        product: Product to read.
        traced: Whether light is traced.
        notes: Takes the vars that are not written.

    Raises:
        LayerError: A var that is not there, or two of one name.
    """
    prim = product.GetPrim()
    sources: dict[str, str] = {}
    half = False
    for path in product.GetOrderedVarsRel().GetForwardedTargets():
        var = UsdRender.Var.Get(prim.GetStage(), path)
        if not var:
            raise LayerError(
                f"{describe(prim)}: orderedVars names <{path}>, which is no RenderVar; correct the "
                "relationship."
            )
        source = _var_source(var, traced, notes)
        if source is None:
            continue
        if sources.setdefault(path.name, source) != source:
            raise LayerError(
                f"{describe(prim)}: two RenderVars are called {path.name}; a part's name is its "
                "RenderVar's, so rename one."
            )
        half |= source == "beauty" and var.GetDataTypeAttr().Get() in _HALF_TYPES
    aovs = [Aov(name, source) for name, source in sources.items() if source in AOV_SOURCES]
    found = set(sources.values())
    return WantedParts(
        beauty="beauty" in found or not found,
        spectral="spectral" in found,
        half=half,
        aovs=tuple(aovs),
    )


def _var_source(var: UsdRender.Var, traced: bool, notes: list[Note]) -> str | None:
    """Return what a RenderVar holds; None, with a note, where that is not written."""
    name, path = var.GetPrim().GetName(), str(var.GetPath())
    kind = choose([var.GetPrim()], "sourceType", text, "raw")
    wanted = choose([var.GetPrim()], "sourceName", text, "") or name
    source = None
    if kind == "lpe":
        expression = wanted.removeprefix("color:").removeprefix("lpe:")
        source = "beauty" if expression in _BEAUTY_EXPRESSIONS else None
    elif kind == "primvar":
        source = "st" if wanted.removeprefix("primvars:") == "st" else None
    else:
        source = _SOURCES.get(wanted.lower())
    unmeasured = source in TRACED_SOURCES and not traced
    if source is None or unmeasured:
        reason = "only the traced integrator measures it" if unmeasured else "not known here"
        source = None
        notes.append(
            Note("aov-not-written", path, f"{kind} {wanted!r}: {reason}; the part is left out.")
        )
    return source


def requested_aovs(names: Sequence[str], traced: bool) -> tuple[Aov, ...]:
    """Return the parts that ``--aov`` names; ``all`` and ``none`` stand alone.

    Raises:
        UsageError: There is no such part.
    """
    if tuple(names) == ("all",):
        return tuple(Aov(source, source) for source in (AOV_SOURCES if traced else MAP_SOURCES))
    if tuple(names) == ("none",):
        return ()
    wanted: dict[str, None] = {}
    spread = [part for name in names for part in _GROUPS.get(name.lower(), (name,))]
    for name in spread:
        source = _SOURCES.get(name.lower(), "")
        if source in TRACED_SOURCES and not traced:
            raise UsageError(f"--aov {name}: only --integrator traced measures it; use that.")
        if source not in AOV_SOURCES:
            raise UsageError(
                f"--aov {name}: no such part; choose from {', '.join(AOV_SOURCES)}, "
                "cryptomatte, all or none."
            )
        wanted[source] = None
    return tuple(Aov(source, source) for source in wanted)
