"""The table of backends: what a row declares is what the backend does, and a row with a file adds a backend."""

import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from yesnt.core.errors import JobError, MissingPartError
from yesnt.core.shot import Shot
from yesnt.decompose import latents, registry
from yesnt.decompose.backend import Footprint, GlobalPredictor, Licence, MeanPredictor
from yesnt.decompose.ensemble import estimate_frame
from yesnt.decompose.identity import identify_backend
from yesnt.decompose.registry import ENTRIES, Entry, KnobSpec
from yesnt.decompose.settings import EnsembleSettings
from yesnt.planning.settings import backend_knobs, ensemble_settings

SHOT = {
    "version": 1, "name": "shot", "frames": "1001-1002", "plate": {"path": "plate.####.exr"},
    "gbuffer": {"path": "gbuffer.####.exr"}, "camera": "camera.json", "light": {"path": "light.exr"},
}  # fmt: skip

TOY = """
import torch


class ToyBackend:
    patch, align, batch, noise_sigmas, nfe = 32, 1, 2, (0.0,), 3

    def __init__(self, path, level):
        self.level = level

    def encode(self, rgb, matte, context):
        return matte

    def sample(self, condition, noise):
        return torch.full((len(noise), 2, 32, 32), self.level / 100)
"""


def test_unknown_backend_lists_the_known():
    with pytest.raises(JobError, match="embedded, marigold, rgbx, diffusion-renderer, diffusion-renderer-cosmos"):
        registry.open_backend("magic")


def test_large_backend_without_weights_says_where_they_are_published():
    with pytest.raises(JobError, match="Hugging Face"):
        registry.open_backend("marigold")


def test_non_commercial_licence_needs_consent_by_name_before_anything_is_read(tmp_path):
    with pytest.raises(JobError, match=r"--accept-license 'Adobe-Research'"):
        registry.open_backend("rgbx", tmp_path)
    with pytest.raises(JobError, match=r"zheng95z/rgb-to-x"):
        registry.open_backend("rgbx", tmp_path, accepted_licences=["Adobe-Research"])


def test_the_licence_of_every_row_is_that_of_its_publisher():
    """Public facts about the weights; a wrong row would let a job use them without consent."""
    assert {name: (entry.licence.name, entry.licence.commercial) for name, entry in ENTRIES.items()} == {
        "embedded": ("Apache-2.0", True),
        "marigold": ("OpenRAIL++-M", True),
        "rgbx": ("Adobe-Research", False),
        "diffusion-renderer": ("NVIDIA-NonCommercial", False),
        "diffusion-renderer-cosmos": ("NVIDIA-Open-Model", True),
    }


@pytest.mark.parametrize("name", list(ENTRIES))
def test_a_row_declares_every_knob_of_its_class_with_the_same_default(name):
    arguments = list(inspect.signature(ENTRIES[name].load()).parameters.values())[1:]
    in_job = {a.name: a.default for a in arguments if a.name != "device"}  # the device is the worker's own choice
    assert in_job == {knob: spec.default for knob, spec in ENTRIES[name].knobs.items()}


@pytest.mark.parametrize(
    ("name", "knobs", "expected"),
    [
        ("embedded", {}, Footprint(128, 16, 1, predicts_mean=True)),
        ("embedded", {"steps": 4}, Footprint(128, 16, 4, predicts_mean=True)),
        ("rgbx", {}, Footprint(768, 8, 100)),
        ("rgbx", {"steps": 3, "patch": 512}, Footprint(512, 8, 6)),
        ("diffusion-renderer", {}, Footprint(512, 64, 40, 24, 6)),
        ("diffusion-renderer", {"window": 9, "window_overlap": 0}, Footprint(512, 64, 40, 9, 0)),
        ("diffusion-renderer-cosmos", {}, Footprint(None, 1, 30, 57, 8)),
    ],
)
def test_footprints_follow_the_knobs(name, knobs, expected):
    entry = ENTRIES[name]
    assert entry.footprint(registry.EMBEDDED_WEIGHTS, entry.resolve(knobs)) == expected


def test_marigold_takes_what_the_checkpoint_states_unless_the_job_does(tmp_path):
    (tmp_path / "model_index.json").write_text('{"default_processing_resolution": 640, "default_denoising_steps": 4}')
    entry = ENTRIES["marigold"]
    assert entry.footprint(tmp_path, entry.resolve({})) == Footprint(640, 8, 4)
    assert entry.footprint(tmp_path, entry.resolve({"steps": 2, "patch": 320})) == Footprint(320, 8, 2)


