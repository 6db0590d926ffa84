"""Where errors come from: a made-up cloth whose losses are known in advance."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from baked_dolls import GRID, baked, bump, full_plan
from dolls import doll
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.database import skin_frame
from wrinkle_synthesis.wrinkle_addon.losses import LossFinder, join, mean_losses
from wrinkle_synthesis.wrinkle_addon.rig import Pose, joint_angles, pose_of_angles

DOWN = np.array([0.0, 0.0, -1.0])
# Half-precision storage to 0.05 mm.
STORED = 0.1


class Cloth:
    """Bumps that the database knows at its samples, joined as synthesis does, and what it does not know."""

    def __init__(self, folder: Path, extra: float = 0.0, lean: float = 0.0, lag: float = 0.0):
        self.character = doll()
        self.bumps = {name: bump(self.character, name) for name in GRID}
        self.database = baked(folder, self.character, full_plan(self.character), self.bumps)
        self._extra, self._lean, self._lag = extra, lean, lag

    def settle(self, pose: Pose, gravity: np.ndarray, through: Sequence[Pose] = ()) -> np.ndarray:
        character = self.character
        angles = joint_angles(character.rig, character.joints, pose)
        offsets = join([self.bumps[name](values) for name, values in angles.items()])
        bent = sum(float(np.abs(angles[name]).max()) > 0.01 for name in ("elbow_L", "shoulder_L")) == 2
        offsets = offsets + [self._extra * bent, self._lag * bool(through), 0.0] + self._lean * (gravity - DOWN)
        skinned, turns = skin_frame(character.rig, character.garment.weights, self.database.rest, pose)
        return skinned + rotations.rotate(turns, offsets)

    def losses(self, angles: dict[str, list[float]], gravity: np.ndarray = DOWN) -> dict[str, float]:
        radians = {name: np.radians(values) for name, values in angles.items()}
        pose = pose_of_angles(self.character.rig, self.character.joints, radians)
        return LossFinder(self.database, self.settle).losses(pose, gravity, self.settle(pose, gravity))


NODES = {"elbow_L": [60.0], "shoulder_L": [40.0, 30.0, 60.0]}


def test_nothing_is_lost_where_samples_say_it_all(tmp_path: Path):
    losses = Cloth(tmp_path).losses(NODES)
    assert losses["skinning"] > 1.0
    assert max(losses[name] for name in ("history", "other_bones", "independence", "interpolation", "all")) < STORED


def test_interpolation_loses_between_samples(tmp_path: Path):
    losses = Cloth(tmp_path).losses({"elbow_L": [75.0]})
    assert losses["interpolation"] > 0.05 and losses["interpolation"] == pytest.approx(losses["all"], abs=STORED)
    assert losses["independence"] < STORED and losses["other_bones"] < STORED


def test_independence_loses_what_joints_do_to_each_other(tmp_path: Path):
    losses = Cloth(tmp_path, extra=0.004).losses(NODES)
    assert losses["independence"] == pytest.approx(4.0, abs=STORED)
    assert losses["interpolation"] < STORED and losses["other_bones"] < STORED


def test_a_leaning_body_loses_what_upright_samples_cannot_know(tmp_path: Path):
    leaning = rotations.rotate(rotations.from_rotvec([0.0, np.pi / 3, 0.0]), DOWN)
    losses = Cloth(tmp_path, lean=0.005).losses(NODES, leaning)
    assert losses["other_bones"] == pytest.approx(5.0, abs=STORED)
    assert losses["independence"] < STORED and losses["interpolation"] < STORED


def test_history_loses_what_depends_on_the_way(tmp_path: Path):
    losses = Cloth(tmp_path, lag=0.003).losses(NODES)
    assert losses["history"] == pytest.approx(3.0, abs=STORED) and losses["all"] < STORED


def test_losses_of_a_clip_are_root_mean_squares():
    assert mean_losses([{"all": 3.0}, {"all": 4.0}]) == {"all": pytest.approx(np.sqrt(12.5))}
