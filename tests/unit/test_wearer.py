"""What a worn garment may touch: the limb under each vertex, and those that cloth may slide onto."""

import numpy as np
import pytest
from dolls import doll
from wrinkle_synthesis.wrinkle_addon.wearer import SLIDE, worn_limbs

# Limbs part where bone weights cross, a ring of the garment or of the body from the joint at most.
RING = 0.03


@pytest.fixture(scope="module")
def sleeve():
    """The left sleeve: distance of each vertex from the elbow, towards the hand [m], and the limbs it may touch."""
    character = doll()
    rig, garment = character.rig, character.garment
    limbs = worn_limbs(rig, garment, character.body)
    elbow, wrist = (rig.heads[rig.index[name]] for name in ("forearm_L", "hand_L"))
    along = (garment.positions - elbow) @ ((wrist - elbow) / np.linalg.norm(wrist - elbow))
    left = garment.positions[:, 0] * elbow[0] > 0.0
    return along[left], limbs.of_vertices[left]


def bits(limbs):
    return np.bitwise_or.reduce(limbs)


def test_cloth_may_slide_over_a_joint_onto_the_next_limb(sleeve):
    along, limbs = sleeve
    forearm = limbs[along > SLIDE + RING]
    near_above = limbs[(along < -RING) & (along > RING - SLIDE)]
    assert len(near_above) and (near_above & bits(forearm[:1]) != 0).all()


def test_cloth_that_cannot_slide_so_far_touches_its_own_limb_alone(sleeve):
    """So that a hand which passes the trunk's cloth does not catch it."""
    along, limbs = sleeve
    assert SLIDE + 2.0 * RING < along.max()
    forearm = limbs[along > SLIDE + 2.0 * RING]
    far_above = limbs[along < -SLIDE - 2.0 * RING]
    assert len(forearm) and len(far_above)
    assert bits(forearm) & bits(far_above) == 0
