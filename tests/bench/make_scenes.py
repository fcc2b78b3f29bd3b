#!/usr/bin/env python3
"""Writes the stages that speed and error are measured on besides the reference scenes, into a folder:

    python tests/bench/make_scenes.py FOLDER [OBJ_FOLDER]
    surflux verify FOLDER/ball.usdc -o ball.html

ball      a smooth ball of 1.05 million triangles with bumps, on a ground, under a white sky
foliage   400 plants of 60 leaves each as instances on a ground, under a white sky
and, where OBJ_FOLDER has stanford-bunny.obj, nefertiti.obj and teapot.obj:
bunny     the scan on a ground, under a sky with four small bright areas
nefertiti the scan alone, under a white sky
teapots   a Cornell box with two teapots, a rect light

Needs numpy and usd-core.
"""
import sys
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt


def stage(path, camera_at, look_at, half_width=0.45):
    made = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(made, "Y")
    UsdGeom.SetStageMetersPerUnit(made, 1.0)
    made.SetDefaultPrim(UsdGeom.Xform.Define(made, "/World").GetPrim())
    camera = UsdGeom.Camera.Define(made, "/World/cam")
    camera.CreateHorizontalApertureAttr(20.0 * half_width)
    camera.CreateVerticalApertureAttr(20.0 * half_width)
    camera.CreateFocalLengthAttr(10.0)
    camera.CreateClippingRangeAttr((0.01, 1000.0))
    view = Gf.Matrix4d().SetLookAt(Gf.Vec3d(*camera_at), Gf.Vec3d(*look_at), Gf.Vec3d(0, 1, 0))
    camera.AddTransformOp().Set(view.GetInverse())
    return made


def material(made, name, color):
    made_material = UsdShade.Material.Define(made, f"/World/Looks/{name}")
    shader = UsdShade.Shader.Define(made, f"/World/Looks/{name}/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*color))
    shader.CreateInput("useSpecularWorkflow", Sdf.ValueTypeNames.Int).Set(1)
    shader.CreateInput("specularColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(0))
    made_material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return made_material


def mesh(made, path, points, faces, look=None, smooth=True):
    """`faces`: (n, 3) or (n, 4) indices, counter-clockwise from outside."""
    points, faces = np.asarray(points, np.float32), np.asarray(faces, np.int32)
    prim = UsdGeom.Mesh.Define(made, path)
    prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    prim.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), faces.shape[1], np.int32)))
    prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.ravel()))
    prim.CreateSubdivisionSchemeAttr("none")
    prim.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)])))
    if smooth:
        normals = np.zeros_like(points, dtype=np.float64)
        corner = points[faces].astype(np.float64)
        across = np.cross(corner[:, 1] - corner[:, 0], corner[:, -1] - corner[:, 0])
        for k in range(faces.shape[1]):
            np.add.at(normals, faces[:, k], across)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        prim.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
        prim.SetNormalsInterpolation("vertex")
    if look:
        UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(look)
    return prim


def quad(made, path, corner, u, v, look, n=1):
    """`n` by `n` quads, normal u × v."""
    corner, u, v = (np.array(x, float) for x in (corner, u, v))
    at = np.array([corner + u * i / n + v * j / n for j in range(n + 1) for i in range(n + 1)])
    faces = [(j * (n + 1) + i, j * (n + 1) + i + 1, (j + 1) * (n + 1) + i + 1, (j + 1) * (n + 1) + i)
             for j in range(n) for i in range(n)]
    return mesh(made, path, at, faces, look)


def cube_sphere(n):
    """Points and quads of a unit ball, 6 n² quads, shared along the cube's edges."""
    points, faces = [], []
    grid = np.linspace(-1.0, 1.0, n + 1)
    for axis in range(3):
        for side in (-1.0, 1.0):
            a, b = np.meshgrid(np.tan(grid * np.pi / 4), np.tan(grid * np.pi / 4), indexing="ij")
            face = np.empty((n + 1, n + 1, 3))
            face[..., axis] = side
            face[..., (axis + 1) % 3], face[..., (axis + 2) % 3] = a, b
            index = len(points) * (n + 1) ** 2 + np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
            four = [index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]]
            faces.append(np.stack(four if side > 0 else four[::-1], -1).reshape(-1, 4))
            points.append(face.reshape(-1, 3))
    points = np.concatenate(points)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    _, first, inverse = np.unique(np.round(points * 1e7).astype(np.int64), axis=0, return_index=True, return_inverse=True)
    return points[first], inverse.ravel()[np.concatenate(faces)]


