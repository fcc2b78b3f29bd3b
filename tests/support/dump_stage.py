"""Dump stages as Pixar's usd-core sees them: the truth tests/native_door.rs compares the native reader with.

Reads a JSON list of {"path", "time", "mask"} from stdin; writes one JSON object a line to stdout, in that order.
Written without a look at the reader: a plain traversal with the public API.
"""

import json
import math
import os
import sys

import numpy as np
from pxr import Gf, Sdf, Tf, Usd

AUTHORED = (Usd.ResolveInfoSourceDefault, Usd.ResolveInfoSourceTimeSamples, Usd.ResolveInfoSourceValueClips)


def number(x):
    x = float(x)
    return x if math.isfinite(x) else repr(x)


def array(values, width):
    """Length and two sums: order matters to the second."""
    flat = np.asarray(values, dtype=np.float64).reshape(-1)
    weights = 1.0 + np.arange(flat.size) % 97
    return {
        "count": len(values),
        "width": width,
        "sum": number(flat.sum()),
        "weighted": number((flat * weights).sum()),
        "size": number(np.abs(flat).sum()),
    }


def quaternion(q):
    return [*map(number, q.imaginary), number(q.real)]


def encode(value):
    if value is None:
        return None
    if isinstance(value, (bool, int)):
        return {"number": int(value)}
    if isinstance(value, float):
        return {"number": number(value)}
    if isinstance(value, Sdf.TimeCode):
        return {"number": number(value.GetValue())}
    if isinstance(value, str):
        return {"text": value}
    if isinstance(value, Sdf.PathExpression):
        return {"text": value.GetText()}
    if isinstance(value, Sdf.AssetPath):
        resolved = os.path.realpath(value.resolvedPath) if value.resolvedPath else ""
        return {"asset": [value.path, resolved]}
    if isinstance(value, (Gf.Quath, Gf.Quatf, Gf.Quatd)):
        return {"numbers": quaternion(value)}
    if isinstance(value, Gf.Matrix4d):
        return {"numbers": [number(value[r][c]) for r in range(4) for c in range(4)]}
    kind = type(value).__name__
    if kind.startswith("Vec") and not kind.endswith("Array"):
        return {"numbers": [number(x) for x in value]}
    if kind in ("TokenArray", "StringArray"):
        return {"texts": list(value)}
    if kind in ("AssetArray", "AssetPathArray"):
        return {"texts": [asset.path for asset in value]}
    if kind.startswith("Quat"):
        return {"array": array([quaternion(q) for q in value], 4)}
    if kind == "Matrix4dArray":
        return {"array": array([[m[r][c] for r in range(4) for c in range(4)] for m in value], 16)}
    if kind.endswith("Array"):
        values = np.asarray(value)
        if kind.startswith(("Double", "Vec2d", "Vec3d", "Vec4d")):
            values = values.astype(np.float32)
        return {"array": array(values, 1 if values.ndim == 1 else values.shape[1])}
    return {"other": kind}


def metadata(thing, key):
    return thing.GetMetadata(key) if thing.HasAuthoredMetadata(key) else None


def attribute(attr, time):
    source = attr.GetResolveInfo(time).GetSource()
    value = attr.Get(time) if source in AUTHORED else None
    return {
        "type": str(attr.GetTypeName()),
        "value": encode(value) if value is not None else None,
        "interpolation": metadata(attr, "interpolation"),
        "elementSize": metadata(attr, "elementSize"),
        "colorSpace": metadata(attr, "colorSpace"),
        "connections": [str(path) for path in attr.GetConnections()],
        "varying": attr.ValueMightBeTimeVarying() or (value is None and attr.GetNumTimeSamples() > 0),
    }


def dump_prim(prim, parent, time):
    relationships = {
        rel.GetName(): {
            "targets": [str(path) for path in rel.GetTargets()],
            "bindMaterialAs": metadata(rel, "bindMaterialAs"),
        }
        for rel in prim.GetAuthoredRelationships()
    }
    return {
        "path": str(prim.GetPath()),
        "type": str(prim.GetTypeName()),
        "parent": parent,
        "apiSchemas": [str(name) for name in prim.GetPrimTypeInfo().GetAppliedAPISchemas()],
        "prototype": str(prim.GetPrototype().GetPath()) if prim.IsInstance() else None,
        "kind": metadata(prim, "kind"),
        "attributes": {attr.GetName(): attribute(attr, time) for attr in prim.GetAuthoredAttributes()},
        "relationships": relationships,
    }


def walk(root, time, prims, prototypes):
    for prim in Usd.PrimRange(root):
        if prim.IsPseudoRoot():
            continue
        parent = prim.GetParent()
        named = None if parent.IsPseudoRoot() or prim.IsPrototype() else str(parent.GetPath())
        prims.append(dump_prim(prim, named, time))
        if prim.IsInstance() and prim.GetPrototype() not in prototypes:
            prototypes.append(prim.GetPrototype())


def dump(request):
    root = request["path"]
    mask = request["mask"]
    if mask:
        stage = Usd.Stage.OpenMasked(root, Usd.StagePopulationMask(mask))
    else:
        stage = Usd.Stage.Open(root)
    time = Usd.TimeCode.Default() if request["time"] is None else Usd.TimeCode(request["time"])
    prims, prototypes = [], []
    walk(stage.GetPseudoRoot(), time, prims, prototypes)
    prototype_start = len(prims)
    done = 0
    while done < len(prototypes):
        walk(prototypes[done], time, prims, prototypes)
        done += 1

    def authored(key):
        return stage.GetMetadata(key) if stage.HasAuthoredMetadata(key) else None

    return {
        "upAxis": authored("upAxis"),
        "metersPerUnit": authored("metersPerUnit"),
        "defaultPrim": authored("defaultPrim"),
        "startTimeCode": authored("startTimeCode"),
        "endTimeCode": authored("endTimeCode"),
        "layers": sorted(os.path.realpath(layer.realPath) for layer in stage.GetUsedLayers() if layer.realPath),
        "prims": prims,
        "prototypeStart": prototype_start,
    }


for request in json.load(sys.stdin):
    try:
        answer = dump(request)
    except (Tf.ErrorException, RuntimeError) as error:
        answer = {"error": str(error)}
    print(json.dumps(answer), flush=True)
