"""The job: what `shot.yaml` says, validated and frozen. No files are read here; see io/jobfile.py."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from yesnt.core.capture_input import CaptureCameras, EvidenceInput, refuse_unmeasurable
from yesnt.core.color_spaces import LIN_REC709, WORKING, JobColors
from yesnt.core.gaussian_input import GaussianInput, fill_from_field, is_made
from yesnt.core.job_part import FIXED, Colorspace, Knob, Part
from yesnt.core.keyframes import Numbers, number_at, numbers_at
from yesnt.core.material_input import DecomposeInput, MaterialInput
from yesnt.core.matting_input import fill_mattes
from yesnt.core.scene_input import SceneFacts
from yesnt.core.set_input import SetInput, refuse_unusable_set
from yesnt.core.windows import Raster, Window

Quality = Literal["draft", "standard", "final", "reference"]

_FORBIDDEN_IN_NAMES = "/\\\0"


def _plain_name(name: str) -> str:
    if any(c in name for c in _FORBIDDEN_IN_NAMES) or name in {".", ".."} or name != name.strip():
        raise ValueError("a name must not hold path separators or surrounding blanks")
    return name


def _single_frame(value: Any) -> Any:
    """YAML reads the range of a single frame as a number."""
    return str(value) if type(value) is int else value


class PlateInput(Part):
    """Colour pictures, the plate or the background.

    `layer` (or the name of a part) or `channels` says where the colour is, `view` which eye; absent: well-known names
    are looked for. `alpha` says whether colour was multiplied by coverage; absent: as the file's format has it.
    """

    path: str
    colorspace: Colorspace = LIN_REC709
    layer: str | None = None
    channels: dict[Literal["R", "G", "B", "A"], str] = Field(default_factory=dict)
    view: str | None = None
    alpha: Literal["straight", "premultiplied", "premultiplied_linear"] | None = None

    @model_validator(mode="after")
    def _one_way_to_name(self) -> Self:
        if self.channels and (self.layer is not None or not {"R", "G", "B"} <= set(self.channels)):
            raise ValueError("channels needs R, G and B, and no layer beside it")
        return self


class MatteInput(Part):
    """Coverage in pictures of its own, in place of the plate's alpha; `channel` is needed where it is not obvious."""

    path: str
    channel: str | None = None


class GBufferInput(Part):
    """Depth and normals; `z` and `normal` name channels; where the defaults are absent, well-known names are.

    Depth is planar, the distance along the ray, or the inverse of planar depth (`z_kind`). Normals of a camera are in
    OpenCV's axes (y down, z away from the viewer) or in OpenGL's, Blender's and Nuke's (y up, z towards the viewer).
    Those of a Y-up world are turned, (x, y, z) to (x, -z, y). Unsigned ones are stored as (N + 1) / 2.
    """

    path: str
    z: str = "depth.Z"
    normal: str = "N"
    view: str | None = None
    normal_space: Literal["world", "world_y_up", "camera", "camera_opengl"] = "world"
    normal_range: Literal["signed", "unsigned"] = "signed"
    z_kind: Literal["planar", "ray", "inverse"] = "planar"
    units: Literal["m", "cm", "mm"] = "m"


KEYED = "(by frame)"
"""Tag of a value by frame; see `FIXED`."""

_BY_FRAME = Discriminator(lambda value: KEYED if isinstance(value, Mapping) else FIXED)

Point = Annotated[tuple[float, float, float], Field(strict=False)]
Points = Annotated[
    Annotated[Point, Tag(FIXED)] | Annotated[dict[int, Point], Field(min_length=1), Tag(KEYED)], _BY_FRAME
]
Stops = Annotated[float, Field(ge=-32, le=32)]
Exposure = Annotated[
    Annotated[Stops, Tag(FIXED)] | Annotated[dict[int, Stops], Field(min_length=1), Tag(KEYED)], _BY_FRAME
]


class _Map(Part):
    """How a lat-long map stands in the world; a path with a frame number names one map a frame.

    `rotation` is in degrees (yaw about +Z first), `exposure` in stops; both may be given by frame (core/keyframes.py).
    `clamp` is the largest radiance that is kept, in the map's own units, and what infinite radiance becomes. Without
    `colorspace` the map is in the space that its files state. `layer` names the layer or the part of the file. A map
    that was captured at `captured_at` (world metres), with what it shows `distance` metres away, is shown to the actor
    and to the camera as it looks from where they are.
    """

    convention: Literal["blender", "opengl", "mitsuba"] = "blender"
    rotation: Points = (0.0, 0.0, 0.0)
    exposure: Exposure = 0.0
    clamp: Annotated[float, Field(gt=0)] | None = None
    colorspace: Colorspace = LIN_REC709
    layer: str | None = None
    captured_at: Point | None = None
    distance: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.captured_at is None) != (self.distance is None):
            raise ValueError("captured_at and distance belong together")
        return self

    def turn(self, frame: int) -> tuple[Numbers, float]:
        """Rotation and exposure in a frame."""
        return numbers_at(self.rotation, frame), number_at(self.exposure, frame)

    def at(self, frame: int) -> Self:
        """The same map with the rotation and the exposure that it has in one frame."""
        rotation, exposure = self.turn(frame)
        return self.model_copy(update={"rotation": rotation, "exposure": exposure})


