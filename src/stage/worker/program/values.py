"""Values as they are sent: small ones spelled out, arrays in a file of their own."""

# Value type names of arrays whose numpy view holds plain numbers, with the type surflux keeps them as.
KEPT_AS = {"b": "i4", "u1": "i4", "i4": "i4", "u4": "i4", "i8": "i8", "u8": "i8", "f2": "f4", "f4": "f4", "f8": "f4"}


# Largest integer of the receiving side; only uint64 scalars exceed it.
LARGEST_INT = 2**63 - 1


def number(value):
    """A float as its shortest exact spelling, NaN and infinities included: JSON readers round and refuse those."""
    return repr(float(value))


class Arrays:
    """Arrays of one load, laid out one after the other on 64-byte borders."""

    def __init__(self):
        self.items = []
        self.size = 0

    def add(self, array):
        array = numpy.ascontiguousarray(array)
        offset = -(-self.size // ALIGNMENT) * ALIGNMENT
        self.items.append((offset, array))
        self.size = offset + array.nbytes
        return offset

    def write(self, folders):
        """Path of the file that holds them, in the first of `folders` with room; "" when there is nothing to hold.

        Each array is let go once it is written, so that there are no two copies of all of them.
        """
        if self.size == 0:
            return ""
        partial = problem = None
        for folder in folders:
            handle, path = tempfile.mkstemp(dir=folder)
            try:
                with os.fdopen(handle, "wb", BATCH) as file:
                    self.write_to(file, folder, partial)
                if partial:
                    os.remove(partial)
                return path
            except OSError as error:
                problem = error
                if partial:
                    os.remove(path)
                else:
                    partial = path  # what was let go is there alone
        os.remove(partial)
        raise problem

    def write_to(self, file, folder, partial):
        if hasattr(os, "fstatvfs"):
            room = os.fstatvfs(file.fileno())
            if room.f_bavail * room.f_frsize < self.size:
                raise OSError("%d bytes do not fit into %s" % (self.size, folder))
        if partial:
            with open(partial, "rb") as written:
                shutil.copyfileobj(written, file, 1 << 20)
        # Written from the front, let go from the back of the list; an empty array is where the next one begins, before it.
        self.items.sort(key=lambda item: (item[0], item[1].nbytes), reverse=True)
        while self.items:
            at = self.items[-1][0]
            file.seek(at)
            count = pending = 0
            for offset, array in reversed(self.items):
                file.write(bytes(offset - at))
                file.write(array)
                at = offset + array.nbytes
                count += 1
                pending += array.nbytes
                if pending >= BATCH:
                    break
            file.flush()
            del self.items[-count:]


# What becomes of a value of a class that the type name tells, as {kind: content}.
CONTENTS = {
    "bool": lambda value: {"bool": value},
    "int": lambda value: {"int": min(value, LARGEST_INT)},
    "float": lambda value: {"float": number(value)},
    "str": lambda value: {"token": value},
    "TimeCode": lambda value: {"float": number(value.GetValue())},
    "PathExpression": lambda value: {"token": value.GetText()},
}

# Types of the components of Gf vectors and matrices, by the last letter of their name.
COMPONENTS = {"d": "f8", "f": "f4", "h": "f2", "i": "i4"}


def spelled_rows(kind, values):
    """Vectors or matrices of one class, which lie in memory as rows of numbers: asked for by index they take longer."""
    rows = numpy.frombuffer(b"".join(values), COMPONENTS[kind[-1]]).astype("f8").reshape(len(values), -1)
    name = "matrix" if kind.startswith("Matrix") else "vector"
    return [{name: list(map(repr, row))} for row in rows.tolist()]


def quaternion(value):
    imaginary = value.GetImaginary()
    return {"quat": [number(imaginary[i]) for i in range(3)] + [number(value.GetReal())]}


def spelled_tokens(values):
    """Token arrays; most are equal to the one before (xformOpOrder)."""
    spelled = []
    last = content = None
    for value in values:
        if last is None or value != last:
            # iterating ends in an exception, which takes long for the many short ones
            count = len(value)
            content = {"tokens": [value[i] for i in range(count)] if count <= 16 else list(value)}
            last = value
        spelled.append(content)
    return spelled


def spelled_values(kind, values, attributes, time, arrays):
    """What becomes of `values`, all of the class `kind`; None for each that surflux has no use for."""
    name = kind.__name__
    if name == "TokenArray":
        return spelled_tokens(values)
    if name.endswith("Array"):
        return [array_value(value, arrays) for value in values]
    if name.startswith("Vec") or name == "Matrix4d":
        return spelled_rows(name, values)
    if name == "AssetPath":
        return [asset_value(attribute, time, value) for attribute, value in zip(attributes, values)]
    spell = quaternion if name.startswith("Quat") else CONTENTS.get(name)
    return list(map(spell, values)) if spell else [None] * len(values)


def udim_path(attribute, time, authored):
    """Absolute path of a `<UDIM>` pattern, anchored at the layer that authored it, the pattern kept."""
    stack = attribute.GetPropertyStack(time)
    layer = stack[0].layer if stack else attribute.GetStage().GetRootLayer()
    before, after = authored.split(UDIM, 1)
    for tile in range(1001, 1101):
        resolved = layer.ComputeAbsolutePath("%s%d%s" % (before, tile, after))
        resolved = Ar.GetResolver().Resolve(resolved).GetPathString() if resolved else ""
        tail = "%d%s" % (tile, after)
        # inside a package the path ends in a bracket that the authored one does not have
        closing = "]" if resolved.endswith("]") and not tail.endswith("]") else ""
        if resolved.endswith(tail + closing):
            return resolved[: -len(tail + closing)] + UDIM + after + closing
    absolute = layer.ComputeAbsolutePath(authored)
    if os.path.isabs(absolute):
        return absolute
    folder = os.path.dirname(layer.realPath)
    return os.path.normpath(os.path.join(folder, authored)) if folder else ""


def asset_value(attribute, time, value):
    authored = value.path
    resolved = value.resolvedPath
    if UDIM in authored:
        resolved = udim_path(attribute, time, authored)
    return {"asset": [authored, resolved]}


# Classes of Vt arrays that hold plain numbers: what they become, the conversion to that or None, and their width.
LAYOUTS = {}


def layout(kind, array):
    """See `LAYOUTS`; None for kinds without use."""
    name = array.dtype.str[1:]
    kept = KEPT_AS.get("b" if name == "b1" else name)
    if kept is None or array.ndim > 2 and kind != "Matrix4dArray":
        return None
    if kind == "Matrix4dArray":
        kept = "f8"
    elif array.ndim == 2:
        kept = "f4"  # int2[] and the like have no integer form in surflux
    width = 1
    for extent in array.shape[1:]:
        width *= extent
    quaternions = "q" if kind.startswith("Quat") else ""
    return quaternions + kept, None if name == kept else "<" + kept, width


def array_value(value, arrays):
    """A Vt array as {"array": [offset, type, rows, columns]} or {"tokens": [...]}; None for kinds without use."""
    kind = type(value).__name__
    if kind in ("TokenArray", "StringArray"):
        return {"tokens": list(value)}
    if kind == "AssetPathArray":
        return {"tokens": [asset.resolvedPath or asset.path for asset in value]}
    if kind == "TimeCodeArray":  # an array of objects before usd-core 25
        array = numpy.array([time.GetValue() for time in value], dtype="<f8")
    else:
        array = numpy.asarray(value)
    if kind not in LAYOUTS:
        LAYOUTS[kind] = layout(kind, array)
    known = LAYOUTS[kind]
    if known is None:
        return None
    kept, conversion, width = known
    if conversion:
        # values out of range become infinities here and are refused where they are used
        with numpy.errstate(over="ignore", invalid="ignore"):
            array = array.astype(conversion)
    return {"array": [arrays.add(array), kept, len(array), width]}
