"""A small proof to report on: a ball, its reproductions, and everything ``proof.json`` may hold."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from usdskin import __version__
from usdskin.colorimetry import (
    delta_e_2000,
    illuminant,
    rgb_to_xyz,
    xyz_to_lab,
    xyz_to_rgb,
    xyz_weights,
)
from usdskin.images import Part, write_exr, write_png, write_spectral_exr

NM = np.arange(400.0, 701.0, 20.0)
WIDTH, HEIGHT = 60, 72
SPACE = "lin_rec709_scene"

LIGHT = """#usda 1.0
(
    defaultPrim = "Light"
    metersPerUnit = 1
    upAxis = "Y"
    customLayerData = {{
        dictionary usdskin = {{
            dictionary {step} = {{
                string created = "2026-01-01T00:00:00Z"
                string[] inputs = []
                string[] inputsSha256 = []
                dictionary settings = {{
                    string estimator = "regression"
                }}
                string version = "0.1"
            }}
        }}
    }}
)

def DomeLight "Light" (
    prepend apiSchemas = ["SpectralLightAPI"]
)
{{
    asset inputs:texture:file = @./{texture}@
    token inputs:texture:format = "latlong"
    uniform token inputs:spectral:illuminant = "FL2"
    uniform token inputs:spectral:source = "rgb"
}}
"""

CAPTURE = """#usda 1.0
(
    defaultPrim = "Shoot"
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "Shoot" (
    prepend apiSchemas = ["CaptureAPI"]
)
{
    double capture:clippedShare = 0.0123
    double capture:coverage = 0.9876
    double capture:fluxError = 0.0042
    double capture:noise = 0.001
    double capture:rotationResidual = 0.034
}
"""


def ball_spectra(warmth: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the spectra of a lit ball [height, width, bands] and where it is [height, width]."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    u, v = (x - WIDTH / 2 + 0.5) / 26.0, (y - HEIGHT / 2 + 0.5) / 32.0
    inside = u**2 + v**2 < 1.0
    z = np.sqrt(np.clip(1.0 - u**2 - v**2, 0.0, 1.0))
    lit = np.clip(0.6 * z - 0.4 * v - 0.3 * u, 0.0, None) + 0.08
    lamp = illuminant("FL2", NM) / 100.0
    skin = 0.25 + 0.35 / (1.0 + np.exp(-(NM - 590.0) / 18.0))
    tinted = lamp * skin * (1.0 + warmth * (NM - 550.0) / 150.0)
    rosy = lamp * np.exp(-(((NM - 620.0) / 60.0) ** 2)) * 0.2
    cheek = np.exp(-((u - 0.3) ** 2 + (v - 0.2) ** 2) / 0.08)
    spectra = lit[..., None] * (tinted + cheek[..., None] * rosy)
    return spectra * inside[..., None], inside


def write_render(base: Path, warmth: float) -> np.ndarray:
    """Write a picture as a render does, and return its XYZ as the file has it."""
    spectra, inside = ball_spectra(warmth)
    rgb = (spectra @ xyz_weights(NM, absolute=True) @ xyz_to_rgb(SPACE).T).astype(np.float32)
    rgba = np.concatenate([rgb, inside[..., None]], axis=2).astype(np.float32)
    write_exr(base.with_suffix(".exr"), [Part("beauty", {"": rgba}, color_space=SPACE)])
    spectral = base.with_name(f"{base.name}.spectral.exr")
    write_spectral_exr(spectral, NM, spectra.astype(np.float32), rgb, "W.m^-2.sr^-1.nm^-1", {})
    return rgb.astype(np.float64) @ rgb_to_xyz(SPACE).T


def spread(values: np.ndarray) -> dict[str, float]:
    """Return mean, median, 95th percentile and maximum."""
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "max": float(values.max()),
    }


def compared(folder: Path, truth: np.ndarray, xyz: np.ndarray, row: dict[str, str]) -> dict:
    """Write the maps of a comparison, and return it as ``proof.json`` has it."""
    _, inside = ball_spectra(0.0)
    white = illuminant("FL2", NM) / 100.0 @ xyz_weights(NM, absolute=True)
    first, second = xyz_to_lab(truth, white), xyz_to_lab(xyz, white)
    delta = delta_e_2000(second, first)
    change = second - first
    planes = {
        "dE2000": delta,
        "dE76": np.linalg.norm(change, axis=-1),
        "dL": change[..., 0],
        "da": change[..., 1],
        "db": change[..., 2],
        "flip": delta / 100.0,
    }
    channels = {name: np.where(inside, plane, np.nan) for name, plane in planes.items()}
    channels["mask"] = inside.astype(np.float64)
    write_exr(
        folder / row["maps"],
        [Part("difference", {key: value.astype(np.float32) for key, value in channels.items()})],
    )
    statistics = {key: spread(value[inside]) for key, value in planes.items()}
    result = {
        "truth": row["truth"],
        "picture": row["picture"],
        "observer": "cie1931_2",
        "yN": float(white[1]),
        "white": [float(value) for value in white[:2] / white.sum()],
        "whiteFrom": "the truth's irradiance",
        "mask": {"from": "alpha", "pixels": int(inside.sum()), "share": float(inside.mean())},
        "deltaE2000": statistics["dE2000"],
        "deltaE76": statistics["dE76"],
        "flip": statistics["flip"],
        "spectral": {"rmse": 0.0123, "gfc": 0.99987, "p05gfc": 0.9991},
        "regions": [{"name": "/Shot/Subject/Head", "pixels": 9, "deltaE2000": spread(delta)}],
    }
    for key, name in (("deltaL", "dL"), ("deltaA", "da"), ("deltaB", "db")):
        values = planes[name][inside]
        result[key] = {"mean": float(values.mean()), "rms": float(np.sqrt((values**2).mean()))}
    return {**row, "png": None, "result": result}


def write_light(folder: Path, name: str, step: str, seed: int) -> None:
    """Write a layer with a dome and its texture."""
    random = np.random.default_rng(seed)
    pixels = (0.2 + 0.02 * random.random((16, 32, 3))).astype(np.float32)
    pixels[3:5, 10:20] = 5.0
    texture = f"{Path(name).stem}.exr"
    beside = (folder / name).parent / texture
    write_exr(beside, [Part("rgb", {"": pixels}, color_space=SPACE)])
    (folder / name).write_text(LIGHT.format(step=step, texture=texture))


def write_proof(
    folder: Path, *, set_name: str = "room_ball", leave_out: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Fill a folder with a proof of everything, and return what its ``proof.json`` holds.

    Args:
        folder: Folder to fill; made where it is not there.
        set_name: Name and title of the set, and of a few other things.
        leave_out: Members of ``proof.json`` not to write.
    """
    for name in ("truth", "renders", "differences"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    pictures, xyz = [], {}
    warmth = {"truth": 0.0, "light": 0.03, "chain": -0.06}
    for integrator, more in (("map", 0.0), ("traced", 0.004)):
        for name, value in warmth.items():
            base = folder / "renders" / f"{name}_{integrator}"
            xyz[name, integrator] = write_render(base, value + (name != "truth") * more)
            pictures.append(
                {
                    "name": name,
                    "integrator": integrator,
                    "beauty": f"renders/{base.name}.exr",
                    "spectral": f"renders/{base.name}.spectral.exr",
                    "png": None,
                }
            )
    comparisons = []
    for name in ("light", "chain"):
        for integrator in ("map", "traced"):
            row = {
                "name": name,
                "integrator": integrator,
                "truth": f"renders/truth_{integrator}.exr",
                "picture": f"renders/{name}_{integrator}.exr",
                "maps": f"differences/{name}_{integrator}.exr",
            }
            picture = xyz[name, integrator]
            done = compared(folder, xyz["truth", integrator], picture, row)
            noise = {"deltaE2000": {"mean": 0.071, "p95": 0.2}} if integrator == "traced" else None
            comparisons.append({**done, "noise": noise})
    write_light(folder, "truth/light.usda", "solve", 1)
    write_light(folder, "light.usda", "estimateLight", 2)
    (folder / "capture.usda").write_text(CAPTURE)
    write_png(folder / "quality.png", np.full((20, 40, 3), 90, np.uint8))
    curve = [float(value) for value in illuminant("FL2", NM)]
    near = [1.02 * value for value in curve]
    mean = comparisons[0]["result"]["deltaE2000"]["mean"]
    content: dict[str, Any] = {
        "version": __version__,
        "set": set_name,
        "title": f"The set {set_name}",
        "settings": {"size": "preview", "seed": 1},
        "steps": [
            {
                "name": "capture",
                "title": f"merge the photographs of {set_name}",
                "command": f"usdskin capture shoot/{set_name}.usda -o capture.usda",
                "seconds": 12.34,
                "reads": [],
                "writes": ["capture.usda"],
                "notes": ["clipped-lamp <tube>: 1.2 % of the light"],
            },
            {
                "name": "compare",
                "title": "compare",
                "command": "usdskin compare renders/truth_map.exr renders/light_map.exr",
                "seconds": 1.0,
                "reads": [],
                "writes": [],
                "notes": [],
            },
        ],
        "layers": {
            "truthLight": "truth/light.usda",
            "truthClasses": {},
            "capture": "capture.usda",
            "light": "light.usda",
        },
        "pictures": pictures,
        "comparisons": comparisons,
        "spectra": {
            "wavelengths": list(NM),
            "items": [
                item(f"irradiance up {set_name}", "light", curve, near, None),
                item("tubes: dark skin", "patch", curve, near, [0.5] * len(curve)),
                item("reflectance S", "skin", [0.4] * len(NM), [0.41] * len(NM), [0.01] * len(NM)),
            ],
        },
        "skin": [
            {"name": "wrap", "true": 0.31, "estimated": 0.3212, "stddev": 0.0061},
            {"name": "alpha", "true": 0.72, "estimated": 0.7154, "stddev": 0.004},
            {"name": "S(550)", "true": 0.4, "estimated": 0.41, "stddev": None},
        ],
        "tones": [
            {
                "tone": tone,
                "integrator": "map",
                "deltaE2000": {"mean": value, "p95": 2.0 * value},
                "gfc": 0.9998,
                "chain": {"deltaE2000": {"mean": 1.1 * value, "p95": 2.2 * value}},
            }
            for tone, value in (("very light", 0.31), ("tan", 0.42), ("dark", 0.63))
        ],
        "budget": [
            {"cause": cause, "setting": setting, "deltaE2000": {"mean": value, "p95": 2 * value}}
            for cause, setting, value in (
                ("clipping", "lamps at a half", 4.9),
                ("rotation", "1 degree", 0.13),
                ("wrap", "l + 0.05", 0.8),
            )
        ],
        "bars": [
            {"name": "light, map: dE2000 mean", "value": mean, "bar": 5.0, "met": True},
            {"name": "chain, map: dE2000 mean", "value": 2.0, "bar": 1.0, "met": False},
        ],
    }
    for name in leave_out:
        del content[name]
    save(folder, content)
    return content


def item(name: str, kind: str, true: list, estimated: list, stddev: list | None) -> dict:
    """Return a spectrum as ``proof.json`` has it."""
    return {"name": name, "kind": kind, "true": true, "estimated": estimated, "stddev": stddev}


def save(folder: Path, content: dict[str, Any]) -> None:
    """Write ``proof.json`` with the hashes of the files that are there now."""
    files = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not name.startswith(("proof.json", "report.")):
            data = path.read_bytes()
            files[name] = {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
    whole = {**content, "files": files}
    (folder / "proof.json").write_text(json.dumps(whole, sort_keys=True))
