"""The auxiliary predictor: its arithmetic, its fusion with the estimator, and its determinism."""

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from yesnt.core.errors import JobError
from yesnt.decompose.auxiliary import (
    AUXILIARY_INPUT_SIDE,
    AUXILIARY_OUTPUT_SIDE,
    AuxiliaryPredictor,
    display_encode,
    fuse_predictions,
    upsample,
)
from yesnt.decompose.backbone import FEATURE_CHANNELS, Backbone, Conv
from yesnt.decompose.embedded import EmbeddedBackend
from yesnt.decompose.ensemble import estimate_frame
from yesnt.decompose.global_context import ContextBatch
from yesnt.decompose.network import Network, NetworkShape
from yesnt.decompose.settings import EnsembleSettings
from yesnt.decompose.weights import FORMAT, load_weights, packed, save_weights, unpacked

SHAPE = NetworkShape(widths=(8, 8, 16), depths=(1, 1, 1), condition=8, denoiser=(8, 8), auxiliary=(6, 4))


@pytest.fixture(scope="module")
def auxiliary_weights(tmp_path_factory):
    """Weights with an auxiliary predictor whose prediction varies over the image."""
    torch.manual_seed(0)
    network = Network(SHAPE)
    for part in (network.estimator, network.denoiser):
        for parameter in part.parameters():
            torch.nn.init.normal_(parameter, std=0.2)
    path = tmp_path_factory.mktemp("weights") / "auxiliary_weights.safetensors"
    save_weights(network, path, 32)
    return path


def image(rows=1):
    generator = torch.Generator().manual_seed(2)
    return torch.rand(rows, 4, AUXILIARY_INPUT_SIDE, AUXILIARY_INPUT_SIDE, generator=generator)


def frame():
    y, x = np.mgrid[:70, :90]
    matte = (np.hypot(y - 36, x - 44) < 30).astype(np.float32)
    rgb = np.stack([y / 70, x / 90, (x % 7) / 7], -1).astype(np.float32) * matte[..., None]
    return rgb, matte


@pytest.mark.parametrize(
    ("kernel", "stride", "length", "out"), [(3, 2, 8, 4), (5, 2, 9, 5), (3, 1, 8, 8), (1, 1, 5, 5)]
)
def test_padding_is_tensorflow_s(kernel, stride, length, out):
    conv = Conv(1, 1, kernel, stride)
    torch.nn.init.ones_(conv.conv.weight)
    torch.nn.init.zeros_(conv.conv.bias)
    counted = conv(torch.ones(1, 1, length, length))
    assert counted.shape[-2:] == (out, out)
    before = max((out - 1) * stride + kernel - length, 0) // 2
    starts = [place * stride - before for place in range(out)]
    rows = torch.tensor([len(set(range(start, start + kernel)) & set(range(length))) for start in starts])
    torch.testing.assert_close(counted[0, 0], (rows[:, None] * rows[None]).float())


def test_the_backbone_returns_four_resolutions():
    with torch.no_grad():
        found = Backbone().eval()(torch.zeros(1, 3, 64, 64))
    assert [tuple(x.shape[1:]) for x in found] == [
        (channels, 64 // shrink, 64 // shrink)
        for channels, shrink in zip(FEATURE_CHANNELS, (4, 8, 16, 32), strict=True)
    ]


def test_the_predictor_is_a_perceptron_on_upsampled_features():
    torch.manual_seed(1)
    auxiliary, seen = AuxiliaryPredictor(6, 4).eval(), image()
    with torch.no_grad():
        planes = torch.cat([upsample(x, AUXILIARY_OUTPUT_SIDE) for x in auxiliary.backbone(display_encode(seen))], 1)
        weight = torch.cat([level.weight for level in auxiliary.projections], 1)
        first = torch.relu(torch.nn.functional.conv2d(planes, weight, auxiliary.bias))
        wanted = auxiliary.output(torch.relu(auxiliary.hidden(first))).clamp(-1, 1)
        torch.testing.assert_close(auxiliary(seen), wanted, atol=1e-5, rtol=1e-4)


def test_predictions_stay_in_their_range():
    auxiliary = AuxiliaryPredictor(6, 4).eval()
    with torch.no_grad():
        auxiliary.output.bias.copy_(torch.tensor([5.0, -5.0]))
        predicted = auxiliary(image())
    assert (predicted[:, 0] == 1).all()
    assert (predicted[:, 1] == -1).all()


def test_display_code_is_grey_outside_and_keeps_highlights_distinct():
    levels = torch.tensor([0.0, 0.18, 1.0, 2.0, 4.0])
    shown = display_encode(torch.cat([levels.expand(1, 3, 1, 5), torch.ones(1, 1, 1, 5)], 1))[0, 0, 0]
    assert shown[0] == -1
    assert float(shown[-1]) == pytest.approx(1, abs=1e-5)
    assert (shown.diff() > 0.05).all()
    assert not display_encode(torch.cat([torch.ones(1, 3, 4, 4), torch.zeros(1, 1, 4, 4)], 1)).any()


def test_display_code_is_the_srgb_curve_of_the_tone_mapped_radiance():
    """kornia's transfer function is the outside truth; the embedded model does not import it."""
    from kornia.color import linear_rgb_to_rgb

    radiance = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(4)) * 4
    mapped = radiance * (1 + radiance / 16) / (1 + radiance)
    shown = display_encode(torch.cat([radiance, torch.ones(1, 1, 16, 16)], 1))
    torch.testing.assert_close(shown, 2 * linear_rgb_to_rgb(mapped) - 1, atol=1e-6, rtol=0)


