"""Flow: its sign, its methods, what fills the background, and when it is trusted."""

from pathlib import Path

import numpy as np
import pytest

from yesnt.temporal import FlowSettings, flow_and_validity, flow_validity
from yesnt.temporal.flow import consistency, dense_flow, encode_grey, photometric_weight, sample_next

METHODS = ("dis-fast", "dis-medium", "dis-quality", "deepflow")
RIGHT, DOWN = 3.0, 1.5


def texture(x, y):
    """Linear colour [..., 3] that is smooth, so that it can be sampled anywhere."""
    waves = [0.5 + 0.25 * np.sin(x / a + c) + 0.25 * np.cos(y / b - c) for a, b, c in ((3, 4, 0), (5, 3, 1), (4, 6, 2))]
    return np.stack(waves, -1).astype(np.float32) ** 2


def moving_disc(height=96, width=120):
    """Two frames of a disc that moves right and down over nothing; mattes with them."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    frames, mattes = [], []
    for t in (0, 1):
        column, row = x - RIGHT * t, y - DOWN * t
        mattes.append((column - 55) ** 2 + (row - 45) ** 2 < 30**2)
        frames.append(np.where(mattes[-1][..., None], texture(column, row), 0).astype(np.float32))
    return frames, mattes


@pytest.mark.parametrize("method", METHODS)
def test_flow_points_to_where_the_pixel_goes(method):
    (now, following), (matte, matte_next) = moving_disc()
    flow, validity = flow_and_validity(now, following, matte, matte_next, FlowSettings(method))
    assert flow.shape == (96, 120, 2)
    assert flow.dtype == validity.dtype == np.float32
    error = np.hypot(flow[..., 0] - RIGHT, flow[..., 1] - DOWN)[matte]
    assert np.median(error) < 0.25
    assert np.mean(validity[matte] > 0.5) > 0.9
    assert (validity[~matte] == 0).all()
    assert validity.min() >= 0
    assert validity.max() <= 1


def test_flow_gives_the_same_bits_twice():
    (now, following), mattes = moving_disc()
    first, second = (flow_and_validity(now, following, *mattes, FlowSettings()) for _ in range(2))
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1], second[1])


def test_what_is_behind_the_matte_pulls_on_nothing():
    (now, following), mattes = moving_disc()
    rng = np.random.default_rng(0)
    dirty = [
        np.where(m[..., None], f, rng.random(f.shape)).astype(np.float32)
        for f, m in zip((now, following), mattes, strict=True)
    ]
    clean = flow_and_validity(now, following, *mattes, FlowSettings())
    np.testing.assert_array_equal(flow_and_validity(*dirty, *mattes, FlowSettings())[0], clean[0])
    assert set(np.unique(encode_grey(dirty[0], mattes[0])[~mattes[0]])) == {128}


def test_consistency_is_method_mds_formula():
    forward = np.zeros((5, 6, 2), np.float32)
    forward[..., 0] = 1.0
    full = np.ones((5, 6), bool)
    for back, good in ((-1.0, True), (-1.7, True), (-1.8, False), (0.0, False)):
        backward = np.zeros((5, 6, 2), np.float32)
        backward[..., 0] = back
        valid = consistency(forward, backward, full, full, FlowSettings(relative=0.01, absolute=0.5))
        assert (valid[:, :-1] == good).all()
        assert (valid[:, -1] == 0).all()  # the flow leaves the frame


def test_occlusion_shows_in_the_colour():
    """A bar that covers what was there: its colour differs, so the link is not trusted."""
    rng = np.random.default_rng(0)
    now = rng.uniform(0.2, 0.4, (20, 30, 3)).astype(np.float32)
    covered = now.copy()
    covered[:, 10:15] = 0.9
    full, still = np.ones((20, 30), bool), np.zeros((20, 30, 2), np.float32)
    weight = photometric_weight(still, now, covered, full, full, 0.1)
    assert weight[:, 11:14].max() < 0.01
    assert weight[:, :9].min() > 0.99
    np.testing.assert_array_equal(photometric_weight(still, now, covered, full, full, np.inf), 1)


def test_sampling_is_the_energys_warp():
    from yesnt.temporal import reference

    rng = np.random.default_rng(1)
    image, flow = rng.random((9, 12, 1)).astype(np.float32), rng.normal(0, 2, (9, 12, 2)).astype(np.float32)
    now, following = rng.random((2, 9, 12)) > 0.3
    sampled, valid = sample_next(image, flow, now, following)
    expected, good = reference.warp(image[..., 0].astype(np.float64), flow.astype(np.float64), following)
    np.testing.assert_array_equal(valid, good & now)
    np.testing.assert_allclose(sampled[valid, 0], expected[valid], atol=1e-6)


def test_tiny_frames_get_no_flow():
    grey = np.zeros((8, 40), np.uint8)
    assert (dense_flow(grey, grey, "dis-quality") == 0).all()


def test_a_flow_from_elsewhere_is_trusted_where_its_sign_is_right():
    """The true flow of the disc is valid; the same flow with the signs turned, another program's habit, is not."""
    frames, mattes = moving_disc()
    true = np.zeros((96, 120, 2), np.float32)
    true[..., 0], true[..., 1] = RIGHT, DOWN
    good = flow_validity(true, None, *frames, *mattes, FlowSettings())
    turned = flow_validity(-true, None, *frames, *mattes, FlowSettings())
    assert np.median(good[mattes[0]]) > 0.99
    assert np.mean(turned[mattes[0]]) < 0.6
    np.testing.assert_array_equal(flow_validity(true, -true, *frames, *mattes, FlowSettings()), good)


