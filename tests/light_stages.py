"""Stages with lights, light maps, and the radiance read from them: for the tests of lights."""

import numpy as np
import OpenEXR
from pxr import Sdf, Usd, UsdGeom, UsdLux

import usdskin.schemas  # noqa: F401  (registers before the first stage)
from usdskin.colorimetry import cat16, illuminant, rgb_to_xyz, white_xyz, xyz_weights
from usdskin.render.lights import read_lights
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as NM

WEIGHTS = xyz_weights(NM)
ABSOLUTE = xyz_weights(NM, absolute=True)
RNG = np.random.default_rng(3)


def new_stage(up="Y"):
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, up)
    return stage


def write_exr(path, channels, **header):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    arrays = {name: np.ascontiguousarray(a, dtype=np.float32) for name, a in channels.items()}
    OpenEXR.File(header, arrays).write(str(path))
    return str(path)


def write_rgb(path, pixels, **header):
    return write_exr(path, {"RGB": pixels}, **header)


def rgb_map(height=8, width=16):
    return RNG.random((height, width, 3)).astype(np.float32)


def dome(stage, texture=None, path="/Dome", kind=UsdLux.DomeLight):
    light = kind.Define(stage, path)
    if texture is not None:
        light.CreateTextureFileAttr(Sdf.AssetPath(texture))
    return light


def spectral(light, source, **inputs):
    prim = light.GetPrim()
    prim.ApplyAPI("SpectralLightAPI")
    prim.GetAttribute("inputs:spectral:source").Set(source)
    for name, value in inputs.items():
        attribute = prim.GetAttribute(f"inputs:spectral:{name.replace('_', ':')}")
        attribute.Set(value)
    return prim


def read(stage, notes=None, **options):
    return read_lights(stage, Usd.TimeCode.Default(), NM, notes=notes, **options)


def only_dome(stage, notes=None, **options):
    (light,) = read(stage, notes, **options).domes
    return light


def radiance(light):
    return light.coefficients.astype(np.float64) @ light.basis


def xyz(light):
    return radiance(light) @ (ABSOLUTE if light.absolute else WEIGHTS)


def adapted(rgb, lamp, color_space="lin_rec709_scene"):
    white = illuminant(lamp, NM) @ WEIGHTS
    return rgb @ (cat16(white_xyz(color_space), white / white[1]) @ rgb_to_xyz(color_space)).T


def codes(notes):
    return [note.code for note in notes]
