"""Whether a calibration may be applied to a capture: the same camera, set the same way."""

from __future__ import annotations

from usdskin.errors import LayerError
from usdskin.notes import Note
from usdskin.prims import CapturedPanorama, SpectralCamera

_SETTINGS = {
    "model": ("camera model", "settings:model"),
    "lens": ("lens", "settings:lens"),
    "white_balance": ("white balance", "settings:whiteBalance"),
}


def check_agreement(
    capture: CapturedPanorama, camera: SpectralCamera, is_read: bool, notes: list[Note]
) -> None:
    """Refuse a capture whose camera values are not those that were calibrated.

    Args:
        capture: The capture.
        camera: The calibration.
        is_read: Whether a reading sets the scale of the result.
        notes: Takes other ISO settings than the calibration's.

    Raises:
        LayerError: Model, lens or white balance differ, or one of the two does not say.
    """
    for field, (what, name) in _SETTINGS.items():
        ours, theirs = getattr(capture, field), getattr(camera, field)
        if ours != theirs:
            raise LayerError(
                f"{capture.where}: {what} is {_shown(ours)} (capture:{name}), but "
                f"{camera.where} was calibrated with {_shown(theirs)} (spectral:{name}); "
                "calibrate with the settings of the capture, or correct the wrong one"
            )
    _check_iso(capture, camera, is_read, notes)


def _check_iso(
    capture: CapturedPanorama, camera: SpectralCamera, is_read: bool, notes: list[Note]
) -> None:
    """Camera values are divided by ISO / 100: that has to mean the same on both sides."""
    if (capture.iso is None) != (camera.iso is None):
        unsaid = capture if capture.iso is None else camera
        name = "capture" if capture.iso is None else "spectral"
        other = camera if capture.iso is None else capture
        raise LayerError(
            f"{unsaid.where}: {name}:settings:iso has no value, but {other.where} has "
            f"{_isos(other)}; author the ISO settings of both, so that camera values have one unit"
        )
    if capture.iso is None or camera.iso is None or is_read:
        return
    if not set(capture.iso.tolist()) <= set(camera.iso.tolist()):
        notes.append(
            Note(
                "iso-differs",
                capture.where,
                f"photographed at ISO {_isos(capture)}, calibrated at ISO {_isos(camera)}: the "
                "scale rests on the camera's ISO settings being true to each other; a luminance "
                "reading would settle it",
            )
        )


def _isos(of: CapturedPanorama | SpectralCamera) -> str:
    return ", ".join(f"{value:g}" for value in ([] if of.iso is None else of.iso))


def _shown(text: str) -> str:
    return f'"{text}"' if text else "not stated"
