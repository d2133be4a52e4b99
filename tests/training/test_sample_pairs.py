"""The pairs of samples that the energy score compares: which noise they share and which they do not."""

import pytest
import torch

from yesnt.training.sample_pairs import SamplePairs

ROWS, PATCH = 8, 16


class Recorder:
    """A denoiser that records its arguments."""

    def __call__(self, state, smooth, condition, time):
        self.state, self.smooth, self.condition, self.time = state, smooth, condition, time
        return state


@pytest.fixture(scope="module")
def pairs():
    return SamplePairs(0, PATCH)


def drawn(pairs, step):
    recorder = Recorder()
    clean = torch.rand(ROWS, 2, PATCH, PATCH, generator=torch.Generator().manual_seed(1))
    condition = torch.arange(ROWS).float()[:, None, None, None].expand(-1, 3, 8, 8)
    first, second = pairs.draw(recorder, condition, clean, step)
    return recorder, clean, first, second


def test_half_of_the_rows_start_from_pure_noise_which_the_two_samples_do_not_share(pairs):
    recorder, _, first, second = drawn(pairs, 3)
    times = recorder.time[:ROWS]
    assert torch.equal(times, recorder.time[ROWS:])
    pure = times == 1
    assert int(pure.sum()) == ROWS // 2
    assert ((times[~pure] >= 0.05) & (times[~pure] < 0.95)).all()
    equal = (first == second).flatten(1).all(1)
    assert torch.equal(equal, ~pure)


def test_other_rows_share_the_diffused_truth(pairs):
    recorder, clean, first, _ = drawn(pairs, 3)
    angle = recorder.time[:ROWS, None, None, None] * torch.pi / 2
    noise = (first - angle.cos() * clean) / angle.sin()
    rest = noise[recorder.time[:ROWS] < 1]
    assert float(rest.mean()) == pytest.approx(0, abs=0.1)
    assert float(rest.std()) == pytest.approx(1, abs=0.1)


def test_conditions_are_shared_and_smooth_noise_is_not(pairs):
    recorder, *_ = drawn(pairs, 3)
    assert torch.equal(recorder.condition[:ROWS], recorder.condition[ROWS:])
    fields = recorder.smooth.flatten(1)
    assert len({tuple(row.tolist()) for row in fields}) == 2 * ROWS


def test_every_sample_has_smooth_noise_of_another_field():
    pairs = SamplePairs(0, PATCH)
    pairs._fields = torch.arange(len(pairs._fields)).float()[:, None, None, None].expand_as(pairs._fields)
    recorder, *_ = drawn(pairs, 3)
    fields = recorder.smooth.flatten(1).unique(dim=1)
    assert fields.shape == (2 * ROWS, 1), "a crop of one field"
    assert len(set(fields[:, 0].tolist())) == 2 * ROWS


def test_noise_is_keyed_by_seed_and_step(pairs):
    for make, same in ((lambda: drawn(pairs, 3), True), (lambda: drawn(pairs, 4), False)):
        other = make()
        assert torch.equal(other[2], drawn(pairs, 3)[2]) is same
    assert not torch.equal(drawn(SamplePairs(1, PATCH), 3)[2], drawn(pairs, 3)[2])
