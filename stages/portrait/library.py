"""The skins of ``stages/skin_library``, whose folder Python does not look into by itself."""

from __future__ import annotations

import sys
from pathlib import Path

LIBRARY = Path(__file__).resolve().parents[1] / "skin_library"
sys.path.append(str(LIBRARY))

from make_library import TONES, WRAP  # noqa: E402
from skin_spectra import WAVELENGTH_NM, Pigments, reflectance  # noqa: E402

__all__ = ["LIBRARY", "TONES", "WAVELENGTH_NM", "WRAP", "Pigments", "reflectance"]
