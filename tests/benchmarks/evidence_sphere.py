"""Materials of a painted sphere by the number of cameras, and the cost of the evidence against its NumPy reference.

    python tests/benchmarks/evidence_sphere.py [SIZE]

Pictures come from a sum in float64 that shares no kernel with yesnt (tests/decompose/evidence/scenes.py).
"""

import resource
import sys
import time
from dataclasses import replace

import numba
import numpy as np

from tests.decompose.evidence.scenes import RELIGHT, around, inputs, smooth_light
from yesnt.decompose.evidence import fit, reference
from yesnt.decompose.evidence.frame import measure_frame
from yesnt.decompose.evidence.records import Observations, Responses
from yesnt.decompose.evidence.settings import METALLIC, ROUGHNESS, EvidenceSettings
from yesnt.relight import EnvMap
from yesnt.relight.envmap import uv_to_direction
from yesnt.relight.frame import prepare_capture

PAINT = (
    (0.35, 0.0, (0.5, 0.2, 0.1)), (0.5, 1.0, (0.8, 0.6, 0.3)), (0.85, 0.0, (0.2, 0.35, 0.5)),
    (0.35, 1.0, (0.7, 0.7, 0.75)), (0.6, 0.0, (0.7, 0.6, 0.5)), (0.4, 0.5, (0.6, 0.6, 0.6)),
)  # fmt: skip
SETTINGS = EvidenceSettings()


def smooth_noise(at, scale, rng, width):
    """Smooth random fields [..., width] of unit variance over points [..., 3]."""
    waves = [(rng.normal(size=3), rng.uniform(0, 2 * np.pi), rng.normal(size=width)) for _ in range(12)]
    total = sum(np.sin(at @ (2 * np.pi / scale * k / np.linalg.norm(k)) + p)[..., None] * a for k, p, a in waves)
    return total / total.std()


def peak():
    """Peak resident memory so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def spoilt(given, env, seed=0):
    """Normals off by 5 degrees, 1 % noise, a map wrong by 10 %: in what the evidence is given, not in the truth."""
    rng = np.random.default_rng(seed)
    normal = given.surface.normal.astype(float)
    tilted = normal + np.tan(np.radians(5)) / np.sqrt(3) * smooth_noise(normal, 0.5, rng, 3)
    tilted *= (given.surface.opacity > 0)[..., None] / np.linalg.norm(tilted, axis=-1, keepdims=True)
    rows, columns, _ = env.radiance.shape
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    wrong = env.radiance * np.clip(1 + 0.1 * smooth_noise(uv_to_direction(u, v), 1.5, rng, 1), 0.3, 2)

    def noisy(image):
        return (image * (1 + 0.01 * rng.normal(size=image.shape))).astype(np.float32)

    return replace(
        given, plate=noisy(given.plate), surface=replace(given.surface, normal=tilted.astype(np.float32)),
        views=[replace(view, radiance=noisy(view.radiance)) for view in given.views],
        light=prepare_capture(EnvMap.from_array(wrong), RELIGHT),
    )  # fmt: skip


def errors(given, truth):
    """RMSE of roughness and of metallic, mean number of views, seconds."""
    begin = time.perf_counter()
    found = measure_frame(given, RELIGHT, SETTINGS)
    seconds = time.perf_counter() - begin
    inside = given.surface.opacity > 0.5
    pair = zip(found.mean, (truth.roughness, truth.metallic), strict=True)
    return [np.sqrt(np.square(a - b)[inside].mean()) for a, b in pair], found.views[inside].mean(), seconds


def accuracy(size):
    """Prints the table of docs/evidence.md."""
    print("| light | cameras | roughness / metallic | spoilt | views of a pixel |\n|---|---|---|---|---|")
    for name, strength in (("smooth directional", 0.8), ("15 % of it", 0.15)):
        env = smooth_light(strength)
        for count in (1, 4, 8, 16):
            given, truth = inputs(around(count), env, size, PAINT)
            (clean, views, _), (other, _, _) = errors(given, truth), errors(spoilt(given, env), truth)
            texts = [" / ".join(f"{value:.3f}" for value in pair) for pair in (clean, other)]
            print(f"| {name} | {count} | {texts[0]} | {texts[1]} | {views:.1f} |")


def plain(normal, view, painted, env):
    """Quick colours: a frame of 500 x 500 is measured for its cost alone."""
    return painted.base * (0.6 + 0.4 * normal[:, 2:3])


def cost():
    """Prints the cost of a frame as large as 960 x 540 with a third covered, and the fit's ratio to its reference."""
    measure_frame(inputs(around(2), smooth_light(), 24)[0], RELIGHT, SETTINGS)  # compiles
    given, _ = inputs(around(12), smooth_light(), 500, PAINT, shade=plain)
    before, cpu, wall = peak(), time.process_time(), time.perf_counter()
    found = measure_frame(given, RELIGHT, SETTINGS)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    points, views = int((found.views > 0).sum()), found.views[found.views > 0].mean()
    print(f"\n{points} points, {views:.1f} views of 12 cameras: {cpu:.1f} processor seconds ({wall:.1f} s on "
          f"{numba.get_num_threads()} threads), peak {peak():.0f} MB ({before:.0f} before)")  # fmt: skip
    print(f"{1e3 * cpu / points:.3f} ms a point, {1e3 * cpu / points / views:.4f} ms a point and view")
    rng, shape = np.random.default_rng(0), (2000, 6, len(ROUGHNESS), 3)
    of = Responses(*(rng.random(shape, np.float32) for _ in range(4)), rng.random(shape[:3], np.float32),
                   np.full(len(ROUGHNESS), 0.8, np.float32))  # fmt: skip
    radiance = rng.random((*shape[:2], 3), np.float32)
    seen = Observations(radiance, 0.06 * radiance + np.float32(0.004), np.ones(shape[:2], bool))
    spent = []
    for run in (fit.negative_log_likelihood, reference.negative_log_likelihood):
        run(seen, of, SETTINGS)
        begin = time.process_time()
        run(seen, of, SETTINGS)
        spent.append(time.process_time() - begin)
    candidates = len(ROUGHNESS) * len(METALLIC)
    fast, slow = (1e3 * seconds / 2000 for seconds in spent)
    print(f"fit of {candidates} candidates: {fast:.3f} ms a point, {slow / fast:.0f} times faster than NumPy")


if __name__ == "__main__":
    size = int(sys.argv[1]) if len(sys.argv) > 1 else 64
    accuracy(size)
    cost()
