"""Read USD stages for surflux: JSON lines in, JSON lines out, arrays through a flat file.

Requests (one JSON object a line on stdin):
  {"open": PATH, "scratch": [FOLDER, ...]}
  {"load": {"time": NUMBER|null, "mask": [PATH], "attributes": [NAME|PREFIX*], "values_not_needed": [...],
            "composition": {"load": "all"|"none", "variants": [[PRIM, SET, CHOICE]], "session": PATH|null, "muted": [ID]},
            "keep": BOOL}}
 With "keep", loads that differ in time only read again what varies; the other arrays are named by their place in the
 file of the first of them ("kept" instead of "array").
   {"validate": {}}
Replies (one line on stdout each): {"ok": ...} or {"error": MESSAGE}; the very first line says what was imported.
All numbers keep the memory order of USD: a row-vector matrix read as columns is its transpose.
"""
import gc
import json
import os
import re
import shutil
import signal
import sys
import tempfile

# `python -c` puts the current folder first: a file called numpy.py there must not be imported.
if sys.path and sys.path[0] == "":
    del sys.path[0]

# An index is a tree: nothing here runs in circles, and looking for that takes a third of a walk over 100 000 prims.
gc.disable()

# Ctrl-C in a terminal goes to the whole group; surflux decides what it means and ends this process itself.
signal.signal(signal.SIGINT, signal.SIG_IGN)

# USD and its plug-ins print to stdout: keep the protocol's own copy and send everything else to stderr.
REQUESTS = os.fdopen(os.dup(0), "r", encoding="utf-8")
REPLIES = os.fdopen(os.dup(1), "w", encoding="utf-8")
os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
os.dup2(2, 1)
sys.stdout = sys.stderr


def reply(message):
    REPLIES.write(json.dumps(message, separators=(",", ":"), allow_nan=False))
    REPLIES.write("\n")
    REPLIES.flush()


try:
    import numpy
    from pxr import Ar, Sdf, Tf, Usd, UsdUtils
except BaseException as problem:  # a broken installation may raise anything
    reply({"error": "cannot import pxr and numpy: %s: %s" % (type(problem).__name__, problem)})
    sys.exit(1)

ALIGNMENT = 64
# Bytes to write at a time.
BATCH = 1 << 20
UDIM = "<UDIM>"
PROTOTYPE = re.compile(r"/__Prototype_[0-9]+(?=[/.]|$)")
FALLBACK_SOURCES = (Usd.ResolveInfoSourceFallback, Usd.ResolveInfoSourceNone)
# Methods, called with their object as an argument: `prim.GetPath()` looks first whether the prim has not expired, which takes
# three times as long as the method. No stage changes while it is walked.
get_path = Usd.Object.GetPath
get_name = Usd.Object.GetName
get_metadata = Usd.Object.GetMetadata
has_metadata = Usd.Object.HasAuthoredMetadata
get_type_name = Usd.Prim.GetTypeName
get_schemas = Usd.Prim.GetAppliedSchemas
get_properties = Usd.Prim.GetAuthoredProperties
is_instance = Usd.Prim.IsInstance
get_prototype = Usd.Prim.GetPrototype
get_targets = Usd.Relationship.GetTargets
get_value_type = Usd.Attribute.GetTypeName
get_value = Usd.Attribute.Get
get_resolve_info = Usd.Attribute.GetResolveInfo
has_connections = Usd.Attribute.HasAuthoredConnections
has_color_space = Usd.Attribute.HasColorSpace
might_vary = Usd.Attribute.ValueMightBeTimeVarying

# Looked up in their modules, these take longer than to be compared.
RELATIONSHIP = Usd.Relationship
ASSET_PATH = Sdf.AssetPath
DEFAULT_SOURCE = Usd.ResolveInfoSourceDefault

# Value type names of arrays whose numpy view holds plain numbers, with the type surflux keeps them as.
KEPT_AS = {"b": "i4", "u1": "i4", "i4": "i4", "u4": "i4", "i8": "i8", "u8": "i8", "f2": "f4", "f4": "f4", "f8": "f4"}


# Largest integer of the receiving side; only uint64 scalars exceed it.
LARGEST_INT = 2**63 - 1


def number(value):
    """A float as its shortest exact spelling, NaN and infinities included: JSON readers round and refuse those."""
    return repr(float(value))


