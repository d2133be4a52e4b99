from dataclasses import replace

import numpy as np
import pytest
import torch

from yesnt.core.errors import JobError
from yesnt.decompose.network import NetworkShape
from yesnt.decompose.weights import PATCH, load_weights
from yesnt.training import trainer as training
from yesnt.training.__main__ import main
from yesnt.training.image_archive import interleaved_people
from yesnt.training.losses import energy_score, estimator_loss
from yesnt.training.synthetic.dataset import Patches, draw_patches
from yesnt.training.trainer import Trainer, TrainingSettings, rate_schedule, train

TINY = NetworkShape(widths=(8, 8, 16), depths=(1, 1, 1), condition=8, denoiser=(8, 8))
SHORT = (
    "--estimator-steps 1 --denoiser-steps 1 --fine-tuning-steps 1 --people 0 --objects 0 --auxiliary-steps 0".split()
)
SETTINGS = TrainingSettings(
    estimator_steps=2, denoiser_steps=1, fine_tuning_steps=1, batch=2, people=0, objects=0, patch=32
)


def test_energy_score_is_least_for_the_true_distribution():
    generator = torch.Generator().manual_seed(0)
    matte = torch.ones(64, 1, 32, 32)

    def score(spread, shift):
        draw = lambda s, m: torch.randn(64, 2, 32, 32, generator=generator) * s + m  # noqa: E731
        return float(energy_score(draw(spread, shift), draw(spread, shift), draw(1.0, 0.0), matte))

    best = score(1.0, 0.0)
    assert best < score(0.6, 0.0)
    assert best < score(1.5, 0.0)
    assert best < score(1.0, 0.3)


def test_energy_score_looks_only_inside_the_matte():
    draws = [torch.rand(2, 2, 32, 32) for _ in range(3)]
    matte = torch.zeros(2, 1, 32, 32)
    matte[..., 8:24] = 1
    score = energy_score(*draws, matte)
    changed = [d + (1 - matte) * torch.rand_like(d) for d in draws]
    assert float(score) == pytest.approx(float(energy_score(*changed, matte)), abs=1e-6)


def test_estimator_loss_is_least_for_the_mean_and_the_class():
    clean, matte = torch.full((2, 2, 8, 8), 0.5), torch.ones(2, 1, 8, 8)
    kind = torch.zeros(2, 8, 8, dtype=torch.int64)
    right = torch.full((2, 4, 4, 4), 0.5)
    sure = torch.tensor([9.0, -9.0])[None, :, None, None].expand(2, 2, 4, 4)
    best = float(estimator_loss(right, sure, clean, kind, matte))
    assert best < 1e-3
    assert float(estimator_loss(right + 0.1, sure, clean, kind, matte)) == pytest.approx(best + 0.01, abs=1e-4)
    assert float(estimator_loss(right, -sure, clean, kind, matte)) > 1


def test_training_resumed_is_training_uninterrupted(tmp_path):
    whole = Trainer(SETTINGS, TINY, tmp_path)
    for _ in train(whole, tmp_path, every=4):
        pass
    first = Trainer(SETTINGS, TINY, tmp_path)
    first.advance()
    first.advance()
    first.save(tmp_path / "checkpoint.pt")
    second = Trainer(SETTINGS, TINY, tmp_path)
    second.resume(tmp_path / "checkpoint.pt")
    second.advance()
    second.advance()
    for name, a in whole.averaged.state_dict().items():  # the norms' running statistics too
        torch.testing.assert_close(a, second.averaged.state_dict()[name], atol=0, rtol=0)


@pytest.mark.parametrize("estimator_steps", [0, 60])
def test_training_lowers_the_loss_in_both_parts(tmp_path, estimator_steps):
    settings = TrainingSettings(
        estimator_steps=estimator_steps,
        denoiser_steps=120,
        fine_tuning_steps=0,
        batch=2,
        people=0,
        objects=0,
        patch=32,
        rate=5e-3,
    )
    trainer = Trainer(settings, TINY, tmp_path)
    losses = [trainer.advance() for _ in range(30)]
    assert np.mean(losses[-8:]) < 0.85 * np.mean(losses[:4])


def test_fine_tuning_uses_realistic_materials(tmp_path):
    settings = replace(SETTINGS, estimator_steps=1, denoiser_steps=1, fine_tuning_steps=1)
    trainer = Trainer(settings, TINY, tmp_path)
    bold = [trainer._augmentation.style.cloth_print]
    for _ in range(2):
        trainer.advance()
        bold.append(trainer._augmentation.style.cloth_print)
    assert bold[0] == bold[1] > bold[2] > 0
    assert trainer._rates()[0] == trainer._rates()[1] > 0


def test_the_estimator_phase_leaves_the_denoiser_unchanged(tmp_path):
    trainer = Trainer(SETTINGS, TINY, tmp_path)
    before = [p.clone() for p in trainer.network.denoiser.parameters()]
    trainer.advance()
    for old, new in zip(before, trainer.network.denoiser.parameters(), strict=True):
        assert torch.equal(old, new)


