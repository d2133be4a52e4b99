"""Direct light against Cycles' direct light, true materials and base colour: no shadow, single factor, per cluster.

    python tests/benchmarks/relight_direct.py STAGE/unmodelled [SUBJECT,...]

Subjects are folders whose truth was also rendered without bounces (`truth/bounces0_MAP.####.exr`). Display PSNR inside
the matte (opacity > 0.99), first frame.
"""

import sys
from pathlib import Path

import numpy as np
from relight_ladder import psnr, rgb

from yesnt.core.camera import Camera
from yesnt.core.color import straighten
from yesnt.io.mesh import read_mesh
from yesnt.io.pictures.image import read_image
from yesnt.relight import EnvMap, ProxyScene, RelightSettings, Surface, prepare_relight
from yesnt.relight.frame import finish, shade_pixels
from yesnt.relight.occlusion import find_occluders
from yesnt.relight.points import gather_pixels

WAYS = {"none": False, "single": "single", "clusters": True}


def subject(folder, frame):
    """Surface, base colour, plate and proxy of a frame."""
    plate, gbuffer, material = (
        read_image(folder / f"{name}.{frame}.exr").channels for name in ("plate", "gbuffer", "truth/material")
    )
    opacity = plate["A"].astype(np.float32)
    whole = np.where(opacity > 0, opacity, 1)
    normal = np.stack([gbuffer[f"N.{axis}"] for axis in "XYZ"], -1).astype(np.float32)
    rough, metal = material["roughness.Y"] / whole, material["metallic.Y"] / whole
    camera = Camera.open(folder / "camera.json")
    mesh = read_mesh(folder / f"proxy.{frame}.ply")
    surface = Surface(normal, gbuffer["depth.Z"], opacity, rough, metal, camera, frame)
    base = rgb(material, "base_color.") / whole[..., None]
    return surface, base, straighten(rgb(plate), opacity), ProxyScene.from_arrays(mesh.vertices, mesh.faces)


def relit(surface, base, plate, proxy, env, shadows):
    settings = RelightSettings(bounce=0, shadows=shadows)
    pixels = gather_pixels(surface)
    occluders, inside = find_occluders(surface, pixels, proxy, settings), pixels.index
    lit = shade_pixels(base.reshape(-1, 3)[inside], pixels, occluders, prepare_relight(env, settings), settings)
    return finish(lit, pixels.image(plate.reshape(-1, 3)[inside]), surface, settings).radiance


def main(root, names):
    scores = {way: [] for way in WAYS}
    for folder in sorted(root / name for name in names) if names else sorted(root.iterdir()):
        for path in sorted((folder / "truth").glob("bounces0_*.exr")):
            name, frame = path.name.removeprefix("bounces0_").split(".")[:2]
            truth = read_image(path).channels
            truth = straighten(rgb(truth), truth["A"].astype(np.float32))
            scene, env = subject(folder, int(frame)), EnvMap.open(folder / "env" / f"{name}.exr")
            matte = scene[0].opacity > 0.99
            found = {way: psnr(relit(*scene, env, shadows), truth, matte) for way, shadows in WAYS.items()}
            for way, value in found.items():
                scores[way].append(value)
            print(f"{folder.name} / {name}: " + ", ".join(f"{w} {v:.2f}" for w, v in found.items()), flush=True)
    print("mean: " + ", ".join(f"{way} {np.mean(values):.2f} dB" for way, values in scores.items()))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2].split(",") if len(sys.argv) > 2 else [])
