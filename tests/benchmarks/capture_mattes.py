"""Mattes of a `multiview` subject before structured backgrounds: each way to make them, alone and with the hull.

    python -m tests.benchmarks.capture_mattes STAGE/multiview/boxer --weights mediapipe/modules --picture mattes.png

Prints the table of docs/capture.md: IoU, that of the worst camera in brackets, and by how many pixels the edge is off
in the mean (absent where no matte has an edge). Without `--weights` the rows with persons are left out.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from tests.benchmarks.matte_data import Recorded, recorded, reduced_rig
from yesnt.capture.consistent import support_of
from yesnt.capture.matting import changed, clean_background, combined, display_levels, median_background, refined
from yesnt.capture.person import Models, View, find_models, person_probability
from yesnt.core.color import srgb_encode

MOMENT = 0


def edge_of(matte):
    inside = (matte > 0.5).astype(np.uint8)
    return inside - cv2.erode(inside, np.ones((3, 3), np.uint8))


def edge_error(matte, truth) -> float:
    """Mean distance between the edges of two mattes, both ways, pixels; NaN where one is empty."""
    edges = [edge_of(one) for one in (matte, truth)]
    if not all(edge.any() for edge in edges):
        return float("nan")
    away = [cv2.distanceTransform(1 - edge, cv2.DIST_L2, 5) for edge in edges]
    return float(0.5 * (away[0][edges[1] > 0].mean() + away[1][edges[0] > 0].mean()))


def agreement(matte, truth) -> float:
    inside, wanted = matte > 0.5, truth > 0.5
    return float((inside & wanted).sum() / max((inside | wanted).sum(), 1))


def probabilities(one: Recorded, models: Models | None) -> dict[str, np.ndarray]:
    """Probability of the subject in a camera's picture, by each way."""
    picture = one.pictures[MOMENT]
    found = {
        "clean plate": changed(picture, clean_background(one.clean)),
        "median, walks through": changed(picture, median_background(one.walking)),
        "median, stays": changed(picture, median_background(one.pictures)),
    }
    if models is None:
        return found
    up = one.camera.pose(None)[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    view = View((float(up[0]), float(up[1])), (0.5 * one.camera.width, 0.5 * one.camera.height))
    persons = np.stack([person_probability(shown, view, models) for shown in one.walking])
    person, still = persons[MOMENT], len(one.pictures)
    walked = changed(picture, median_background(one.walking, persons))
    stayed = changed(picture, median_background(one.pictures, persons[:still]))
    return found | {
        "person": person, "clean plate and person": combined(found["clean plate"], person),
        "median and person, walks": combined(walked, person), "median and person, stays": combined(stayed, person),
    }  # fmt: skip


def mattes_of(cameras: list[Recorded], chances: Mapping[str, np.ndarray], with_hull: bool) -> list[np.ndarray]:
    levels = [display_levels(one.pictures[MOMENT]) for one in cameras]
    mattes = [refined(shown, chances[one.name]) for one, shown in zip(cameras, levels, strict=True)]
    if not with_hull:
        return mattes
    supports = support_of([one.silhouette(matte) for one, matte in zip(cameras, mattes, strict=True)])
    applied = [s.applied(chances[one.name]) for one, s in zip(cameras, supports, strict=True)]
    return [refined(shown, chance) for shown, chance in zip(levels, applied, strict=True)]


def scores(cameras: list[Recorded], mattes: list[np.ndarray]) -> str:
    pairs = [(matte, one.truth[MOMENT]) for one, matte in zip(cameras, mattes, strict=True)]
    shares, edges = [agreement(*pair) for pair in pairs], [edge_error(*pair) for pair in pairs]
    edge = "" if np.isnan(edges).all() else f", {np.nanmean(edges):.2f}"
    return f"{np.mean(shares):.3f} ({np.min(shares):.3f}){edge}"


def shown(one: Recorded, matte) -> np.ndarray:
    """The picture, red where the matte is too large, blue where it is too small."""
    picture = 0.6 * srgb_encode(one.pictures[MOMENT])
    inside, wanted = matte > 0.5, one.truth[MOMENT] > 0.5
    picture[inside & ~wanted], picture[wanted & ~inside] = (1, 0, 0), (0, 0.3, 1)
    return picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--cameras", type=int, nargs="+", default=[24, 8, 4])
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    models = None if options.weights is None else find_models(options.weights)
    rig, start = recorded(options.folder), time.process_time()
    chances = {one.name: probabilities(one, models) for one in rig}
    print(f"{time.process_time() - start:.0f} processor seconds for the probabilities of {len(rig)} cameras\n")
    rows, cells = [], {way: [] for way in next(iter(chances.values()))}
    for count in options.cameras:
        cameras = reduced_rig(rig, count)
        for way, line in cells.items():
            chosen = {one.name: chances[one.name][way] for one in cameras}
            both = [mattes_of(cameras, chosen, with_hull) for with_hull in (False, True)]
            line += [scores(cameras, mattes) for mattes in both]
            if count == options.cameras[0]:
                rows.append([shown(cameras[i], mattes[i]) for mattes in both for i in (0, 3, 6, 13)])
    heads = [f"{count} cameras, {kind}" for count in options.cameras for kind in ("each alone", "with the hull")]
    print("\n".join([f"| way | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]))
    print("\n".join(f"| {way} | {' | '.join(line)} |" for way, line in cells.items()))
    if options.picture is not None:
        grid = np.concatenate([np.concatenate(row, axis=1) for row in rows])
        cv2.imwrite(str(options.picture), (255 * np.clip(grid, 0, 1) + 0.5).astype(np.uint8)[..., ::-1])


if __name__ == "__main__":
    main()