def test_a_checkpoint_of_another_format_is_refused_with_what_to_do(tmp_path):
    trainer = Trainer(SETTINGS, TINY, tmp_path)
    torch.save({"step": 3, "network": {}}, tmp_path / "checkpoint.pt")
    with pytest.raises(JobError, match=r"format 1\..*format 2.*delete the file to begin anew"):
        trainer.resume(tmp_path / "checkpoint.pt")


def test_a_missing_image_is_named_after_the_timeout(tmp_path, monkeypatch):
    monkeypatch.setattr(training, "_IMAGE_TIMEOUT", 0.0)
    monkeypatch.setattr(training.time, "sleep", lambda seconds: None)
    with pytest.raises(JobError, match="--only images"):
        Trainer(TrainingSettings(batch=6, patch=32), TINY, tmp_path).advance()


def test_command_writes_weights_that_load(tmp_path, monkeypatch):
    monkeypatch.setattr("yesnt.training.__main__.NetworkShape", lambda: TINY)
    assert main([str(tmp_path / "new"), *SHORT]) == 0
    network, patch = load_weights(tmp_path / "new" / "embedded.safetensors")
    assert network.shape == TINY
    assert patch == PATCH


def test_the_learning_rate_warms_up_and_decays_to_a_fiftieth():
    assert rate_schedule(0, 1000) == pytest.approx(0.01)
    assert rate_schedule(99, 1000) == pytest.approx(0.02 + 0.49 * (1 + np.cos(0.099 * np.pi)))
    assert rate_schedule(500, 1000) == pytest.approx(0.51)
    assert rate_schedule(1000, 1000) == pytest.approx(0.02)


def test_rates_of_estimator_and_denoiser_follow_the_phases(tmp_path):
    settings = replace(SETTINGS, estimator_steps=400, denoiser_steps=300, fine_tuning_steps=200, rate=1.0)
    trainer = Trainer(settings, TINY, tmp_path)
    for step, expected in (
        (200, (0.51, 0.0)),
        (400 + 150, (0.51 / 5, 0.51)),
        (400 + 300 + 100, (0.4 * 0.51, 0.4 * 0.51)),
    ):
        trainer.step = step
        assert trainer._rates() == pytest.approx(expected)


def test_the_averaged_network_is_an_exponential_moving_average(tmp_path):
    trainer = Trainer(SETTINGS, TINY, tmp_path)
    before = {name: value.clone() for name, value in trainer.averaged.state_dict().items()}
    trainer.advance()
    decay = (1 + 1) / (10 + 1)
    for name, value in trainer.network.state_dict().items():
        if value.is_floating_point():
            expected = decay * before[name] + (1 - decay) * value
            torch.testing.assert_close(trainer.averaged.state_dict()[name], expected, atol=1e-6, rtol=1e-5)


def test_the_energy_score_does_not_train_the_estimator(tmp_path):
    """With and without the denoiser's loss, the gradients of the estimator are the same."""
    gradients = []
    for estimator_steps in (1, 0):
        trainer = Trainer(replace(SETTINGS, estimator_steps=estimator_steps), TINY, tmp_path)
        trainer._loss(draw_patches(0, 1, 2, 32)).backward()
        gradients.append([p.grad for p in trainer.network.estimator.parameters()])
        trained = any(p.grad is not None and p.grad.any() for p in trainer.network.denoiser.parameters())
        assert trained is (estimator_steps == 0)
    for alone, both in zip(*gradients, strict=True):
        torch.testing.assert_close(alone, both, atol=0, rtol=0)


@pytest.mark.parametrize(
    ("people", "objects", "step", "expected"),
    [(800, 600, 0, (5, 0)), (800, 600, 10, (4, 2)), (0, 600, 10, (0, 2)), (800, 0, 10, (5, 0)), (0, 0, 10, (0, 0))],
)
def test_a_step_shows_people_objects_and_scenes_as_the_settings_say(
    tmp_path, monkeypatch, people, objects, step, expected
):
    settings = TrainingSettings(batch=8, people=people, objects=objects, objects_after=10, patch=32)
    trainer, shown = Trainer(settings, TINY, tmp_path), []
    trainer.step = step
    example = Patches(*(plane[0] for plane in draw_patches(0, 1, 1, 32).planes()))
    for kind in ("person", "object"):
        monkeypatch.setattr(trainer, f"_{kind}_crop", lambda rng, kind=kind: (shown.append(kind), example)[1])
    assert len(trainer._patches().rgb) == 8
    assert (shown.count("person"), shown.count("object")) == expected


def test_people_are_used_as_the_archive_grows(tmp_path, monkeypatch):
    opened = []

    def recorded(path):
        opened.append(int(path.stem))
        raise LookupError

    monkeypatch.setattr(training, "await_image", recorded)
    settings = TrainingSettings(first=16, every=3, patch=32)
    for step, most in ((0, 16), (30, 26), (10_000, 800)):
        trainer = Trainer(settings, TINY, tmp_path)
        trainer.step = step
        opened.clear()
        for seed in range(60):
            with pytest.raises(LookupError):
                trainer._person_crop(np.random.default_rng(seed))
        allowed = interleaved_people()[:most]
        assert set(opened) <= set(allowed)
        assert max(allowed.index(number) for number in opened) >= 0.5 * min(most, 100)
