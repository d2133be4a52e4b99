"""Materials of six objects that Cycles rendered, by the number of cameras. Needs Blender (`make blender`).

    python tests/benchmarks/evidence_objects.py [FOLDER [SEED]]

A box, balls, a ring and a pill occlude and mirror one another; one ball is a half metal. Seed 0 has the materials of
`OBJECTS`; others draw them. Pictures, kept in FOLDER, are 96 x 96 with 64 samples. The guess is roughness 0.5 and
metallic 0.3 everywhere.
"""

import json
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import trimesh
from trimesh.transformations import rotation_matrix

from tests.benchmarks.evidence_errors import LADDER, with_errors
from tests.benchmarks.evidence_sphere import SETTINGS
from tests.decompose.evidence.scenes import FRAME, around, look_from, smooth_light
from yesnt.capture_stage.tools import find_tools, run_script
from yesnt.decompose.evidence.frame import EvidenceInputs, measure_frame
from yesnt.decompose.evidence.records import View
from yesnt.io.exr import write_exr
from yesnt.io.pictures.image import read_image
from yesnt.relight import ProxyScene, RelightSettings, Surface
from yesnt.relight.frame import prepare_capture

SIZE, DISTANCE = 96, 4.4
LIGHTS = {"smooth": 0.8, "even": 0.15}
OBJECTS = (
    ("box", 0.25, 0.0, (0.5, 0.1, 0.08)),
    ("ball", 0.2, 1.0, (0.75, 0.75, 0.78)),
    ("ring", 0.45, 1.0, (0.85, 0.6, 0.25)),
    ("pill", 0.85, 0.0, (0.12, 0.25, 0.5)),
    ("egg", 0.4, 0.0, (0.7, 0.62, 0.5)),
    ("knob", 0.3, 0.5, (0.5, 0.5, 0.5)),
)
"""Name, roughness, metallic, base colour."""

PLACES = (
    (-0.45, 0, -0.45), (0.05, -0.35, -0.1), (0.5, 0, 0.3), (-0.35, 0.1, 0.05), (0.55, -0.2, -0.4), (0.05, -0.2, 0.45),
)  # fmt: skip
GIVEN = ((1, "exact", "none"), (4, "exact", "none"), (8, "exact", "none"), *((8, "coarse", rung) for rung in LADDER))
"""Number of cameras, proxy, errors."""

AS_GIVEN = replace(SETTINGS, gain_error=0.0, light_error=0.0)
"""Settings that take gains and map as they are."""

TWICE = ("none", "map 10 %", "gain 5 %", "all")
"""Rungs that are measured without the corrections too."""


def materials(seed):
    """Roughness, metallic and base colour of the six objects: of `OBJECTS`, or drawn."""
    if seed == 0:
        return [entry[1:] for entry in OBJECTS]
    rng = np.random.default_rng(seed)
    metallic = rng.permutation([0, 0, 0, 1, 1, rng.choice([0, 1, rng.uniform(0.2, 0.8)])])
    roughness = rng.permutation(np.linspace(0.1, 0.95, 6) + rng.uniform(-0.07, 0.05, 6))
    lowest = np.where(metallic > 0.5, 0.45, 0.03)[:, None]
    grey, tint = rng.uniform(lowest, 0.85, (6, 1)), rng.uniform(0.6, 1.1, (6, 3))
    return list(zip(roughness.tolist(), metallic.tolist(), (grey * tint).tolist(), strict=True))


def meshes(detail=1):
    """The objects; `detail` 0 is a coarse proxy of 2,000 triangles."""
    ball, sections = (5, (96, 40)) if detail else (2, (28, 12))
    box = trimesh.creation.box((0.7, 0.5, 0.6))
    box.apply_transform(rotation_matrix(0.5, [0, 0, 1]))
    ring = trimesh.creation.torus(0.3, 0.11, major_sections=sections[0], minor_sections=sections[1])
    ring.apply_transform(rotation_matrix(1.1, [1, 0.3, 0]))
    pill = trimesh.creation.capsule(0.7, 0.2, count=[48, 48] if detail else [14, 14])
    balls = [trimesh.creation.icosphere(ball, radius) for radius in (0.32, 0.28, 0.2)]
    found = [box, balls[0], ring, pill, balls[1], balls[2]]
    for mesh, place in zip(found, PLACES, strict=True):
        mesh.apply_translation(place)
    return found


def cameras():
    return [look_from(way, SIZE, DISTANCE) for way in ([0, -1, 0.15], *around(8))]


def render(folder, seed):
    """Renders what the folder lacks."""
    if all((folder / f"{name}.8.exr").exists() for name in LIGHTS):
        return
    folder.mkdir(parents=True, exist_ok=True)
    entries = [
        {"name": name, "vertices": mesh.vertices.tolist(), "faces": mesh.faces.tolist(), "roughness": roughness,
         "metallic": metallic, "base": base, "smooth": name != "box"}
        for (name, *_), (roughness, metallic, base), mesh in zip(OBJECTS, materials(seed), meshes(), strict=True)
    ]  # fmt: skip
    poses = [camera.poses[FRAME].tolist() for camera in cameras()]
    scene = {"size": SIZE, "fx": cameras()[0].fx, "objects": entries, "poses": poses}
    (folder / "scene.json").write_text(json.dumps(scene))
    for name, strength in LIGHTS.items():
        radiance = smooth_light(strength, 32).radiance
        write_exr(folder / f"{name}.exr", {c: np.ascontiguousarray(radiance[..., i]) for i, c in enumerate("RGB")})
    script = Path(__file__).parent / "inside_blender/evidence_scene.py"
    run_script(find_tools(folder / "cache"), script, [str(folder), ",".join(LIGHTS)], 1800)


