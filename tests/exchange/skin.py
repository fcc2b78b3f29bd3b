"""An arm of two joints and faces that change their shape, as glTF, and where their triangles are by glTF's own rules.

skin.py OUT.glb|OUT.gltf      writes the file
skin.py truth FRAME           prints the triangles, +Y up, 24 frames a second
"""
import base64, json, math, struct, sys
import numpy as np


def about(axis, degrees):
    half = math.radians(degrees) / 2
    return [math.sin(half) * x for x in axis] + [math.cos(half)]


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
KEYS = [0.0, 0.5, 1.0]
LOWER = [about(Z, 0), about(Z, 40), about(Z, -50)]
UPPER = [about(X, 10), about(X, 70), about(X, 0)]
STEPS = [[0.0, 1.0, 0.0], [0.0, 1.2, 0.0], [0.0, 1.0, 0.5]]
ARM_WEIGHTS, FACE_WEIGHTS = [[0.0], [1.0], [0.5]], [[0.0, 1.0], [0.5, 0.25], [1.0, 0.0]]
ARM = [(x, y, 0.0) for y in (0.0, 1.0, 2.0) for x in (-0.3, 0.3)]
ARM_TRIANGLES = [(0, 1, 3), (0, 3, 2), (2, 3, 5), (2, 5, 4)]
ARM_SHAPE = [(0.0, 0.0, 0.2 if k in (2, 3) else 0.0) for k in range(6)]
# by the order of the skin's joints: upper first
JOINTS = [(0, 1, 0, 0)] * 6
WEIGHTS = [(0.0, 1.0, 0.0, 0.0)] * 2 + [(0.5, 0.5, 0.0, 0.0)] * 2 + [(0.75, 0.25, 0.0, 0.0)] * 2
BINDS = [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
FACE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)]
FACE_TRIANGLES = [(0, 1, 2), (0, 2, 3)]
SMILE = [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, 0.0, 0.7), (0.0, 0.0, 0.0)]
FROWN = [(-0.2, -0.1, 0.3)] * 4
ARMATURE = ([0.5, 0.0, 0.0], about(Y, 30), [2.0, 2.0, 2.0])
FACE_AT, REST_AT = ([-3.0, 0.0, 1.0], about(Y, 45), [1.0, 2.0, 1.0]), ([0.0, 0.0, -4.0], about(X, 0), [1.0, 1.0, 1.0])


def matrix(place):
    move, (x, y, z, w), size = place
    turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = turn * np.array(size), move
    return made


def at(keys, time, is_turn=False, is_step=False):
    k = min(int(time / 0.5), 1)
    if is_step:
        return np.array(keys[2 if time >= 1.0 else k])
    t = (time - KEYS[k]) / 0.5
    a, b = np.array(keys[k]), np.array(keys[k + 1])
    if not is_turn:
        return (1 - t) * a + t * b
    b = b if a @ b >= 0 else -b
    angle = math.acos(min(1.0, a @ b))
    return a if angle < 1e-9 else (math.sin((1 - t) * angle) * a + math.sin(t * angle) * b) / math.sin(angle)


def truth(frame):
    time = frame / 24
    armature = matrix(ARMATURE)
    lower = armature @ matrix(([0, 0, 0], at(LOWER, time, True), [1, 1, 1]))
    upper = lower @ matrix((at(STEPS, time, is_step=True), at(UPPER, time, True), [1, 1, 1]))
    joints = [world @ np.linalg.inv(matrix((bind, about(X, 0), [1, 1, 1]))) for world, bind in zip((upper, lower), BINDS)]
    shape = at(ARM_WEIGHTS, time)
    points = np.array(ARM) + shape[0] * np.array(ARM_SHAPE)
    arm = [sum(w * (joints[j] @ np.append(p, 1))[:3] for j, w in zip(js, ws) if w) for p, js, ws in zip(points, JOINTS, WEIGHTS)]
    smile, frown = at(FACE_WEIGHTS, time)
    moved = np.array(FACE) + smile * np.array(SMILE) + frown * np.array(FROWN)
    face = [(matrix(FACE_AT) @ np.append(p, 1))[:3] for p in moved]
    moved = np.array(FACE) + 0.25 * np.array(SMILE) + 0.5 * np.array(FROWN)
    rest = [(matrix(REST_AT) @ np.append(p, 1))[:3] for p in moved]
    shown = [(arm, ARM_TRIANGLES), (face, FACE_TRIANGLES), (rest, FACE_TRIANGLES)]
    return [[[float(x) for x in points[k]] for k in t] for points, triangles in shown for t in triangles]


