"""Runs inside a checkout of DiffusionRenderer-Cosmos, with its Python: reads frames, writes float arrays.

Usage: python run.py REQUEST.json. It imports the checkout and nothing of yesnt. The pipeline itself returns 8-bit
values; this script captures the output of the decoder before that conversion.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from cosmos_predict1.diffusion.inference.diffusion_renderer_pipeline import DiffusionRendererPipeline
from cosmos_predict1.diffusion.inference.diffusion_renderer_utils.dataloader_utils import dict_collation_fn
from cosmos_predict1.diffusion.inference.diffusion_renderer_utils.dataset_inference import VideoFramesDataset
from cosmos_predict1.diffusion.inference.diffusion_renderer_utils.rendering_utils import GBUFFER_INDEX_MAPPING
from cosmos_predict1.utils import misc


def main(request: dict[str, Any]) -> None:
    """Draws every requested member of every requested quantity of one clip."""
    torch.set_grad_enabled(False)
    height, width = request["height"], request["width"]
    pipeline = DiffusionRendererPipeline(
        checkpoint_dir=request["checkpoints"], checkpoint_name="Diffusion_Renderer_Inverse_Cosmos_7B",
        offload_network=request["offload"], offload_tokenizer=request["offload"], guidance=0.0,
        num_steps=request["steps"], height=height, width=width, fps=24, num_video_frames=request["frames"], seed=0,
    )  # fmt: skip
    dataset = VideoFramesDataset(
        root_dir=request["folder"], sample_n_frames=request["frames"], overlap_n_frames=0, chunk_mode="first",
        group_mode="folder", image_extensions=["png"], resolution=[height, width], resize_resolution=None,
    )  # fmt: skip
    batch = next(iter(torch.utils.data.DataLoader(dataset, batch_size=1, collate_fn=dict_collation_fn)))
    decoded = _keep_decoded(pipeline.model)
    for draw in request["draws"]:
        batch["context_index"].fill_(GBUFFER_INDEX_MAPPING[draw["pass"]])
        misc.set_random_seed(draw["seed"])
        pipeline.seed = draw["seed"]
        pipeline.generate_video(data_batch=batch, normalize_normal=False)
        quantity = (0.5 + 0.5 * decoded.pop()[0].float()).clamp(0, 1).mean(0)  # [3, T, H, W] to [T, H, W]
        np.save(draw["output"], quantity.cpu().numpy().astype(np.float32))


def _keep_decoded(model: Any) -> list[Any]:
    """Patches the model so that it appends every decoded clip to the returned list."""
    kept: list[Any] = []
    decode = model.decode

    def decode_and_keep(*args: Any, **kwargs: Any) -> Any:
        kept.append(decode(*args, **kwargs))
        return kept[-1]

    model.decode = decode_and_keep
    return kept


if __name__ == "__main__":
    main(json.loads(Path(sys.argv[1]).read_text()))
