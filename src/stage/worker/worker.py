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
UDIM = "<UDIM>"
PROTOTYPE = re.compile(r"/__Prototype_[0-9]+(?=[/.]|$)")
FALLBACK_SOURCES = (Usd.ResolveInfoSourceFallback, Usd.ResolveInfoSourceNone)
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
                with os.fdopen(handle, "wb") as file:
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
        while self.items:
            offset, array = self.items[-1]
            if array.nbytes:
                file.seek(offset)
                file.write(array.reshape(-1).view(numpy.uint8).data)
            file.flush()
            self.items.pop()


def scalar_value(value):
    """One value that is not an array, as {kind: content}; None when surflux has no use for its type."""
    if isinstance(value, bool):
        return {"bool": value}
    if isinstance(value, int):
        return {"int": min(value, LARGEST_INT)}
    if isinstance(value, float):
        return {"float": number(value)}
    if isinstance(value, str):
        return {"token": value}
    kind = type(value).__name__
    if kind == "TimeCode":
        return {"float": number(value.GetValue())}
    if kind == "PathExpression":
        return {"token": value.GetText()}
    if kind.startswith("Vec"):
        return {"vector": components(value)}
    if kind.startswith("Quat"):
        return {"quat": components(value.GetImaginary()) + [number(value.GetReal())]}
    if kind == "Matrix4d":
        return {"matrix": [number(value[row, column]) for row in range(4) for column in range(4)]}
    return None


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


def array_value(value, arrays):
    """A Vt array as {"array": [offset, type, shape]} or {"tokens": [...]}; None for kinds without use."""
    kind = type(value).__name__
    if kind in ("TokenArray", "StringArray"):
        # iterating ends in an exception, which takes long for the many short ones (xformOpOrder)
        few = len(value) <= 16
        return {"tokens": [value[i] for i in range(len(value))] if few else list(value)}
    if kind == "AssetPathArray":
        return {"tokens": [asset.resolvedPath or asset.path for asset in value]}
    if kind == "TimeCodeArray":  # an array of objects before usd-core 25
        array = numpy.array([time.GetValue() for time in value], dtype="<f8")
    else:
        array = numpy.asarray(value)
    name = array.dtype.str[1:]
    kept = KEPT_AS.get("b" if name == "b1" else name)
    if kept is None:
        return None
    shape = list(array.shape)
    if kind == "Matrix4dArray":
        kept = "f8"
    elif len(shape) == 2:
        kept = "f4"  # int2[] and the like have no integer form in surflux
    elif len(shape) > 2:
        return None
    if array.dtype.str[1:] != kept:
        # values out of range become infinities here and are refused where they are used
        with numpy.errstate(over="ignore", invalid="ignore"):
            array = array.astype("<" + kept)
    width = 1
    for extent in shape[1:]:
        width *= extent
    quaternions = "q" if kind.startswith("Quat") else ""
    return {"array": [arrays.add(array), quaternions + kept, shape[0], width]}


def matcher(patterns):
    exact = frozenset(pattern for pattern in patterns if not pattern.endswith("*"))
    starts = tuple(pattern[:-1] for pattern in patterns if pattern.endswith("*"))
    return lambda name: name in exact or name.startswith(starts)


# What moves the points of a PointInstancer between samples, if it has one of the movers.
MOVED = ("positions", "velocities", "accelerations", "orientations", "orientationsf", "angularVelocities", "scales")
MOVERS = ("velocities", "angularVelocities")