def components(vector):
    """By index: iterating over a Gf vector ends in an exception, which takes ten times as long."""
    return [number(vector[i]) for i in range(vector.dimension)]


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


def matrix(value):
    return [number(value[row, column]) for row in range(4) for column in range(4)]


# What becomes of a value of a class that the type name tells, as {kind: content}.
CONTENTS = {
    "bool": lambda value: {"bool": value},
    "int": lambda value: {"int": min(value, LARGEST_INT)},
    "float": lambda value: {"float": number(value)},
    "str": lambda value: {"token": value},
    "TimeCode": lambda value: {"float": number(value.GetValue())},
    "PathExpression": lambda value: {"token": value.GetText()},
    "Matrix4d": lambda value: {"matrix": matrix(value)},
}


def vector(value):
    return {"vector": components(value)}


def vector3(value):
    return {"vector": [number(value[0]), number(value[1]), number(value[2])]}


def quaternion(value):
    return {"quat": components(value.GetImaginary()) + [number(value.GetReal())]}


def content_of(kind):
    """How values of the class `kind` are spelled; None when surflux has no use for them."""
    name = kind.__name__
    known = CONTENTS.get(name)
    if known is None and name.startswith("Vec"):
        return vector3 if name.startswith("Vec3") else vector
    return quaternion if known is None and name.startswith("Quat") else known


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
        # iterating ends in an exception, which takes long for the many short ones (xformOpOrder)
        count = len(value)
        return {"tokens": [value[i] for i in range(count)] if count <= 16 else list(value)}
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


def matcher(patterns):
    exact = frozenset(pattern for pattern in patterns if not pattern.endswith("*"))
    starts = tuple(pattern[:-1] for pattern in patterns if pattern.endswith("*"))
    return lambda name: name in exact or name.startswith(starts)


# What moves the points of a PointInstancer between samples, if it has one of the movers.
MOVED = ("positions", "velocities", "accelerations", "orientations", "orientationsf", "angularVelocities", "scales")
MOVERS = ("velocities", "angularVelocities")


# Arrays of the schemas that have elements of one value each, whatever their metadata say.
PLAIN = frozenset(
    ("points", "extent", "faceVertexCounts", "faceVertexIndices", "curveVertexCounts", "holeIndices", "creaseIndices",
     "creaseLengths", "creaseSharpnesses", "cornerIndices", "cornerSharpnesses", "protoIndices", "positions", "indices")
)


class Names:
    """What is to be done with properties, by name: made out once for each of the few names of a stage."""

    def __init__(self, request):
        self.is_wanted = matcher(request["attributes"])
        self.is_listed = matcher(request["values_not_needed"])
        self.known = {}

    def get(self, name):
        known = self.known.get(name)
        if known is None:
            known = self.known[name] = Name(name, self.is_wanted(name), self.is_listed(name))
        return known


class Name:
    def __init__(self, name, is_wanted, is_listed):
        self.is_read = is_wanted and not is_listed
        self.is_kept = is_wanted or is_listed
        self.is_listed = is_listed
        self.is_op = name.startswith("xformOp")  # they know neither connections nor color spaces
        self.is_primvar = name.startswith("primvars:")
        self.is_plain = name in PLAIN
        self.is_inbetween = name.startswith("inbetweens:")
        self.is_binding = name.startswith("material:binding")
        # tokens of geometry have no color space
        self.may_have_space = ":" in name and not self.is_op
        # the order of transforms has one type in all schemas
        self.type = ("token[]", True, False, False) if name == "xformOpOrder" else None


