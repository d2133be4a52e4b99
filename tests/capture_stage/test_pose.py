import numpy as np
import pytest

from yesnt.capture_stage import motions
from yesnt.capture_stage.pose import Body, arm, forward_kinematics, leg, skin, turn


@pytest.fixture
def worm() -> Body:
    """Three bones along +Z, a ring of vertices about each joint, blended half way."""
    joints = np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 2]])
    rings = [
        [[np.cos(a), np.sin(a), z] for a in np.linspace(0, 2 * np.pi, 8, endpoint=False)] for z in (0, 0.5, 1, 1.5, 2)
    ]
    weights = np.repeat(
        np.array([[1, 0, 0], [1, 0, 0], [0.5, 0.5, 0], [0, 1, 0], [0, 0.5, 0.5]], dtype=np.float32), 8, axis=0
    )
    faces = np.zeros((1, 4), dtype=np.int32)
    return Body(np.array(rings).reshape(-1, 3), faces, joints, weights, ("a", "b", "c"), (-1, 0, 1))


def test_no_rotation_is_the_rest_pose(worm):
    assert np.allclose(skin(worm, {}), worm.vertices)


def test_turning_the_root_is_rigid(worm):
    posed = skin(worm, {"a": turn("y", 37) @ turn("z", 20)})
    before, after = (np.linalg.norm(v[:, None] - v[None], axis=-1) for v in (worm.vertices, posed))
    assert np.allclose(before, after, atol=1e-12)
    assert posed[:, 2].min() == pytest.approx(0)


def test_a_child_follows_its_parent(worm):
    linear, shift = forward_kinematics(worm, {"a": turn("y", 90), "b": turn("z", 30)})
    tip = linear[2] @ worm.joints[2] + shift[2]
    assert np.allclose(tip, [2, 0, 0], atol=1e-12)  # +Z turned to +X about the root; the twist leaves the axis


def test_a_joint_stays_where_it_is_when_its_own_bone_turns(worm):
    linear, shift = forward_kinematics(worm, {"b": turn("x", 70)})
    assert np.allclose(linear[1] @ worm.joints[1] + shift[1], worm.joints[1])


def test_unknown_bones_are_refused(worm):
    with pytest.raises(ValueError, match="no such bones"):
        skin(worm, {"tail": np.eye(3)})


def test_knees_bend_backwards_and_thighs_swing_forwards():
    shin = np.array([0.0, 0.0, -1.0])
    assert (leg("L", 0, 40)["lowerleg01.L"] @ shin)[1] > 0  # bodies face -Y
    assert (leg("L", 30, 0)["upperleg01.L"] @ shin)[1] < 0


def test_arms_mirror():
    joints = {"upperarm01": [0.17, 0, 1.4], "lowerarm01": [0.35, 0, 1.2]}
    bones = tuple(f"{b}.{s}" for b in joints for s in "LR")
    where = np.array([[x if s == "L" else -x, y, z] for x, y, z in joints.values() for s in "LR"])
    body = Body(where, np.zeros((1, 4), np.int32), where, np.eye(4, dtype=np.float32), bones, (-1, -1, 0, 1))
    flip = np.diag([-1.0, 1, 1])
    left, right = arm(body, "L", 20, 30, 10, 50), arm(body, "R", 20, 30, 10, 50)
    for bone in joints:
        assert np.allclose(flip @ left[f"{bone}.L"] @ flip, right[f"{bone}.R"])


def test_every_motion_names_bones_and_is_smooth():
    joints = {f"{b}.{s}": [0.2 if s == "L" else -0.2, 0, 1.0] for b in ("upperarm01", "lowerarm01") for s in "LR"}
    joints["lowerarm01.L"], joints["lowerarm01.R"] = [0.35, 0, 0.8], [-0.35, 0, 0.8]
    where = np.array(list(joints.values()))
    body = Body(where, np.zeros((1, 4), np.int32), where, np.eye(4, dtype=np.float32), tuple(joints), (-1,) * 4)
    for motion in (motions.walk_and_sweep, motions.box, motions.turn_and_wave, motions.greet, motions.guard):
        first, second = motion(body, 0.30), motion(body, 0.3001)
        assert first.keys() == second.keys()
        assert all(np.abs(first[b] - second[b]).max() < 0.01 for b in first)
        assert all(np.allclose(r @ r.T, np.eye(3)) for r in first.values())
