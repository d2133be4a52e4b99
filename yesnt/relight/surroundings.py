"""The set as a mesh among which light travels: it occludes the subject's surroundings and reflects light onto it.

Source: docs/method.md section 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.proxy import ProxyScene

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class SetMaterial:
    """One material for the whole set.

    Attributes:
        color: [3] base colour, 0..1, linear in the space of the lights.
        roughness: Disney's, 0..1.
        metallic: 0..1.
    """

    color: F32
    roughness: float
    metallic: float


@dataclass(frozen=True)
class Surroundings:
    """The set around a subject: G triangles of one material.

    Attributes:
        mesh: the triangles.
        material: of all of them.
        floor: world z, metres, below which nothing of the subject is looked from: the height of a ground plane, into
            which a proxy's feet may sink; None for a mesh.
    """

    mesh: ProxyScene
    material: SetMaterial
    floor: float | None = None

    def features(self) -> F32:
        """Material of the triangles as `indirect_light` paints it, [G, 8]: diffuse and metallic colour, r, m."""
        color, metallic = self.material.color, np.float32(self.material.metallic)
        row = np.concatenate([color * (1 - metallic), color * metallic, [self.material.roughness, metallic]])
        return np.broadcast_to(row.astype(np.float32), (len(self.mesh.faces), 8))

    def around(self, subject: ProxyScene) -> ProxyScene:
        """One scene of the subject's F triangles, which come first, and those of the set."""
        faces = np.concatenate([subject.faces, self.mesh.faces + np.int32(len(subject.vertices))])
        return ProxyScene(np.concatenate([subject.vertices, self.mesh.vertices]), faces)
