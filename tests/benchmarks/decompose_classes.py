"""Mean error of the embedded model by material class, on images that are not used for training.

python tests/benchmarks/decompose_classes.py FOLDER [--people 20] [--objects 40] [--weights FILE]

People and objects of seed 1 are rendered below FOLDER; bodies come from FOLDER/bodies (`make train` makes
them) or from `.venv-anny`. The training's seed is 0, so these are other clothes, poses, shapes, cameras and lights; the
24 bodies are the same. For each class: pixels, mean of the truth, mean error (estimate less truth; 0.05 is asked for),
root mean square error, and root mean square of the spread; roughness first, then metallic.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from yesnt.capture_stage.tools import anny_only
from yesnt.decompose.embedded import EmbeddedBackend
from yesnt.decompose.ensemble import estimate_frame
from yesnt.decompose.registry import EMBEDDED_WEIGHTS
from yesnt.decompose.settings import EnsembleSettings
from yesnt.training.bodies import make_bodies
from yesnt.training.image_archive import (
    interleaved_people,
    make_object,
    make_person,
    object_path,
    open_views,
    person_path,
)
from yesnt.training.synthetic.materials import CLASSES

SEED = 1


def archive(folder, people, objects):
    """Archive files, rendered if they do not exist."""
    numbers = interleaved_people()[:people]
    if people:
        bodies = make_bodies(0, folder / "bodies", anny_only(folder))
        for number in numbers:
            make_person(folder, SEED, number, bodies)
    for number in range(objects):
        make_object(folder, SEED, number)
    return [person_path(folder, SEED, n) for n in numbers] + [object_path(folder, SEED, n) for n in range(objects)]


def evaluated(path, backend, members):
    """Of each view: class, error [2], truth [2] and squared spread [2] of the pixels wholly inside the matte."""
    for number, view in enumerate(open_views(path)):
        rgb, matte, truth = (np.asarray(plane, np.float32) for plane in (view.rgb, view.matte, view.truth))
        matte = matte.reshape(matte.shape[-2:])
        found = estimate_frame(rgb.transpose(1, 2, 0), matte, backend, EnsembleSettings(members), 0, number)
        inside = (matte > 0.99) & (view.kind >= 0)
        error = found.mean[:, inside] - truth[:, inside]
        yield view.kind[inside], error, truth[:, inside], found.std[:, inside] ** 2


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--people", type=int, default=20)
    parser.add_argument("--objects", type=int, default=40)
    parser.add_argument("--weights", type=Path, default=EMBEDDED_WEIGHTS)
    parser.add_argument("--samples", type=int, default=4)
    options = parser.parse_args()
    torch.set_num_threads(1)
    backend = EmbeddedBackend(options.weights, steps=2)
    found = [part for path in archive(options.folder, options.people, options.objects)
             for part in evaluated(path, backend, options.samples)]  # fmt: skip
    kind, error, truth, square = (np.concatenate(planes, -1) for planes in zip(*found, strict=True))
    titles = ("truth", "mean error", "RMSE", "spread")
    print("class".ljust(18), "pixels".rjust(9), *(f"{plane} {t}".rjust(12) for plane in "rm" for t in titles))
    for name, chosen in [*((n, kind == i) for i, n in enumerate(CLASSES)), ("all", kind >= 0)]:
        if not chosen.any():
            continue
        figures = [
            figure
            for p in (0, 1)
            for figure in (
                truth[p, chosen].mean(),
                error[p, chosen].mean(),
                np.sqrt((error[p, chosen] ** 2).mean()),
                np.sqrt(square[p, chosen].mean()),
            )
        ]
        print(name.ljust(18), f"{chosen.sum():9d}", *(f"{figure:12.3f}" for figure in figures))


if __name__ == "__main__":
    main()