def test_fusion_averages_both_and_appends_their_difference():
    condition, auxiliary = torch.rand(2, 5, 4, 4), torch.rand(2, 2, 4, 4)
    found = fuse_predictions(condition, auxiliary)
    torch.testing.assert_close(found[:, :2], (condition[:, :2] + auxiliary) / 2)
    assert torch.equal(found[:, 2:5], condition[:, 2:])
    torch.testing.assert_close(found[:, 5:], auxiliary - condition[:, :2])


def test_eight_bits_are_close_and_packing_again_changes_nothing(auxiliary_weights):
    torch.manual_seed(0)
    state = {name: value for name, value in Network(SHAPE).state_dict().items() if value.is_floating_point()}
    once = unpacked(packed(state))
    for name, value in state.items():
        largest = value.abs().flatten(1).amax(1) if value.dim() > 1 else value.abs().amax()
        error = (once[name] - value).abs()
        error = error.flatten(1).amax(1) if value.dim() > 1 else error.amax()
        assert (error <= largest / 250 + 1e-6).all(), name
    twice = unpacked(packed(once))
    for name, value in once.items():
        torch.testing.assert_close(twice[name], value, atol=1e-7, rtol=1e-6)


def test_files_of_sixteen_bits_are_read(tmp_path, auxiliary_weights):
    network, patch = load_weights(auxiliary_weights)
    half = {name: value.half().contiguous() for name, value in network.state_dict().items()}
    save_file(
        half, tmp_path / "old.safetensors", {"format": FORMAT, "shape": network.shape.header(), "patch": str(patch)}
    )
    old, _ = load_weights(tmp_path / "old.safetensors")
    for name, value in network.state_dict().items():
        torch.testing.assert_close(old.state_dict()[name].float(), value.float(), atol=1e-3, rtol=1e-3)


def test_files_of_another_format_are_refused_with_what_to_do(tmp_path):
    network = Network(SHAPE)
    header = {"shape": network.shape.header(), "patch": "32"}
    for stated, text in ((header, "1 or unknown"), (header | {"format": "3"}, "3")):
        save_file(packed(network.state_dict()), tmp_path / "old.safetensors", stated)
        with pytest.raises(JobError) as refused:
            load_weights(tmp_path / "old.safetensors")
        message = str(refused.value)
        assert f"the weights have format {text}" in message
        assert "use the weights of the installed package, or make them anew" in message


def test_weights_without_an_auxiliary_predictor_take_no_global_image(tmp_path):
    torch.manual_seed(0)
    network = Network(NetworkShape(widths=(8, 8, 16), depths=(1, 1, 1), condition=8, denoiser=(8, 8)))
    save_weights(network, tmp_path / "alone.safetensors", 32)
    backend = EmbeddedBackend(tmp_path / "alone.safetensors")
    assert backend.auxiliary_side == 0
    with pytest.raises(ValueError, match="no auxiliary predictor"):
        backend.predict_auxiliary(image())
    estimate_frame(*frame(), backend, EnsembleSettings(2), 0, 1)


def test_without_a_global_image_the_difference_is_zero(auxiliary_weights, context):
    backend = EmbeddedBackend(auxiliary_weights)
    rgb, matte = torch.rand(8, 3, 32, 32), torch.ones(8, 1, 32, 32)
    alone = backend.encode(rgb, matte, context(8))
    assert not alone[:, -2:].any()
    found = backend.encode(
        rgb, matte, ContextBatch(*context(8)[:2], backend.predict_auxiliary(image()).expand(8, -1, -1, -1))
    )
    assert found.shape == alone.shape
    torch.testing.assert_close(found[:, :2], alone[:, :2] + 0.5 * found[:, -2:])


def test_the_auxiliary_prediction_is_made_once_a_frame(auxiliary_weights, monkeypatch):
    backend, shown = EmbeddedBackend(auxiliary_weights), []
    predict = backend.predict_auxiliary
    monkeypatch.setattr(backend, "predict_auxiliary", lambda seen: (shown.append(seen), predict(seen))[1])
    estimate_frame(*frame(), backend, EnsembleSettings(4), 0, 1)
    assert [tuple(seen.shape) for seen in shown] == [(1, 4, AUXILIARY_INPUT_SIDE, AUXILIARY_INPUT_SIDE)]


def test_the_auxiliary_prediction_is_the_same_on_any_number_of_threads(auxiliary_weights):
    backend, threads, answers = EmbeddedBackend(auxiliary_weights), torch.get_num_threads(), []
    try:
        for number in (1, 2):
            torch.set_num_threads(number)
            answers.append(backend.predict_auxiliary(image()))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(*answers)
