"""Author the attributes of one schema of ours."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, Vt

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.prims.applied import fits


def write_schema(
    prim: Usd.Prim, schema: str, values: Mapping[str, Any], folder: str | Path | None = None
) -> None:
    """Apply a single-apply schema to a prim and author its values, fallbacks too.

    A published layer also speaks to readers that do not know the schema and its fallbacks.

    Args:
        prim: Prim to write to, at the stage's edit target.
        schema: Identifier of the schema.
        values: Values by attribute name, None where there is to be no opinion.
        folder: Folder the layer is going to be written to, from which files are named. By default
            that of the edited layer; without either, relative paths are authored as they are.

    Raises:
        LayerError: The schema does not fit the prim, or the file of a layer in memory has an
            absolute path.
    """
    if not fits(prim, schema):
        raise LayerError(
            f"{describe(prim)}: {schema} does not fit a {prim.GetTypeName() or 'untyped prim'}"
        )
    prim.ApplyAPI(schema)
    layer = prim.GetStage().GetEditTarget().GetLayer()
    if folder is None and layer.realPath:
        folder = Path(layer.realPath).parent
    for name, value in values.items():
        if isinstance(value, Path):
            prim.GetAttribute(name).Set(Sdf.AssetPath(_relative(prim, value, folder)))
        elif isinstance(value, list) and value and isinstance(value[0], Path):
            files = [_relative(prim, file, folder) for file in value]
            prim.GetAttribute(name).Set(Sdf.AssetPathArray(files))
        elif isinstance(value, np.ndarray):
            array = np.ravel(value).astype(np.float64)
            prim.GetAttribute(name).Set(Vt.DoubleArray.FromNumpy(array))
        elif value is not None:
            prim.GetAttribute(name).Set(value)


def _relative(prim: Usd.Prim, file: Path, folder: str | Path | None) -> str:
    if folder is not None:
        file = Path(os.path.relpath(file, folder))
    elif file.is_absolute():
        raise LayerError(
            f"{describe(prim)}: {file} is an absolute path in a layer without a folder; say which "
            "folder the layer is going to be written to"
        )
    # Without the dots USD would look for the file on its search path too.
    return file.as_posix() if file.parts[:1] == ("..",) else f"./{file.as_posix()}"
