"""A frame is lit to the same bits by a process that compiles the kernels and by one that loads them from the cache.

LLVM reassociates sums in `fastmath` functions by their surroundings. A function that exists by itself beside the copies
in its callers therefore has several versions that differ in the last bit, and the linker takes whichever was loaded
first. So every function that only kernels call is part of its callers, and nothing is left to choose.
"""

import gc
import importlib
import os
import subprocess
import sys

import pytest
from numba.core.registry import CPUDispatcher

PROBE = """
import hashlib
import numpy as np
from tests.relight.scenes import box_mesh, sky, sphere, surface
from yesnt.relight import (
    FrameInputs, ProxyScene, RelightSettings, prepare_capture, prepare_relight, relight_frame, uniform_light,
)
gbuffer, cam = sphere((48, 48))
random = np.random.default_rng(0)
gbuffer.roughness[:] = random.random((48, 48))
gbuffer.metallic[:] = random.random((48, 48)) ** 3
settings = RelightSettings.from_quality("standard")
lights = prepare_relight(sky(32), settings), prepare_capture(uniform_light(), settings)
proxy = ProxyScene.from_arrays(*box_mesh((-1.4, -1.4, -1.2), (1.4, 1.4, -1.0)))
plate = np.full((48, 48, 3), 0.4, np.float32)
relit = relight_frame(FrameInputs(plate, surface(gbuffer, cam)), *lights, proxy, settings)
arrays = relit.base_color, relit.diffuse, relit.specular, relit.shadow
print(*(hashlib.sha256(np.ascontiguousarray(array)).hexdigest() for array in arrays))
"""


def test_functions_that_kernels_call_are_part_of_their_callers():
    importlib.import_module("yesnt.relight.frame")  # imports every module that holds a kernel
    ours = [
        d for d in gc.get_objects() if type(d) is CPUDispatcher and d.py_func.__module__.startswith("yesnt.relight")
    ]
    inner = [d for d in ours if d.targetoptions.get("no_cpython_wrapper")]
    assert len(inner) > 20
    for dispatcher in inner:
        options = dispatcher.targetoptions
        assert options.get("forceinline") or options.get("inline") == "always", dispatcher.py_func.__qualname__


@pytest.mark.slow
def test_compiling_and_loading_light_a_frame_to_the_same_bits(tmp_path):
    environment = {**os.environ, "YESNT_CACHE_DIR": str(tmp_path)}
    results = [
        subprocess.run(
            [sys.executable, "-c", PROBE], env=environment, capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    ]
    assert results[0] == results[1]