class Loader:
    """One load: walks a stage and fills the index and the arrays."""

    def __init__(self, stage, time, request):
        self.stage = stage
        self.time = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
        self.names = Names(request)
        self.arrays = Arrays()
        self.values = 0  # read so far in this load
        self.varying = []  # (attribute, name, entry) of what has to be read anew at another time
        self.is_settled = False
        self.prims = []
        # Prototype paths are numbered anew in order of first use: usd-core's own numbers may differ between runs.
        self.prototypes = []
        self.prototype_numbers = {}
        self.prototype_paths = {}
        self.types = {}  # spelling, is an array, may have a color space, has one; by type name
        self.contents = {}  # see `content_of`
        self.has_materialx = any(
            asset.lower().endswith(".mtlx")
            for layer in stage.GetUsedLayers()
            for asset in layer.GetCompositionAssetDependencies()
        )

    def walk(self):
        self.walk_range(Usd.PrimRange.Stage(self.stage, Usd.PrimDefaultPredicate))
        stage_prims = len(self.prims)
        roots = []
        done = 0
        while done < len(self.prototypes):
            roots.append(len(self.prims))
            self.walk_range(Usd.PrimRange(self.prototypes[done], Usd.PrimDefaultPredicate))
            done += 1
        for prim in self.prims:
            if "prototype" in prim:
                prim["prototype"] = roots[prim["prototype"]]
        for prim in self.prims if roots else ():
            if not prim["path"].startswith("/__Prototype_"):
                continue
            prim["path"] = self.stage_path(prim["path"])
            for targets in prim.get("relationships", {}).values():
                targets[0] = [self.stage_path(target) for target in targets[0]]
            for attribute in prim.get("attributes", {}).values():
                if "connections" in attribute:
                    attribute["connections"] = [self.stage_path(path) for path in attribute["connections"]]
        return stage_prims

    def move_to(self, time):
        """Read again, at `time`, what varies; everything else stays as it is."""
        if not self.is_settled:
            for prim in self.prims:
                for entry in prim.get("attributes", {}).values():
                    for value in (entry.get("value"), entry.get("held", [None, None])[1]):
                        if value and "array" in value:
                            value["kept"] = value.pop("array")
            self.is_settled = True
        self.time = Usd.TimeCode(time)
        self.arrays = Arrays()
        self.values = 0
        for attribute, name, entry in self.varying:
            value = self.value(attribute, attribute.GetTypeName().isArray, False)
            if value is None:
                entry.pop("value", None)
            else:
                entry["value"] = value
            if "held" in entry:
                entry["held"] = self.held(attribute)

    def walk_range(self, prim_range):
        parents = []  # indices of the ancestors of the prim at hand
        walk = iter(prim_range)
        base = None
        for prim in walk:
            path = get_path(prim)
            depth = path.pathElementCount
            if base is None:
                base = depth
            del parents[depth - base :]
            index = len(self.prims)
            entry = self.prim_entry(prim, str(path))
            if parents:
                entry["parent"] = parents[-1]
            self.prims.append(entry)
            parents.append(index)

    def prim_entry(self, prim, path):
        type_name = get_type_name(prim)
        entry = {"path": path, "type": type_name}
        schemas = get_schemas(prim)
        if schemas:
            entry["schemas"] = [str(schema) for schema in schemas]
        kind = get_metadata(prim, "kind")
        if kind:
            entry["kind"] = str(kind)
        if is_instance(prim):
            entry["prototype"] = self.prototype_number(get_prototype(prim))
        if self.has_materialx and (prim.HasAuthoredReferences() or prim.HasAuthoredPayloads()):
            documents = self.materialx_entry(prim)
            if documents:
                entry["materialx"] = documents
        moved = ()
        if type_name == "PointInstancer":
            inactive = prim.GetMetadata("inactiveIds")
            if inactive:
                entry["inactive_ids"] = list(inactive.GetAddedOrExplicitItems())
            moved = MOVED if self.moves(prim) else ()
        attributes, relationships, unread = {}, {}, []
        names = self.names
        for item in get_properties(prim):
            name = get_name(item)
            what = names.get(name)
            if item.__class__ is RELATIONSHIP:
                relationships[name] = self.relationship_entry(item, what)
            elif what.is_kept or name in moved:
                attributes[name] = self.attribute_entry(item, name, what, name in moved)
            else:
                unread.append(name)
        for key, value in (("attributes", attributes), ("relationships", relationships), ("unread", unread)):
            if value:
                entry[key] = value
        return entry

    @staticmethod
    def materialx_entry(prim):
        """References to MaterialX documents, strongest first: usd-core without its plug-in cannot compose them."""
        found = []
        for spec in prim.GetPrimStack():
            for items in (spec.referenceList, spec.payloadList):
                for item in items.GetAddedOrExplicitItems():
                    if item.assetPath.lower().endswith(".mtlx"):
                        path = spec.layer.ComputeAbsolutePath(item.assetPath)
                        path = Ar.GetResolver().Resolve(path).GetPathString() or path
                        found.append([path, str(item.primPath)])
        return found

    def prototype_number(self, prototype):
        known = self.prototype_numbers.get(prototype)
        if known is None:
            known = self.prototype_numbers[prototype] = len(self.prototypes)
            self.prototype_paths[str(prototype.GetPath())] = known
            self.prototypes.append(prototype)
        return known

    def stage_path(self, path):
        match = PROTOTYPE.match(path)
        if not match or match.group() not in self.prototype_paths:
            return path
        return "/__Prototype_%d%s" % (self.prototype_paths[match.group()] + 1, path[match.end() :])

    @staticmethod
    def relationship_entry(relationship, what):
        targets = [str(target) for target in get_targets(relationship)]
        strength = get_metadata(relationship, "bindMaterialAs") if what.is_binding else None
        return [targets, str(strength) if strength else None]

    def moves(self, prim):
        """True for an instancer `prim` with velocities, asked for at a time."""
        if self.time.IsDefault():
            return False
        return any(prim.GetAttribute(name).HasAuthoredValue() for name in MOVERS)

    def held(self, attribute):
        """Time and value of the last sample up to the time, or of the first of all; None without samples."""
        bracket = attribute.GetBracketingTimeSamples(self.time.GetValue())
        value = attribute.Get(bracket[0]) if bracket else None
        if value is None:
            return None
        self.values += 1
        return [number(bracket[0]), array_value(value, self.arrays)]

    def type_of(self, attribute):
        """See `self.types`."""
        type_name = get_value_type(attribute)
        known = self.types.get(type_name)
        if known is None:
            spelling = str(type_name)
            has_space = spelling.startswith(("color", "asset"))
            may_have_space = spelling.startswith(("token", "string"))
            known = self.types[type_name] = (spelling, type_name.isArray, may_have_space, has_space)
        return known

    def attribute_entry(self, attribute, name, what, is_moved):
        spelling, is_array, may_have_space, has_space = what.type or self.type_of(attribute)
        entry = {"type": spelling}
        if not what.is_op:
            if has_connections(attribute):
                entry["connections"] = [str(path) for path in attribute.GetConnections()]
            if is_array or what.is_primvar:
                interpolation = get_metadata(attribute, "interpolation")
                if interpolation:
                    entry["interpolation"] = str(interpolation)
                if not what.is_plain and has_metadata(attribute, "elementSize"):
                    entry["element_size"] = get_metadata(attribute, "elementSize")
                if what.is_inbetween and has_metadata(attribute, "weight"):
                    entry["weight"] = number(get_metadata(attribute, "weight"))
            if (has_space or may_have_space and what.may_have_space) and has_color_space(attribute):
                entry["color_space"] = str(attribute.GetColorSpace())
        if is_moved:
            held = self.held(attribute)
            if held:
                entry["held"] = held
        is_default = get_resolve_info(attribute).GetSource() == DEFAULT_SOURCE
        if not is_default and might_vary(attribute):
            entry["varying"] = True
        if what.is_read or is_moved and not what.is_listed:
            value = self.value(attribute, is_array, is_default)
            if value is not None:
                entry["value"] = value
            elif not is_default and attribute.GetNumTimeSamples():
                entry["varying"] = True
            if "varying" in entry:
                self.varying.append((attribute, name, entry))
        return entry

    def value(self, attribute, is_array, is_default):
        # A fallback is not authored: a time-sampled attribute has none at the default time, a blocked one never.
        # Where a default is the strongest opinion at other times, it is at the default time too.
        if not is_default and get_resolve_info(attribute, self.time).GetSource() in FALLBACK_SOURCES:
            return None
        value = get_value(attribute, self.time)
        if value is None:
            return None
        self.values += 1
        if is_array:
            return array_value(value, self.arrays)
        kind = value.__class__
        if kind is ASSET_PATH:
            return asset_value(attribute, self.time, value)
        contents = self.contents
        if kind not in contents:
            contents[kind] = content_of(kind)
        spelled = contents[kind]
        return spelled(value) if spelled else None