class LightInput(_Map):
    """The light that relights: a map, or the word `set`, which bakes the map at the actor's place from the scene."""

    path: str | None = None
    set: bool = False

    @model_validator(mode="before")
    @classmethod
    def _word(cls, value: Any) -> Any:
        if isinstance(value, str) and value != "set":
            raise ValueError("it is a map (`path:`) or the word `set`")
        return {"set": True} if value == "set" else value

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.set == (self.path is not None):
            raise ValueError("it needs a path or the word `set`, and not both")
        return self


class CaptureInput(_Map):
    """The light that the plate was shot under: a map, or the word `estimate`, which guesses it from the shot."""

    path: str | None = None
    estimate: bool = False

    @model_validator(mode="before")
    @classmethod
    def _word(cls, value: Any) -> Any:
        if isinstance(value, str) and value != "estimate":
            raise ValueError("it is a map (`path:`) or the word `estimate`")
        return {"estimate": True} if value == "estimate" else value

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.estimate == (self.path is not None):
            raise ValueError("it needs a path or the word `estimate`, and not both")
        if self.estimate and "colorspace" in self.model_fields_set:
            raise ValueError("an estimate is made from the plate and has no `colorspace` of its own")
        return self


class ProxyInput(Part):
    """A sequence of meshes, in the world of the camera or in units and axes that are said."""

    path: str
    units: Literal["m", "cm", "mm"] = "m"
    up: Literal["z", "y"] = "z"


class FlowInput(Part):
    """Optical flow: a method with its knobs, or a precomputed sequence with channels forward.u, forward.v.

    `weights` is the file of a learned method.
    """

    path: str | None = None
    weights: str | None = None
    knobs: dict[str, Knob] = Field(default_factory=dict)


class TemporalInput(Part):
    """The energy of method.md section 4 and how it is cut into chunks; `knobs` are fields of EnergyParams.

    `memory` is what a worker may hold while it solves, in GB; by default no more than it takes to decompose a frame, so
    that memory does not grow with length. A shot that needs no more is solved as one; others are
    cut into chunks of frames (or of `chunk` frames, if that is given), and these if need be into bands of rows.
    """

    enabled: bool = True
    method: Literal["default", "adam"] = "default"
    tolerance: Annotated[float, Field(gt=0, le=1)] = 1e-4
    chunk: Annotated[int, Field(ge=1, le=4096)] | None = None
    halo: Annotated[int, Field(ge=0, le=4096)] | None = None
    sweeps: Annotated[int, Field(ge=0, le=256)] | None = None
    robust: bool = True
    memory: Annotated[float, Field(gt=0, le=4096)] | None = None
    knobs: dict[str, Knob] = Field(default_factory=dict)


def _working_space(name: str) -> str:
    if name.casefold() not in WORKING:
        raise ValueError(f"the working space is one of {', '.join(WORKING)}")
    return name.casefold()


class ColorInput(Part):
    """OpenColorIO's configuration, and the spaces of the work, the delivered EXRs and the preview.

    `config` is a path, a name such as `ocio://default`, or `$OCIO`: that of the environment, else the built-in ACES
    configuration. Light is computed in `working`; the decomposition always receives linear Rec.709. `view` is a view of
    the configuration's default display; without it the preview shows sRGB as it is.
    """

    config: str = "$OCIO"
    working: Annotated[str, AfterValidator(_working_space)] = LIN_REC709
    output: Colorspace = LIN_REC709
    view: str | None = None


class ExrOutput(Part):
    """How the EXR sequence is written; `layers` are delivered beside those that every file holds."""

    compression: Literal["none", "rle", "zips", "zip", "piz"] = "zip"
    layers: Annotated[tuple[Literal["base_color", "light_sun", "light_rest"], ...], Field(strict=False)] = ()


