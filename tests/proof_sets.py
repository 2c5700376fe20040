"""Tiny sets for tests of the proof: a solved light of two lamps, and a ball in it."""

from __future__ import annotations

import os
from pathlib import Path

from usdskin.images import Part, read_image, write_exr

ROOT = Path(__file__).resolve().parents[1]

TINY = ("--size", "tiny", "--integrator", "map")
"""As little as can be proved."""

_HEAD = '#usda 1.0\n(\n    defaultPrim = "{root}"\n    metersPerUnit = 1\n    upAxis = "Y"\n)\n'

_SHOT = """
def Xform "Shot"
{{
    def Xform "Subject" (
        variants = {{
            string subject = "ball"
        }}
        prepend variantSets = "subject"
    )
    {{
        variantSet "subject" = {{
            "ball" {{
                def Sphere "ball" (
                    prepend apiSchemas = ["MaterialBindingAPI"]
                )
                {{
                    double radius = 0.12
                    rel material:binding = </Shot/Skin>
                }}
            }}
            "missing" {{
                def "head" (
                    references = @./no_such_head.usda@
                )
                {{
                }}
            }}
        }}
    }}

    def "Light" (
        references = @./light.usda@
    )
    {{
    }}

    def "Skin" (
        references = @{library}@
    )
    {{
    }}

    def Camera "Camera"
    {{
        float2 clippingRange = (0.05, 100)
        float focalLength = 50
        float horizontalAperture = 24
        float verticalAperture = 24
        double3 xformOp:translate = (0, 0, 0.6)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
}}
"""


_LIGHT = """
def Xform "Light" (
    references = @{room}@
)
{{
    over "Light"
    {{
        asset inputs:spectral:coefficients:file = @./room.exr@
    }}
}}
"""


def _write_small_map(path: Path, step: int = 8) -> None:
    """Write the capture room's light, averaged over blocks of texels."""
    whole = read_image(ROOT / "stages/capture_room/room.exr")
    height, width, count = whole.pixels.shape
    small = whole.pixels.reshape(height // step, step, width // step, step, count).mean((1, 3))
    channels = {name: small[..., index] for index, name in enumerate(whole.channel_names)}
    write_exr(path, [Part("", channels)])


def write_set(folder: Path, lamps: tuple[str, ...] = ("tubes", "window")) -> Path:
    """Write a set whose light is that of the capture room; return the light to hand over."""
    folder.mkdir(parents=True)
    stages = Path(os.path.relpath(ROOT / "stages", folder)).as_posix()
    library = f"{stages}/skin_library/skin_library.usda"
    (folder / "shot.usda").write_text(_HEAD.format(root="Shot") + _SHOT.format(library=library))
    whole = "room" if len(lamps) > 1 else lamps[0]
    named = {"light": whole}
    if len(lamps) > 1:
        named |= {f"light_{lamp}": lamp for lamp in lamps}
    for name, source in named.items():
        text = _LIGHT.format(room=f"{stages}/capture_room/{source}.usda")
        (folder / f"{name}.usda").write_text(_HEAD.format(root="Light") + text)
    _write_small_map(folder / "room.exr")
    return folder / "light.usda"
