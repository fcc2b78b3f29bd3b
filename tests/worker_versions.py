"""The usd-core worker with the oldest and the newest usd-core: the same stage must give the same answers.

    python3.11 tests/worker_versions.py [VERSION ...]        (default: 24.3 24.11 25.11 26.11)

An environment for each version is made below target/usd-core-VERSION, once (0.4 GB each). Prints one line a version;
exit code 1 if an answer differs from that of the first version. Speaks to src/stage/worker/program directly, so
nothing has to be built. Python 3.11 is the newest that usd-core 24.3 has wheels for.
"""
import json
import pathlib
import subprocess
import sys
import tempfile
import venv

ROOT = pathlib.Path(__file__).resolve().parent.parent
PARTS = ["start", "values", "loader", "worker"]  # as in src/stage/worker/process.rs
PROGRAM = "".join((ROOT / ("src/stage/worker/program/%s.py" % part)).read_text() for part in PARTS)
VERSIONS = ["24.3", "24.11", "25.11", "26.11"]
ATTRIBUTES = ["points", "xformOp:*", "xformOpOrder", "faceVertexCounts", "faceVertexIndices", "primvars:*", "size"]

COMPOSITION = {"load": "all", "variants": [], "session": None, "muted": []}

PROP = """#usda 1.0
( defaultPrim = "p" )
def Xform "p"
{
    def Mesh "m"
    {
        point3f[] points = [(0, 0, 0), (0, 0, 1), (1, 0, 1)]
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        half[] primvars:h = [0.5, 0.25, 0.125] ( interpolation = "vertex" )
        quatf[] primvars:q = [(1, 2, 3, 4)]
    }
}
"""
SHOT = """#usda 1.0
( defaultPrim = "shot"
  metersPerUnit = 1
  upAxis = "Y" )
def Xform "shot"
{
    def "moved" ( payload = @./prop.usda@ )
    {
        double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 3: (0, 2, 0) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def "one" ( instanceable = true
                references = @./prop.usda@ )
    {
    }
    def "two" ( instanceable = true
                references = @./prop.usda@ )
    {
    }
    def Cube "chosen" ( variants = { string kind = "big" }
                        prepend variantSets = "kind" )
    {
        variantSet "kind" = {
            "big" {
                double size = 5
            }
        }
    }
    def "lost" ( references = @./gone.usda@ )
    {
    }
}
"""


def interpreter(version):
    folder = ROOT / "target" / ("usd-core-" + version)
    python = folder / "bin" / "python"
    if not (folder / "complete").exists():
        venv.create(folder, with_pip=True, clear=True)
        subprocess.run([python, "-m", "pip", "install", "-q", "usd-core==" + version, "numpy==1.26.4"], check=True)
        (folder / "complete").touch()
    return python


def answers(python, stage):
    """What the worker says to a first frame, two later ones and the default time, and whether it ends with its input."""
    worker = subprocess.Popen([python, "-c", PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    hello = json.loads(worker.stdout.readline())

    def ask(request):
        worker.stdin.write(json.dumps(request) + "\n")
        worker.stdin.flush()
        return json.loads(worker.stdout.readline())["ok"]

    with tempfile.TemporaryDirectory() as scratch:
        folder = pathlib.Path(scratch) / "arrays"
        folder.mkdir()
        ask({"open": str(stage), "scratch": [str(folder)]})
        found = []
        for time in (1.0, 2.0, 3.0, None):
            load = {"time": time, "mask": [], "attributes": ATTRIBUTES, "values_not_needed": []}
            loaded = ask({"load": {**load, "keep": True, "composition": COMPOSITION}})
            arrays = pathlib.Path(loaded["arrays"]).read_bytes().hex() if loaded["arrays"] else ""
            found.append([loaded["prims"], loaded["fresh"], loaded["read"], arrays, len(loaded["warnings"])])
        validators = ask({"validate": {}})["validators"]
        worker.stdin.close()
        ended = worker.wait(10) == 0 and not folder.exists()
    return hello["ok"]["usd"], validators, found, ended


def main():
    expected = None
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        stage = pathlib.Path(folder) / "shot.usda"
        stage.write_text(SHOT)
        (pathlib.Path(folder) / "prop.usda").write_text(PROP)
        for version in sys.argv[1:] or VERSIONS:
            usd, validators, found, ended = answers(interpreter(version), stage)
            expected = expected or found
            right = found == expected and ended
            failed |= not right
            reads = [load[2] for load in found]
            print("%-8s %s  values read at 1, 2, 3, default: %s  %s" % (usd, "ok" if right else "DIFFERS", reads, validators))
            if not right:
                print(json.dumps(found))
    sys.exit(failed)


main()