class Loader:
    """One load: walks a stage and fills the index and the arrays."""

    def __init__(self, stage, time, request):
        self.stage = stage
        self.time = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
        self.wants = matcher(request["attributes"])
        self.name_only = matcher(request["values_not_needed"])
        self.arrays = Arrays()
        self.values = 0  # read so far in this load
        self.varying = []  # (attribute, name, entry) of what has to be read anew at another time
        self.is_settled = False
        self.prims = []
        # Prototype paths are numbered anew in order of first use: usd-core's own numbers may differ between runs.
        self.prototypes = []
        self.prototype_numbers = {}
        self.types = {}  # spelling, is an array, may have a color space; by type name
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
            prim["path"] = self.stage_path(prim["path"])
            if "prototype" in prim:
                prim["prototype"] = roots[prim["prototype"]]
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
            path = prim.GetPath()
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
        type_name = prim.GetTypeName()
        entry = {"path": path, "type": type_name}
        schemas = prim.GetAppliedSchemas()
        if schemas:
            entry["schemas"] = [str(schema) for schema in schemas]
        kind = prim.GetMetadata("kind")
        if kind:
            entry["kind"] = str(kind)
        if prim.IsInstance():
            entry["prototype"] = self.prototype_number(prim.GetPrototype())
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
        for item in prim.GetAuthoredProperties():
            name = item.GetName()
            if isinstance(item, Usd.Relationship):
                relationships[name] = self.relationship_entry(item, name)
            elif self.wants(name) or self.name_only(name) or name in moved:
                attributes[name] = self.attribute_entry(item, name, name in moved)
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
        path = str(prototype.GetPath())
        if path not in self.prototype_numbers:
            self.prototype_numbers[path] = len(self.prototypes)
            self.prototypes.append(prototype)
        return self.prototype_numbers[path]

    def stage_path(self, path):
        match = PROTOTYPE.match(path)
        if not match or match.group() not in self.prototype_numbers:
            return path
        return "/__Prototype_%d%s" % (self.prototype_numbers[match.group()] + 1, path[match.end() :])

    @staticmethod
    def relationship_entry(relationship, name):
        targets = [str(target) for target in relationship.GetTargets()]
        strength = relationship.GetMetadata("bindMaterialAs") if name.startswith("material:binding") else None
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
        type_name = attribute.GetTypeName()
        known = self.types.get(type_name)
        if known is None:
            spelling = str(type_name)
            has_space = spelling.startswith(("color", "asset", "token", "string"))
            known = self.types[type_name] = (spelling, type_name.isArray, has_space)
        return known

    def attribute_entry(self, attribute, name, is_moved):
        spelling, is_array, has_space = self.type_of(attribute)
        entry = {"type": spelling}
        is_op = name.startswith("xformOp")  # they know neither connections nor color spaces
        if not is_op and attribute.HasAuthoredConnections():
            entry["connections"] = [str(path) for path in attribute.GetConnections()]
        if is_array and not is_op or name.startswith("primvars:"):
            interpolation = attribute.GetMetadata("interpolation")
            if interpolation:
                entry["interpolation"] = str(interpolation)
            if attribute.HasAuthoredMetadata("elementSize"):
                entry["element_size"] = attribute.GetMetadata("elementSize")
            if name.startswith("inbetweens:") and attribute.HasAuthoredMetadata("weight"):
                entry["weight"] = number(attribute.GetMetadata("weight"))
        if has_space and not is_op and attribute.HasColorSpace():
            entry["color_space"] = str(attribute.GetColorSpace())
        if is_moved:
            held = self.held(attribute)
            if held:
                entry["held"] = held
        source = attribute.GetResolveInfo().GetSource()
        is_default = source == Usd.ResolveInfoSourceDefault
        if not is_default and attribute.ValueMightBeTimeVarying():
            entry["varying"] = True
        if (self.wants(name) or is_moved) and not self.name_only(name):
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
        if not is_default and attribute.GetResolveInfo(self.time).GetSource() in FALLBACK_SOURCES:
            return None
        value = attribute.Get(self.time)
        if value is None:
            return None
        self.values += 1
        if is_array:
            return array_value(value, self.arrays)
        if isinstance(value, Sdf.AssetPath):
            return asset_value(attribute, self.time, value)
        return scalar_value(value)


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
