"""Nodes of the preview: segments of a video, encoded as frames are delivered, and the video of all."""

from __future__ import annotations

from collections.abc import Iterator

from yesnt.io.preview import USUAL, Presentation, has_video
from yesnt.planning.builders.assemble import ids, node_fields, node_keys
from yesnt.planning.graph import Graph, Node
from yesnt.planning.keyed_settings import shared
from yesnt.planning.shot_plan import ShotPlan
from yesnt.planning.stages import COMPOSITE, PREVIEW, SEGMENT
from yesnt.planning.task_records import PreviewSegmentTask, PreviewTask


def segment_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """Every second of the preview video, as soon as its frames are delivered; none where a frame is too small."""
    if not has_video(plan.job):
        return
    how = Presentation.of(plan.job)
    seen = {"shown": str(how.shown) if how.shown else None, "rate": str(how.rate) if how.rate != USUAL.rate else None}
    settings = shared(name=plan.job.shot.name, color=plan.job.colors.digests("display"), **seen)
    for number, first in enumerate(range(0, len(plan.delivered), how.segment_frames)):
        frames = plan.delivered[first : first + how.segment_frames]
        needs = [graph.committer(COMPOSITE, frame) for frame in frames]
        fields = node_fields(plan, SEGMENT, settings, node_keys(needs))
        yield Node(SEGMENT, number, frames[:1], fields, ids(needs), PreviewSegmentTask(frames), transient=True)


def preview_nodes(plan: ShotPlan, graph: Graph) -> Iterator[Node]:
    """The video and the contact sheet of all delivered frames; nothing without segments."""
    segments = [node for node in graph if node.stage == SEGMENT]
    if segments:
        fields = node_fields(plan, PREVIEW, shared(), node_keys(segments))
        yield Node(PREVIEW, 0, plan.job.frames[:1], fields, ids(segments), PreviewTask(len(segments)))