def bumps(directions):
    """Smooth heights over the unit ball: waves of 3 to 24 around it."""
    random = np.random.default_rng(7)
    height = np.zeros(len(directions))
    for wave, size in ((3, 0.12), (7, 0.05), (13, 0.03), (24, 0.012)):
        for _ in range(4):
            way = random.normal(size=3)
            way /= np.linalg.norm(way)
            height += size / 2 * np.sin(wave * directions @ way + random.uniform(0, 2 * np.pi))
    return height


def ball(folder, n=296):
    made = stage(folder / "ball.usdc", (2.6, 1.6, 2.6), (0, 0.9, 0))
    white = material(made, "white", (0.7, 0.7, 0.7))
    points, faces = cube_sphere(n)
    points = points * (1 + bumps(points))[:, None]
    points[:, 1] -= points[:, 1].min()
    triangles = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    mesh(made, "/World/ball", points, triangles, white)
    quad(made, "/World/ground", (-6, 0, 6), (12, 0, 0), (0, 0, -12), white, 24)
    UsdLux.DomeLight.Define(made, "/World/sky").CreateIntensityAttr(1.0)
    made.Save()


def foliage(folder):
    random = np.random.default_rng(3)
    made = stage(folder / "foliage.usdc", (0, 4, 9), (0, 0.3, 0))
    green, brown = material(made, "green", (0.15, 0.4, 0.1)), material(made, "brown", (0.35, 0.25, 0.15))
    points, faces = [], []
    for leaf in range(60):
        turn, lift = random.uniform(0, 2 * np.pi), random.uniform(0.1, 1.2)
        out = np.array([np.cos(turn) * np.cos(lift), np.sin(lift), np.sin(turn) * np.cos(lift)])
        across = np.array([-np.sin(turn), 0, np.cos(turn)])
        start = np.array([0, random.uniform(0, 0.4), 0])
        for t, width in ((0.05, 0.01), (0.2, 0.05), (0.4, 0.04), (0.55, 0.0)):
            sag = np.array([0, -0.5 * t * t, 0])
            points += [start + out * t + sag - across * width, start + out * t + sag + across * width]
        base = 8 * leaf
        faces += [(base + 2 * k, base + 2 * k + 1, base + 2 * k + 3, base + 2 * k + 2) for k in range(3)]
    field = UsdGeom.PointInstancer.Define(made, "/World/field")
    mesh(made, "/World/field/plant", points, faces, green)
    field.CreatePrototypesRel().AddTarget("/World/field/plant")
    places = np.stack(np.meshgrid(np.arange(20), np.arange(20)), -1).reshape(-1, 2) * 0.35 - 3.4
    places += random.uniform(-0.12, 0.12, places.shape)
    turns = random.uniform(0, 2 * np.pi, len(places))
    field.CreatePositionsAttr([Gf.Vec3f(float(x), 0, float(z)) for x, z in places])
    field.CreateOrientationsAttr([Gf.Quath(float(np.cos(t / 2)), 0, float(np.sin(t / 2)), 0) for t in turns])
    field.CreateScalesAttr([Gf.Vec3f(float(s)) for s in random.uniform(0.7, 1.3, len(places))])
    field.CreateProtoIndicesAttr([0] * len(places))
    quad(made, "/World/ground", (-5, 0, 5), (10, 0, 0), (0, 0, -10), brown, 100)
    UsdLux.DomeLight.Define(made, "/World/sky").CreateIntensityAttr(1.0)
    made.Save()


