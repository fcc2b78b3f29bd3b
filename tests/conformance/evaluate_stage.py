"""What Pixar's usd-core computes of a stage: the truth that tests/conformance compares scenes with.

One JSON request a line on stdin, {"path", "time", "arrays", "unloaded", "variants", "session", "muted"}; one JSON answer a line on stdout. Arrays lie in the file
`arrays` as little-endian doubles; an answer names them as [offset in doubles, count]. Written without a look at
surflux's own worker, from the computing API of the schemas (ComputeVisibility, ComputeBoundMaterial, …).
"""

import json
import math
import os
import sys

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdRender, UsdShade, UsdSkel, Vt

PRIMVARS = ("displayColor", "displayOpacity", "st")
PURPOSES = ("default", "render")


class Arrays:
    def __init__(self, path):
        self.file = open(path, "wb")
        self.used = 0

    def add(self, values):
        flat = np.asarray(values, dtype="<f8").reshape(-1)
        self.file.write(flat.tobytes())
        self.used += flat.size
        return [self.used - flat.size, flat.size]


def numbers(values):
    return [float(x) if math.isfinite(x) else repr(float(x)) for x in values]


def matrix(m):
    return numbers(m[r][c] for r in range(4) for c in range(4))


def limit_points(counts, indices, points, sharp):
    """Catmull-Clark limits of points inside the surface with nothing but quads around them, and which points those
    are: (n^2 p + 4 sum of neighbours + sum of opposite corners) / n(n+5)."""
    n = len(points)
    starts = np.concatenate(([0], np.cumsum(counts)))[:-1]
    face = np.repeat(np.arange(len(counts)), counts)
    at = np.arange(len(indices)) - starts[face]
    following = indices[starts[face] + (at + 1) % counts[face]]
    edges = np.sort(np.stack([indices, following], axis=1), axis=1)
    edges, uses = np.unique(edges, axis=0, return_counts=True)
    quads = counts[face] == 4
    good = np.ones(n, dtype=bool)
    good[indices[~quads]] = False
    good[edges[uses != 2].reshape(-1)] = False
    good[np.asarray(sharp, dtype=int)] = False
    valence = np.bincount(edges.reshape(-1), minlength=n)
    good &= (valence == np.bincount(indices, minlength=n)) & (valence > 2)
    around, across = np.zeros((n, 3)), np.zeros((n, 3))
    np.add.at(around, edges[:, 0], points[edges[:, 1]])
    np.add.at(around, edges[:, 1], points[edges[:, 0]])
    opposite = indices[(starts[face] + (at + 2) % np.maximum(counts[face], 1))[quads]]
    np.add.at(across, indices[quads], points[opposite])
    v = valence[good][:, None].astype(float)
    limits = (v * v * points[good] + 4.0 * around[good] + across[good]) / (v * (v + 5.0))
    return np.flatnonzero(good), limits


