"""One load of a stage: the walk over its prims and properties."""

# Prims read at a time.
AT_ONCE = 256


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


class Columns:
    """Attributes that are read together."""

    def __init__(self):
        self.attributes = []
        self.whats = []  # see `Name`
        self.entries = []
        self.is_moved = []

    def add(self, attribute, what, entry, is_moved):
        self.attributes.append(attribute)
        self.whats.append(what)
        self.entries.append(entry)
        self.is_moved.append(is_moved)


class Loader:
    """One load: walks a stage and fills the index and the arrays."""

    def __init__(self, stage, time, request):
        self.stage = stage
        self.time = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
        self.names = Names(request)
        self.arrays = Arrays()
        self.values = 0  # read so far in this load
        self.varying = []  # (attribute, entry) of what has to be read anew at another time
        self.is_settled = False
        self.prims = []
        # Prototype paths are numbered anew in order of first use: usd-core's own numbers may differ between runs.
        self.prototypes = []
        self.prototype_numbers = {}
        self.prototype_paths = {}
        self.types = {}  # spelling, is an array, may have a color space, has one; by type name
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
        attributes = [attribute for attribute, _ in self.varying]
        is_absent = [source in FALLBACK_SOURCES for source in self.sources(attributes, self.time)]
        contents = self.contents(attributes, is_absent)
        for (attribute, entry), content in zip(self.varying, contents):
            if content is None:
                entry.pop("value", None)
            else:
                entry["value"] = content
            if "held" in entry:
                entry["held"] = self.held(attribute)

    def walk_range(self, prim_range):
        parents = []  # indices of the ancestors of the prim at hand
        walk = iter(prim_range)
        base = None
        for prims in iter(lambda: list(itertools.islice(walk, AT_ONCE)), []):
            index = len(self.prims)
            for entry in self.prim_entries(prims):
                depth = entry["path"].count("/")
                if base is None:
                    base = depth
                del parents[depth - base :]
                if parents:
                    entry["parent"] = parents[-1]
                parents.append(index)
                index += 1
                self.prims.append(entry)

    def prim_entries(self, prims):
        """Entries of `prims`, method by method: taking turns, the methods drive each other out of the processor's caches,
        and a walk takes twice as long."""
        paths = [path.pathString for path in list(map(get_path, prims))]
        entries = [{"path": path, "type": name} for path, name in zip(paths, list(map(get_type_name, prims)))]
        for entry, schemas in zip(entries, list(map(get_schemas, prims))):
            if schemas:
                entry["schemas"] = list(map(str, schemas))
        for entry, kind in zip(entries, list(map(get_kind, prims))):
            if kind:
                entry["kind"] = kind
        instances = [(entry, prim) for entry, prim, of in zip(entries, prims, list(map(is_instance, prims))) if of]
        prototypes = [get_prototype(prim) for _, prim in instances]
        for (entry, _), number in zip(instances, map(self.prototype_number, prototypes)):
            entry["prototype"] = number
        moved = {}
        for entry, prim in zip(entries, prims):
            if self.has_materialx and (prim.HasAuthoredReferences() or prim.HasAuthoredPayloads()):
                documents = self.materialx_entry(prim)
                if documents:
                    entry["materialx"] = documents
            if entry["type"] == "PointInstancer":
                inactive = prim.GetMetadata("inactiveIds")
                if inactive:
                    entry["inactive_ids"] = list(inactive.GetAddedOrExplicitItems())
                moved[id(entry)] = MOVED if self.moves(prim) else ()
        self.add_properties(prims, entries, moved)
        return entries

    def add_properties(self, prims, entries, moved):
        """Put the properties of `prims` into their `entries`; `moved` has the names that move, by identity of an entry."""
        ops, others = Columns(), Columns()
        names = self.names
        for entry, items in zip(entries, list(map(get_properties, prims))):
            attributes, relationships, unread = {}, {}, []
            moved_here = moved.get(id(entry), ())
            for item, name in zip(items, list(map(get_name, items))):
                what = names.get(name)
                if type(item) is RELATIONSHIP:
                    relationships[name] = self.relationship_entry(item, what)
                elif what.is_kept or name in moved_here:
                    made = attributes[name] = {}
                    (ops if what.is_op else others).add(item, what, made, name in moved_here)
                else:
                    unread.append(name)
            for key, value in (("attributes", attributes), ("relationships", relationships), ("unread", unread)):
                if value:
                    entry[key] = value
        self.add_ops(ops)
        self.add_others(others)

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

    def type_of(self, attribute, what):
        """See `self.types`."""
        if what.type:
            return what.type
        type_name = get_value_type(attribute)
        known = self.types.get(type_name)
        if known is None:
            spelling = str(type_name)
            has_space = spelling.startswith(("color", "asset"))
            may_have_space = spelling.startswith(("token", "string"))
            known = self.types[type_name] = (spelling, type_name.isArray, may_have_space, has_space)
        return known

    def add_ops(self, columns):
        """Transforms: no schema has a fallback for them, and none has anything but a type and a value."""
        attributes, entries = columns.attributes, columns.entries
        for entry, known in zip(entries, list(map(self.type_of, attributes, columns.whats))):
            entry["type"] = known[0]
        varies = list(map(might_vary, attributes))
        self.add_values(columns, varies, [False] * len(attributes))

    def add_others(self, columns):
        attributes, whats, entries = columns.attributes, columns.whats, columns.entries
        types = list(map(self.type_of, attributes, whats))
        for entry, known in zip(entries, types):
            entry["type"] = known[0]
        self.add_metadata(columns, types)
        for attribute, entry, is_moved in zip(attributes, entries, columns.is_moved):
            held = self.held(attribute) if is_moved else None
            if held:
                entry["held"] = held
        # A fallback is not authored: a time-sampled attribute has none at the default time, a blocked one never.
        # Where a default is the strongest opinion at other times, it is at the default time too.
        is_open = [source != DEFAULT_SOURCE for source in self.sources(attributes)]
        varies = [is_open and might_vary(attribute) for attribute, is_open in zip(attributes, is_open)]
        is_absent = [
            is_open and get_resolve_info(attribute, self.time).GetSource() in FALLBACK_SOURCES
            for attribute, is_open in zip(attributes, is_open)
        ]
        self.add_values(columns, varies, is_absent)

    @staticmethod
    def sources(attributes, *time):
        return list(map(get_source, [get_resolve_info(attribute, *time) for attribute in attributes]))

    @staticmethod
    def add_metadata(columns, types):
        attributes, whats, entries = columns.attributes, columns.whats, columns.entries
        for attribute, entry, connected in zip(attributes, entries, list(map(has_connections, attributes))):
            if connected:
                entry["connections"] = [str(path) for path in attribute.GetConnections()]
        for attribute, what, entry, (_, is_array, may_have_space, has_space) in zip(attributes, whats, entries, types):
            if (is_array or what.is_primvar) and not what.is_plain:
                interpolation = get_metadata(attribute, "interpolation")
                if interpolation:
                    entry["interpolation"] = str(interpolation)
                if has_metadata(attribute, "elementSize"):
                    entry["element_size"] = get_metadata(attribute, "elementSize")
                if what.is_inbetween and has_metadata(attribute, "weight"):
                    entry["weight"] = number(get_metadata(attribute, "weight"))
            if (has_space or may_have_space and what.may_have_space) and has_color_space(attribute):
                entry["color_space"] = str(attribute.GetColorSpace())

    def add_values(self, columns, varies, is_absent):
        attributes, whats, entries = columns.attributes, columns.whats, columns.entries
        is_read = [
            what.is_read or is_moved and not what.is_listed for what, is_moved in zip(whats, columns.is_moved)
        ]
        contents = self.contents(attributes, [absent or not read for absent, read in zip(is_absent, is_read)])
        for attribute, entry, content, varying, read in zip(attributes, entries, contents, varies, is_read):
            if content is not None:
                entry["value"] = content
            elif read and attribute.GetNumTimeSamples():
                varying = True
            if varying:
                entry["varying"] = True
                if read:
                    self.varying.append((attribute, entry))

    def contents(self, attributes, is_absent):
        """Values of `attributes` at the time of the load, spelled out; None where `is_absent` or without use."""
        time = self.time
        contents = [None] * len(attributes)
        values = [None if absent else get_value(attribute, time) for attribute, absent in zip(attributes, is_absent)]
        places = {}  # of values, by class
        for place, value in enumerate(values):
            if value is not None:
                places.setdefault(type(value), []).append(place)
        for kind, of_kind in places.items():
            self.values += len(of_kind)
            spelled = spelled_values(
                kind, [values[place] for place in of_kind], [attributes[place] for place in of_kind], time, self.arrays
            )
            for place, content in zip(of_kind, spelled):
                contents[place] = content
        return contents
