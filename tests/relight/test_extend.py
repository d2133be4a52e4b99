"""Light of edge pixels, extended outward; grain of the plate; a relit hair over ten backgrounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import laplace

from tests.relight.scenes import sphere, surface
from yesnt.core.color import straighten
from yesnt.relight import (
    EnvMap,
    FrameInputs,
    RelightSettings,
    prepare_capture,
    prepare_relight,
    relight_frame,
    uniform_light,
)
from yesnt.relight.extend import EDGE, SIDE, CapturedLight, extend_light
from yesnt.scene.composite import associate, over

F32 = NDArray[np.float32]
SHAPE = (12, 14)
DRAFT = RelightSettings.from_quality("draft", shadows=False)


def scene(seed: int = 0) -> tuple[F32, F32, CapturedLight, F32]:
    """Diffuse and specular light [H, W, 3], what was captured, and a coverage with a solid part, an edge and hair."""
    draw = np.random.default_rng(seed)
    diffuse, specular, captured, shiny, plate = (draw.uniform(0.1, 2, (*SHAPE, 3)).astype(np.float32) for _ in range(5))
    coverage = np.zeros(SHAPE, np.float32)
    coverage[:, :5], coverage[:, 5], coverage[4, 6:] = 1, draw.uniform(0.05, 0.9, SHAPE[0]), 0.1
    return diffuse, specular, CapturedLight(plate, captured, 0.2 * shiny), coverage


def reference(diffuse: F32, specular: F32, captured: CapturedLight, coverage: F32) -> tuple[F32, F32]:
    """The two equations at the head of relight/extend.py, pixel by pixel."""
    tap = {-1: SIDE, 0: 1 - 2 * SIDE, 1: SIDE}
    out = diffuse.astype(np.float64), specular.astype(np.float64)
    for y, x in np.argwhere((coverage > 0) & (coverage < EDGE)):
        near = [(y + i, x + j, tap[i] * tap[j]) for i in tap for j in tap]
        near = [(i, j, w * coverage[i, j] ** 2) for i, j, w in near if 0 <= i < SHAPE[0] and 0 <= j < SHAPE[1]]
        light = sum(w * diffuse[i, j] for i, j, w in near)
        shown = sum(w * (captured.diffuse[i, j] + captured.specular[i, j]) for i, j, w in near)
        mean = sum(w * captured.specular[i, j] for i, j, w in near) / sum(w for _, _, w in near)
        out[0][y, x] = captured.plate[y, x] * light / shown
        out[1][y, x] = specular[y, x] * np.minimum(1, mean / captured.specular[y, x])
    return out[0].astype(np.float32), out[1].astype(np.float32)


def test_edges_follow_the_equations_and_all_else_stays() -> None:
    given = scene()
    found, expected = extend_light(*given), reference(*given)
    solid = given[3] >= EDGE
    for one, two, before in zip(found, expected, given[:2], strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-5)
        np.testing.assert_array_equal(one[solid], before[solid])
        assert np.abs(one - before)[~solid & (given[3] > 0)].max() > 0.1


def test_it_is_linear_in_the_light() -> None:
    """Light groups sum up only then."""
    diffuse, specular, captured, coverage = scene()
    other, share, _, _ = scene(1)
    whole = extend_light(diffuse + other, specular + share, captured, coverage)
    parts = extend_light(diffuse, specular, captured, coverage), extend_light(other, share, captured, coverage)
    for total, one, two in zip(whole, *parts, strict=True):
        np.testing.assert_allclose(one + two, total, rtol=1e-5)


def test_black_plates_and_no_edges_are_left_alone() -> None:
    diffuse, specular, captured, coverage = scene()
    dark = CapturedLight(*(0 * plane for plane in captured))
    np.testing.assert_array_equal(extend_light(diffuse, specular, dark, coverage)[0], diffuse)
    np.testing.assert_array_equal(extend_light(diffuse, specular, captured, np.ones(SHAPE, np.float32))[0], diffuse)


def hair(normals: np.random.Generator | None = None) -> tuple[FrameInputs, F32]:
    """Strands of 0.4 to 20 % coverage before the camera, as a plate of half floats, and the plate as it was."""
    gbuffer, cam = sphere((32, 32), roughness=0.8)
    draw = np.random.default_rng(3)
    coverage = np.where(draw.random((32, 32)) < 0.5, draw.uniform(0.004, 0.2, (32, 32)), 0).astype(np.float32)
    coverage[0, 0] = 0.1
    color = np.broadcast_to(np.array([0.35, 0.2, 0.1], np.float32), (32, 32, 3))
    facing = np.broadcast_to(np.array([0.0, -1.0, 0.0], np.float32), (32, 32, 3))
    if normals is not None:
        facing = facing + normals.normal(0, 0.8, facing.shape)
        facing = facing / np.linalg.norm(facing, axis=-1, keepdims=True)
    seen = replace(surface(gbuffer, cam), normal=facing, z=np.full((32, 32), 4.0), opacity=coverage)
    stored = associate(color, coverage).astype(np.float16).astype(np.float32)
    return FrameInputs(straighten(stored[..., :3], stored[..., 3]), seen), color


def test_a_relit_hair_over_ten_backgrounds_is_the_direct_render() -> None:
    """Under twice the light a thing is twice as bright; energy from 0 to 100."""
    inputs, color = hair()
    light, capture = prepare_relight(uniform_light(2.0), DRAFT), prepare_capture(uniform_light(), DRAFT)
    relit = relight_frame(inputs, light, capture, None, DRAFT).radiance
    coverage = np.asarray(inputs.surface.opacity)
    for level in (0, 0.01, 0.1, 0.5, 1, 2, 5, 10, 50, 100):
        background = np.full((32, 32, 3), level, np.float32)
        direct = 2 * color * coverage[..., None] + (1 - coverage[..., None]) * background
        found = over(associate(relit, coverage), background)[..., :3]
        assert np.abs(found - direct).max() < 1e-3 * max(1, level)


def test_chance_normals_of_an_edge_make_no_rims() -> None:
    """In a hair, normals are those of whatever lies at the middle of a pixel: its light is nearer to the truth."""
    inputs, _ = hair(np.random.default_rng(5))
    sky = np.full((16, 32, 3), 0.2, np.float32)
    sky[:8] = 3
    light, capture = prepare_relight(EnvMap.from_array(sky), DRAFT), prepare_capture(uniform_light(), DRAFT)
    truth = relight_frame(hair()[0], light, capture, None, DRAFT).radiance
    shown = np.asarray(inputs.surface.opacity) > 0
    error = [
        np.square(relight_frame(inputs, light, capture, None, replace(DRAFT, extend=e)).radiance - truth)[shown].mean()
        for e in (False, True)
    ]
    assert error[1] < 0.75 * error[0]


@pytest.mark.parametrize(("metallic", "least"), [(0.0, 0.98), (1.0, 0.65)])
def test_the_grain_of_the_plate_is_kept(metallic: float, least: float) -> None:
    """Relit grain has the plate's strength, by the change of light, and its spectrum; edges included.

    A metal's colour is in its reflection, which the pixel filter averages as a whole: 0.72 of its grain is left.
    """
    seen = surface(*sphere((64, 64), roughness=0.7, metallic=metallic))
    inner = seen.normal[..., 1] < -0.5
    clean = np.full((64, 64, 3), 0.3, np.float32)
    grain = np.random.default_rng(2).normal(0, 0.02, clean.shape).astype(np.float32)
    light, capture = prepare_relight(uniform_light(3.0), DRAFT), prepare_capture(uniform_light(), DRAFT)
    for share, left_over in ((1.0, least), (0.97, 0.75 * least)):  # solid, and all an edge, where gloss takes a share
        relit = [
            relight_frame(
                FrameInputs(plate, replace(seen, opacity=seen.opacity * np.float32(share))), light, capture, None, DRAFT
            ).radiance
            for plate in (clean, clean + grain)
        ]
        left = (relit[1] - relit[0])[inner]
        assert left_over < left.std() / (3 * grain[inner].std()) < 1.02
        rough = [
            np.stack([laplace(x[..., k]) for k in range(3)], -1)[inner].std() for x in (relit[1] - relit[0], grain)
        ]
        assert 0.7 * left_over < rough[0] / (3 * rough[1]) < 1.02
