"""A set that is a scene of Blender, or glTF (docs/set.md)."""

from __future__ import annotations

from dataclasses import dataclass

SCENE_SUFFIXES = (".blend", ".gltf", ".glb")


def scene_file(path: str) -> str:
    """The path of a scene.

    Raises:
        ValueError: it has another suffix.
    """
    if not path.lower().endswith(SCENE_SUFFIXES):
        raise ValueError(f"a scene is a file of {', '.join(SCENE_SUFFIXES)}")
    return path


def has_world(path: str) -> bool:
    """Whether a scene's file says what surrounds its objects; glTF does not."""
    return path.lower().endswith(".blend")


@dataclass(frozen=True)
class SceneFacts:
    """What Blender says of a scene.

    Attributes:
        files: absolute paths of the libraries, pictures and caches that it is made from.
        version: of Blender.
        denoises: whether this Blender can denoise; without, it renders four times the samples.
    """

    files: tuple[str, ...]
    version: str
    denoises: bool