class Evaluation:
    def __init__(self, stage, time, arrays):
        self.stage = stage
        self.time = time
        self.arrays = arrays
        self.xforms = UsdGeom.XformCache(time)
        self.drawn, self.lights, self.cameras = [], [], []

    def run(self):
        walk = iter(Usd.PrimRange.Stage(self.stage, Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)))
        for prim in walk:
            imageable = UsdGeom.Imageable(prim)
            if prim.IsA(UsdGeom.Camera):
                self.cameras.append(self.camera(prim))
            if not imageable:
                continue
            shown = imageable.ComputeVisibility(self.time) != "invisible"
            purpose = str(imageable.ComputePurpose())
            shown = shown and purpose in PURPOSES
            if self.is_light(prim) and shown:
                self.lights.append(self.light(prim))
            if prim.IsA(UsdGeom.PointInstancer):
                if shown:
                    place = self.xforms.GetLocalToWorldTransform(prim)
                    self.points(prim, place, str(prim.GetPath()), purpose)
                walk.PruneChildren()
            elif prim.IsA(UsdGeom.Gprim) and shown:
                place = self.xforms.GetLocalToWorldTransform(prim)
                self.drawn.append(self.gprim(prim, place, str(prim.GetPath()), purpose))
        return {"drawn": self.drawn, "lights": self.lights, "cameras": self.cameras, "settings": self.settings()}

    def points(self, prim, world, name, purpose):
        """Every unmasked point: each gprim below its prototype, placed."""
        instancer = UsdGeom.PointInstancer(prim)
        roots = [self.stage.GetPrimAtPath(path) for path in instancer.GetPrototypesRel().GetForwardedTargets()]
        include, ignore = UsdGeom.PointInstancer.IncludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
        places = instancer.ComputeInstanceTransformsAtTime(self.time, self.time, include, ignore)
        mask = instancer.ComputeMaskAtTime(self.time)
        chosen = instancer.GetProtoIndicesAttr().Get(self.time) or []
        for index, (place, which) in enumerate(zip(places, chosen)):
            if (mask and not mask[index]) or not 0 <= which < len(roots) or not roots[which]:
                continue
            self.prototype(roots[which], Gf.Matrix4d(place) * world, "%s[%d]" % (name, index), purpose)

    def prototype(self, root, place, name, outer):
        walk = iter(Usd.PrimRange(root, Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)))
        for prim in walk:
            line = [prim]
            while line[-1] != root:
                line.append(line[-1].GetParent())
            imageables = [UsdGeom.Imageable(item) for item in line if UsdGeom.Imageable(item)]
            hidden = any(item.GetVisibilityAttr().Get(self.time) == "invisible" for item in imageables)
            own = [item.GetPurposeAttr() for item in imageables if item.GetPurposeAttr().HasAuthoredValue()]
            purpose = str(own[0].Get()) if own else outer
            suffix = str(prim.GetPath())[len(str(root.GetPath().GetParentPath()).rstrip("/")) :]
            relative = self.xforms.ComputeRelativeTransform(prim, root)[0]
            is_instancer = prim.IsA(UsdGeom.PointInstancer)
            if not hidden and is_instancer:
                self.points(prim, relative * place, name + suffix, purpose)
            elif not hidden and prim.IsA(UsdGeom.Gprim) and purpose in PURPOSES:
                self.drawn.append(self.gprim(prim, relative * place, name + suffix, purpose))
            if is_instancer:
                walk.PruneChildren()

    def gprim(self, prim, place, name, purpose):
        entry = {"path": name, "type": str(prim.GetTypeName()), "matrix": matrix(place), "purpose": purpose}
        entry["material"], entry["dangling"] = self.bound(prim)
        if prim.IsA(UsdGeom.Mesh):
            self.mesh(UsdGeom.Mesh(prim), np.array(place), entry)
        elif prim.IsA(UsdGeom.PointBased):
            self.hull(UsdGeom.PointBased(prim), place, entry)
        else:
            entry["matrix"] = matrix(self.moved_whole(prim, place))
            extent = UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(prim), self.time)
            entry["extent"] = numbers(np.array(extent, dtype=float).reshape(-1)) if extent else None
        return entry

    def hull(self, prim, place, entry):
        """Curves, patches and points: a box around their control points and half their largest width, which they are within."""
        points = np.array(prim.GetPointsAttr().Get(self.time) or [], dtype=float).reshape(-1, 3)
        entry["empty"] = not len(points)
        if entry["empty"]:
            return
        points, place = self.posed(prim, points, np.array(place))
        entry["matrix"] = matrix(place)
        widths = prim.GetPrim().GetAttribute("widths")
        is_thick = prim.GetPrim().IsA(UsdGeom.Curves) or prim.GetPrim().IsA(UsdGeom.Points)
        widths = (widths.Get(self.time) if widths else None) or [1.0 if is_thick else 0.0]
        reach = max(widths) / 2
        entry["hull"] = numbers([*(points.min(axis=0) - reach), *(points.max(axis=0) + reach)])

    def bound(self, prim):
        """Path of the bound material (and in its prototype, if it is below an instance), and that of a binding whose target is no material here."""
        api = UsdShade.MaterialBindingAPI(prim)
        material, relationship = api.ComputeBoundMaterial("full")
        if material:
            path = material.GetPath()
            shared = material.GetPrim().GetPrimInPrototype() if material.GetPrim().IsInstanceProxy() else None
            return [str(path), str(shared.GetPath()) if shared else None], None
        at = prim
        while at and not at.IsPseudoRoot():
            for name in ("material:binding:full", "material:binding"):
                targets = at.GetRelationship(name).GetTargets() if at.HasRelationship(name) else []
                if targets:
                    return None, str(targets[0])
            at = at.GetParent()
        return None, None

    def mesh(self, mesh, place, entry):
        def get(attribute, kind):
            value = attribute.Get(self.time)
            return np.array(value if value is not None else [], dtype=kind)

        counts = get(mesh.GetFaceVertexCountsAttr(), int)
        indices = get(mesh.GetFaceVertexIndicesAttr(), int)
        points = get(mesh.GetPointsAttr(), float).reshape(-1, 3)
        scheme = str(mesh.GetSubdivisionSchemeAttr().Get(self.time))
        entry["empty"] = not (len(points) and len(indices))
        valid = counts.sum() == len(indices) and (not len(indices) or 0 <= indices.min() <= indices.max() < len(points))
        if entry["empty"] or not valid:
            return
        unposed = place
        points, place = self.posed(mesh, points, place)
        moved = lambda p: p @ place[:3, :3] + place[3, :3]
        entry["scheme"] = scheme
        entry["double_sided"] = bool(mesh.GetDoubleSidedAttr().Get(self.time))
        entry["counts"] = self.arrays.add(counts)
        entry["indices"] = self.arrays.add(indices)
        entry["holes"] = self.arrays.add(get(mesh.GetHoleIndicesAttr(), int))
        if scheme == "none":
            which, limits = np.arange(len(points)), points
        elif scheme == "catmullClark":
            sharp = [*get(mesh.GetCornerIndicesAttr(), int), *get(mesh.GetCreaseIndicesAttr(), int)]
            which, limits = limit_points(counts, indices, points, sharp)
        else:
            which, limits = np.arange(0), points[:0]
        entry["which"] = self.arrays.add(which)
        entry["points"] = self.arrays.add(moved(limits))
        entry["primvars"] = self.primvars(mesh.GetPrim())
        entry["normals"] = self.normals(mesh, unposed, indices) if scheme == "none" else None
        entry["subsets"] = []
        for subset in UsdShade.MaterialBindingAPI(mesh.GetPrim()).GetMaterialBindSubsets():
            faces = get(subset.GetIndicesAttr(), int)
            entry["subsets"].append([*self.bound(subset.GetPrim()), self.arrays.add(faces)])

    def skinning(self, prim):
        """What deforms `prim`: its query and the skeleton's; None where nothing does."""
        root = UsdSkel.Root.Find(prim)
        if not root:
            return None
        cache, everything = UsdSkel.Cache(), Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
        cache.Populate(root, everything)
        for binding in cache.ComputeSkelBindings(root, everything):
            for target in binding.GetSkinningTargets():
                if target.GetPrim() == prim:
                    return cache, target, cache.GetSkelQuery(binding.GetSkeleton())
        return None

    def posed(self, gprim, points, place):
        """Points as their skeleton deforms them, and the matrix that then takes them to the world."""
        prim = gprim.GetPrim()
        found = self.skinning(prim)
        if not found:
            return points, place
        _, skinning, query = found
        if skinning.HasBlendShapes() and query.GetAnimQuery():
            points = self.blended(UsdSkel.BindingAPI(prim), self.shape_weights(skinning, query), points)
        if not skinning.HasJointInfluences():
            return points, place
        joints = query.ComputeSkinningTransforms(self.time)
        vectors = Vt.Vec3fArray.FromNumpy(points.astype(np.float32))
        if joints and skinning.IsRigidlyDeformed():
            matrix = np.array(skinning.ComputeSkinnedTransform(joints, self.time))
            points = points @ matrix[:3, :3] + matrix[3, :3]
        elif not joints or not skinning.ComputeSkinnedPoints(joints, vectors, self.time):
            return points, place
        else:
            points = np.array(vectors, dtype=float)
        return points, np.array(self.xforms.GetLocalToWorldTransform(query.GetPrim()))

    def shape_weights(self, skinning, query):
        weights = query.GetAnimQuery().ComputeBlendShapeWeights(self.time)
        mapper = skinning.GetBlendShapeMapper()
        return mapper.Remap(weights) if mapper else weights

    def shapes_of_normals(self, prim):
        """The binding of `prim` in a copy of its stage where what shapes do to normals is what they do to points: usd-core's
        Python blends points only."""
        copy = self.stage_of_normals = Usd.Stage.Open(prim.GetStage().Flatten())  # prims do not keep it
        binding = UsdSkel.BindingAPI(copy.GetPrimAtPath(prim.GetPath()))
        for path in binding.GetBlendShapeTargetsRel().GetTargets():
            shape = UsdSkel.BlendShape(copy.GetPrimAtPath(path))
            steps = [(shape.GetOffsetsAttr(), shape.GetNormalOffsetsAttr())]
            steps += [(step.GetAttr(), step.GetNormalOffsetsAttr()) for step in shape.GetInbetweens()]
            for of_points, of_normals in steps:
                own = of_normals.Get() if of_normals else None
                of_points.Set(own or [Gf.Vec3f(0)] * len(of_points.Get()))
        return binding

    def moved_whole(self, prim, place):
        """The matrix of a gprim without points that a skeleton moves."""
        found = self.skinning(prim)
        if not found or not found[1].HasJointInfluences():
            return place
        _, skinning, query = found
        joints = query.ComputeSkinningTransforms(self.time)
        skinned = skinning.ComputeSkinnedTransform(joints, self.time)
        return Gf.Matrix4d(skinned) * self.xforms.GetLocalToWorldTransform(query.GetPrim())

    def normals(self, mesh, place, indices):
        """World normals as authored, or as the skeleton turns them, and what there is one for; None without any."""
        prim = mesh.GetPrim()
        primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
        if primvar and primvar.HasAuthoredValue():
            values, interpolation = primvar.ComputeFlattened(self.time), primvar.GetInterpolation()
        else:
            values, interpolation = mesh.GetNormalsAttr().Get(self.time), mesh.GetNormalsInterpolation()
        if not values or abs(np.linalg.det(place[:3, :3])) < 1e-30:
            return None
        normals = np.array(values, dtype=float)
        found = self.skinning(prim)
        if found and found[1].HasBlendShapes() and found[2].GetAnimQuery() and interpolation in ("vertex", "varying"):
            normals = self.blended(self.shapes_of_normals(prim), self.shape_weights(*found[1:]), normals)
        if found and found[1].HasJointInfluences():
            if interpolation not in ("vertex", "varying", "faceVarying"):
                return None
            _, skinning, query = found
            normals = self.turned(skinning, query, normals, indices if interpolation == "faceVarying" else None)
            place = np.array(self.xforms.GetLocalToWorldTransform(query.GetPrim()))
        normals = normals @ np.linalg.inv(place[:3, :3]).T
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        return [str(interpolation), self.arrays.add(normals / np.where(lengths > 0, lengths, 1))]

    def turned(self, skinning, query, normals, corners):
        joints = query.ComputeSkinningTransforms(self.time)
        if skinning.GetJointMapper():
            known = dict(zip(query.GetJointOrder(), joints))
            joints = [known.get(name, Gf.Matrix4d(1)) for name in skinning.GetJointOrder()]
        count = len(normals) if corners is None else int(corners.max()) + 1
        which, weights = skinning.ComputeVaryingJointInfluences(count, self.time)
        width = len(which) // count
        which, weights = np.array(which).reshape(count, width), np.array(weights).reshape(count, width)
        if corners is not None:
            which, weights = which[corners], weights[corners]
        inverse = lambda m: m.GetTranspose().GetInverse()
        linear = lambda m: Gf.Matrix3d(*[m[r][c] for r in range(3) for c in range(3)])
        values = Vt.Vec3fArray.FromNumpy(normals.astype(np.float32))
        UsdSkel.SkinNormals(
            skinning.GetSkinningMethod(),
            inverse(linear(skinning.GetGeomBindTransform(self.time))),
            Vt.Matrix3dArray([inverse(linear(joint)) for joint in joints]),
            Vt.IntArray.FromNumpy(which.reshape(-1).astype(np.int32)),
            Vt.FloatArray.FromNumpy(weights.reshape(-1).astype(np.float32)),
            width,
            values,
        )
        return np.array(values, dtype=float)

    @staticmethod
    def blended(binding, weights, points):
        points = points.copy()
        shapes = UsdSkel.BlendShapeQuery(binding)
        weights, shape_ids, sub_ids = shapes.ComputeSubShapeWeights(weights)
        vectors = Vt.Vec3fArray.FromNumpy(points.astype(np.float32))
        offsets, indices = shapes.ComputeSubShapePointOffsets(), shapes.ComputeBlendShapePointIndices()
        shapes.ComputeDeformedPoints(weights, shape_ids, sub_ids, indices, offsets, vectors)
        return np.array(vectors, dtype=float)

    def primvars(self, prim):
        found = {}
        for name in PRIMVARS:
            primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
            values = primvar.ComputeFlattened(self.time) if primvar and primvar.HasValue() else None
            if values is None:
                continue
            values = np.array(values, dtype=float)
            width = values.shape[1] if values.ndim == 2 else 1
            found[name] = [str(primvar.GetInterpolation()), width, self.arrays.add(values)]
        return found

    @staticmethod
    def is_light(prim):
        return prim.HasAPI(UsdLux.LightAPI) or prim.IsA(UsdLux.BoundableLightBase) or prim.IsA(UsdLux.NonboundableLightBase)

    def light(self, prim):
        light = UsdLux.LightAPI(prim)
        value = lambda attribute: attribute.Get(self.time)

        def own(name, default=None):
            attribute = prim.GetAttribute("inputs:" + name)
            found = attribute.Get(self.time) if attribute else None
            return default if found is None else found

        color = np.array(value(light.GetColorAttr()), dtype=float)
        if value(light.GetEnableColorTemperatureAttr()):
            color *= np.array(UsdLux.BlackbodyTemperatureAsRgb(value(light.GetColorTemperatureAttr())))
        strength = value(light.GetIntensityAttr()) * 2.0 ** value(light.GetExposureAttr()) * value(light.GetDiffuseAttr())
        texture = own("texture:file")
        shaping = None
        if prim.HasAPI(UsdLux.ShapingAPI):
            api = UsdLux.ShapingAPI(prim)
            shaping = [math.radians(value(api.GetShapingConeAngleAttr())), value(api.GetShapingConeSoftnessAttr())]
            shaping += [value(api.GetShapingFocusAttr()), *value(api.GetShapingFocusTintAttr())]
        shadow = UsdLux.ShadowAPI(prim)
        plain = ("intensity", "exposure", "color", "radius", "normalize", "angle")
        return {
            "path": str(prim.GetPath()),
            "type": str(prim.GetTypeName()),
            "matrix": matrix(self.xforms.GetLocalToWorldTransform(prim)),
            "radiance": numbers(color * strength),
            "normalize": bool(value(light.GetNormalizeAttr())),
            "shape": {name: float(own(name, 0.0)) for name in ("angle", "radius", "width", "height", "length")},
            "texture": os.path.realpath(texture.resolvedPath) if texture and texture.resolvedPath else None,
            "shaping": shaping and numbers(shaping),
            "shadows": bool(value(shadow.GetShadowEnableAttr())) if prim.HasAPI(UsdLux.ShadowAPI) else True,
            "unlinked": {name: self.unlinked(prim, name) for name in ("lightLink", "shadowLink")},
            "dome": self.dome(prim) if "Dome" in prim.GetTypeName() else None,
            "mesh": self.mesh_light(prim) if prim.IsA(UsdGeom.Mesh) else None,
            "old": any(prim.GetAttribute(name).HasAuthoredValue() for name in plain if prim.HasAttribute(name)),
        }

    def dome(self, prim):
        """Matrix of the image, whose pole is +Y and whose middle is at +Z, and the format."""
        world = self.xforms.GetLocalToWorldTransform(prim)
        if prim.IsA(UsdLux.DomeLight_1):
            pole = UsdLux.DomeLight_1(prim).GetPoleAxisAttr().Get(self.time)
            if (str(UsdGeom.GetStageUpAxis(self.stage)) if pole == "scene" else pole) == "Z":
                world = Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(1, 0, 0), 90)) * world
        world.SetTranslateOnly((0, 0, 0))
        return matrix(world)

    def mesh_light(self, prim):
        """World area of the polygons, and how the material takes part."""
        mesh = UsdGeom.Mesh(prim)
        place = np.array(self.xforms.GetLocalToWorldTransform(prim))
        points = np.array(mesh.GetPointsAttr().Get(self.time), dtype=float) @ place[:3, :3]
        indices, at, area = mesh.GetFaceVertexIndicesAttr().Get(self.time), 0, 0.0
        for count in mesh.GetFaceVertexCountsAttr().Get(self.time):
            face = points[list(indices[at : at + count])]
            area += 0.5 * np.linalg.norm(np.cross(face[1:-1] - face[0], face[2:] - face[0]), axis=1).sum()
            at += count
        return {"area": float(area), "sync": str(prim.GetAttribute("light:materialSyncMode").Get(self.time))}

    def unlinked(self, prim, name):
        """Paths of the gprims that the collection does not hold."""
        query = Usd.CollectionAPI(prim, name).ComputeMembershipQuery()
        if query.GetAsPathExpansionRuleMap() == {Sdf.Path.absoluteRootPath: Usd.Tokens.expandPrims}:
            return []
        everything = Usd.PrimRange.Stage(self.stage, Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate))
        gprims = (prim.GetPath() for prim in everything if prim.IsA(UsdGeom.Gprim))
        return [str(path) for path in gprims if not query.IsPathIncluded(path)]

    def camera(self, prim):
        camera = UsdGeom.Camera(prim)
        gf = camera.GetCamera(self.time)
        near_far = gf.clippingRange
        return {
            "path": str(prim.GetPath()),
            "matrix": matrix(self.xforms.GetLocalToWorldTransform(prim)),
            "projection": str(camera.GetProjectionAttr().Get(self.time)),
            "lens": numbers(
                [
                    gf.horizontalAperture,
                    gf.verticalAperture,
                    gf.horizontalApertureOffset,
                    gf.verticalApertureOffset,
                    gf.focalLength,
                    near_far.min,
                    near_far.max,
                    camera.GetExposureAttr().Get(self.time),
                ]
            ),
        }

    def settings(self):
        found = []
        for prim in self.stage.Traverse():
            if prim.IsA(UsdRender.Settings):
                settings = UsdRender.Settings(prim)
                cameras = settings.GetCameraRel().GetForwardedTargets()
                size = settings.GetResolutionAttr().Get()
                camera = str(cameras[0]) if cameras else None
                entry = {"path": str(prim.GetPath()), "camera": camera, "resolution": list(size)}
                entry["products"] = self.products(settings)
                found.append(entry)
        return found


    def products(self, settings):
        found = []
        for path in settings.GetProductsRel().GetForwardedTargets():
            product = UsdRender.Product(self.stage.GetPrimAtPath(path))

            def value(get):
                own, shared = get(product), get(settings)
                return (own if own.HasAuthoredValue() else shared).Get()

            cameras = product.GetCameraRel().GetForwardedTargets() or settings.GetCameraRel().GetForwardedTargets()
            rendered = [UsdRender.Var(self.stage.GetPrimAtPath(var)) for var in product.GetOrderedVarsRel().GetForwardedTargets()]
            kinds = [(var.GetSourceNameAttr(), var.GetSourceTypeAttr(), var.GetDataTypeAttr()) for var in rendered]
            found.append(
                {
                    "path": str(path),
                    "name": str(product.GetProductNameAttr().Get()),
                    "type": str(product.GetProductTypeAttr().Get()),
                    "camera": str(cameras[0]) if cameras else None,
                    "resolution": list(value(lambda base: base.GetResolutionAttr())),
                    "policy": str(value(lambda base: base.GetAspectRatioConformPolicyAttr())),
                    "window": numbers(value(lambda base: base.GetDataWindowNDCAttr())),
                    "vars": [[str(attribute.Get()) for attribute in kind] for kind in kinds],
                }
            )
        return found


