"""A GLB with most of what surflux converts, made by hand: make_gltf.py OUT.glb|OUT.gltf."""
import base64, json, math, struct, sys, zlib

blob = bytearray()
views, accessors = [], []
SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
CODES = {"f": 5126, "H": 5123, "B": 5121, "I": 5125}


def view(data):
    while len(blob) % 4:
        blob.append(0)
    views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
    blob.extend(data)
    return len(views) - 1


def accessor(kind, code, values, normalized=False, bounds=False):
    flat = [x for v in values for x in (v if isinstance(v, (list, tuple)) else [v])]
    made = {"bufferView": view(struct.pack("<%d%s" % (len(flat), code), *flat)), "componentType": CODES[code],
            "count": len(values), "type": kind}
    if normalized:
        made["normalized"] = True
    if bounds:
        columns = list(zip(*[v if isinstance(v, (list, tuple)) else [v] for v in values]))
        made["min"], made["max"] = [min(c) for c in columns], [max(c) for c in columns]
    accessors.append(made)
    return len(accessors) - 1


def png(width, height, rgba):
    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
    rows = b"".join(b"\0" + bytes(rgba[4 * width * y:4 * width * (y + 1)]) for y in range(height))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


image = view(png(2, 2, [255, 0, 0, 255, 0, 255, 0, 128, 0, 0, 255, 255, 255, 255, 255, 64]))
square = [(-1.0, 0.0, -1.0), (1.0, 0.0, -1.0), (1.0, 0.0, 1.0), (-1.0, 0.0, 1.0)]
up = [(0.0, 1.0, 0.0)] * 4
P = accessor("VEC3", "f", square, bounds=True)
N = accessor("VEC3", "f", up)
UV = accessor("VEC2", "f", [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
C = accessor("VEC4", "B", [(255, 0, 0, 255), (0, 255, 0, 255), (0, 0, 255, 128), (51, 102, 204, 255)], normalized=True)
I = accessor("SCALAR", "H", [0, 2, 1, 0, 3, 2])
STRIP = accessor("VEC3", "f", [(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (2.0, 0.0, 0.5)], bounds=True)
FAN = accessor("VEC3", "f", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.25), (-1.0, 1.0, 0.5)], bounds=True)
DOTS = accessor("VEC3", "f", [(0.0, 3.0, 0.0), (0.5, 3.0, 0.0), (1.0, 3.5, 0.0)], bounds=True)
DOTC = accessor("VEC3", "f", [(0.1, 0.2, 0.3), (1.0, 0.5, 0.0), (0.0, 0.25, 2.0)])
RADII = accessor("SCALAR", "f", [0.1, 0.2, 0.05])
PLACES = accessor("VEC3", "f", [(0.0, 0.0, 0.0), (0.0, 2.0, 0.0), (3.0, 0.0, 1.0)])
half = math.sqrt(0.5)
TURNS = accessor("VEC4", "f", [(0.0, 0.0, 0.0, 1.0), (0.0, half, 0.0, half), (half, 0.0, 0.0, half)])
SIZES3 = accessor("VEC3", "f", [(1.0, 1.0, 1.0), (0.5, 0.5, 0.5), (1.0, 2.0, 0.25)])
TIMES = accessor("SCALAR", "f", [0.0, 0.5, 1.0], bounds=True)
MOVES = accessor("VEC3", "f", [(1.0, 2.0, 3.0), (2.0, 2.0, 3.0), (2.0, 4.0, 3.0)])
SPINS = accessor("VEC4", "f", [(0.0, 0.0, 0.0, 1.0), (0.0, half, 0.0, half), (0.0, 1.0, 0.0, 0.0)])


def mesh(name, *primitives):
    return {"name": name, "primitives": list(primitives)}


def info(**more):
    return {"index": 0, **more}


transform = {"KHR_texture_transform": {"offset": [0.25, 0.5], "rotation": 0.5, "scale": [2.0, 3.0]}}
gltf = {
    "asset": {"version": "2.0"},
    "extensionsUsed": ["KHR_lights_punctual", "KHR_texture_transform", "KHR_materials_emissive_strength", "KHR_materials_ior",
                       "KHR_materials_clearcoat", "KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness", "EXT_mesh_gpu_instancing"],
    "extensionsRequired": ["EXT_mesh_gpu_instancing"],
    "scene": 0,
    "scenes": [{"nodes": [0, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13]}],
    "nodes": [
        {"name": "moved.001", "translation": [1, 2, 3], "rotation": [0, half, 0, half], "scale": [1, 2, 0.5], "mesh": 0, "children": [1, 2]},
        {"name": "strip", "translation": [0, 1, 0], "mesh": 1},
        {"name": "fan", "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 4, 5, 6, 1], "mesh": 2},
        {"name": "dots", "mesh": 3},
        {"name": "twin", "translation": [10, 0, 0], "mesh": 4},
        {"name": "twin", "translation": [20, 0, 0], "scale": [2, 2, 2], "mesh": 4},
        {"name": "scattered", "translation": [0, 0, 30], "mesh": 5,
         "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": PLACES, "ROTATION": TURNS, "SCALE": SIZES3}}}},
        {"name": "eye", "translation": [0, 1, 9], "camera": 0},
        {"name": "bulb", "translation": [0, 5, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
        {"name": "spot", "translation": [0, 6, 0], "extensions": {"KHR_lights_punctual": {"light": 1}}},
        {"name": "sun", "extensions": {"KHR_lights_punctual": {"light": 2}}},
        {"name": "unlit", "translation": [0, 0, -10], "mesh": 6},
        {"name": "coated", "translation": [0, 0, -20], "mesh": 7},
        {"name": "glossy", "translation": [0, 0, -30], "mesh": 8},
    ],
    "meshes": [
        mesh("square", {"attributes": {"POSITION": P, "NORMAL": N, "TEXCOORD_0": UV, "COLOR_0": C}, "indices": I, "material": 0}),
        mesh("strip", {"attributes": {"POSITION": STRIP}, "mode": 5, "material": 1}),
        mesh("fan", {"attributes": {"POSITION": FAN}, "mode": 6}),
        mesh("dots", {"attributes": {"POSITION": DOTS, "COLOR_0": DOTC, "_RADIUS": RADII}, "mode": 0}),
        mesh("twin", {"attributes": {"POSITION": P, "NORMAL": N, "TEXCOORD_0": UV}, "indices": I, "material": 2}),
        mesh("leaf", {"attributes": {"POSITION": P, "NORMAL": N}, "indices": I, "material": 1}),
        mesh("unlit", {"attributes": {"POSITION": P, "NORMAL": N}, "indices": I, "material": 3}),
        mesh("coated", {"attributes": {"POSITION": P, "NORMAL": N, "TEXCOORD_0": UV}, "indices": I, "material": 4}),
        mesh("glossy", {"attributes": {"POSITION": P, "NORMAL": N, "TEXCOORD_0": UV}, "indices": I, "material": 5}),
    ],
    "materials": [
        {"name": "painted", "pbrMetallicRoughness": {"metallicFactor": 0.25, "roughnessFactor": 0.75}, "doubleSided": True},
        {"name": "glow", "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.4, 0.2, 1], "metallicFactor": 0.5, "roughnessFactor": 0.3},
         "emissiveFactor": [1, 0.5, 0.25], "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 6},
         "KHR_materials_ior": {"ior": 1.4}, "KHR_materials_clearcoat": {"clearcoatFactor": 0.7, "clearcoatRoughnessFactor": 0.1}}},
        {"name": "textured", "alphaMode": "MASK", "alphaCutoff": 0.4,
         "pbrMetallicRoughness": {"baseColorTexture": info(extensions=transform), "baseColorFactor": [1, 0.5, 1, 1],
                                  "metallicRoughnessTexture": info(), "metallicFactor": 0.9, "roughnessFactor": 0.8},
         "normalTexture": info(scale=0.5), "occlusionTexture": info(strength=0.6), "emissiveTexture": info(), "emissiveFactor": [1, 1, 1]},
        {"name": "flat", "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.6, 0.3, 1]}, "extensions": {"KHR_materials_unlit": {}}},
        {"name": "coated", "extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 0.7, "clearcoatTexture": info(),
         "clearcoatRoughnessFactor": 0.4, "clearcoatRoughnessTexture": info(extensions=transform)}}},
        {"name": "glossy", "extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.2, 0.4, 0.6, 0.5],
         "specularFactor": [0.5, 0.25, 1], "glossinessFactor": 0.75, "specularGlossinessTexture": info()}}, "alphaMode": "BLEND"},
    ],
    "textures": [{"source": 0, "sampler": 0}],
    "samplers": [{"wrapS": 33071, "wrapT": 33648}],
    "images": [{"name": "corner colors", "bufferView": image, "mimeType": "image/png"}],
    "cameras": [{"type": "perspective", "perspective": {"yfov": 0.8, "aspectRatio": 1.5, "znear": 0.1, "zfar": 100}}],
    "extensions": {"KHR_lights_punctual": {"lights": [
        {"type": "point", "intensity": 25.0, "color": [1, 0.5, 0.25]},
        {"type": "spot", "intensity": 40.0, "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.4}},
        {"type": "directional", "intensity": 3.0},
    ]}},
    "animations": [{"samplers": [{"input": TIMES, "output": MOVES}, {"input": TIMES, "output": SPINS, "interpolation": "STEP"}],
                    "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}},
                                 {"sampler": 1, "target": {"node": 0, "path": "rotation"}}]}],
}
gltf["accessors"], gltf["bufferViews"] = accessors, views
if sys.argv[1].endswith(".gltf"):
    gltf["buffers"] = [{"byteLength": len(blob), "uri": "data:application/octet-stream;base64," + base64.b64encode(blob).decode()}]
    open(sys.argv[1], "w").write(json.dumps(gltf))
else:
    gltf["buffers"] = [{"byteLength": len(blob)}]
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + bytes(blob)
    open(sys.argv[1], "wb").write(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)
