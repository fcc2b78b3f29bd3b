"""Embree (PyPI `embreex`, one ray at a time, one thread) on the geometry and rays of `cargo bench --bench rays`.

    SURFLUX_BENCH_DATA=folder cargo bench --bench rays
    python tests/bench/embree_rival.py folder

Prints millions of rays a second, the best and the median of seven runs, and how many rays hit. The time includes
embreex's loop over the rays in C and its copying of each ray and result.
"""

import statistics
import sys
import time
from pathlib import Path

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

RUNS = 7


def load(path, *shape):
    return np.fromfile(path, dtype="<f4").reshape(-1, *shape)


def scene_of(triangles):
    start = time.perf_counter()
    scene = rtcore_scene.EmbreeScene()
    mesh = TriangleMesh(scene, triangles)
    # the first query commits the scene
    scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
    return scene, mesh, time.perf_counter() - start


def main(folder):
    for shape in ("box", "ball"):
        triangles = load(folder / f"{shape}_triangles.f32", 3, 3)
        scene, mesh, seconds = scene_of(triangles)
        print(f"{shape}: {len(triangles)} triangles, built in {seconds:.3f} s")
        for order in ("local", "world"):
            rays = load(folder / f"{shape}_{order}_rays.f32", 2, 3)
            origins, directions = (np.ascontiguousarray(rays[:, i]) for i in (0, 1))
            for query in ("INTERSECT", "OCCLUDED"):
                times = []
                for _ in range(RUNS):
                    start = time.perf_counter()
                    hits = scene.run(origins, directions, query=query)
                    times.append(time.perf_counter() - start)
                count = int((hits >= 0).sum()) if query == "INTERSECT" else int((hits != -1).sum())
                best, middle = (len(rays) / t / 1e6 for t in (min(times), statistics.median(times)))
                print(f"  {query.lower():9} {order:5} {best:6.2f} (median {middle:.2f}) Mray/s, {count} of {len(rays)} hit")
        del mesh


if __name__ == "__main__":
    main(Path(sys.argv[1]))
