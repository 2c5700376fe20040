"""Make the lights of the sets' shots: ``python stages/make_lights.py [SET ...]``, minutes each.

Solves ``set.usda`` at 128 x 64 and keeps ``light.usda`` with its two images beside it. The
coefficients keep twelve binary digits, so that the files are small: the light of the shot is what
the files hold, ``usdskin prove`` solves its own.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.images import Part, read_image, write_exr
from usdskin.judge.truth.solve import solve_set

FOLDER = Path(__file__).resolve().parent
SETS = ("room_fluorescent", "hall_incandescent", "outdoor_sun", "mixed_window")
IMAGES = ("light.coefficients.exr", "light.rgb.exr")


def rounded(values: NDArray[np.float32], bits: int = 12) -> NDArray[np.float32]:
    """Return values with few binary digits."""
    mantissa, exponent = np.frexp(values.astype(np.float64))
    return np.ldexp(np.rint(mantissa * 2.0**bits) / 2.0**bits, exponent).astype(np.float32)


def pack(path: Path) -> None:
    """Write the coefficients anew, rounded."""
    image = read_image(path)
    values = rounded(image.pixels)
    channels = {
        name: np.ascontiguousarray(values[..., k]) for k, name in enumerate(image.channel_names)
    }
    write_exr(path, [Part("light", channels, {}, "float")], "zip:9")


def main() -> None:
    """Solve and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sets", nargs="*", default=SETS)
    for name in parser.parse_args().sets:
        with tempfile.TemporaryDirectory() as folder:
            solved = solve_set(FOLDER / name / "set.usda", Path(folder) / "light.usda", height=64)
            pack(Path(folder) / IMAGES[0])
            for file in (solved.light, *(Path(folder) / image for image in IMAGES)):
                shutil.copyfile(file, FOLDER / name / file.name)


if __name__ == "__main__":
    main()