def test_the_footprint_of_the_embedded_model_is_the_model_s():
    backend, declared = registry.open_backend("embedded", knobs={"steps": 3}), registry.footprint("embedded")
    assert (backend.patch, backend.align) == (declared.patch, declared.align)
    assert backend.nfe == registry.footprint("embedded", knobs={"steps": 3}).nfe == 3
    assert isinstance(backend, MeanPredictor) == declared.predicts_mean
    assert isinstance(backend, GlobalPredictor)


@pytest.mark.parametrize(
    ("name", "knobs", "text"),
    [
        ("embedded", {"steps": 5}, r"The knob 'steps' is 5\..*key decompose\.knobs.*an int in 1 \.\. 4"),
        ("embedded", {"steps": 0}, r"The knob 'steps' is 0\..*an int in 1 \.\. 4"),
        ("embedded", {"steps": True}, "The knob 'steps' is True"),
        ("embedded", {"patch": 64}, r"The backend has no knob 'patch'\..*steps"),
        ("rgbx", {"patch": 0}, "an int of at least 1"),
        ("marigold", {"precision": "half"}, "one of auto, float32, float16, bfloat16"),
        ("diffusion-renderer-cosmos", {"allow_pickle": "yes"}, "a bool"),
    ],
)
def test_knobs_that_are_not_accepted_are_refused_with_what_is(name, knobs, text):
    with pytest.raises(JobError, match=text):
        ENTRIES[name].resolve(knobs)


def test_a_job_with_a_knob_out_of_range_is_refused_before_it_runs():
    shot = Shot.model_validate(SHOT | {"decompose": {"backend": "embedded", "knobs": {"steps": 5}}})
    with pytest.raises(JobError, match=r"an int in 1 \.\. 4"):
        backend_knobs(shot)


def test_a_file_and_a_row_add_a_backend(tmp_path, monkeypatch):
    """Checks, plan, identity, settings of a job and sampling work without another change."""
    (tmp_path / "toy_backend.py").write_text(TOY)
    (tmp_path / "toy.bin").write_bytes(b"weights")
    monkeypatch.syspath_prepend(tmp_path)
    row = Entry(
        "toy_backend:ToyBackend", Licence("Toy", commercial=False), version=7,
        footprint=lambda path, knobs: Footprint(32, 1, 3), knobs={"level": KnobSpec(40, high=100)},
    )  # fmt: skip
    monkeypatch.setitem(ENTRIES, "toy", row)
    with pytest.raises(JobError, match="--accept-license 'Toy'"):
        registry.check_licence("toy", ())
    identity = identify_backend("toy", tmp_path / "toy.bin", ["Toy"], {"level": 70})
    assert (identity.version, identity.knobs, identity.footprint.nfe) == (7, (("level", 70),), 3)
    shot = Shot.model_validate(SHOT | {"decompose": {"backend": "toy", "knobs": {"level": 70, "overlap": 0.5}}})
    assert backend_knobs(shot) == {"level": 70}
    assert ensemble_settings(shot).overlap == 0.5
    backend = registry.open_backend("toy", tmp_path / "toy.bin", ["Toy"], backend_knobs(shot))
    rgb, matte = np.full((40, 40, 3), 0.5, np.float32), np.ones((40, 40), np.float32)
    estimate = estimate_frame(rgb, matte, backend, EnsembleSettings(2), 0, 1)
    np.testing.assert_allclose(estimate.mean, 0.7, atol=1e-6)


def test_missing_package_names_backend_and_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "diffusers", None)
    with pytest.raises(MissingPartError, match=r"rgbx.*yesnt\[diffusers\]"):
        latents.diffusers_for("rgbx")


def test_the_table_imports_no_torch_and_the_embedded_model_no_kornia():
    """Jobs are planned without torch; a worker of the embedded model does not pay for kornia."""
    code = (
        "import sys\n"
        "import yesnt.decompose.registry, yesnt.decompose.identity, yesnt.decompose.settings, yesnt.decompose.window\n"
        "assert 'torch' not in sys.modules\n"
        "import yesnt.decompose.ensemble, yesnt.decompose.embedded\n"
        "assert 'torch' in sys.modules and 'kornia' not in sys.modules\n"
    )
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-c", code], check=True, cwd=root)
