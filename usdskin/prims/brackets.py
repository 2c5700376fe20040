"""``ExposureBracketAPI`` <-> ``ExposureBracket``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from usdskin.prims.values import DEFAULT_TIME, PrimError, Problem, read_schema
from usdskin.prims.writing import write_schema

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ExposureBracket:
    """The photographs of one view; every array has one value per image unless it says otherwise."""

    images: tuple[Path, ...]
    """The photographs."""

    exposure_time_s: FloatArray
    """Exposure times [s], shape [image_count]."""

    iso: FloatArray
    """Sensitivity settings [1], shape [image_count]."""

    f_number: FloatArray
    """F-numbers [1], shape [image_count]."""

    nd_factor: FloatArray
    """Attenuation of neutral density filters, at least 1 [1], shape [image_count]."""

    black_level: FloatArray
    """Raw value without light [DN], shape [1] or [3]."""

    white_level: FloatArray | None = None
    """Raw value at saturation [DN], shape [1] or [3]; None: what the files say."""

    gain: FloatArray | None = None
    """Electrons per raw value [DN^-1], shape [image_count]; None: to be measured."""

    read_noise: FloatArray | None = None
    """Standard deviation without light [DN], shape [image_count]; None: to be measured."""

    transfer: str = "auto"
    """``auto``, ``linear`` or ``recovered``."""

    response_file: Path | None = None
    """Text file of the inverse response, which wins over ``transfer``."""

    dark_file: Path | None = None
    """Photograph with the lens covered."""

    flat_file: Path | None = None
    """Photograph of an even field."""

    @property
    def exposure(self) -> FloatArray:
        """Exposure of each image, t (ISO / 100) / N^2 / ND [s], shape [image_count].

        Camera values rho are (DN - black) / (white - black) divided by it.
        """
        return np.asarray(
            self.exposure_time_s * (self.iso / 100.0) / self.f_number**2 / self.nd_factor
        )


def read_bracket(prim: Usd.Prim) -> ExposureBracket:
    """Return the exposure bracket of a camera.

    Raises:
        LayerError: The camera has none, or an opinion is missing or cannot be used.
    """
    values = read_schema(prim, "ExposureBracketAPI", DEFAULT_TIME)
    images = values["bracket:images"]
    if not images or None in images:
        text = "names no photographs; list those of the view"
        raise PrimError(prim, Problem("missing-value", "bracket:images", text))
    for name in ("bracket:exposureTimes", "bracket:iso", "bracket:fNumbers"):
        if values[name] is None or len(values[name]) == 0:
            text = "has no value; copy it from the photographs' EXIF, or from the shooting notes"
            raise PrimError(prim, Problem("missing-value", name, text))

    def per_image(name: str, fallback: float) -> FloatArray:
        given = optional(name)
        return np.full(len(images), fallback) if given is None else given

    def optional(name: str) -> FloatArray | None:
        given = values[name]
        if given is None or len(given) == 0:
            return None
        return np.broadcast_to(given, len(images)).astype(np.float64)

    black = _levels(values["bracket:blackLevel"])
    return ExposureBracket(
        images=tuple(images),
        exposure_time_s=values["bracket:exposureTimes"],
        iso=per_image("bracket:iso", 100.0),
        f_number=per_image("bracket:fNumbers", 1.0),
        nd_factor=per_image("bracket:ndFactors", 1.0),
        black_level=np.zeros(1) if black is None else black,
        white_level=_levels(values["bracket:whiteLevel"]),
        gain=optional("bracket:gain"),
        read_noise=optional("bracket:readNoise"),
        transfer=values["bracket:transfer"],
        response_file=values["bracket:response:file"],
        dark_file=values["bracket:dark:file"],
        flat_file=values["bracket:flat:file"],
    )


def _levels(given: FloatArray | None) -> FloatArray | None:
    return None if given is None or len(given) == 0 else given


def write_bracket(
    prim: Usd.Prim, bracket: ExposureBracket, folder: str | Path | None = None
) -> None:
    """Apply ``ExposureBracketAPI`` to a camera and author its photographs and their settings.

    Args:
        prim: Camera, written at the stage's edit target.
        bracket: What to write.
        folder: Folder the layer is going to be written to; see ``write_schema``.

    Raises:
        LayerError: The prim is no camera, or a file cannot be named from the layer.
    """
    write_schema(
        prim,
        "ExposureBracketAPI",
        {
            "bracket:images": list(bracket.images),
            "bracket:exposureTimes": bracket.exposure_time_s,
            "bracket:iso": bracket.iso,
            "bracket:fNumbers": bracket.f_number,
            "bracket:ndFactors": bracket.nd_factor,
            "bracket:blackLevel": bracket.black_level,
            "bracket:whiteLevel": bracket.white_level,
            "bracket:gain": bracket.gain,
            "bracket:readNoise": bracket.read_noise,
            "bracket:transfer": bracket.transfer,
            "bracket:response:file": bracket.response_file,
            "bracket:dark:file": bracket.dark_file,
            "bracket:flat:file": bracket.flat_file,
        },
        folder,
    )
