"""The subprocess adapter against a checkout whose classes have the real names and arguments, its model of formulas."""

import sys

import numpy as np
import pytest

from yesnt.core.color import srgb_encode
from yesnt.core.errors import JobError, YesntError
from yesnt.decompose import cosmos
from yesnt.decompose.cosmos import CosmosBackend, draw_seed
from yesnt.decompose.published import COSMOS
from yesnt.decompose.settings import EnsembleSettings
from yesnt.decompose.window import make_clip

INFERENCE = "cosmos_predict1/diffusion/inference"
SIZE = (44, 80)

PIPELINE = """
import torch

class Model(torch.nn.Module):
    def decode(self, sample):
        return sample

class DiffusionRendererPipeline:
    def __init__(self, checkpoint_dir, checkpoint_name, offload_network=False, offload_tokenizer=False, guidance=0.0,
                 num_steps=15, height=704, width=1280, fps=24, num_video_frames=57, seed=1000):
        assert checkpoint_name == "Diffusion_Renderer_Inverse_Cosmos_7B"
        self.model, self.seed, self.steps = Model(), seed, num_steps

    def generate_video(self, data_batch, normalize_normal=False):
        # Red follows the picture, green the quantity's number, blue the seed; none is a multiple of 1/255.
        rgb = data_batch["rgb"]
        sample = rgb.clone()
        sample[:, 1] = 2 * data_batch["context_index"].float().item() / 10 - 1
        sample[:, 2] = 2 * (self.seed % 1000) / 1000 - 1
        video = (1 + self.model.decode(sample)).clamp(0, 2) / 2
        return (video[0].permute(1, 2, 3, 0) * 255).to(torch.uint8).numpy()
"""

DATASET = """
import cv2, numpy as np, torch
from pathlib import Path

class VideoFramesDataset:
    def __init__(self, root_dir, sample_n_frames, overlap_n_frames, chunk_mode, group_mode, image_extensions,
                 resolution, resize_resolution):
        assert (chunk_mode, group_mode, image_extensions) == ("first", "folder", ["png"])
        self.paths = sorted(Path(root_dir).glob("*/*.png"))
        assert len(self.paths) == sample_n_frames
        self.resolution = resolution

    def __len__(self):
        return 1

    def __getitem__(self, index):
        frames = np.stack([cv2.imread(str(p))[..., ::-1] for p in self.paths])
        assert list(frames.shape[1:3]) == self.resolution
        rgb = torch.from_numpy(2 * frames.astype(np.float32) / 255 - 1).permute(3, 0, 1, 2)
        return {"rgb": rgb, "context_index": torch.zeros(1)}
"""

COLLATE = """
import torch

def dict_collation_fn(samples):
    return {name: torch.stack([s[name] for s in samples]) for name in samples[0]}
"""


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    monkeypatch.setattr(cosmos, "_SIZE", SIZE)
    files = dict.fromkeys(COSMOS.files, "") | {
        f"{INFERENCE}/diffusion_renderer_pipeline.py": PIPELINE,
        f"{INFERENCE}/diffusion_renderer_utils/dataset_inference.py": DATASET,
        f"{INFERENCE}/diffusion_renderer_utils/dataloader_utils.py": COLLATE,
        f"{INFERENCE}/diffusion_renderer_utils/rendering_utils.py": "GBUFFER_INDEX_MAPPING = "
        '{"basecolor": 0, "metallic": 1, "roughness": 2}\n',
        "cosmos_predict1/utils/misc.py": "def set_random_seed(seed, by_rank=False):\n    pass\n",
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


def open_it(folder, **knobs):
    return CosmosBackend(folder, window=3, python=sys.executable, allow_pickle=True, **knobs)


@pytest.fixture
def clip():
    rng = np.random.default_rng(0)
    rgb = [np.full((22, 40, 3), value, np.float32) for value in rng.random(3)]
    matte = np.ones((22, 40), np.float32)
    matte[:, :10] = 0
    return make_clip(rgb, [matte] * 3, (1001, 1002, 1003), 3)


def test_members_come_back_as_floats_at_the_clips_size(checkout, clip):
    members = list(open_it(checkout).draw(clip, 7, (0, 1), EnsembleSettings(2)))
    assert len(members) == 2
    for number, member in enumerate(members):
        assert member.shape == (3, 2, 22, 40)
        for plane, (quantity, index) in enumerate((("roughness", 2), ("metallic", 1))):
            seed = draw_seed(7, 1001, number, quantity)
            red = np.rint(255 * srgb_encode(clip.rgb[:, 11, 25, 0])) / 255
            expected = (red + index / 10 + (seed % 1000) / 1000) / 3
            np.testing.assert_allclose(member[:, plane, 11, 25], expected, atol=1e-5)
            white = (1 + index / 10 + (seed % 1000) / 1000) / 3
            np.testing.assert_allclose(member[:, plane, 11, 2], white, atol=1e-5, err_msg="the ground is white")


def test_a_member_is_the_same_alone_and_among_others(checkout, clip):
    backend = open_it(checkout)
    both = list(backend.draw(clip, 7, (0, 1), EnsembleSettings(2)))
    np.testing.assert_array_equal(next(backend.draw(clip, 7, (1,), EnsembleSettings(2))), both[1])
    seeds = {draw_seed(s, f, m, q) for s in (0, 1) for f in (1, 2) for m in (0, 1) for q in ("roughness", "metallic")}
    assert len(seeds) == 16
    assert all(0 <= seed < 2**31 for seed in seeds)


def test_pickles_and_the_interpreter_must_be_allowed_explicitly(checkout):
    with pytest.raises(JobError, match="allow_pickle: true"):
        CosmosBackend(checkout, python=sys.executable)
    with pytest.raises(JobError, match="python"):
        CosmosBackend(checkout, allow_pickle=True)


def test_the_error_of_a_failed_process_holds_its_stderr(checkout, clip):
    (checkout / INFERENCE / "diffusion_renderer_pipeline.py").write_text("raise RuntimeError('no CUDA device')")
    with pytest.raises(YesntError, match="no CUDA device"):
        next(open_it(checkout).draw(clip, 0, (0,), EnsembleSettings(1)))


def test_missing_files_are_named_with_their_source(tmp_path):
    with pytest.raises(JobError, match=r"model\.pt.*cosmos-transfer1-diffusion-renderer"):
        CosmosBackend(tmp_path)
