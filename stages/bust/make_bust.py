"""Make the bust: ``python stages/bust/make_bust.py``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from usdskin.layers import write_layer

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom, Vt

FOLDER = Path(__file__).resolve().parent


def main() -> None:
    sys.path.insert(0, str(FOLDER.parents[1] / "benchmarks"))
    from head import head

    points, _, faces = head(32)
    points = points * 0.135 + (0.0, 1.60, 0.05)
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetMetadata("documentation", "A bust.")
    root = UsdGeom.Xform.Define(stage, "/Bust")
    stage.SetDefaultPrim(root.GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, "/Bust/mesh")
    mesh.CreatePointsAttr(Vt.Vec3fArray([Gf.Vec3f(*np.round(p, 5).tolist()) for p in points]))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(faces)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray(faces.ravel().tolist()))
    mesh.CreateExtentAttr([Gf.Vec3f(*points.min(0).tolist()), Gf.Vec3f(*points.max(0).tolist())])
    mesh.CreateSubdivisionSchemeAttr("none")
    write_layer(stage, FOLDER / "bust.usda")


if __name__ == "__main__":
    main()