def write(path):
    blob, views, accessors = bytearray(), [], []
    codes = {"f": 5126, "H": 5123, "B": 5121}

    def accessor(kind, code, rows):
        flat = [x for row in rows for x in (row if isinstance(row, (list, tuple)) else [row])]
        blob.extend(b"\0" * (-len(blob) % 4))
        data = struct.pack("<%d%s" % (len(flat), code), *flat)
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        blob.extend(data)
        made = {"bufferView": len(views) - 1, "componentType": codes[code], "count": len(rows), "type": kind}
        columns = list(zip(*[row if isinstance(row, (list, tuple)) else [row] for row in rows]))
        made["min"], made["max"] = [min(c) for c in columns], [max(c) for c in columns]
        accessors.append(made)
        return len(accessors) - 1

    vectors = lambda rows: accessor("VEC3", "f", rows)
    corners = lambda triangles: accessor("SCALAR", "H", [k for t in triangles for k in t])
    inverse = [[float(x) for x in np.linalg.inv(matrix((bind, about(X, 0), [1, 1, 1]))).T.flatten()] for bind in BINDS]
    times = accessor("SCALAR", "f", KEYS)
    arm = {"POSITION": vectors(ARM), "JOINTS_0": accessor("VEC4", "B", JOINTS), "WEIGHTS_0": accessor("VEC4", "f", WEIGHTS)}
    face = {"attributes": {"POSITION": vectors(FACE), "NORMAL": vectors([Z] * 4)}, "indices": corners(FACE_TRIANGLES),
            "targets": [{"POSITION": vectors(SMILE), "NORMAL": vectors([(0.1, 0.0, 0.0)] * 4)}, {"POSITION": vectors(FROWN)}]}
    outputs = [accessor("VEC4", "f", LOWER), accessor("VEC4", "f", UPPER), vectors(STEPS),
               accessor("SCALAR", "f", [w for row in ARM_WEIGHTS for w in row]),
               accessor("SCALAR", "f", [w for row in FACE_WEIGHTS for w in row])]
    targets = [(1, "rotation"), (2, "rotation"), (2, "translation"), (3, "weights"), (4, "weights")]
    place = lambda p: {"translation": p[0], "rotation": p[1], "scale": p[2]}
    gltf = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 3, 4, 5]}],
        "nodes": [
            {"name": "armature", "children": [1], **place(ARMATURE)},
            {"name": "bone", "children": [2], "rotation": LOWER[0]},
            {"name": "bone", "translation": STEPS[0], "rotation": UPPER[0]},
            {"name": "arm", "mesh": 0, "skin": 0},
            {"name": "face", "mesh": 1, **place(FACE_AT)},
            {"name": "resting", "mesh": 1, "weights": [0.25, 0.5], **place(REST_AT)},
        ],
        "skins": [{"name": "arm", "joints": [2, 1], "inverseBindMatrices": accessor("MAT4", "f", inverse)}],
        "meshes": [
            {"name": "arm", "weights": [0.0], "primitives": [{"attributes": arm, "indices": corners(ARM_TRIANGLES), "targets": [{"POSITION": vectors(ARM_SHAPE)}]}]},
            {"name": "face", "weights": [0.0, 1.0], "primitives": [face], "extras": {"targetNames": ["smile", "frown"]}},
        ],
        "animations": [{
            "samplers": [{"input": times, "output": output, "interpolation": "STEP" if k == 2 else "LINEAR"} for k, output in enumerate(outputs)],
            "channels": [{"sampler": k, "target": {"node": node, "path": name}} for k, (node, name) in enumerate(targets)],
        }],
        "accessors": accessors, "bufferViews": views,
    }
    if path.endswith(".gltf"):
        gltf["buffers"] = [{"byteLength": len(blob), "uri": "data:application/octet-stream;base64," + base64.b64encode(blob).decode()}]
        open(path, "w").write(json.dumps(gltf))
        return
    gltf["buffers"] = [{"byteLength": len(blob)}]
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    blob.extend(b"\0" * (-len(blob) % 4))
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + bytes(blob)
    open(path, "wb").write(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)


if sys.argv[1] == "truth":
    print(json.dumps(truth(float(sys.argv[2]))))
else:
    write(sys.argv[1])
