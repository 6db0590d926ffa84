"""The nine joints are found in any human rig, and what is missing is said."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import skeletons
from skeletons import CONVENTIONS, human, nameless, rig_of, t_posed
from wrinkle_synthesis.wrinkle_addon.joints import JOINT_NAMES, JointSearch, find_joints, joints_to_json
from wrinkle_synthesis.wrinkle_addon.rig import Rig

FAR = {"elbow": "forearm", "knee": "shin", "shoulder": "upperarm", "hip": "thigh"}


def expected_far_bones(name_of: Callable[[str], str]) -> dict[str, str]:
    return {
        name: name_of("chest") if name == "spine" else name_of(f"{FAR[name[:-2]]}_{name[-1]}") for name in JOINT_NAMES
    }


def far_bones(search: JointSearch) -> dict[str, str | None]:
    return {name: joint.far if joint else None for name, joint in search.joints.items()}


def assert_found(rig: Rig, original: Rig | None = None) -> JointSearch:
    """All nine joints sit on the bones that stand where ``original`` has them under the names of the body parts."""
    names = (original or rig).names
    search = find_joints(rig)
    assert far_bones(search) == expected_far_bones(lambda part: rig.names[names.index(part)])
    return search


# --- names --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("pose", ["A-pose", "T-pose"])
def test_every_naming_convention(convention: str, pose: str) -> None:
    names = CONVENTIONS[convention]
    rig = human(names)
    search = find_joints(rig if pose == "A-pose" else t_posed(rig, lambda part: names.get(part, "")))
    assert far_bones(search) == expected_far_bones(names.__getitem__)
    assert not search.missing and not search.notes


def test_bones_run_from_the_trunk_outwards() -> None:
    joints = find_joints(human(CONVENTIONS["Unreal"])).joints
    assert joints["shoulder_L"].bones == ("clavicle_l", "upperarm_l")
    assert joints["spine"].bones == ("spine_01", "spine_02", "spine_03")
    near = {name: joints[name].near for name in ("spine", "shoulder_R", "elbow_R", "hip_R", "knee_R")}
    assert near == {
        "spine": "pelvis", "shoulder_R": "spine_03", "elbow_R": "upperarm_r", "hip_R": "pelvis", "knee_R": "thigh_r",
    }  # fmt: skip


# --- shape --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("body", [human(), t_posed(human())], ids=["A-pose", "T-pose"])
def test_bones_without_names_are_told_by_shape(body: Rig) -> None:
    assert_found(nameless(body), body)


@pytest.mark.parametrize("seed", range(6))
def test_neither_roll_nor_local_axes_nor_orientation_nor_size_matter(seed: int) -> None:
    body = human()
    vector = np.random.default_rng(seed).normal(size=3) * 1.5
    assert_found(skeletons.rolled(nameless(body), seed), body)
    assert_found(skeletons.with_stray_tails(nameless(body), seed), body)
    assert_found(skeletons.turned(nameless(body), vector), body)
    assert_found(skeletons.scaled(nameless(body), 10.0 ** (seed - 3)), body)


def test_a_rig_lying_across_gravity_is_read_by_its_own_up() -> None:
    lying = replace(skeletons.turned(human(), (0.4, 1.1, -0.7)), gravity=np.array([0.0, 0.0, -1.0]))
    assert_found(lying)
    assert_found(nameless(lying), lying)


@pytest.mark.parametrize(
    "drop",
    [
        ("toe_L", "toe_R"),
        ("clavicle_L", "clavicle_R"),
        ("head", "neck"),
        ("spine1", "spine2"),
        ("foot_L", "foot_R", "toe_L", "toe_R"),
        ("thumb_L", "thumb_R", "index_L", "index_R", "ring_L", "ring_R", "hand_L", "hand_R"),
    ],
    ids=lambda drop: drop[0],
)
def test_rigs_with_fewer_bones(drop: tuple[str, ...]) -> None:
    body = human(drop=drop)
    assert_found(body)
    assert_found(nameless(body), body)


def test_a_nine_joint_rig_may_hang_limbs_anywhere() -> None:
    table = {
        name: (body.names[parent] if parent >= 0 else "", head, tail)
        for body in [human()]
        for name, parent, head, tail in zip(body.names, body.parents, body.heads, body.tails, strict=True)
    }
    loose_legs = rig_of({n: ("" if n.startswith("thigh") else p, h, t) for n, (p, h, t) in table.items()})
    arms_on_neck = rig_of({n: ("neck" if n.startswith("clavicle") else p, h, t) for n, (p, h, t) in table.items()})
    flat = rig_of({n: ("", h, t) for n, (_, h, t) in table.items()})
    one_root = rig_of({n: ("root", h, t) for n, (_, h, t) in table.items()} | {"root": ("", (0, 0, 0), (0, 0.1, 0))})
    daz = {n: ("girdle" if n.startswith("thigh") else p, h, t) for n, (p, h, t) in table.items()}
    beside = rig_of(daz | {"girdle": ("pelvis", (0, 0, 0.95), (0, 0, 0.9))})
    for rig in (loose_legs, arms_on_neck, flat, one_root):
        assert_found(rig)
    assert find_joints(beside).joints["spine"].near == "girdle"
    assert find_joints(beside).joints["spine"].bones == ("spine1", "spine2", "chest")


def decoyed(with_copies: bool) -> Rig:
    """The body with twist bones, IK and control bones, skirt, hair, tail and wings."""
    body = human()
    bones: dict[str, tuple] = {"root": ("", (0, 0, 0), (0, 0.1, 0))}
    for side, x in (("L", 1.0), ("R", -1.0)):
        for part in ("upperarm", "forearm", "thigh", "shin", "hand", "foot"):
            row = body.index[f"{part}_{side}"]
            head, tail = body.heads[row], body.tails[row]
            bones[f"{part}_twist_{side}"] = (f"{part}_{side}", head, 0.5 * (head + tail))
            bones[f"corrective_{part}_{side}"] = (f"{part}_{side}", tail, 0.9 * tail + 0.1 * head)
            if with_copies:
                bones[f"DRV_{part}_{side}"] = (body.names[body.parents[row]], head, tail)
                bones[f"CTRL_{part}_{side}"] = ("root", head, tail)
        bones[f"ik_hand_{side}"] = ("root", (0.51 * x, -0.08, 1.04), (0.56 * x, -0.12, 0.97))
        bones[f"ik_foot_{side}"] = ("root", (0.13 * x, 0.03, 0.09), (0.14 * x, -0.09, 0.03))
        bones[f"pole_knee_{side}"] = ("root", (0.1 * x, -0.6, 0.5), (0.1 * x, -0.7, 0.5))
        bones[f"breast_{side}"] = ("chest", (0.1 * x, -0.05, 1.25), (0.1 * x, -0.15, 1.25))
        bones[f"eye_{side}"] = ("head", (0.03 * x, -0.08, 1.62), (0.03 * x, -0.1, 1.62))
        chains = {"skirt": ("pelvis", 5, (0.15, -0.1, 0.9), (0.02, 0.0, -0.15)),
                  "hair": ("head", 6, (0.08, 0.1, 1.7), (0.0, 0.0, -0.15)),
                  "wing": ("chest", 4, (0.1, 0.2, 1.4), (0.3, 0.0, 0.1))}  # fmt: skip
        for name, (carrier, count, start, step) in chains.items():
            for i in range(count):
                head = np.array(start) + i * np.array(step)
                above = f"{name}{i - 1}_{side}" if i else carrier
                bones[f"{name}{i}_{side}"] = (above, head * (x, 1, 1), (head + step) * (x, 1, 1))
    for i in range(8):
        bones[f"tail{i}"] = (f"tail{i - 1}" if i else "pelvis", (0, 0.1 + 0.1 * i, 0.95), (0, 0.2 + 0.1 * i, 0.95))
    return skeletons.with_bones(body, bones)


def test_decoys_are_passed_over() -> None:
    search = assert_found(decoyed(with_copies=True))
    assert not search.notes


def test_decoys_without_names_are_passed_over() -> None:
    rig = decoyed(with_copies=False)
    assert_found(nameless(rig), rig)


def test_bones_that_divide_a_limb_belong_to_it() -> None:
    body = human()
    bones = {n: (body.names[p] if p >= 0 else "", h, t)
             for n, p, h, t in zip(body.names, body.parents, body.heads, body.tails, strict=True)}  # fmt: skip
    for side in "LR":
        for part, after in (("upperarm", "forearm"), ("forearm", "hand"), ("thigh", "shin"), ("shin", "foot")):
            middle, end = f"{part}_{side}", bones[f"{after}_{side}"][1]
            half = 0.5 * (np.array(bones[middle][1]) + end)
            bones[f"{part}2_{side}"] = (middle, half, end)
            bones[f"{after}_{side}"] = (f"{part}2_{side}", *bones[f"{after}_{side}"][1:])
    rig = rig_of(bones)
    assert assert_found(rig).joints["elbow_L"].near == "upperarm2_L"
    assert_found(nameless(rig), rig)


# --- names against shape --------------------------------------------------------------------------------------------


def test_swapped_sides_are_found_where_they_lie_and_noted() -> None:
    body = human()
    swap = {"_L": "_R", "_R": "_L"}
    rig = skeletons.renamed(body, [name[:-2] + swap.get(name[-2:], name[-2:]) for name in body.names])
    search = assert_found(rig, body)
    assert any("upperarm_R" in note and "left upper arm" in note for note in search.notes)


def test_a_knee_named_on_the_arm_is_not_believed() -> None:
    body = human()
    names = ["shin_L" if n == "forearm_R" else "forearm_R" if n == "shin_L" else n for n in body.names]
    search = assert_found(skeletons.renamed(body, names), body)
    assert any("shin_L" in note and "right forearm" in note for note in search.notes)


def test_arms_named_as_legs_are_not_believed() -> None:
    body = human()
    other = {"upperarm": "thigh", "forearm": "shin", "hand": "foot"}
    other |= {leg: arm for arm, leg in other.items()}
    names = [f"{other.get(n[:-2], n[:-2])}{n[-2:]}" if n[-2:] in ("_L", "_R") else n for n in body.names]
    assert_found(skeletons.renamed(body, names), body)


@pytest.mark.parametrize("seed", range(12))
def test_shuffled_names_do_not_mislead(seed: int) -> None:
    body = t_posed(human()) if seed % 2 else human()
    names = np.random.default_rng(seed).permutation(body.names)
    assert_found(skeletons.renamed(body, [str(name) for name in names]), body)


# --- what is missing ------------------------------------------------------------------------------------------------


def test_a_missing_arm_is_said_with_the_bones_considered() -> None:
    body = human()
    gone = [n for n in body.names if n.endswith("_R") and n[:-2] in ("clavicle", "upperarm", "forearm", "hand", "thumb",
                                                                    "index", "ring")]  # fmt: skip
    search = find_joints(human(drop=gone))
    assert [name for name, joint in search.joints.items() if joint is None] == ["elbow_R", "shoulder_R"]
    assert search.joints["elbow_L"].far == "forearm_L"
    assert all(missing.considered and missing.reason.endswith(".") for missing in search.missing.values())


def test_a_missing_forearm_leaves_the_shoulder() -> None:
    search = find_joints(human(drop=["forearm_L", "forearm_R"]))
    assert search.joints["elbow_L"] is None and "upperarm_L" in search.missing["elbow_L"].reason
    assert search.joints["shoulder_L"].far == "upperarm_L"


@pytest.mark.parametrize("half", ["arms", "legs"])
def test_half_a_body_gives_half_the_joints(half: str) -> None:
    arm = ("clavicle", "upperarm", "forearm", "hand", "thumb", "index", "ring")
    drop = [n for n in human().names if (n.partition("_")[0] in arm) != (half == "arms") and n[-2:] in ("_L", "_R")]
    found = {joint.name.partition("_")[0] for joint in find_joints(human(drop=drop)).found}
    assert found == ({"elbow", "shoulder", "spine"} if half == "arms" else {"knee", "hip", "spine"})


def test_no_joints_are_invented() -> None:
    chain = rig_of({f"b{i}": (f"b{i - 1}" if i else "", (0, 0, 0.1 * i), (0, 0, 0.1 * i + 0.1)) for i in range(20)})
    fingers: dict[str, tuple] = {"hand": ("", (0, 0, 0), (0, 0, 0.1))}
    for finger in range(5):
        for i in range(3):
            x, z = 0.02 * (finger - 2), 0.1 + 0.04 * i
            above = f"finger{finger}_{i - 1}" if i else "hand"
            fingers[f"finger{finger}_{i}"] = (above, (x, 0, z), (x, 0, z + 0.04))
    for rig in (rig_of({"Bone": ("", (0, 0, 0), (0, 0, 1))}), chain, rig_of(fingers)):
        search = find_joints(rig)
        assert not search.found
        assert all(search.missing[name].considered for name in JOINT_NAMES)


def test_the_json_names_all_nine_and_what_was_considered() -> None:
    described = joints_to_json(find_joints(human(drop=["forearm_L", "forearm_R"])))
    assert set(JOINT_NAMES) < set(described)
    assert described["elbow_L"] is None and described["considered"]["elbow_L"]["bones"]
    knee, hip = described["knee_L"], described["hip_L"]
    assert knee["bones"] == ["shin_L"] and knee["dof"] == 1 and len(knee["axis"]) == 3 and len(knee["range_deg"]) == 2
    assert hip["dof"] == 3 and np.shape(hip["axis"]) == (3, 3) and np.shape(hip["range_deg"]) == (3, 2)
