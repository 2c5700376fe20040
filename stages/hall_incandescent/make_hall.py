"""Make the hall: ``python stages/hall_incandescent/make_hall.py``.

A hall of 20 x 12 x 7 m: boarded floor, panelled walls, plaster above, a stage with a red curtain
at one end, a gallery along one side. Twenty-eight opal globes with incandescent lamps (CIE
illuminant A, from colour-science's tables as usdskin ships them) hang in four rings and a row.
Reflectances are measured: materials of the USGS Spectral Library.

Writes: ``set.usda``. It is committed; run this after a change.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).resolve().parent
sys.path.append(str(FOLDER.parent))

from set_layers import add_light, box, lamp_radiance, measured, new_set, write_set  # noqa: E402

# isort: split
# After ours, which register the schemas.
from pxr import Gf, UsdLux  # noqa: E402

CAPTURE_POINT = (-2.5, 1.45, 1.2)
LOW, HIGH = (-10.0, 0.0, -6.0), (10.0, 7.0, 6.0)
PANEL = 1.6
"""Height of the panelling [m]."""

GLOBE_RADIUS, GLOBE_LUMEN = 0.10, 4200.0
"""Of an opal globe [m] and of the lamps in it [lm], some 300 W."""
GLOBE_LUMINANCE = GLOBE_LUMEN / (4.0 * np.pi**2 * GLOBE_RADIUS**2)

RINGS = ((-6.0, 4.6, -1.5), (-1.2, 4.2, 2.4), (3.6, 4.6, -1.0), (7.4, 4.8, 2.6))
"""Middles of the chandeliers [m], of six globes each."""
ROW = tuple((x, 2.3, -5.7) for x in (-7.0, -3.0, 1.0, 5.0))
"""Globes on brackets along one wall [m]."""

REFLECTANCES = {
    "plaster": measured("GDS796"),  # lead white
    "boards": measured("GDS363"),  # pine
    "panels": measured("GDS357"),  # cedar
    "curtain": measured("GDS431"),  # red nylon
    "carpet": measured("GDS535"),  # light brown nylon
    "black": measured("GDS341"),  # ABS
}


def shell() -> dict:
    """Return floor, walls in two heights and ceiling, seen from inside."""
    low, high = LOW, HIGH
    knee = (high[0], PANEL, high[2])
    return {
        "floor": ("boards", box(low, high, "-y", inside=True)),
        "ceiling": ("plaster", box(low, high, "+y", inside=True)),
        "panelling": ("panels", box(low, knee, "-x +x -z +z", inside=True)),
        "walls": ("plaster", box((low[0], PANEL, low[2]), high, "-x +x -z +z", inside=True)),
        "curtain": ("curtain", box((9.6, 1.0, -4.0), (9.7, 6.0, 4.0), "-x -y +y -z +z")),
        "stage": ("boards", box((7.0, 0.0, -4.5), (9.99, 1.0, 4.5), "-x +x +y -z +z")),
        "gallery": ("panels", box((-9.99, 3.4, 4.4), (2.0, 4.4, 5.99))),
        "carpet": ("carpet", box((-9.0, 0.005, -0.6), (6.5, 0.01, 0.9), "-x +x +y -z +z")),
        "piano": ("black", box((4.0, 0.3, -3.6), (5.6, 1.2, -2.2))),
        "door": ("black", box((-9.98, 0.0, -3.0), (-9.95, 2.4, -1.4), "+x -z +z +y")),
    }  # fmt: skip


def main() -> None:
    """Write ``set.usda``."""
    stage = new_set("A hall in incandescent light. See README.", ("bulbs",), CAPTURE_POINT)
    places = list(ROW)
    for x, y, z in RINGS:
        for turn in np.radians(np.arange(6) * 60.0 + 10.0):
            places.append((x + 0.7 * np.cos(turn), y, z + 0.7 * np.sin(turn)))
    for number, place in enumerate(places, start=1):
        radiance = lamp_radiance("A", GLOBE_LUMINANCE)
        lamp = add_light(stage, UsdLux.SphereLight, f"bulbs/globe{number}", radiance)
        lamp.CreateRadiusAttr(GLOBE_RADIUS)
        lamp.AddTranslateOp().Set(Gf.Vec3d(*np.round(place, 4).tolist()))
    write_set(stage, FOLDER, REFLECTANCES, shell())


if __name__ == "__main__":
    main()