class Shot(Part):
    """One `shot.yaml` (contract.md, "A shot")."""

    version: Literal[1]
    name: Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_plain_name)]
    frames: Annotated[str, BeforeValidator(_single_frame)]
    plate: PlateInput
    matte: MatteInput | None = None
    gbuffer: GBufferInput
    camera: str
    light: LightInput
    capture_light: CaptureInput | None = None
    background: PlateInput | None = None
    proxy: ProxyInput | None = None
    decompose: DecomposeInput = DecomposeInput()
    materials: Annotated[tuple[MaterialInput, ...], Field(strict=False), BeforeValidator(lambda m: m or ())] = ()
    gaussians: GaussianInput | None = None
    capture: CaptureCameras | None = None
    evidence: EvidenceInput = EvidenceInput()
    flow: FlowInput = FlowInput()
    temporal: TemporalInput = TemporalInput()
    relight: dict[str, Knob] = Field(default_factory=dict)
    set: SetInput | None = None
    composite: Literal["linear", "display"] = "linear"
    exr: ExrOutput = ExrOutput()
    color: ColorInput = ColorInput()
    quality: Quality = "standard"
    seed: Annotated[int, Field(ge=0, lt=2**64)] = 0
    output: str = "out"

    @property
    def corrected(self) -> bool:
        """Whether what the backend or the passes say is corrected before the temporal solve."""
        single = self.decompose.samples_backend and bool(self.decompose.quantities)
        return single or bool(self.materials)

    @property
    def captured(self) -> CaptureCameras | None:
        """The capture's cameras, if they may measure the materials."""
        return None if self.evidence.use is False else self.capture

    @property
    def matted(self) -> CaptureCameras | None:
        """The capture's cameras, if the run makes their mattes and something reads them."""
        fitted = self.gaussians is not None and self.gaussians.path is None
        capture = self.capture if fitted else self.captured
        return None if capture is None or capture.matting is None else capture

    @property
    def built_in_set(self) -> SetInput | None:
        """The set, if it is a ground or a mesh."""
        return None if self.set is None or self.set.blend is not None else self.set

    @property
    def light_groups(self) -> tuple[str, ...]:
        """Layers that hold the composite under a part of the light, if the job asks for them."""
        return tuple(name for name in ("light_sun", "light_rest") if name in self.exr.layers)

    @property
    def scene(self) -> str | None:
        """Path of the scene that is the set; None if there is none."""
        return None if self.set is None else self.set.blend

    @property
    def made(self) -> tuple[str, ...]:
        """Patterns of pictures and meshes that the run itself makes from the Gaussian fields, each once."""
        proxy = self.proxy.path if self.proxy else None
        patterns = dict.fromkeys(path for path in (self.plate.path, self.gbuffer.path, proxy) if path is not None)
        return tuple(path for path in patterns if self.gaussians is not None and is_made(path, self.output))

    @model_validator(mode="before")
    @classmethod
    def _filled(cls, data: Any) -> Any:
        return fill_mattes(fill_from_field(data))

    @model_validator(mode="after")
    def _set_whole(self) -> Self:
        shadows = self.relight.get("shadows", True)
        refuse_unusable_set(self.set, self.proxy is not None, self.background is not None, shadows)
        if self.light.set and self.scene is None:
            raise ValueError("`light: set` is baked from a scene; name it as `set: {blend: scene.blend}`")
        return self

    @model_validator(mode="after")
    def _divisible(self) -> Self:
        if self.light_groups and self.composite == "display":
            raise ValueError(
                f"`exr.layers: [{', '.join(self.light_groups)}]` sum up to the composite in linear light only; remove "
                "these layers, or `composite: display`"
            )
        if self.light_groups and self.scene is not None:
            raise ValueError(
                f"`exr.layers: [{', '.join(self.light_groups)}]` need a light of the job alone; the lamps of a scene "
                "of Blender are not told apart. Remove these layers, or use light groups of Blender itself"
            )
        return self

    @model_validator(mode="after")
    def _measurable(self) -> Self:
        refuse_unmeasurable(self.capture, self.evidence, self.proxy is not None)
        return self


class Job(Part):
    """A shot made absolute: where its files lie and which frames it has, in order.

    Attributes:
        shot: what the user wrote.
        root: absolute folder of the job file; relative paths start here.
        frames: frame numbers as delivered, ascending.
        width: columns that are processed.
        height: rows that are processed.
        raster: windows and pixel aspect ratio of the plates; None: all pictures are as large as the camera's.
        colors: how colours are converted on the way in and out.
        scene: what Blender says of the scene that is the set; None: there is none.
        left_out: (frame, stage) of frames that are not in `frames`, since the stage could not make what they are read
            from; ascending.
    """

    shot: Shot
    root: str
    frames: tuple[int, ...]
    width: int
    height: int
    raster: Raster | None = None
    colors: JobColors = JobColors()
    scene: SceneFacts | None = None
    left_out: tuple[tuple[int, str], ...] = ()

    def all_but(self, *stages: str) -> tuple[int, ...]:
        """All frames of the shot, left out or not, but for those that one of these stages could not make; ascending."""
        back = [frame for frame, stage in self.left_out if stage not in stages]
        return tuple(sorted((*self.frames, *back))) if back else self.frames

    @property
    def window(self) -> Window:
        """What is processed, counted from the corner of the display window."""
        return Window(0, 0, self.width, self.height) if self.raster is None else self.raster.data

    @property
    def display_size(self) -> tuple[int, int]:
        """Columns and rows of every picture's display window."""
        return (self.width, self.height) if self.raster is None else self.raster.display.size

    def position(self, frame: int) -> int:
        """Index of a frame number in the sequence.

        Raises:
            ValueError: the shot has no such frame.
        """
        index = bisect_left(self.frames, frame)
        if index == len(self.frames) or self.frames[index] != frame:
            raise ValueError(f"the shot has no frame {frame}")
        return index

    @property
    def probe_frames(self) -> tuple[int, ...]:
        """Frames that stand for the shot where its capture light is estimated: the ends and the middle."""
        last = len(self.frames) - 1
        return tuple(self.frames[i] for i in sorted({0, last // 2, last}))
