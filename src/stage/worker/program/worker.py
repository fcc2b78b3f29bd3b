"""The worker: opens and composes the stage, answers requests."""

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
