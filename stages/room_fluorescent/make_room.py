"""Make the office that the proof is shot in: ``python stages/room_fluorescent/make_room.py``.

A room of 6.4 x 6.6 x 2.8 m with four bare fluorescent tubes (CIE FL2) hung below a white ceiling, a
desk, a cabinet and a sofa. Reflectances are measured: materials of the USGS Spectral Library, and
Munsell papers for the accent wall and the poster.

Writes: ``set.usda``. It is committed; run this after a change.
"""

from __future__ import annotations

import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
sys.path.append(str(FOLDER.parent))

from set_layers import add_light, box, lamp_radiance, measured, munsell, new_set, write_set  # noqa: E402

# isort: split
# After ours, which register the schemas.
from pxr import Gf, UsdLux  # noqa: E402

LOW, HIGH = (-3.2, 0.0, -3.6), (3.2, 2.8, 3.0)
"""Corners of the room [m], +Y up; the floor is at 0."""

CAPTURE_POINT = (0.2, 1.45, 0.1)
TUBE_LUMINANCE, TUBE_RADIUS, TUBE_LENGTH = 9000.0, 0.013, 1.2  # cd m^-2 and [m], a T8 tube
TUBES = tuple((x, 2.45, z) for x in (-1.5, 1.6) for z in (-1.9, 1.3))

REFLECTANCES = {
    "ceiling": measured("GDS335"),  # white fiberglass
    "wall": measured("GDS338"),  # white PVC
    "accent": munsell(5),  # light bluish green
    "floor": measured("GDS536"),  # gray nylon pile
    "wood": measured("GDS365"),  # pine plywood
    "black": measured("GDS341"),  # ABS
    "cabinet": measured("GDS333"),  # aluminum painted light gray
    "fabric": measured("GDS433"),  # blue nylon
    "cardboard": measured("GDS371"),
    "poster": munsell(10),  # strong yellow
}

BOXES = {
    "desk": (
        "wood",
        (
            ((0.6, 0.70, -3.2), (2.4, 0.74, -2.3)),
            ((0.66, 0.0, -3.1), (0.72, 0.70, -2.4)),
            ((2.28, 0.0, -3.1), (2.34, 0.70, -2.4)),
        ),
    ),
    "screen": ("black", (((1.2, 0.78, -3.0), (1.9, 1.2, -2.95)),)),
    "cabinet": ("cabinet", (((-3.0, 0.0, -3.5), (-1.4, 1.9, -3.05)),)),
    "sofa": (
        "fabric",
        (
            ((2.2, 0.05, -0.6), (3.0, 0.42, 1.6)),
            ((2.8, 0.42, -0.6), (3.05, 0.85, 1.6)),
        ),
    ),
    "crate": ("cardboard", (((-2.6, 0.0, 1.5), (-2.0, 0.55, 2.1)),)),
    "poster": ("poster", (((-3.195, 1.0, -0.6), (-3.18, 1.9, 0.7)),)),
}
"""Furniture: material, and boxes by their low and high corners [m]."""


def surfaces() -> dict:
    """Return the room, seen from inside, and what stands in it."""
    found = {
        name: (material, box(LOW, HIGH, side, inside=True))
        for name, material, side in (
            ("floor", "floor", "-y"),
            ("ceiling", "ceiling", "+y"),
            ("wallLeft", "wall", "-x"),
            ("wallRight", "accent", "+x"),
            ("wallBack", "wall", "-z"),
            ("wallFront", "wall", "+z"),
        )
    }
    for name, (material, boxes) in BOXES.items():
        found[name] = (material, [face for low, high in boxes for face in box(low, high)])
    return found


def main() -> None:
    """Write ``set.usda``."""
    text = "An office lit by four fluorescent tubes. See README."
    stage = new_set(text, ("tubes",), CAPTURE_POINT)
    for number, place in enumerate(TUBES, start=1):
        radiance = lamp_radiance("FL2", TUBE_LUMINANCE)
        lamp = add_light(stage, UsdLux.CylinderLight, f"tubes/tube{number}", radiance)
        lamp.CreateRadiusAttr(TUBE_RADIUS)
        lamp.CreateLengthAttr(TUBE_LENGTH)
        lamp.AddTranslateOp().Set(Gf.Vec3d(*place))
    write_set(stage, FOLDER, REFLECTANCES, surfaces())


if __name__ == "__main__":
    main()
