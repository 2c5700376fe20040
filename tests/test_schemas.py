"""The usdSkin schemas: what they declare, how they are generated and when they are registered."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pxr
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

import usdskin
from usdskin import schemas
from usdskin.prims.applied import fits
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, SpectralQuantity

# The version of usd-core whose generator wrote the committed files; another may order or format
# them differently.
GENERATED_WITH = (0, 26, 11)
BASE_SCHEMA = "usd/resources/usd/schema.usda"

MULTIPLE_APPLY = {"SpectralDistributionAPI": "spectrum", "SpectralRecoveryAPI": "recovery"}

CAN_ONLY_APPLY_TO = {
    "CaptureAPI": ["Xform", "Scope"],
    "ColorChartAPI": ["Scope"],
    "ExposureBracketAPI": ["Camera"],
    "FisheyeCameraAPI": ["Camera"],
    "LightEstimateAPI": ["LightAPI"],
    "SkinMaterialAPI": ["Material"],
    "SkinRenderSettingsAPI": ["RenderSettings"],
    "SkinSampleAPI": ["Scope"],
    "SkinTransferAPI": ["Gprim"],
    "SpectralCameraAPI": ["Camera"],
    "SpectralDistributionAPI": [],
    "SpectralLightAPI": ["LightAPI"],
    "SpectralRecoveryAPI": ["Camera"],
}

# DESIGN section 4 as data: attribute -> type and fallback (None: no fallback). Attributes of
# multiple-apply schemas without prefix and instance.
ATTRIBUTES: dict[str, dict[str, tuple[str, object]]] = {
    "SpectralDistributionAPI": {
        "wavelengths": ("double[]", None),
        "values": ("double[]", None),
        "quantity": ("token", "relative"),
        "interpolation": ("token", "linear"),
    },
    "SpectralLightAPI": {
        "inputs:spectral:source": ("token", "rgb"),
        "inputs:spectral:illuminant": ("token", "D65"),
        "inputs:spectral:illuminant:file": ("asset", None),
        "inputs:spectral:coefficients:file": ("asset", None),
        "inputs:spectral:basis": ("double[]", None),
        "inputs:spectral:basis:wavelengths": ("double[]", None),
        "inputs:spectral:bands:file": ("asset", None),
        "inputs:spectral:scale": ("float", 1.0),
        "inputs:spectral:units": ("token", "relative"),
        "inputs:spectral:classMap:file": ("asset", None),
    },
    "LightEstimateAPI": {
        "estimate:origin": ("token", "measured"),
        "estimate:illuminant": ("string", ""),
        "estimate:classes": ("token[]", None),
        "estimate:classShares": ("double[]", None),
        "estimate:scale": ("double", None),
        "estimate:cct": ("double", None),
        "estimate:duv": ("double", None),
        "estimate:cri": ("double", None),
        "estimate:fidelity": ("double", None),
        "estimate:ssi": ("double", None),
        "estimate:ssiReference": ("string", ""),
        "estimate:illuminance": ("double", None),
        "estimate:peakIlluminance": ("double", None),
        "estimate:clippedShare": ("double", None),
        "estimate:negativeShare": ("double", None),
        "estimate:greyDeltaE2000": ("double", None),
        "estimate:skinDeltaE2000": ("double", None),
    },
    "SpectralCameraAPI": {
        "spectral:wavelengths": ("double[]", None),
        "spectral:responsivity": ("double[]", None),
        "spectral:units": ("token", "relative"),
        "spectral:noise": ("double[]", None),
        "spectral:settings:model": ("string", ""),
        "spectral:settings:whiteBalance": ("string", ""),
        "spectral:settings:lens": ("string", ""),
        "spectral:settings:iso": ("double[]", None),
    },
    "SpectralRecoveryAPI": {
        "matrix": ("double[]", None),
        "estimator": ("token", "regression"),
        "illuminant": ("double[]", None),
        "priorMean": ("double[]", None),
        "priorCovariance": ("double[]", None),
        "posteriorStddev": ("double[]", None),
        "greyDeltaE2000": ("double", None),
        "skinDeltaE2000": ("double", None),
        "ridge": ("double", None),
        "condition": ("double", None),
        "identityError": ("double", None),
        "looGfc": ("double", None),
        "looRmse": ("double", None),
        "looDeltaE2000": ("double", None),
        "patches": ("token[]", None),
        "patchGfc": ("double[]", None),
        "patchRmse": ("double[]", None),
        "patchDeltaE2000": ("double[]", None),
        "negativeShare": ("double", None),
    },
    "FisheyeCameraAPI": {
        "fisheye:projection": ("token", "equidistant"),
        "fisheye:focalLength": ("double", 0.0),
        "fisheye:center": ("double2", None),
        "fisheye:distortion": ("double4", (0.0, 0.0, 0.0, 0.0)),
        "fisheye:maxAngle": ("double", 90.0),
        "fisheye:vignetting": ("double[]", None),
        "fisheye:resolution": ("int2", None),
        "fisheye:glare": ("double", 0.0),
    },
    "CaptureAPI": {
        "capture:session": ("string", ""),
        "capture:device": ("string", ""),
        "capture:time": ("string", ""),
        "capture:settings:model": ("string", ""),
        "capture:settings:lens": ("string", ""),
        "capture:settings:whiteBalance": ("string", ""),
        "capture:settings:iso": ("double[]", None),
        "capture:luminanceWeights": ("double3", (0.0, 1.0, 0.0)),
        "capture:units": ("token", "relative"),
        "capture:scale": ("double", None),
        "capture:illuminance": ("double", 0.0),
        "capture:illuminance:direction": ("vector3d", None),
        "capture:luminance": ("double", 0.0),
        "capture:luminance:direction": ("vector3d", None),
        "capture:panorama:file": ("asset", None),
        "capture:stddev:file": ("asset", None),
        "capture:coverage": ("double", None),
        "capture:clippedShare": ("double", None),
        "capture:rotationResidual": ("double", None),
        "capture:fluxError": ("double", None),
        "capture:noise": ("double", None),
        "capture:exposureError": ("double", None),
        "capture:movedShare": ("double", None),
        "capture:rotationChanges": ("double[]", None),
        "capture:lamps:directions": ("vector3d[]", None),
        "capture:lamps:solidAngles": ("double[]", None),
        "capture:lamps:shares": ("double[]", None),
        "capture:lamps:factors": ("double[]", None),
    },
    "ExposureBracketAPI": {
        "bracket:images": ("asset[]", None),
        "bracket:exposureTimes": ("double[]", None),
        "bracket:iso": ("double[]", None),
        "bracket:fNumbers": ("double[]", None),
        "bracket:ndFactors": ("double[]", None),
        "bracket:blackLevel": ("double[]", (0.0,)),
        "bracket:whiteLevel": ("double[]", None),
        "bracket:gain": ("double[]", None),
        "bracket:readNoise": ("double[]", None),
        "bracket:transfer": ("token", "auto"),
        "bracket:response:file": ("asset", None),
        "bracket:dark:file": ("asset", None),
        "bracket:flat:file": ("asset", None),
    },
    "ColorChartAPI": {
        "chart:name": ("string", ""),
        "chart:layout": ("token", ""),
        "chart:patches": ("token[]", None),
        "chart:cameraValues": ("double[]", None),
        "chart:cameraValues:file": ("asset", None),
        "chart:units": ("token", "relative"),
        "chart:wavelengths": ("double[]", None),
        "chart:signals": ("double[]", None),
        "chart:signals:file": ("asset", None),
        "chart:reflectances": ("double[]", None),
        "chart:reflectances:file": ("asset", None),
        "chart:illuminant": ("token", ""),
        "chart:illuminant:file": ("asset", None),
        "chart:settings:model": ("string", ""),
        "chart:settings:lens": ("string", ""),
        "chart:settings:whiteBalance": ("string", ""),
        "chart:settings:iso": ("double[]", None),
        "chart:image:file": ("asset", None),
        "chart:corners": ("float2[]", None),
        "chart:lightClass": ("token", ""),
    },
    "SkinSampleAPI": {
        "samples:light": ("vector3f[]", None),
        "samples:view": ("vector3f[]", None),
        "samples:normal": ("vector3f[]", None),
        "samples:thetaI": ("double[]", None),
        "samples:thetaR": ("double[]", None),
        "samples:azimuth": ("double[]", None),
        "samples:values:file": ("asset", None),
        "samples:quantity": ("token", "reflectanceFactor"),
        "samples:white": ("double[]", None),
        "samples:thickness": ("double[]", None),
        "samples:saturation": ("double", 0.0),
        "samples:lightClass": ("token", ""),
        "samples:reflectance:file": ("asset", None),
        "samples:reflectance:geometry": ("token", "di8"),
        "samples:reflectance:specularIncluded": ("bool", False),
        "samples:values": ("double[]", None),
        "samples:wavelengths": ("double[]", None),
        "samples:mask": ("bool[]", None),
        "samples:images": ("asset[]", None),
        "samples:geometry:files": ("asset[]", None),
        "samples:mask:files": ("asset[]", None),
    },
    "SkinMaterialAPI": {
        "inputs:skin:alpha": ("float", 1.0),
        "inputs:skin:wrap": ("float", 0.3),
        "inputs:skin:wrapNormalization": ("token", "paper"),
        "inputs:skin:opacity": ("float", 0.0),
        "inputs:skin:thickness": ("float", 0.0),
        "inputs:skin:albedo:file": ("asset", None),
        "inputs:skin:albedo:sourceColorSpace": ("token", "auto"),
        "inputs:skin:weights:file": ("asset", None),
        "inputs:skin:weights:basis": ("double[]", None),
        "inputs:skin:weights:basis:wavelengths": ("double[]", None),
        "inputs:skin:texcoord": ("token", "st"),
        "inputs:skin:normal:file": ("asset", None),
        "inputs:skin:bump:file": ("asset", None),
        "inputs:skin:bump:depth": ("float", 0.0001),
        "inputs:skin:displacement:file": ("asset", None),
        "inputs:skin:displacement:scale": ("float", 0.001),
        "inputs:skin:displacement:midLevel": ("float", 0.5),
        "inputs:skin:specular:weight:file": ("asset", None),
        "inputs:skin:specular:roughness:file": ("asset", None),
        "inputs:skin:specular:weight": ("float", 0.0),
        "inputs:skin:specular:roughness1": ("float", 0.5),
        "inputs:skin:specular:roughness2": ("float", 0.3),
        "inputs:skin:specular:mix": ("float", 0.3),
        "inputs:skin:specular:f0": ("float", 0.028),
        "inputs:skin:melanin": ("float", None),
        "inputs:skin:haemoglobin": ("float", None),
        "inputs:skin:oxygenation": ("float", None),
        "inputs:skin:epidermisThickness": ("float", None),
        "fit:convention": ("token", "none"),
        "fit:parameters": ("token[]", None),
        "fit:values": ("double[]", None),
        "fit:covariance": ("double[]", None),
        "fit:wrapStddev": ("double", None),
        "fit:alphaStddev": ("double", None),
        "fit:reach": ("double", None),
        "fit:neededReach": ("double", None),
        "fit:residual": ("double", None),
    },
    "SkinTransferAPI": {
        "transfer:file": ("asset", None),
        "transfer:version": ("int", 1),
        "transfer:index": ("int", 0),
        "transfer:rowCount": ("int", 0),
        "transfer:rings": ("int", 0),
        "transfer:subdivisionLevel": ("int", 0),
        "transfer:geometryHash": ("string", None),
        "transfer:sceneHash": ("string", None),
        "transfer:reach": ("double[]", None),
    },
    "SkinRenderSettingsAPI": {
        "usdskin:integrator": ("token", "map"),
        "usdskin:samplesPerPixel": ("int", 4),
        "usdskin:targetError": ("float", 0.0),
        "usdskin:bounces": ("int", 0),
        "usdskin:motionSamples": ("int", 0),
        "usdskin:seed": ("int", 0),
        "usdskin:wavelengths": ("double[]", tuple(range(400, 701, 5))),
        "usdskin:observer": ("token", "cie1931_2"),
        "usdskin:subdivisionLevel": ("int", 2),
        "usdskin:spectralOutput": ("bool", False),
        "usdskin:pixelFilter": ("token", "blackmanHarris"),
        "usdskin:dome": ("token", "auto"),
    },
}

RELATIONSHIPS = {
    "CaptureAPI": {"capture:views"},
    "ColorChartAPI": {"chart:view"},
    "SkinSampleAPI": {"samples:camera", "samples:lights", "samples:views"},
}

TOKENS = {
    "quantity": [quantity.value for quantity in SpectralQuantity],
    "interpolation": ["linear", "held"],
    "inputs:spectral:source": ["rgb", "tabulated", "blackbody", "illuminantD", "basis", "bands"],
    "inputs:spectral:units": ["absolute", "relative"],
    "estimator": ["regression", "literal", "tsvd", "pca", "wiener", "smooth"],
    "fisheye:projection": [
        "equidistant",
        "equisolid",
        "stereographic",
        "orthographic",
        "opencv",
    ],
    "capture:units": ["absolute", "relative"],
    "chart:layout": ["", "classic24", "sg140"],
    "chart:units": ["absolute", "relative"],
    "estimate:origin": ["measured", "assigned"],
    "samples:quantity": ["reflectanceFactor", "radiance", "cameraValues"],
    "samples:reflectance:geometry": ["di8", "45to0"],
    "spectral:units": ["absolute", "relative"],
    "bracket:transfer": ["auto", "linear", "recovered"],
    "inputs:skin:wrapNormalization": ["paper", "energy"],
    "inputs:skin:albedo:sourceColorSpace": ["auto", "raw", "sRGB"],
    "fit:convention": ["none", "luminousMean"],
    "usdskin:integrator": ["map", "traced"],
    "usdskin:observer": ["cie1931_2", "cie1964_10", "cie2015_2"],
    "usdskin:pixelFilter": ["box", "triangle", "gaussian", "blackmanHarris"],
    "usdskin:dome": ["auto", "show", "hide"],
}

UNIT_INTERVAL = (0.0, 1.0)
NOT_NEGATIVE = (0.0, None)
UNLIMITED = ("inputs:skin:bump:depth", "inputs:skin:displacement:scale",
             "inputs:skin:displacement:midLevel")  # fmt: skip
LIMITS = {
    "inputs:spectral:scale": NOT_NEGATIVE,
    "condition": (1.0, None),
    "identityError": NOT_NEGATIVE,
    "looGfc": UNIT_INTERVAL,
    "looDeltaE2000": NOT_NEGATIVE,
    "looRmse": NOT_NEGATIVE,
    "ridge": NOT_NEGATIVE,
    "greyDeltaE2000": NOT_NEGATIVE,
    "skinDeltaE2000": NOT_NEGATIVE,
    "negativeShare": UNIT_INTERVAL,
    "estimate:scale": NOT_NEGATIVE,
    "estimate:cct": NOT_NEGATIVE,
    "estimate:duv": (-1.0, 1.0),
    "estimate:cri": (None, 100.0),
    "estimate:fidelity": (0.0, 100.0),
    "estimate:ssi": (None, 100.0),
    "estimate:illuminance": NOT_NEGATIVE,
    "estimate:peakIlluminance": NOT_NEGATIVE,
    "estimate:clippedShare": UNIT_INTERVAL,
    "estimate:negativeShare": UNIT_INTERVAL,
    "estimate:greyDeltaE2000": NOT_NEGATIVE,
    "estimate:skinDeltaE2000": NOT_NEGATIVE,
    "fisheye:focalLength": NOT_NEGATIVE,
    "fisheye:maxAngle": (0.0, 180.0),
    "fisheye:glare": (0.0, 0.5),
    "capture:scale": NOT_NEGATIVE,
    "capture:noise": NOT_NEGATIVE,
    "capture:exposureError": NOT_NEGATIVE,
    "capture:movedShare": UNIT_INTERVAL,
    "capture:illuminance": NOT_NEGATIVE,
    "capture:luminance": NOT_NEGATIVE,
    "capture:coverage": UNIT_INTERVAL,
    "capture:clippedShare": UNIT_INTERVAL,
    "capture:rotationResidual": NOT_NEGATIVE,
    "capture:fluxError": NOT_NEGATIVE,
    "inputs:skin:alpha": UNIT_INTERVAL,
    "inputs:skin:wrap": UNIT_INTERVAL,
    "inputs:skin:opacity": NOT_NEGATIVE,
    "inputs:skin:thickness": NOT_NEGATIVE,
    "inputs:skin:specular:weight": UNIT_INTERVAL,
    "inputs:skin:specular:roughness1": UNIT_INTERVAL,
    "inputs:skin:specular:roughness2": UNIT_INTERVAL,
    "inputs:skin:specular:mix": UNIT_INTERVAL,
    "inputs:skin:specular:f0": UNIT_INTERVAL,
    "inputs:skin:melanin": UNIT_INTERVAL,
    "inputs:skin:haemoglobin": UNIT_INTERVAL,
    "inputs:skin:oxygenation": UNIT_INTERVAL,
    "inputs:skin:epidermisThickness": NOT_NEGATIVE,
    "fit:residual": NOT_NEGATIVE,
    "fit:wrapStddev": NOT_NEGATIVE,
    "fit:alphaStddev": NOT_NEGATIVE,
    "fit:reach": (0.0, 180.0),
    "fit:neededReach": (0.0, 190.0),
    "samples:saturation": NOT_NEGATIVE,
    "usdskin:samplesPerPixel": (1, None),
    "usdskin:targetError": NOT_NEGATIVE,
    "usdskin:bounces": (0, 1),
    "usdskin:motionSamples": (0, 256),
    "usdskin:seed": NOT_NEGATIVE,
    "usdskin:subdivisionLevel": (0, 8),
    "transfer:version": (1, None),
    "transfer:index": NOT_NEGATIVE,
    "transfer:rowCount": NOT_NEGATIVE,
    "transfer:rings": (0, 200),
    "transfer:subdivisionLevel": (0, 8),
}

PRIM_TYPES = {
    "SkinTransferAPI": "Mesh",
    "SpectralLightAPI": "DomeLight",
    "LightEstimateAPI": "DomeLight",
    "SpectralDistributionAPI": "Scope",
}


@pytest.fixture(params=schemas.SCHEMA_NAMES)
def schema(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def stage() -> Usd.Stage:
    return Usd.Stage.CreateInMemory()


def applied(stage: Usd.Stage, schema: str) -> Usd.Prim:
    kind = PRIM_TYPES.get(schema) or CAN_ONLY_APPLY_TO[schema][0]
    prim = stage.DefinePrim(f"/{schema}", kind)
    assert prim.ApplyAPI(schema, "one") if schema in MULTIPLE_APPLY else prim.ApplyAPI(schema)
    return prim


def full_name(schema: str, name: str) -> str:
    return f"{MULTIPLE_APPLY[schema]}:one:{name}" if schema in MULTIPLE_APPLY else name


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_the_table_of_this_test_names_every_schema_and_property(schema: str) -> None:
    definition = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition(schema)
    names = {name.split("__INSTANCE_NAME__:")[-1] for name in definition.GetPropertyNames()}
    assert names == set(ATTRIBUTES[schema]) | RELATIONSHIPS.get(schema, set())


def test_attributes_have_their_type_and_fallback(stage: Usd.Stage, schema: str) -> None:
    prim = applied(stage, schema)
    for name, (kind, fallback) in ATTRIBUTES[schema].items():
        attribute = prim.GetAttribute(full_name(schema, name))
        value = attribute.Get()
        assert str(attribute.GetTypeName()) == kind, name
        if isinstance(fallback, tuple):
            assert tuple(value) == fallback, name
        elif isinstance(fallback, float):
            assert value == pytest.approx(fallback, rel=1e-7), name
        else:
            assert value == fallback, name


def test_attributes_can_be_set_and_read_back(stage: Usd.Stage, schema: str) -> None:
    prim = applied(stage, schema)
    samples = {
        "double[]": [1.5, 2.5],
        "float2[]": [(1.0, 2.0)],
        "vector3f[]": [(0.0, 0.0, 1.0)],
        "vector3d[]": [(0.0, 0.0, 1.0)],
        "token[]": ["a"],
        "bool[]": [True],
        "asset[]": ["./a.exr"],
        "asset": "./a.exr",
        "double": 0.5,
        "float": 0.5,
        "int": 3,
        "bool": True,
        "token": "t",
        "string": "s",
        "double2": (1.0, 2.0),
        "double3": (1.0, 2.0, 3.0),
        "double4": (1.0, 2.0, 3.0, 4.0),
        "int2": Gf.Vec2i(3, 4),
        "vector3d": (0.0, 1.0, 0.0),
    }
    for name, (kind, _) in ATTRIBUTES[schema].items():
        attribute = prim.GetAttribute(full_name(schema, name))
        assert attribute.Set(samples[kind]), name
        value = attribute.Get()
        if kind == "asset":
            assert value.path == samples[kind]
        elif kind == "asset[]":
            assert [item.path for item in value] == samples[kind]
        elif isinstance(samples[kind], list):
            assert list(value) == samples[kind], name
        else:
            assert value == samples[kind], name


def test_every_property_says_what_it_is_and_in_which_unit(stage: Usd.Stage, schema: str) -> None:
    prim = applied(stage, schema)
    numeric = ("double", "float", "int", "vector")
    for name, (kind, _) in ATTRIBUTES[schema].items():
        attribute = prim.GetAttribute(full_name(schema, name))
        doc = attribute.GetDocumentation()
        assert doc.endswith("."), name
        assert attribute.GetDisplayGroup(), name
        if kind.startswith(numeric) and name != "values":
            assert "[" in doc, f"{name} has no unit"
    for name in RELATIONSHIPS.get(schema, ()):
        assert prim.GetRelationship(name).GetDocumentation().endswith("."), name
    definition = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition(schema)
    assert definition.GetDocumentation().endswith(".")


def test_tokens_list_what_is_allowed(stage: Usd.Stage, schema: str) -> None:
    prim = applied(stage, schema)
    for name in ATTRIBUTES[schema]:
        allowed = prim.GetAttribute(full_name(schema, name)).GetMetadata("allowedTokens")
        assert (list(allowed) if allowed else None) == TOKENS.get(name), name


def test_fallback_tokens_are_allowed_ones() -> None:
    for attributes in ATTRIBUTES.values():
        for name, (_, fallback) in attributes.items():
            if name in TOKENS:
                assert fallback in TOKENS[name], name


def test_numbers_have_their_limits(stage: Usd.Stage, schema: str) -> None:
    prim = applied(stage, schema)
    for name in ATTRIBUTES[schema]:
        hard = prim.GetAttribute(full_name(schema, name)).GetHardLimits()
        assert (hard.GetMinimum(), hard.GetMaximum()) == LIMITS.get(name, (None, None)), name


def test_scalars_without_limits_are_none_but_listed_ones() -> None:
    """A number may be unlimited only where every value makes sense."""
    for attributes in ATTRIBUTES.values():
        for name, (kind, _) in attributes.items():
            if kind in ("float", "double", "int"):
                assert (name in LIMITS) != (name in UNLIMITED), name


def test_schemas_fit_only_the_prims_they_are_for(stage: Usd.Stage, schema: str) -> None:
    registry = Usd.SchemaRegistry
    allowed = list(registry.GetAPISchemaCanOnlyApplyToTypeNames(schema, ""))
    assert allowed == CAN_ONLY_APPLY_TO[schema]
    other = stage.DefinePrim("/Other", "Shader" if "Gprim" in allowed else "Cube")
    instance = ("one",) if schema in MULTIPLE_APPLY else ()
    assert bool(other.CanApplyAPI(schema, *instance)) == (not allowed)
    assert fits(other, schema) == (not allowed)
    assert fits(applied(stage, schema), schema)


def test_spectral_lights_are_stock_lights_of_any_kind(stage: Usd.Stage) -> None:
    for number, kind in enumerate(("DomeLight", "DomeLight_1", "DistantLight", "RectLight")):
        assert fits(stage.DefinePrim(f"/L{number}", kind), "SpectralLightAPI")
    mesh = UsdGeom.Mesh.Define(stage, "/Mesh").GetPrim()
    assert not fits(mesh, "SpectralLightAPI")
    UsdLux.MeshLightAPI.Apply(mesh)
    assert fits(mesh, "SpectralLightAPI")


def test_the_default_wavelengths_are_those_of_the_package(stage: Usd.Stage) -> None:
    prim = applied(stage, "SkinRenderSettingsAPI")
    assert list(prim.GetAttribute("usdskin:wavelengths").Get()) == list(DEFAULT_WAVELENGTHS_NM)


def test_the_plugin_needs_no_library_and_lies_in_one_folder() -> None:
    folder = Path(usdskin.plugin_path())
    text = (folder / "plugInfo.json").read_text()
    assert '"Type": "resource"' in text
    assert '"LibraryPath": ""' in text
    assert "@PLUG_INFO" not in text
    assert (folder / "generatedSchema.usda").is_file()


def generator() -> ModuleType:
    pytest.importorskip("jinja2", reason="usdGenSchema needs jinja2: pip install usdskin[schema]")
    if not Path(pxr.__file__).with_name("pluginfo").joinpath(BASE_SCHEMA).is_file():
        pytest.skip("this usd-core has no schema.usda to derive from; take 26.11 or later")
    from usdskin.schemas import generate

    return generate


def test_generated_files_are_fresh(tmp_path: Path) -> None:
    generate = generator()
    generate.generate(tmp_path)
    for name in generate.GENERATED_NAMES:
        fresh, committed = tmp_path / name, generate.FOLDER / name
        if Usd.GetVersion() == GENERATED_WITH:
            assert fresh.read_bytes() == committed.read_bytes(), "run usdskin.schemas.generate"
        elif name.endswith(".usda"):
            layers = [Sdf.Layer.OpenAsAnonymous(str(path)) for path in (fresh, committed)]
            assert layers[0].ExportToString() == layers[1].ExportToString()


def test_generating_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    generate = generator()
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        generate.generate(folder)
    for name in generate.GENERATED_NAMES:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()


def test_registration_after_the_registry_was_built_is_an_error_with_the_remedy() -> None:
    done = run(
        "from pxr import Usd; Usd.Stage.CreateInMemory().DefinePrim('/A', 'Mesh')\n"
        "import usdskin.schemas, usdskin.errors\n"
        "try: usdskin.schemas.ensure_registered()\n"
        "except usdskin.errors.SchemaError as error: print(error)\n"
    )
    assert "before the first stage is opened" in done.stdout
    assert "PXR_PLUGINPATH_NAME" in done.stdout
    assert done.stdout.count("\n") == 1
    assert done.stderr == ""


def test_registration_works_after_pxr_was_imported() -> None:
    done = run(
        "from pxr import Usd, UsdGeom, UsdShade\n"
        "import usdskin.schemas as s; s.ensure_registered(); s.ensure_registered()\n"
        "stage = Usd.Stage.CreateInMemory()\n"
        "print(stage.DefinePrim('/A', 'Material').ApplyAPI('SkinMaterialAPI'))"
    )
    assert (done.stdout, done.stderr) == ("True\n", "")


def test_a_host_finds_the_schemas_through_the_plugin_path_alone() -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "from pxr import Usd\n"
            "print(bool(Usd.SchemaRegistry.FindSchemaInfo('SkinMaterialAPI')))\n"
            "import usdskin.schemas; usdskin.schemas.ensure_registered()",
        ],
        env={"PXR_PLUGINPATH_NAME": usdskin.plugin_path()},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.stdout, done.stderr) == ("True\n", "")


def test_importing_the_schemas_loads_nothing_heavy() -> None:
    done = run(
        "import sys, usdskin.schemas\n"
        "print([m for m in ('pxr.Usd', 'numpy', 'warp', 'colour') if m in sys.modules])"
    )
    assert done.stdout == "[]\n"


def test_the_plugin_path_is_known_without_pxr() -> None:
    done = run("import sys, usdskin; print(usdskin.plugin_path()); assert 'pxr' not in sys.modules")
    assert Path(done.stdout.strip(), "plugInfo.json").is_file()
    assert done.stderr == ""
