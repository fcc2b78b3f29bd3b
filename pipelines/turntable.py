"""A stage that turns an asset before a camera: turntable.py ASSET OUT.usda [FRAMES]

Writes a small layer over ASSET: a camera that goes round it once in FRAMES frames (24), as far away as it takes to see all
of it, and a dome light if the asset has no light. Needs usd-core.
"""

import math
import os
import sys

from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

FOCAL, APERTURE = 50.0, 36.0
ELEVATION = math.radians(20)


def main(asset, out, frames=24):
    layer = Sdf.Layer.CreateNew(out)
    layer.subLayerPaths.append(os.path.relpath(asset, os.path.dirname(os.path.abspath(out))))
    stage = Usd.Stage.Open(layer)
    source = Usd.Stage.Open(asset)
    up = UsdGeom.GetStageUpAxis(source)
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(source))
    if source.HasDefaultPrim():
        stage.SetMetadata("defaultPrim", source.GetDefaultPrim().GetName())
    purposes = [UsdGeom.Tokens.default_, UsdGeom.Tokens.render]
    bounds = UsdGeom.BBoxCache(Usd.TimeCode.Default(), purposes).ComputeWorldBound(source.GetPseudoRoot())
    box = bounds.ComputeAlignedRange()
    if box.IsEmpty():
        sys.exit(f"{asset}: nothing to see")
    center, radius = box.GetMidpoint(), 0.5 * box.GetSize().GetLength()
    distance = 1.05 * radius / math.sin(math.atan(0.5 * APERTURE / FOCAL))
    camera = UsdGeom.Camera.Define(stage, "/turntable/camera")
    camera.CreateFocalLengthAttr(FOCAL)
    camera.CreateHorizontalApertureAttr(APERTURE)
    camera.CreateVerticalApertureAttr(APERTURE)
    camera.CreateClippingRangeAttr(Gf.Vec2f(max(distance - 2 * radius, 1e-3 * radius), distance + 2 * radius))
    transform = camera.AddTransformOp()
    axis = Gf.Vec3d(0, 0, 1) if up == UsdGeom.Tokens.z else Gf.Vec3d(0, 1, 0)
    side, front = (Gf.Vec3d(1, 0, 0), Gf.Vec3d(0, -1, 0)) if up == UsdGeom.Tokens.z else (Gf.Vec3d(1, 0, 0), Gf.Vec3d(0, 0, 1))
    for frame in range(1, frames + 1):
        angle = 2 * math.pi * (frame - 1) / frames
        level = side * math.sin(angle) + front * math.cos(angle)
        eye = center + distance * (math.cos(ELEVATION) * level + math.sin(ELEVATION) * axis)
        transform.Set(Gf.Matrix4d(1).SetLookAt(eye, center, axis).GetInverse(), frame)
    if not any(prim.HasAPI(UsdLux.LightAPI) for prim in source.Traverse()):
        UsdLux.DomeLight.Define(stage, "/turntable/sky").CreateIntensityAttr(1)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(frames)
    layer.Save()


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:]))