@cache
def geometry():
    """The proxy with exact normals, and the object of every triangle."""
    vertices, faces, normals, owner = [], [], [], []
    for number, mesh in enumerate(meshes()):
        flat = OBJECTS[number][0] == "box"
        points = mesh.triangles.reshape(-1, 3) if flat else mesh.vertices
        corners = np.arange(len(points)) if flat else mesh.faces
        faces.append(corners.reshape(-1, 3) + sum(map(len, vertices)))
        vertices.append(points)
        normals.append(np.repeat(mesh.face_normals, 3, axis=0) if flat else mesh.vertex_normals)
        owner += [number] * len(mesh.faces)
    scene = ProxyScene.from_arrays(np.concatenate(vertices), np.concatenate(faces))
    return scene, np.concatenate(normals), np.array(owner)


def surface_of(camera):
    """z, normals and object [H, W] of what a camera sees; -1 for none."""
    scene, normals, owner = geometry()
    rays = camera.rays(FRAME).astype(float).reshape(-1, 3)
    length = np.linalg.norm(rays, axis=1)
    eye = np.broadcast_to(camera.position(FRAME).astype(np.float32), rays.shape)
    hit = scene.trace(np.ascontiguousarray(eye), (rays / length[:, None]).astype(np.float32))
    face, known = np.maximum(hit["primID"], 0), hit["primID"] >= 0
    u, v = hit["u"][:, None], hit["v"][:, None]
    corner = normals[scene.faces[face]]
    normal = corner[:, 0] * (1 - u - v) + corner[:, 1] * u + corner[:, 2] * v
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    z, shown = np.where(known, hit["tfar"] / length, 1e10), np.where(known, owner[face], -1)
    image = np.where(known[:, None], normal, 0).reshape(SIZE, SIZE, 3).astype(np.float32)
    return z.reshape(SIZE, SIZE).astype(np.float32), image, shown.reshape(SIZE, SIZE)


def picture(folder, name, number):
    """Straight colour and coverage of a rendered picture."""
    planes = read_image(folder / f"{name}.{number}.exr").channels
    alpha = planes["A"]
    color = np.stack([planes[c] for c in "RGB"], axis=-1) / np.maximum(alpha, 1e-6)[..., None]
    return np.where(alpha[..., None] > 0, color, 0).astype(np.float32), alpha


def inputs_of(folder, name, count, proxy):
    """Inputs of the evidence, and the object of every pixel."""
    rig = cameras()
    z, normal, shown = surface_of(rig[0])
    color, alpha = picture(folder, name, 0)
    full, matte = np.ones_like(z), np.where(shown >= 0, alpha, 0).astype(np.float32)
    surface = Surface(normal, z, matte, 0.5 * full, 0.3 * full, rig[0], FRAME)
    chosen = {1: (4,), 4: (1, 3, 5, 7), 8: range(1, 9)}[count]
    views = [View(f"c{i}", rig[i], FRAME, *picture(folder, name, i)) for i in chosen]
    light = prepare_capture(smooth_light(LIGHTS[name], 32), RelightSettings())
    return EvidenceInputs(color, surface, np.stack([0.1 * full, 0.1 * full]), views, proxy, light), shown


def main(folder, seed):
    render(folder, seed)
    coarse = trimesh.util.concatenate(meshes(0))
    proxies = {"exact": geometry()[0], "coarse": ProxyScene.from_arrays(coarse.vertices, coarse.faces)}
    print("| light | cameras | proxy | errors | roughness RMSE | metallic RMSE | AUC | within 1 std | sparsification |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, strength in LIGHTS.items():
        for count, proxy, rung in GIVEN:
            given, shown = inputs_of(folder, name, count, proxies[proxy])
            given = with_errors(given, smooth_light(strength, 32), seed, **LADDER[rung])
            label = f"{name} | {count} | {proxy} | {rung}"
            row(label, given, shown, seed)
            if count == 8 and proxy == "coarse" and rung in TWICE:
                row(f"{label}, no corrections", given, shown, seed, AS_GIVEN)


def sparsification(wrong, std):
    """Area between the curve of the error and its best, over that of a random order: 0 is perfect, 1 tells nothing."""

    def curve(order):
        kept = np.arange(1, len(wrong) + 1)
        return np.sqrt(np.cumsum(np.square(wrong[order])) / kept).mean()

    best, flat = curve(np.argsort(np.abs(wrong))), np.sqrt(np.square(wrong).mean())
    return (curve(np.argsort(std, kind="stable")) - best) / (flat - best)


def row(label, given, shown, seed, settings=SETTINGS):
    found = measure_frame(given, RelightSettings(), settings)
    inside = (shown >= 0) & (given.surface.opacity > 0.99)
    truth = np.array([entry[:2] for entry in materials(seed)])[shown[inside]].T
    wrong, std = found.mean[:, inside] - truth, found.std[:, inside]
    rmse = np.sqrt(np.square(wrong).mean(axis=1))
    within = (np.abs(wrong) <= np.maximum(std, 1e-3)).mean(axis=1)
    metal, other = (found.mean[1][inside][mask] for mask in (truth[1] > 0.6, truth[1] < 0.4))
    auc = (metal[:, None] > other[None]).mean() + 0.5 * (metal[:, None] == other[None]).mean()
    order = " / ".join(f"{sparsification(*pair):.2f}" for pair in zip(wrong, std, strict=True))
    print(f"| {label} | {rmse[0]:.3f} | {rmse[1]:.3f} | {auc:.3f} | {within[0]:.2f} / {within[1]:.2f} | {order} |",
          flush=True)  # fmt: skip


if __name__ == "__main__":
    arguments = [*sys.argv[1:], *(".cache/evidence_objects", "0")[len(sys.argv) - 1 :]]
    main(Path(arguments[0]), int(arguments[1]))
