"""What bone names say: part, side and helper, in every usual spelling."""

import pytest
from wrinkle_synthesis.wrinkle_addon.bone_names import BoneLabel, read_bone_name, read_bone_names


@pytest.mark.parametrize(
    "name",
    [
        "forearm.L", "DEF-forearm.L.001", "mixamorig:LeftForeArm", "lowerarm01.L", "lowerarm_l", "J_Bip_L_LowerArm",
        "leftLowerArm", "left_elbow", "lForeArm", "Bip01 L Forearm", "CC_Base_L_Forearm", "Neo_LeftForeArm", "左ひじ",
        "Left elbow", "LEFTELBOW", "lower-arm-left", "L_Elbow", "lelbow", "elbowL", "forearm_lft",
        "Character1_LeftForeArm",
    ],
)  # fmt: skip
def test_left_forearm_is_read_in_every_spelling(name: str) -> None:
    assert read_bone_name(name) == BoneLabel("forearm", "L")


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("LeftUpLeg", BoneLabel("thigh", "L")),
        ("LeftLeg", BoneLabel("leg", "L")),
        ("RThumb", BoneLabel("finger", "R")),
        ("LHipJoint", BoneLabel("hip", "L")),
        ("Hips", BoneLabel("pelvis")),
        ("lMetatarsals", BoneLabel("toe", "L")),
        ("calf_r", BoneLabel("shin", "R")),
        ("abdomenLower", BoneLabel("spine")),
        ("Bone.003", BoneLabel()),
        ("armature_root", BoneLabel("root")),
        ("breast.L", BoneLabel("soft", "L")),
        ("上半身2", BoneLabel("spine")),
    ],
)
def test_other_parts(name: str, label: BoneLabel) -> None:
    assert read_bone_name(name) == label


@pytest.mark.parametrize(
    "name",
    ["upperarm_twist_01_l", "CTRL_knee.R", "DRV_elbow_L", "ik_hand_l", "右腕捩", "CC_Base_L_ElbowShareBone",
     "LeftForeArmRoll", "MCH-thigh.L", "knee_helper", "Bip01 L Toe0Nub"],
)  # fmt: skip
def test_helpers_are_told_from_joints(name: str) -> None:
    assert read_bone_name(name).helper


def test_a_helper_word_in_most_names_is_only_a_prefix() -> None:
    labels = read_bone_names([f"ctl_{part}" for part in ("hips", "spine", "thigh_l", "calf_l", "foot_l")])
    assert not any(label.helper for label in labels)


def test_in_a_rig_that_marks_its_deforming_bones_all_others_are_helpers() -> None:
    marked = [f"DEF-{part}.{side}" for part in ("thigh", "shin", "foot", "upper_arm", "forearm") for side in "LR"]
    labels = read_bone_names([*marked, "torso", "chest"])
    assert [label.helper for label in labels] == [False] * 10 + [True] * 2
