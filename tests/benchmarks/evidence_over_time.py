"""Materials of a shot measured by one camera over time, against its truth and the model alone.

    python tests/benchmarks/evidence_over_time.py SHOT [POSITION ...]

SHOT has `truth/` with materials and flow. Each position in the shot is measured by the frames of `OFFSETS` around it,
along the shot's own flow and along the true one. "turn" is the median angle by which the normals of the farthest frame
differ, "reached" the share of pixels whose track leads there.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import yaml

from yesnt.decompose.evidence.over_time import Moment, measure_over_time
from yesnt.decompose.evidence.settings import OFFSETS, EvidenceSettings
from yesnt.decompose.evidence.tracks import earlier_places, later_places
from yesnt.decompose.reuse import Link
from yesnt.measure.evaluation.subjects import Subject
from yesnt.measure.trade.harness import Harness
from yesnt.measure.trade.variants import variants
from yesnt.metrics.material import measure_material
from yesnt.planning import settings as of
from yesnt.relight import ProxyScene
from yesnt.runtime.session import Session
from yesnt.tasks.evidence_inputs import evidence_inputs
from yesnt.tasks.light import LightFiles
from yesnt.tasks.relight_inputs import proxy_scene, read_proxy


def open_shot(folder, home):
    """The shot without its capture, with absolute paths and an output of its own."""
    job = yaml.safe_load((folder / "shot.yaml").read_text())
    for part in ("plate", "gbuffer", "light", "capture_light", "proxy"):
        job[part]["path"] = str(folder / job[part]["path"])
    for name in ("capture", "evidence", "set"):
        job.pop(name, None)
    job |= {"camera": str(folder / job["camera"]), "output": str(home / "out")}
    (home / "shot.yaml").write_text(yaml.safe_dump(job))
    return Session(home)


class Shot:
    """The frames around one position."""

    def __init__(self, session, folder, position):
        frames = session.job.frames
        reach = [position + o for o in OFFSETS if 0 <= position + o < len(frames)]
        first = min([position, *reach])
        self.harness = Harness(session, frames[first : max([position, *reach]) + 1])
        self.subject, self.now = Subject(folder, folder.name, ()), position - first
        self.others = [p - first for p in reach]
        base = variants((1,))[0]
        self.mean, self.std, _ = self.harness.observe(base.ensemble, base.knobs, base.method)

    def true_links(self):
        """The true flow, valid inside the matte."""
        mattes = self.harness.mattes
        flows = [self.subject.read_flow(frame) for frame in self.harness.frames[:-1]]
        inside = zip(flows, mattes, strict=False)
        return [Link(np.where(m[..., None], f, 0).astype(np.float32), m.astype(np.float32)) for f, m in inside]

    def inputs(self, place):
        job, frame = self.harness.session.job, self.harness.frames[place]
        bare = replace(self.harness.bare(place), proxy=proxy_scene(read_proxy(job, frame), ProxyScene))
        estimate = self.mean[:, place], self.std[:, place]
        return evidence_inputs(bare, estimate, [], LightFiles.read(job, frame), of.relight_settings(job.shot))

    def places(self, links, other):
        low, high = sorted((self.now, other))
        mattes = [self.harness.mattes[p] for p in range(low, high + 1)]
        return (later_places if other > self.now else earlier_places)(links[low:high], mattes)


def figures(planes, true, inside):
    """RMSE of roughness and of metallic, and AUC of metallic, as text."""
    found = [
        {m.name: m.value for m in measure_material(planes[i][inside], true[i][inside], None, i == 1)} for i in (0, 1)
    ]
    return f"{found[0]['rmse']:.3f} | {found[1]['rmse']:.3f} | {found[1].get('auc', np.nan):.3f}"


def measure(shot, label):
    """Prints the rows of one frame."""
    matte = shot.harness.plates[shot.now].matte
    true, inside = shot.subject.read_material(shot.harness.frames[shot.now], matte).planes, matte > 0.99
    print(f"| {label} | the model | | | {figures(shot.mean[:, shot.now], true, inside)} |", flush=True)
    inputs = {p: shot.inputs(p) for p in (shot.now, *shot.others)}
    relight = of.relight_settings(shot.harness.session.job.shot)
    for name, links in (("own flow", shot.harness.links("dis-quality")[0]), ("true flow", shot.true_links())):
        moments = [Moment(inputs[p], shot.places(links, p)) for p in shot.others]
        found = measure_over_time(inputs[shot.now], moments, relight, EvidenceSettings())
        turn, reached = _turn(inputs[shot.now], moments[-1], inside)
        text = figures(found.mean, true, inside)
        print(f"| {label} | {len(moments)} frames, {name} | {turn:.0f} | {reached:.2f} | {text} |", flush=True)


def _turn(now, moment, inside):
    known = inside & np.isfinite(moment.place[..., 0])
    column, row = np.rint(moment.place[known]).astype(int).T
    cosine = (now.surface.normal[known] * moment.inputs.surface.normal[row, column]).sum(axis=-1)
    return np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))), known.sum() / inside.sum()


def main(folder, positions):
    torch.set_num_threads(1)
    print("| frame | measured by | turn, degrees | reached | roughness RMSE | metallic RMSE | metallic AUC |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as home:
        session = open_shot(folder, Path(home))
        for position in positions or [len(session.job.frames) // 2]:
            measure(Shot(session, folder, position), f"{folder.name} {session.job.frames[position]}")


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute(), [int(p) for p in sys.argv[2:]])
