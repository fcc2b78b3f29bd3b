"""Random legal stages through the native door: it may refuse none that usd-core opens without a complaint.

    target/test-venv/bin/python tests/native_refusals.py SURFLUX [COUNT [FIRST [FOLDER]]]

SURFLUX is the program. Stages FIRST to FIRST + COUNT (default 500 from 0) are made in FOLDER (default: a temporary one):
text and binary layers, some in packages, some with relocates. They are
opened with usd-core; those it has nothing to say about are read by `SURFLUX info --usd native`. Prints each refusal; exit
code 1 if there is any. Nothing has to be built for it. `COMPLAINTS=1` prints what usd-core complains of most.
"""
import collections
import concurrent.futures
import os
import pathlib
import random
import subprocess
import sys
import tempfile

from pxr import Sdf, Tf, Usd, UsdUtils

CHILDREN = ["a", "b", "c"]
SHAPES = ["Xform", "Scope", "Mesh", "Cube", "Sphere", "Camera", "SphereLight", "BasisCurves", ""]


class Maker:
    """The stage of one seed: libraries /L0, /L1 … in each layer refer to earlier ones only, so that nothing is circular."""

    def __init__(self, seed, folder):
        self.random = random.Random(seed)
        self.folder = pathlib.Path(folder)
        self.layers = self.random.choice([1, 2, 3])
        self.libraries = [self.random.choice([1, 2, 2]) for _ in range(self.layers)]
        # apart, so that what the layers hold does not depend on how they are stored
        self.storage = random.Random("storage %d" % seed)
        self.extensions = [self.storage.choice(["usda", "usda", "usdc"]) for _ in range(self.layers)]
        self.is_package = self.storage.random() < 0.2
        self.moves = self.storage.random() < 0.4

    def chance(self, share):
        return self.random.random() < share

    def write(self):
        """Layers from the last one on: each may refer to those after it. The path of the root layer, or of the package."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self.sublayered = [i for i in range(1, self.layers) if self.chance(0.4)]
        for layer in reversed(range(self.layers)):
            self.store(self.folder / self.name(layer), self.layer(layer))
        return self.packed() if self.is_package else self.folder / self.name(0)

    @staticmethod
    def store(path, text):
        if path.suffix == ".usda":
            path.write_text(text)
            return
        # relocates take a newer version of the format than usd-core begins with, as it says each time
        _silent = UsdUtils.CoalescingDiagnosticDelegate()
        layer = Sdf.Layer.CreateAnonymous(".usda")
        layer.ImportFromString(text)
        layer.Export(str(path))

    def packed(self):
        path = self.folder / "all.usdz"
        with Sdf.ZipFileWriter.CreateNew(str(path)) as package:
            for layer in range(self.layers):
                package.AddFile(str(self.folder / self.name(layer)), self.name(layer))
        return path

    def name(self, layer):
        return "l%d.%s" % (layer, self.extensions[layer])

    def relocates(self):
        """What the prims of the world have from elsewhere, moved."""
        moved = []
        for i in range(self.storage.choice([1, 2])):
            to = self.storage.choice(["</W/moved%d>" % i, "</W/w%d/moved>" % i])
            moved.append("</W/w%d/%s>: %s" % (i, self.storage.choice(CHILDREN), to))
        return "relocates = { %s }" % ", ".join(moved)

    def layer(self, layer):
        meta = ['defaultPrim = "L0"']
        if layer == 0:
            meta += ['upAxis = "%s"' % self.random.choice("YZ"), "metersPerUnit = 0.01", "timeCodesPerSecond = 24"]
            if self.sublayered:
                offset = " (offset = 2; scale = 0.5)" if self.chance(0.3) else ""
                paths = ["@./%s@%s" % (self.name(i), offset) for i in self.sublayered]
                meta.append("subLayers = [%s]" % ", ".join(paths))
            if self.moves:
                meta.append(self.relocates())
        prims = [self.library(layer, k) for k in range(self.libraries[layer])]
        if layer == 0:
            prims.append(self.world())
        return "#usda 1.0\n(\n    %s\n)\n\n%s" % ("\n    ".join(meta), "\n".join(prims))

    def targets(self, layer, below):
        """Prims that the library `below` of `layer` may bring in."""
        found = ["</L%d>" % k for k in range(max(below - 1, 0), below)]
        for other in range(layer + 1, self.layers):
            if other not in self.sublayered and layer not in self.sublayered:
                found += ["@./%s@" % self.name(other), "@./%s@</L0/a>" % self.name(other)]
        return found

    def library(self, layer, number):
        specifier = "class" if self.chance(0.2) else "def"
        children = "".join(self.prim(layer, number, child, 1) for child in CHILDREN)
        return '%s Xform "L%d"\n{\n%s%s}\n' % (specifier, number, self.properties("Xform"), children)

    def world(self):
        body = []
        for i in range(self.random.choice([2, 4, 6])):
            body.append(self.prim(0, self.libraries[0], "w%d" % i, 1))
        return 'def Xform "W"\n{\n%s}\n' % "".join(body)

    def arcs(self, layer, below, depth):
        targets = self.targets(layer, below)
        if not targets or self.chance(0.4 if depth == 1 else 0.9):
            return []
        internal = [target for target in targets if target.startswith("<")]
        arcs = []
        for kind in self.random.sample(["references", "payload", "inherits", "specializes"], self.random.choice([1, 1, 2])):
            among = targets if kind in ("references", "payload") else internal
            if not among:
                continue
            chosen = self.random.sample(among, min(len(among), self.random.choice([1, 1, 2])))
            if kind in ("references", "payload") and self.chance(0.2):
                chosen[0] += " (offset = 3)"
            operation = self.random.choice(["prepend ", "append ", ""])
            arcs.append("%s%s = [%s]" % (operation, kind, ", ".join(chosen)))
        return arcs

    def prim(self, layer, below, name, depth):
        shape = self.random.choice(SHAPES)
        meta = self.arcs(layer, below, depth)
        variants = ""
        if self.chance(0.15):
            meta += ['variants = { string v = "%s" }' % self.random.choice("xy"), 'prepend variantSets = "v"']
            inner = []
            for choice in "xy":
                more = self.arcs(layer, below, depth)
                inner.append('"%s"%s {\n%s}\n' % (choice, self.parenthesis(more), self.properties("Xform")))
            variants = 'variantSet "v" = {\n%s}\n' % "".join(inner)
        if meta and self.chance(0.25):
            meta.append("instanceable = true")
        if self.chance(0.05):
            meta.append("active = false")
        if self.chance(0.1):
            meta.append('kind = "%s"' % self.random.choice(["component", "group", "subcomponent"]))
        specifier = "over" if self.chance(0.1) else "def"
        children = ""
        if depth < 3 and self.chance(0.5):
            names = self.random.sample(CHILDREN, self.random.choice([1, 2]))
            children = "".join(self.prim(layer, below, child, depth + 1) for child in names)
        body = self.properties(shape) + variants + children
        return '%s %s "%s"%s\n{\n%s}\n' % (specifier, shape, name, self.parenthesis(meta), body)

    @staticmethod
    def parenthesis(meta):
        return " (\n%s\n)" % "\n".join(meta) if meta else ""

    def properties(self, shape):
        lines = []
        if self.chance(0.5):
            value = "(%d, 0, 1)" % self.random.randrange(9)
            sampled = "double3 xformOp:translate.timeSamples = { 1: %s, 5: (1, 2, 3), 7: None }" % value
            lines.append(sampled if self.chance(0.3) else "double3 xformOp:translate = " + value)
            lines.append('uniform token[] xformOpOrder = [%s"xformOp:translate"]' % self.random.choice(["", '"!resetXformStack!", ']))
        if self.chance(0.2):
            lines.append('token visibility = "%s"' % self.random.choice(["inherited", "invisible"]))
        if self.chance(0.2):
            lines.append('uniform token purpose = "%s"' % self.random.choice(["render", "proxy", "guide"]))
        if self.chance(0.2):
            lines.append("rel material:binding = %s" % self.random.choice(["</L0/a>", "[]", "None"]))
        if self.chance(0.2):
            lines.append('custom string note = "%s"' % self.random.choice(["", "ä €", "a\\tb", "it's"]))
        if self.chance(0.2):
            lines.append("color3f[] primvars:displayColor = [(1, 0.5, 0)] ( interpolation = \"constant\" )")
        if self.chance(0.1):
            lines += ["float inputs:x = 1", "float inputs:x.connect = </L0/a.outputs:y>"]
        if self.chance(0.1):
            lines.append("custom asset where = @./nothing.png@")
        if shape == "Mesh":
            lines += ["point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]", "int[] faceVertexCounts = [3]"]
            lines.append("int[] faceVertexIndices = [0, 1, 2]")
        if shape == "BasisCurves":
            lines += ['uniform token type = "linear"', "point3f[] points = [(0, 0, 0), (1, 0, 0)]"]
            lines += ["int[] curveVertexCounts = [2]", "float[] widths = [0.1] ( interpolation = \"constant\" )"]
        return "".join(line + "\n" for line in lines)


def complaints_of_usd(path):
    """What usd-core complains of in the stage at `path`, walked to the last prim."""
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        stage = Usd.Stage.Open(str(path))
        for _ in stage.Traverse(Usd.TraverseInstanceProxies()):
            pass
    except Tf.ErrorException as problem:
        return [str(problem)]
    complaints = [str(error) for error in stage.GetCompositionErrors()]
    return complaints + [item.commentary for item in delegate.TakeUncoalescedDiagnostics()]


def refusal(program, path):
    """Why the native door does not read the stage at `path`; empty where it does."""
    run = subprocess.run([program, "info", "--usd", "native", "--json", str(path)], capture_output=True, text=True)
    return run.stderr.strip() or "exit code %d" % run.returncode if run.returncode else ""


def main():
    program = sys.argv[1]
    count, first = [int(number) for number in (sys.argv[2:4] + ["500", "0"][len(sys.argv[2:4]) :])]
    folder = pathlib.Path(sys.argv[4] if len(sys.argv) > 4 else tempfile.mkdtemp())
    clean, packages, relocated = [], 0, 0
    kinds = collections.Counter()
    for seed in range(first, first + count):
        maker = Maker(seed, folder / str(seed))
        path = maker.write()
        complaints = complaints_of_usd(path)
        kinds.update(complaint.split("\n")[0][:60] for complaint in complaints)
        if not complaints:
            clean.append(path)
            packages += maker.is_package
            relocated += maker.moves
    refused = 0
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        for path, problem in zip(clean, pool.map(lambda path: refusal(program, path), clean)):
            if problem:
                refused += 1
                print("%s: %s" % (path, problem))
    print("%d stages, %d without a complaint of usd-core, %d of those refused" % (count, len(clean), refused))
    print("of those %d are packages, and %d have relocates" % (packages, relocated))
    if os.environ.get("COMPLAINTS"):
        print(kinds.most_common(12))
    sys.exit(refused > 0)


main()
