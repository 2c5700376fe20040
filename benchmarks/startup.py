"""Time to the first picture of the sphere stage, with an empty kernel cache and with a full one."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from statistics import median

from benchmarks.measure import ROOT, Child, run

STAGE = ROOT / "stages" / "sphere" / "sphere.usda"

IMPORTS = "import warp, OpenEXR; from pxr import Usd, UsdGeom, UsdLux, UsdRender, UsdShade"
"""What nobody who renders a USD stage with Warp to EXR gets around."""


def first_pictures(repeats: int) -> dict[str, float]:
    """Return seconds from process start to the files written: cold, warm, and imports alone."""
    with tempfile.TemporaryDirectory() as folder:
        cache = str(Path(folder) / "kernels")
        out = str(Path(folder) / "sphere.exr")

        def render() -> Child:
            command = [sys.executable, "-m", "usdskin", "-q", "render", str(STAGE), out]
            return run(command, WARP_CACHE_PATH=cache)

        cold = render().wall
        warm, imports = [], []
        for _ in range(max(3, repeats)):
            imports.append(run([sys.executable, "-c", IMPORTS]).wall)
            warm.append(render().wall)
    return {"cold": cold, "warm": median(warm), "imports": median(imports)}
