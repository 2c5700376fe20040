"""Skin from three camera values, origin by origin: ``python -m benchmarks.skin_prior DATA``.

DATA is the folder of the evaluation data. The prior is fitted without one origin of the
International Skin Spectra Archive, whose skins measured cameras then see in several lights, without
noise and with 1 % of each value. Reflectances are diffuse (the surface's mirror image subtracted).

Colour difference: CIEDE2000, CIE 1931 2 degrees, of the recovered reflectance from the measured one
under each light; Y and white are those of the perfect diffuser in that light; no mask.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.skin.generate import MeasuredSkin, read_issa
from usdskin.judge.skin_prior import LIGHTS, judge_origins
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as GRID
from usdskin.spectrum import resample

FloatArray = NDArray[np.float64]


def measured_cameras(folder: Path) -> dict[str, FloatArray]:
    """Return the responsivities of the measured cameras on the default grid, shape [61, 3]."""
    found = {}
    for path in sorted((folder / "cameras").glob("*.json")):
        rows = json.loads(path.read_text())["spectral_data"]["data"]["main"]
        nm = np.array([float(key) for key in rows])
        values = np.array(list(rows.values()), dtype=float)
        found[path.stem.removesuffix("_380_780_5")] = resample(nm, values.T, GRID).T
    return found


def tell(skin: MeasuredSkin, cameras: dict[str, FloatArray], noise: float, step: int) -> None:
    errors = judge_origins(skin, list(cameras.values()), noise, step)
    print(
        f"\n{100 * noise:g} % noise: dE2000 {errors.own.mean():.3f} in the taking light, ", end=""
    )
    print(f"{errors.other.mean():.3f} in the others; {errors.inside.mean():.0%} within 1 sd")
    print("taken in  " + " ".join(f"{name:>7}" for name in LIGHTS))
    for name, row in zip(LIGHTS, errors.pairs, strict=True):
        print(f"{name:9} " + " ".join(f"{value:7.3f}" for value in row))
    print("tone class, lightest first   skins   own  others  within 1 sd")
    shares = (errors.by_tone(each) for each in (errors.own, errors.other, errors.inside))
    rows = np.stack(list(shares), axis=-1)
    for tone, (own, other, inside) in enumerate(rows):
        count = int((errors.tone == tone).sum())
        print(f"{tone + 1:26} {count:7} {own:6.3f} {other:6.3f} {inside:10.0%}")
    ratio = rows.max(axis=0) / rows.min(axis=0)
    print(f"worst class over best              {ratio[0]:6.2f} {ratio[1]:6.2f}")
    own = errors.delta_e[:, np.arange(len(LIGHTS)), np.arange(len(LIGHTS))].mean(axis=(1, 2))
    print("own, best and worst camera:", end=" ")
    names = list(cameras)
    for index in (int(own.argmin()), int(own.argmax())):
        print(f"{names[index]} {own[index]:.3f}", end="  ")
    print()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of the evaluation data")
    parser.add_argument("--quick", action="store_true", help="every fifth skin, six cameras")
    chosen = parser.parse_args()
    skin = read_issa(chosen.data / "skin" / "issa_subset_400_700_10.npz")
    cameras = measured_cameras(chosen.data)
    if chosen.quick:
        cameras = dict(list(cameras.items())[::3])
    counts = np.unique(skin.origin, return_counts=True)[1]
    print(
        f"{counts.sum()} skins of {len(counts)} origins {counts.tolist()}, {len(cameras)} cameras"
    )
    for noise in (0.0, 0.01):
        tell(skin, cameras, noise, 5 if chosen.quick else 1)


if __name__ == "__main__":
    main()
