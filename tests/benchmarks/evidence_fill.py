"""Frames between measured ones: pixels that the flow does not reach, filled from those that look alike or not.

    python tests/benchmarks/evidence_fill.py SET OUTPUT SHOT FRAME ...

OUTPUT is that of `yesnt eval SET --output OUTPUT` with rows of 12 cameras, the store of which holds the model's
estimate and what was carried. Each frame is solved by itself and relit under the map `city`. PSNR in dB; RMSE against
the true materials, roughness and metallic; "within" is the share of unreached pixels within one standard deviation.
"""

import sys
from pathlib import Path

import numpy as np

from yesnt.decompose.confidence import confidence
from yesnt.decompose.evidence.fill import Materials, filled
from yesnt.decompose.evidence.settings import EvidenceSettings
from yesnt.io.store import FrameStore
from yesnt.measure.evaluation.evidence_rows import EVIDENCE_ROWS
from yesnt.measure.evaluation.scene import Scene
from yesnt.measure.evaluation.subjects import find_subjects
from yesnt.metrics.score import Truth, score_briefly
from yesnt.runtime.session import Session
from yesnt.temporal import EnergyParams, solve

ROW, MAP = "cameras_12", "city"


def stored(session, frame):
    """Materials with the model's own estimate where nothing was measured, and where something was."""
    store = FrameStore(session.output.store)

    def read(stage, name):
        record = session.book.find(stage, frame)
        return store.read(name, session.job.position(frame), record.arrays[name])

    known = read("evidence", "views").reshape(read("decompose", "observed").shape[1:]) > 0
    pairs = ("measured", "observed"), ("measured_spread", "spread")
    planes = (np.where(known, read("evidence", a), read("decompose", b)) for a, b in pairs)
    return Materials(*planes), known


def solved(found, inside):
    """Materials [2, H, W] of the frame by itself."""
    nothing = np.zeros((0, *inside.shape), np.float32)
    flow = np.zeros((0, *inside.shape, 2), np.float32)
    return solve(found.mean[:, None], confidence(found.std)[:, None], flow, nothing, EnergyParams(), inside[None])


def main(folder, output, shot, frames):
    session = Session(output / "shots" / shot / ROW)
    subject = find_subjects(folder, [MAP], [shot])[0]
    print(
        "| frame | unreached | unreached pixels | PSNR | roughness RMSE | metallic RMSE | within |\n" + "|---" * 7 + "|"
    )
    for frame in frames:
        scene = Scene(session.job, frame)
        matte = scene.plate.matte
        truth, true = Truth.of(*subject.read_relit(MAP, frame), matte), subject.read_material(frame, matte).planes
        own, known = stored(session, frame)
        other = filled(own, known, scene.plate.color, matte > 0.5, EvidenceSettings())
        solid, open_ = matte > 0.99, (matte > 0.99) & ~known
        for label, found in (("the model's", own), ("filled", other)):
            planes = np.ascontiguousarray(solved(found, matte > 0.5).value[:, 0], np.float32)
            relit = scene.relit(EVIDENCE_ROWS["cameras_8"], planes, subject.env_path(MAP))
            psnr = {one.name: one.value for one in score_briefly(relit, truth)}["psnr"]
            wrong = found.mean - true
            rmse = [float(np.sqrt(np.square(plane[solid]).mean())) for plane in wrong]
            within = [float((np.abs(a[open_]) <= b[open_]).mean()) for a, b in zip(wrong, found.std, strict=True)]
            print(f"| {shot} {frame} | {label} | {open_.sum() / solid.sum():.2f} | {psnr:.1f} | {rmse[0]:.3f} "
                  f"| {rmse[1]:.3f} | {within[0]:.2f} / {within[1]:.2f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], [int(one) for one in sys.argv[4:]])