def test_validity_is_soft_unless_it_is_asked_to_be_cut():
    frames, mattes = moving_disc()
    flow = np.full((96, 120, 2), 1.0, np.float32)
    soft = flow_validity(flow, None, *frames, *mattes, FlowSettings())
    hard = flow_validity(flow, None, *frames, *mattes, FlowSettings(cut=0.5))
    assert len(np.unique(soft)) > 100
    np.testing.assert_array_equal(hard, soft >= 0.5)


def spynet_state(push, prefix="spynet."):
    """Weights of 0: each level only adds `push` pixels to the right."""
    import torch

    state, widths = {}, (8, 32, 64, 32, 16, 2)
    for level in range(6):
        for k, layer in enumerate((0, 2, 4, 6, 8)):
            name = f"{prefix}basic_module.{level}.basic_module.{layer}"
            state[f"{name}.weight"] = torch.zeros(widths[k + 1], widths[k], 7, 7)
            state[f"{name}.bias"] = torch.zeros(widths[k + 1])
        state[f"{name}.bias"][0] = push
    return state


def test_spynet_adds_up_its_levels_and_says_what_is_absent():
    from yesnt.core.errors import MissingPartError
    from yesnt.temporal.spynet import SpyNet

    picture = np.zeros((70, 64, 3), np.uint8)
    flow = SpyNet(spynet_state(0.5))(picture, picture)
    assert flow.shape == (70, 64, 2)
    np.testing.assert_allclose(flow[..., 0], 0.5 * (2**6 - 1), rtol=1e-5)
    np.testing.assert_array_equal(flow[..., 1], 0)
    state = spynet_state(0.5, prefix="")
    del state["basic_module.3.basic_module.4.bias"]
    with pytest.raises(MissingPartError, match=r"basic_module\.3\.basic_module\.4"):
        SpyNet(state)


def test_weights_are_read_as_tensors_and_a_pickle_is_never_run(tmp_path):
    import pickle

    import torch
    from safetensors.torch import save_file

    from yesnt.core.errors import JobError
    from yesnt.temporal.spynet import open_spynet

    picture, state = np.zeros((64, 64, 3), np.uint8), spynet_state(0.5)
    torch.save({"state_dict": state}, tmp_path / "a.pth")
    save_file(state, tmp_path / "a.safetensors")
    expected = open_spynet(tmp_path / "a.pth")(picture, picture)
    np.testing.assert_array_equal(open_spynet(tmp_path / "a.safetensors")(picture, picture), expected)

    class Trap:
        def __reduce__(self):
            return Path.touch, (tmp_path / "was run",)

    (tmp_path / "trap.pth").write_bytes(pickle.dumps(Trap(), protocol=2))
    with pytest.raises(JobError, match="cannot be read"):
        open_spynet(tmp_path / "trap.pth")
    assert not (tmp_path / "was run").exists()


def test_a_learned_method_without_weights_is_refused():
    from yesnt.core.errors import JobError

    frames, mattes = moving_disc()
    with pytest.raises(JobError, match="needs weights"):
        flow_and_validity(*frames, *mattes, FlowSettings("spynet"))


def test_any_function_of_two_pictures_serves_as_flow():
    frames, mattes = moving_disc()
    seen = []

    def match(picture, following):
        seen.append((picture, following))
        sign = 1 if len(seen) == 1 else -1
        return np.full((*picture.shape[:2], 2), (sign * RIGHT, sign * DOWN), np.float32)

    flow, validity = flow_and_validity(*frames, *mattes, FlowSettings(), match)
    assert (flow == (RIGHT, DOWN)).all()
    assert np.median(validity[mattes[0]]) > 0.99
    assert seen[0][0].dtype == np.uint8
    assert seen[0][0] is seen[1][1]
