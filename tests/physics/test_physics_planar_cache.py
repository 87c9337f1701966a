"""Compiling `planar` again, in another process, comes from JAX's persistent cache."""

import json
import os
import subprocess
import sys

_PROGRAM = """
import json, sys
import jax, numpy as np
from pgf_jax.physics.engine import World, make_engine

events = {"hits": 0, "misses": 0}
def count(name, **_):
    for kind in events:
        events[kind] += name == f"/jax/compilation_cache/cache_{kind}"
jax.monitoring.register_event_listener(count)
engine = make_engine("planar", n_objects=3, sizes=())
start = World(np.zeros((8, 3, 2)), np.zeros((8, 3, 2)), np.zeros((8, 3)), np.zeros(8))
start.objects[:, :, 0], start.objects[:, :, 1] = 0.35, (0.1, 0.0, -0.1)
controls = np.tile([0.1, 0.0, 0.0], (8, 8, 1))
before = dict(events)
out = engine.rollout(start, controls, np.zeros((8, 8)), engine.physics.substeps)
events = {k: events[k] - before[k] for k in events}
events["end"] = np.asarray(out.objects[0, -1]).tolist()
print(json.dumps(events))
"""


def run(folder) -> dict:
    environment = {
        **os.environ,
        "JAX_COMPILATION_CACHE_DIR": str(folder),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "0",
    }
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM], env=environment, capture_output=True, check=True
    )
    return json.loads(done.stdout)


def test_the_second_process_compiles_nothing(tmp_path):
    first, second = run(tmp_path), run(tmp_path)
    assert first["hits"] == 0 and first["misses"] >= 1
    assert second["misses"] == 0 and second["hits"] == first["misses"]
    assert second["end"] == first["end"]