# Relationships and connections whose targets a masked prim needs besides itself.
NEEDED_RELATIONSHIPS = ("material:binding", "prototypes", "skel:", "products", "orderedVars", "camera")


class Worker:
    def __init__(self):
        self.path = None
        self.root = None
        self.scratch = []
        self.stages = {}
        self.kept = None  # (what was asked for, loader, number of prims outside prototypes)
        self.delegate = UsdUtils.CoalescingDiagnosticDelegate()

    def open(self, request):
        self.scratch = request["scratch"]
        self.path = request["open"]
        self.root = Sdf.Layer.FindOrOpen(self.path)
        if self.root is None:
            raise FileNotFoundError("usd-core finds no layer there")
        return {}

    def stage(self, mask, composition):
        key = json.dumps([mask, composition])
        if key not in self.stages:
            self.stages.clear()  # one population at a time: the frames of a job share theirs
            self.stages[key] = self.composed(mask, composition)
        return self.stages[key]

    def composed(self, mask, composition):
        load = Usd.Stage.LoadNone if composition["load"] == "none" else Usd.Stage.LoadAll
        session = self.session(composition)
        muted = composition["muted"]
        for layer in muted:
            if not Ar.GetResolver().Resolve(Sdf.ComputeAssetPathRelativeToLayer(self.root, layer)):
                raise FileNotFoundError("usd-core finds no layer %s to mute" % layer)
        population = Usd.StagePopulationMask([Sdf.Path(path) for path in mask]) if mask else Usd.StagePopulationMask.All()
        if muted:
            # nothing is populated before that: what muted layers bring in is not even opened
            stage = Usd.Stage.OpenMasked(self.root, session, Usd.StagePopulationMask(), load)
            stage.MuteAndUnmuteLayers(muted, [])
            stage.SetPopulationMask(population)
        else:
            stage = Usd.Stage.OpenMasked(self.root, session, population, load)
        return self.widened(stage, population) if mask else stage

    @staticmethod
    def session(composition):
        path = composition["session"]
        if path is None:
            session = Sdf.Layer.CreateAnonymous("session.usda")
        else:
            session = Sdf.Layer.FindOrOpen(path)
            if session is None:
                raise FileNotFoundError("usd-core finds no session layer %s" % path)
            if session.dirty:
                session.Reload(True)
        for prim, variant_set, choice in composition["variants"]:
            Sdf.CreatePrimInLayer(session, prim).variantSelections[variant_set] = choice
        return session

    @staticmethod
    def variant_outcome(stage, path, variant_set, choice):
        prim = stage.GetPrimAtPath(path)
        if not prim or not prim.IsDefined() or not prim.IsLoaded():
            return ["prim", []]
        sets = prim.GetVariantSets()
        if variant_set not in sets.GetNames():
            return ["set", sorted(sets.GetNames())]
        variants = sets.GetVariantSet(variant_set).GetVariantNames()
        if choice not in variants:
            return ["variant", sorted(variants)]
        return ["instance" if prim.IsInstanceProxy() else "applied", []]

    def widened(self, stage, population):
        while True:
            wider = population
            for path in self.needed_outside(stage):
                if not wider.IncludesSubtree(path):
                    wider = wider.GetUnion(path)
            if wider == population:
                return stage
            population = wider
            stage.SetPopulationMask(population)

    @staticmethod
    def needed_outside(stage):
        """Prim paths that the populated prims point at: their materials, prototypes, skeletons, shader inputs."""
        predicate = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
        for prim in Usd.PrimRange.Stage(stage, predicate):
            for item in prim.GetAuthoredProperties():
                if isinstance(item, Usd.Relationship):
                    targets = item.GetTargets() if item.GetName().startswith(NEEDED_RELATIONSHIPS) else []
                    # a collection's own members are chosen, not needed
                    targets = [target for target in targets if target.IsPrimPath()]
                else:
                    targets = item.GetConnections() if item.HasAuthoredConnections() else []
                for target in targets:
                    yield target.GetPrimPath()

    def load(self, request):
        composition = request["composition"]
        stage = self.stage(request["mask"], composition)
        time = request.pop("time")
        key = None if time is None or not request["keep"] else json.dumps(request, sort_keys=True)
        is_fresh = key is None or self.kept is None or self.kept[0] != key
        if is_fresh:
            loader = Loader(stage, time, request)
            stage_prims = loader.walk()
            self.kept = (key, loader, stage_prims) if key else None
        else:
            _, loader, stage_prims = self.kept
            loader.move_to(time)
        return {
            "fresh": is_fresh,
            "read": loader.values,
            "meta": stage_meta(stage),
            "variants": [self.variant_outcome(stage, *choice) for choice in composition["variants"]],
            "prims": loader.prims,
            "prototype_start": stage_prims,
            "arrays": loader.arrays.write(self.scratch),
            "size": loader.arrays.size,
        }

    def validate(self):
        """What USD's own validators say of the whole stage."""
        version = ".".join(str(part) for part in Usd.GetVersion()[1:])
        try:
            from pxr import UsdValidation
        except ImportError:  # before usd-core 25
            return self.check_compliance(version)
        stage = Usd.Stage.Open(self.root, Usd.Stage.LoadAll)
        validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
        complaints = []
        for error in UsdValidation.ValidationContext(validators).Validate(stage):
            sites = list(error.GetSites())
            objects = [site.GetProperty() if site.IsProperty() else site.GetPrim() for site in sites if site.IsValid()]
            places = [str(item.GetPath()) for item in objects if item]
            complaints.append(
                {
                    "name": str(error.GetName()),
                    "is_error": error.GetType() == UsdValidation.ValidationErrorType.Error,
                    "place": places[0] if places else "/",
                    "message": " ".join(error.GetMessage().split()),
                }
            )
        return {
            "validators": "UsdValidation of usd-core " + version,
            "count": len(validators),
            "complaints": complaints,
        }

    def check_compliance(self, version):
        checker = UsdUtils.ComplianceChecker(skipARKitRootLayerCheck=True)
        checker.CheckCompliance(self.path)
        found = [(text, True) for text in checker.GetErrors() + checker.GetFailedChecks()]
        found += [(text, False) for text in checker.GetWarnings()]
        complaints = [
            {"name": "ComplianceChecker", "is_error": is_error, "place": "/", "message": " ".join(text.split())}
            for text, is_error in found
        ]
        return {
            "validators": "UsdUtils.ComplianceChecker of usd-core " + version,
            "count": 1,
            "complaints": complaints,
        }

    def warnings(self):
        return sorted({item.commentary.strip() for item in self.delegate.TakeUncoalescedDiagnostics()})

    def answer(self, request):
        try:
            if "open" in request:
                result = self.open(request)
            elif "validate" in request:
                result = self.validate()
            else:
                result = self.load(request["load"])
            result["warnings"] = self.warnings()
            return {"ok": result}
        except Tf.ErrorException as problem:
            return {"error": "; ".join(str(getattr(error, "commentary", error)).strip() for error in problem.args)}
        except FileNotFoundError as problem:
            return {"error": "; ".join([str(problem)] + self.warnings())}


