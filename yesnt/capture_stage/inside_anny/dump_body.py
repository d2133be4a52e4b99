"""Writes rest bodies of the parametric human `anny` (code Apache-2.0, data CC0) as plain arrays.

Runs in an environment of its own (anny needs torch and warp): `python dump_body.py requests.json`, where the requests
are `[{"out": "body.npz", "phenotype": {"gender": 0.0, ...}}, ...]`. Posing is yesnt's own code (capture_stage/pose.py).
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import anny
import numpy as np
import torch


def dump(model: Any, phenotype: dict[str, float], out: Path) -> None:
    """Writes one body: vertices [V, 3] metres Z up, quads [F, 4], joints [J, 3], weights [V, J]."""
    with torch.no_grad():
        rest = model(phenotype_kwargs=phenotype, return_bone_ends=False)
        indices, weights = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    dense = np.zeros((len(indices), model.bone_count), dtype=np.float32)
    np.put_along_axis(dense, indices, 0, axis=1)
    for column in range(indices.shape[1]):  # indices may repeat within a row with weight 0
        np.add.at(dense, (np.arange(len(indices)), indices[:, column]), weights[:, column])
    temporary = out.with_name(f".{out.name}.{os.getpid()}.npz")
    np.savez_compressed(
        temporary,
        vertices=rest["rest_vertices"][0].numpy().astype(np.float32),
        faces=np.asarray(model.faces, dtype=np.int32),
        joints=rest["rest_bone_heads"][0].numpy().astype(np.float32),
        weights=dense,
        bones=np.array(model.bone_labels),
        parents=np.array(model.bone_parents, dtype=np.int32),
        anny_version=np.array(anny.__version__),
    )
    os.replace(temporary, out)


def main() -> None:
    """Builds the model once (about a minute, longer the first time) and writes every asked body."""
    torch.set_num_threads(1)
    requests = json.loads(Path(sys.argv[1]).read_text())
    model = anny.Anny(rig="makehuman", topology="anny-quads", skinning_method="lbs")
    for request in requests:
        dump(model, request["phenotype"], Path(request["out"]))


if __name__ == "__main__":
    main()
