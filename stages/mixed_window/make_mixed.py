"""Make the room with two kinds of light: ``python stages/mixed_window/make_mixed.py``.

A room of 5.6 x 6 x 2.7 m with four fluorescent tubes (CIE FL2) on the right of who sits there and
a window on the left, through which an even sky shines (CIE daylight of 7500 K, D75): a uniform
portal. Both spectra are usdskin's tables of CIE illuminants. Reflectances are measured: materials
of the USGS Spectral Library.

Writes: ``set.usda``. It is committed; run this after a change.
"""

from __future__ import annotations

import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
sys.path.append(str(FOLDER.parent))

from set_layers import add_light, box, lamp_radiance, measured, new_set, write_set  # noqa: E402

# isort: split
# After ours, which register the schemas.
from pxr import Gf, UsdLux  # noqa: E402

CAPTURE_POINT = (-0.4, 1.45, -0.3)
LOW, HIGH = (-2.8, 0.0, -3.2), (2.8, 2.7, 2.8)
WINDOW = ((0.9, -0.9), (2.3, 1.3))
"""Low and high corner of the opening in the wall at -X, as height and z [m]."""
SKY_LUMINANCE = 1300.0  # cd m^-2, an overcast sky behind glass
TUBE_LUMINANCE, TUBE_RADIUS, TUBE_LENGTH = 9000.0, 0.013, 1.2  # T8
TUBES = ((0.8, 2.6, 1.2), (2.1, 2.6, 1.2), (0.8, 2.6, -0.4), (2.1, 2.6, -0.4))

REFLECTANCES = {
    "ceiling": measured("GDS335"),  # white fiberglass
    "wall": measured("GDS333"),  # paint, light gray
    "floor": measured("GDS363"),  # pine
    "frame": measured("GDS372"),  # white vinyl
    "wood": measured("GDS365"),  # pine plywood
    "black": measured("GDS341"),  # ABS
    "chair": measured("GDS537"),  # yellow terrycloth
    "cloth": measured("GDS433"),  # blue nylon
}


def surfaces() -> dict:
    """Return the room, its wall at -X in four parts round the window, and what stands in it."""
    (y0, z0), (y1, z1) = WINDOW
    x = LOW[0]
    left = [((LOW[1], LOW[2]), (HIGH[1], z0)), ((LOW[1], z1), (HIGH[1], HIGH[2])),
            ((LOW[1], z0), (y0, z1)), ((y1, z0), (HIGH[1], z1))]  # fmt: skip
    wall = [quad for low, high in left for quad in box((x - 0.1, *low), (x, *high), "+x")]
    return {
        "floor": ("floor", box(LOW, HIGH, "-y", inside=True)),
        "ceiling": ("ceiling", box(LOW, HIGH, "+y", inside=True)),
        "walls": ("wall", box(LOW, HIGH, "+x -z +z", inside=True)),
        "wallLeft": ("wall", wall),
        "reveal": ("frame", box((x - 0.15, y0, z0), (x, y1, z1), "-y +y -z +z", inside=True)),
        "mullion": ("frame", box((x - 0.10, y0, 0.17), (x - 0.04, y1, 0.23), "-x +x -z +z")),
        "table": ("wood", box((0.7, 0.68, -2.9), (2.3, 0.73, -2.0))),
        "tableLegs": ("wood", box((0.8, 0.0, -2.8), (0.86, 0.68, -2.1), "-x +x -z +z")
                      + box((2.14, 0.0, -2.8), (2.2, 0.68, -2.1), "-x +x -z +z")),
        "shelf": ("black", box((-2.4, 0.0, -3.15), (-1.0, 1.8, -2.85), "-x +x +y +z")),
        "chair": ("chair", box((1.6, 0.05, 1.7), (2.4, 0.45, 2.5))),
        "picture": ("cloth", box((2.76, 1.0, -0.6), (2.79, 1.9, 0.9), "-x -y +y -z +z")),
    }  # fmt: skip


def main() -> None:
    """Write ``set.usda``."""
    text = "A room with fluorescent tubes and a window. See README."
    stage = new_set(text, ("tubes", "window"), CAPTURE_POINT)
    for number, place in enumerate(TUBES, start=1):
        radiance = lamp_radiance("FL2", TUBE_LUMINANCE)
        lamp = add_light(stage, UsdLux.CylinderLight, f"tubes/tube{number}", radiance)
        lamp.CreateRadiusAttr(TUBE_RADIUS)
        lamp.CreateLengthAttr(TUBE_LENGTH)
        lamp.AddTranslateOp().Set(Gf.Vec3d(*place))
    (y0, z0), (y1, z1) = WINDOW
    radiance = lamp_radiance("D75", SKY_LUMINANCE)
    sky = add_light(stage, UsdLux.RectLight, "window/sky", radiance)
    sky.CreateWidthAttr(z1 - z0)
    sky.CreateHeightAttr(y1 - y0)
    sky.AddTranslateOp().Set(Gf.Vec3d(LOW[0] - 0.15, 0.5 * (y0 + y1), 0.5 * (z0 + z1)))
    sky.AddRotateYOp().Set(-90.0)  # it shines along its -Z, to +X
    write_set(stage, FOLDER, REFLECTANCES, surfaces())


if __name__ == "__main__":
    main()