def read_obj(path):
    points, faces = [], []
    for line in path.read_text().splitlines():
        word, *rest = line.split() or [""]
        if word == "v":
            points.append([float(x) for x in rest[:3]])
        elif word == "f":
            corners = [int(x.split("/")[0]) - 1 for x in rest]
            faces += [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
    return np.array(points), np.array(faces)


def placed(points, height, at=(0, 0, 0), turn=0.0):
    """Upright on `at`, `height` high, turned about Y."""
    low, high = points.min(0), points.max(0)
    points = (points - [(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2]) * (height / (high[1] - low[1]))
    c, s = np.cos(turn), np.sin(turn)
    return points @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) + at


def write_hdr(path, image):
    """Radiance RGBE, uncompressed."""
    largest = image.max(-1)
    exponent = np.where(largest > 1e-30, np.ceil(np.log2(np.maximum(largest, 1e-30))), 0)
    mantissa = np.clip(image / np.exp2(exponent)[..., None] * 256, 0, 255)
    pixels = np.concatenate([mantissa, (exponent + 128)[..., None]], -1).astype(np.uint8)
    pixels[largest <= 1e-30] = 0
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {image.shape[0]} +X {image.shape[1]}\n"
    path.write_bytes(header.encode() + pixels.tobytes())


def sky_with_four_areas(path, width=512):
    """Blue to white with four areas of 2 to 6 degrees, up to 400 times as bright."""
    height = width // 2
    polar, around = np.meshgrid((np.arange(height) + 0.5) / height * np.pi, (np.arange(width) + 0.5) / width * 2 * np.pi,
                                indexing="ij")
    way = np.stack([np.sin(polar) * np.cos(around), np.cos(polar), np.sin(polar) * np.sin(around)], -1)
    up = np.clip(way[..., 1:2], 0, 1)
    image = np.array([0.25, 0.4, 0.7]) * up + np.array([0.5, 0.5, 0.5]) * (1 - up)
    for toward, degrees, radiance in (((1, 1.2, 0.4), 2, (400, 380, 330)), ((-1, 0.7, 0.3), 4, (40, 20, 10)),
                                      ((0.2, 0.6, -1), 6, (15, 20, 30)), ((-0.2, 1.5, 0.9), 3, (80, 80, 80))):
        toward = np.array(toward) / np.linalg.norm(toward)
        image[way @ toward > np.cos(np.radians(degrees))] = radiance
    write_hdr(path, image)


def bunny(folder, source):
    made = stage(folder / "bunny.usdc", (1.6, 1.2, 2.0), (0, 0.5, 0))
    white, gray = material(made, "white", (0.7, 0.7, 0.7)), material(made, "gray", (0.4, 0.4, 0.4))
    points, faces = read_obj(source / "stanford-bunny.obj")
    mesh(made, "/World/bunny", placed(points, 1.2), faces, white)
    quad(made, "/World/ground", (-3, 0, 3), (6, 0, 0), (0, 0, -6), gray, 60)
    sky_with_four_areas(folder / "four_areas.hdr")
    dome = UsdLux.DomeLight.Define(made, "/World/sky")
    dome.CreateIntensityAttr(1.0)
    dome.CreateTextureFileAttr("./four_areas.hdr")
    made.Save()


def nefertiti(folder, source):
    made = stage(folder / "nefertiti.usdc", (1.2, 1.2, 2.0), (0, 0.7, 0))
    points, faces = read_obj(source / "nefertiti.obj")
    if np.ptp(points[:, 2]) > 1.2 * np.ptp(points[:, 1]):
        points = points[:, [0, 2, 1]] * [1, 1, -1]
    mesh(made, "/World/nefertiti", placed(points, 1.5), faces, material(made, "clay", (0.6, 0.5, 0.4)))
    UsdLux.DomeLight.Define(made, "/World/sky").CreateIntensityAttr(1.0)
    made.Save()


def teapots(folder, source):
    made = stage(folder / "teapots.usdc", (0, 1, 3.6), (0, 1, 0), 0.45)
    white, red = material(made, "white", (0.73, 0.73, 0.73)), material(made, "red", (0.63, 0.06, 0.05))
    green = material(made, "green", (0.14, 0.45, 0.09))
    quad(made, "/World/floor", (-1, 0, 1), (2, 0, 0), (0, 0, -2), white, 40)
    quad(made, "/World/ceiling", (-1, 2, -1), (2, 0, 0), (0, 0, 2), white, 40)
    quad(made, "/World/back", (-1, 0, -1), (2, 0, 0), (0, 2, 0), white, 40)
    quad(made, "/World/left", (-1, 0, 1), (0, 0, -2), (0, 2, 0), red, 40)
    quad(made, "/World/right", (1, 0, -1), (0, 0, 2), (0, 2, 0), green, 40)
    points, faces = read_obj(source / "teapot.obj")
    mesh(made, "/World/teapot1", placed(points, 0.5, (-0.4, 0, 0.1), 0.5), faces, white)
    mesh(made, "/World/teapot2", placed(points, 0.6, (0.4, 0, -0.3), 2.2), faces, white)
    light = UsdLux.RectLight.Define(made, "/World/lamp")
    light.CreateWidthAttr(0.5)
    light.CreateHeightAttr(0.5)
    light.CreateIntensityAttr(15.0)
    light.AddTranslateOp().Set((0, 1.99, 0))
    light.AddRotateXOp().Set(-90)
    made.Save()


def main():
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    ball(folder)
    foliage(folder)
    if len(sys.argv) > 2:
        source = Path(sys.argv[2])
        bunny(folder, source)
        nefertiti(folder, source)
        teapots(folder, source)
    print("\n".join(sorted(str(path) for path in folder.iterdir())))


if __name__ == "__main__":
    main()
