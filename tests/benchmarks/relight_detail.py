"""Error and texels read of sharp and wide lobes by `detail`, against every cell of 256 x 512.

    python tests/benchmarks/relight_detail.py [FOLDER with city.exr, courtyard.exr, studio.exr]

Display PSNR of a metal of F0 1, 300 random normals and views; the worst of the maps. Last the irradiance of 3,000
normals by the number of clusters, a row a map (mean at mid grey).
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from relight_speed import env, pixels

from yesnt.core.color import srgb_encode
from yesnt.relight import EnvMap, prepare_light
from yesnt.relight.combine import normalise
from yesnt.relight.kernels import IRRADIANCE, METAL_F0, METAL_F90, sum_lobes
from yesnt.relight.texel_lod import LEAST_COSINE, TAIL

COUNT = 300
EVERY_CELL = 1e-9


def seen(px, light, detail):
    """Display colour [P, 3]."""
    part = slice(0, COUNT)
    sums = normalise(sum_lobes(px.lobes(part, "default"), replace(light, detail=detail), None, None), px, part)
    return np.clip(srgb_encode(sums[:, METAL_F0] + sums[:, METAL_F90]), 0, 1)


def texels_read(px, light, detail):
    """Mean over pixels of the texels that texel_lod.choose_levels asks for."""
    alpha, cos_o = px.lobes(slice(0, COUNT), "default").alpha, px.cos_o[:, None]
    mirror, facing = 2 * cos_o * px.normal - px.view, px.normal @ light.cone[:3]
    core = 2 * alpha[:, None] * np.maximum(cos_o, LEAST_COSINE)
    away = np.maximum(np.sqrt(np.maximum(2 - 2 * mirror @ light.cone[:3], 0)) - light.cone[3], 0)
    bearable = detail * (core + away) * (1 + TAIL * away / core)
    level = (light.texels.size[:-1, None] > bearable).sum(0)
    held = 8 * np.diff(light.texels.start, axis=1)
    read = held[level, np.arange(held.shape[1])] * (facing > -light.cone[3])
    whole = (light.clusters.solid_angle <= bearable**2) & (np.abs(facing) > light.cone[3])
    return np.where(whole, facing > 0, read).sum(1).mean()


def irradiance(px, light):
    """[P, 3]."""
    part = slice(0, len(px.index))
    return normalise(sum_lobes(px.lobes(part, "default"), light, None, None), px, part)[:, IRRADIANCE]


def show_irradiance(env_map):
    """Display PSNR to every cell."""
    px, full = pixels(3000, np.float32(0.6)), prepare_light(env_map, 131072, 512, 256, 32)
    truth = irradiance(px, full)
    cells = []
    for clusters in (512, 256, 64):
        found = irradiance(px, prepare_light(env_map, 2048, clusters, 256, 32))
        shown = [srgb_encode(np.clip(a * (0.5 / truth.mean()), 0, 1)) for a in (found, truth)]
        cells.append(f"{clusters}: {-10 * np.log10(np.square(shown[0] - shown[1]).mean()):.1f} dB")
    print("irradiance by clusters ", ", ".join(cells), flush=True)


def main(folder):
    maps = [env(), *(EnvMap.open(path) for path in sorted(folder.glob("*.exr")) if path.stem != "capture")]
    lights = [prepare_light(m, 2048, 256, 256, 32) for m in maps]
    print(
        f"{len(maps)} maps; every cell: {texels_read(pixels(COUNT, np.float32(0)), lights[0], EVERY_CELL):.0f} texels"
    )
    for roughness in (0.0, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7):
        px = pixels(COUNT, np.float32(roughness))
        px = replace(px, metallic=px.metallic + 1)
        full = [seen(px, light, EVERY_CELL) for light in lights]
        for detail in (0.3, 0.45, 0.6, 0.9):
            errors = [np.square(seen(px, light, detail) - f).mean() for light, f in zip(lights, full, strict=True)]
            worst, read = -10 * np.log10(max(*errors, 1e-12)), texels_read(px, lights[0], detail)
            print(f"roughness {roughness:.2f}  detail {detail:.2f}  {worst:5.1f} dB  {read:5.0f} texels", flush=True)
    for env_map in maps:
        show_irradiance(env_map)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