def stage_meta(stage):
    def authored(name, convert):
        return convert(stage.GetMetadata(name)) if stage.HasAuthoredMetadata(name) else None

    def numeric(name):
        return authored(name, number)

    ranged = stage.HasAuthoredTimeCodeRange()
    rate = numeric("timeCodesPerSecond")
    return {
        "up_axis": authored("upAxis", str),
        "meters_per_unit": numeric("metersPerUnit"),
        "default_prim": authored("defaultPrim", str),
        "start_time_code": number(stage.GetStartTimeCode()) if ranged else None,
        "end_time_code": number(stage.GetEndTimeCode()) if ranged else None,
        "time_codes_per_second": rate if rate is not None else numeric("framesPerSecond"),
        "render_settings_prim_path": authored("renderSettingsPrimPath", str),
        # anonymous layers (the session's) have no name that means anything outside this process
        "layers": sorted(layer.identifier for layer in stage.GetUsedLayers() if not layer.anonymous),
        "unloaded": unloaded(stage),
    }


def unloaded(stage):
    """Prims whose payloads are not loaded, those below instances under the first of them."""
    if stage.GetLoadRules() == Usd.StageLoadRules.LoadAll():
        return []
    wanted = Usd.PrimIsActive & Usd.PrimIsDefined & ~Usd.PrimIsAbstract
    found = []
    for root in [stage.GetPseudoRoot()] + stage.GetPrototypes():
        for prim in Usd.PrimRange(root, wanted):
            if prim.HasAuthoredPayloads() and not prim.IsLoaded():
                found.append(str(prim.GetPath()))
    return found


def main():
    worker = Worker()
    reply({"ok": {"usd": ".".join(str(part) for part in Usd.GetVersion()), "numpy": numpy.__version__}})
    for line in REQUESTS:
        reply(worker.answer(json.loads(line)))
    # surflux is gone; if it could not clean up after itself, do it here
    for folder in worker.scratch:
        shutil.rmtree(folder, ignore_errors=True)


main()
