"""The ``usdSkin`` schemas; importing this package registers them.

USD builds its schema registry once, when the first stage is opened, and ignores what is
registered later. Import this package before that, or let ``PXR_PLUGINPATH_NAME`` name the folder
``usdskin schema-path`` prints. ``ensure_registered`` finds out which of the two happened.
"""

from __future__ import annotations

from pathlib import Path

from pxr import Plug

from usdskin.errors import SchemaError

SCHEMA_NAMES = (
    "CaptureAPI",
    "ColorChartAPI",
    "ExposureBracketAPI",
    "FisheyeCameraAPI",
    "LightEstimateAPI",
    "SkinMaterialAPI",
    "SkinRenderSettingsAPI",
    "SkinSampleAPI",
    "SkinTransferAPI",
    "SpectralCameraAPI",
    "SpectralDistributionAPI",
    "SpectralLightAPI",
    "SpectralRecoveryAPI",
)
"""Identifiers of all schemas, sorted."""

Plug.Registry().RegisterPlugins(str(Path(__file__).resolve().parent))


def ensure_registered() -> None:
    """Check that USD's schema registry knows every schema of this package.

    Asking builds the registry: plugins that are registered afterwards stay unknown. So this is
    called on opening a stage, not on import.

    Raises:
        SchemaError: The registry was built before the schemas were registered, or with an older
            copy of them.
    """
    from pxr import Usd

    missing = [name for name in SCHEMA_NAMES if not Usd.SchemaRegistry.FindSchemaInfo(name)]
    if not missing:
        return
    if len(missing) == len(SCHEMA_NAMES):
        raise SchemaError(
            "the usdSkin schemas were registered after USD had built its schema registry, so "
            "lights and materials would lose their spectra; import usdskin.schemas before the "
            "first stage is opened, or set PXR_PLUGINPATH_NAME to the folder that "
            "`usdskin schema-path` prints"
        )
    plugin = Plug.Registry().GetPluginWithName("usdSkin")
    raise SchemaError(
        f"the usdSkin schemas in {plugin.resourcePath} are of another version: "
        f"{', '.join(missing)} missing; remove that folder from PXR_PLUGINPATH_NAME"
    )
