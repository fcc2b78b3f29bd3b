#!/usr/bin/env python3
"""Writes examples/room.usda: a Cornell box with a creased subdivision block, a torus, a ball and instanced pebbles.

Plain Python, no packages: python3 examples/make_room.py > examples/room.usda
"""
import math

WHITE, RED, GREEN, BLUE = (0.73, 0.73, 0.71), (0.65, 0.06, 0.05), (0.12, 0.45, 0.15), (0.22, 0.36, 0.62)


def text(values):
    """A USD array of numbers or tuples."""
    one = lambda v: "(" + ", ".join(one(x) for x in v) + ")" if isinstance(v, tuple) else f"{v:.6g}"
    return "[" + ", ".join(one(v) for v in values) + "]"


def mesh(name, points, counts, indices, material, scheme="none", extra="", normals=None):
    normal = f"\n        normal3f[] normals = {text(normals)} (interpolation = \"vertex\")" if normals else ""
    return f"""
    def Mesh "{name}" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        point3f[] points = {text(points)}
        int[] faceVertexCounts = {text(counts)}
        int[] faceVertexIndices = {text(indices)}{normal}
        uniform token subdivisionScheme = "{scheme}"
        float3[] extent = {text([tuple(min(p[k] for p in points) for k in range(3)), tuple(max(p[k] for p in points) for k in range(3))])}
        rel material:binding = </Room/Looks/{material}>{extra}
    }}"""


def grid(origin, u, v, n):
    """An n by n grid of quads, normal u × v."""
    points = [tuple(origin[k] + u[k] * i / n + v[k] * j / n for k in range(3)) for j in range(n + 1) for i in range(n + 1)]
    quads = [(j * (n + 1) + i, j * (n + 1) + i + 1, (j + 1) * (n + 1) + i + 1, (j + 1) * (n + 1) + i) for j in range(n) for i in range(n)]
    return points, [4] * len(quads), [i for q in quads for i in q]


def torus(center, big, small, n, m):
    points, normals, quads = [], [], []
    for j in range(m):
        for i in range(n):
            a, b = 2 * math.pi * i / n, 2 * math.pi * j / m
            normal = (math.cos(a) * math.cos(b), math.sin(b), math.sin(a) * math.cos(b))
            normals.append(normal)
            points.append((center[0] + math.cos(a) * big + small * normal[0], center[1] + small * normal[1], center[2] + math.sin(a) * big + small * normal[2]))
            k, l = (i + 1) % n, (j + 1) % m
            quads.append((j * n + i, l * n + i, l * n + k, j * n + k))
    return points, [4] * len(quads), [i for q in quads for i in q], normals


def block(center, half, turn):
    """A turned box, creased for subdivision."""
    c, s = math.cos(turn), math.sin(turn)
    corners = [(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]
    points = [(center[0] + c * x * half[0] + s * z * half[2], center[1] + y * half[1], center[2] - s * x * half[0] + c * z * half[2]) for x, y, z in corners]
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    edges = sorted({tuple(sorted((q[k], q[(k + 1) % 4]))) for q in quads for k in range(4)})
    extra = f"""
        int[] creaseIndices = {text([i for e in edges for i in e])}
        int[] creaseLengths = {text([2] * len(edges))}
        float[] creaseSharpnesses = {text([2.5] * len(edges))}"""
    return points, [4] * 6, [i for q in quads for i in q], extra


def look(name, color):
    return f"""
        def Material "{name}"
        {{
            token outputs:surface.connect = </Room/Looks/{name}/preview.outputs:surface>
            def Shader "preview"
            {{
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor = ({color[0]}, {color[1]}, {color[2]})
                float inputs:roughness = 1
                color3f inputs:specularColor = (0, 0, 0)
                int inputs:useSpecularWorkflow = 1
                token outputs:surface
            }}
        }}"""


def pebbles():
    """A ring of instances around the torus, by the golden angle."""
    positions, orientations, scales = [], [], []
    for i in range(60):
        angle, radius = i * 2.399963, 0.34 + 0.16 * ((i * 0.618034) % 1)
        positions.append((0.38 + radius * math.cos(angle) * 0.9, 0.021, 0.42 + radius * math.sin(angle) * 0.8))
        orientations.append((math.cos(angle), 0.0, math.sin(angle), 0.0))
        scales.append((0.028 + 0.012 * ((i * 0.755) % 1), 0.022, 0.03))
    keep = [k for k, p in enumerate(positions) if abs(p[0]) < 0.95 and -0.1 < p[2] < 0.95]
    return [[column[k] for k in keep] for column in (positions, orientations, scales)]


def room():
    out = ['#usda 1.0\n(\n    defaultPrim = "Room"\n    metersPerUnit = 1\n    upAxis = "Y"\n    doc = "Written by make_room.py"\n)\n\ndef Xform "Room"\n{']
    walls = [("floor", (-1, 0, 1), (2, 0, 0), (0, 0, -2), "White"), ("ceiling", (-1, 2, -1), (2, 0, 0), (0, 0, 2), "White"),
             ("back", (-1, 0, -1), (2, 0, 0), (0, 2, 0), "White"), ("left", (-1, 0, 1), (0, 0, -2), (0, 2, 0), "Red"), ("right", (1, 0, -1), (0, 0, 2), (0, 2, 0), "Green")]
    out += [mesh(name, *grid(o, u, v, 16), material) for name, o, u, v, material in walls]
    points, counts, indices, extra = block((-0.42, 0.55, -0.38), (0.3, 0.55, 0.3), 0.32)
    out.append(mesh("block", points, counts, indices, "White", "catmullClark", extra))
    points, counts, indices, normals = torus((0.38, 0.11, 0.42), 0.25, 0.11, 48, 24)
    out.append(mesh("torus", points, counts, indices, "Blue", normals=normals))
    positions, orientations, scales = pebbles()
    out.append(f"""
    def Sphere "ball" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        double radius = 0.3
        float3[] extent = [(-0.3, -0.3, -0.3), (0.3, 0.3, 0.3)]
        double3 xformOp:translate = (0.45, 0.3, -0.35)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        rel material:binding = </Room/Looks/White>
    }}
    def PointInstancer "pebbles"
    {{
        rel prototypes = </Room/pebbles/pebble>
        int[] protoIndices = {text([0] * len(positions))}
        point3f[] positions = {text(positions)}
        quath[] orientations = {text(orientations)}
        float3[] scales = {text(scales)}
        def Sphere "pebble" (prepend apiSchemas = ["MaterialBindingAPI"])
        {{
            double radius = 1
            float3[] extent = [(-1, -1, -1), (1, 1, 1)]
            rel material:binding = </Room/Looks/Red>
        }}
    }}
    def RectLight "lamp"
    {{
        float inputs:width = 0.7
        float inputs:height = 0.6
        float inputs:intensity = 14
        color3f inputs:color = (1, 0.86, 0.66)
        double3 xformOp:translate = (0, 1.99, 0)
        float xformOp:rotateX = -90
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
    }}
    def Camera "cam"
    {{
        float focalLength = 35
        float horizontalAperture = 20
        float verticalAperture = 20
        float2 clippingRange = (0.1, 100)
        double3 xformOp:translate = (0, 1, 4.7)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    def Scope "Looks"
    {{""" + "".join(look(*pair) for pair in (("White", WHITE), ("Red", RED), ("Green", GREEN), ("Blue", BLUE))) + "\n    }\n}")
    return "\n".join(out)


print(room())
