"""A body of tubes with the bones that costumes and poses name: the parametric human's stand-in."""

import numpy as np

from yesnt.capture_stage.pose import Body

_AROUND = 8

_CHAINS = {
    # bone: (parent, from, to, radius)
    "root": (None, (0, 0, 0.95), (0, 0, 1.05), 0.14),
    "spine03": ("root", (0, 0, 1.05), (0, 0, 1.42), 0.15),
    "neck01": ("spine03", (0, 0, 1.42), (0, 0, 1.52), 0.05),
    "head": ("neck01", (0, -0.01, 1.52), (0, -0.01, 1.78), 0.09),
    "eye.L": ("head", (0.03, -0.1, 1.66), (0.03, -0.11, 1.67), 0.012),
    "eye.R": ("head", (-0.03, -0.1, 1.66), (-0.03, -0.11, 1.67), 0.012),
}
for _side, _sign in (("L", 1.0), ("R", -1.0)):
    _CHAINS |= {
        f"upperarm01.{_side}": ("spine03", (0.17 * _sign, 0, 1.4), (0.27 * _sign, 0, 1.3), 0.05),
        f"upperarm02.{_side}": (f"upperarm01.{_side}", (0.27 * _sign, 0, 1.3), (0.37 * _sign, 0, 1.2), 0.045),
        f"lowerarm01.{_side}": (f"upperarm02.{_side}", (0.37 * _sign, 0, 1.2), (0.47 * _sign, 0, 1.1), 0.04),
        f"lowerarm02.{_side}": (f"lowerarm01.{_side}", (0.47 * _sign, 0, 1.1), (0.57 * _sign, 0, 1.0), 0.035),
        f"wrist.{_side}": (f"lowerarm02.{_side}", (0.57 * _sign, 0, 1.0), (0.63 * _sign, 0, 0.94), 0.03),
        f"upperleg01.{_side}": ("root", (0.09 * _sign, 0, 0.95), (0.09 * _sign, 0, 0.5), 0.08),
        f"lowerleg01.{_side}": (f"upperleg01.{_side}", (0.09 * _sign, 0, 0.5), (0.09 * _sign, 0, 0.08), 0.05),
        f"foot.{_side}": (f"lowerleg01.{_side}", (0.09 * _sign, 0, 0.05), (0.09 * _sign, -0.14, 0.04), 0.04),
    }
    for _finger in range(2, 6):
        _parent = f"wrist.{_side}"
        for _joint in range(1, 4):
            _along = 0.02 * (_joint - 1)
            _start = np.array([(0.63 + _along) * _sign, 0.01 * (_finger - 3.5), 0.94 - _along])
            _CHAINS[f"finger{_finger}-{_joint}.{_side}"] = (
                _parent, tuple(_start), tuple(_start + np.array([0.02 * _sign, 0, -0.02])), 0.008,
            )  # fmt: skip
            _parent = f"finger{_finger}-{_joint}.{_side}"


def puppet() -> Body:
    """One tube a bone, every vertex moved by its own bone alone."""
    bones, vertices, faces, owners = tuple(_CHAINS), [], [], []
    for number, (_, start, end, radius) in enumerate(_CHAINS.values()):
        first = _AROUND * 2 * number
        along = np.subtract(end, start)
        side = np.cross(along, (0.3, 1.0, 0.2))
        side /= np.linalg.norm(side)
        up = np.cross(along, side) / np.linalg.norm(along)
        for centre in (start, end):
            angles = np.arange(_AROUND) * 2 * np.pi / _AROUND
            vertices += list(centre + radius * (np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * up))
        for k in range(_AROUND):
            n = (k + 1) % _AROUND
            faces.append([first + k, first + n, first + _AROUND + n, first + _AROUND + k])
        owners += [number] * 2 * _AROUND
    weights = np.zeros((len(vertices), len(bones)), np.float32)
    weights[np.arange(len(vertices)), owners] = 1
    parents = tuple(-1 if parent is None else bones.index(parent) for parent, *_ in _CHAINS.values())
    joints = np.array([start for _, start, *_ in _CHAINS.values()])
    return Body(np.array(vertices), np.array(faces, np.int32), joints, weights, bones, parents)