def opened(request):
    load = Usd.Stage.LoadNone if request["unloaded"] else Usd.Stage.LoadAll
    root, session = Sdf.Layer.FindOrOpen(request["path"]), request["session"]
    session = Sdf.Layer.FindOrOpen(session) if session else Sdf.Layer.CreateAnonymous()
    stage = Usd.Stage.Open(root, session, load)
    for layer in request["muted"]:
        stage.MuteLayer(layer)
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for prim, name, choice in request["variants"]:
            stage.OverridePrim(prim).GetVariantSet(name).SetVariantSelection(choice)
    return stage


def answer(request):
    stage = opened(request)
    time = Usd.TimeCode.Default() if request["time"] is None else Usd.TimeCode(request["time"])
    arrays = Arrays(request["arrays"])
    result = Evaluation(stage, time, arrays).run()
    arrays.file.close()
    result["range"] = [stage.GetStartTimeCode(), stage.GetEndTimeCode()] if stage.HasAuthoredTimeCodeRange() else None
    result["up"] = str(UsdGeom.GetStageUpAxis(stage))
    result["layers"] = [layer.realPath for layer in stage.GetUsedLayers() if layer.realPath]
    result["default"] = str(stage.GetRootLayer().defaultPrim) or None
    result["meters"] = float(UsdGeom.GetStageMetersPerUnit(stage))
    return result


for line in sys.stdin:
    try:
        print(json.dumps(answer(json.loads(line))), flush=True)
    except (Tf.ErrorException, RuntimeError) as error:
        print(json.dumps({"error": str(error)}), flush=True)
