"""The demo: its progress, its pictures, its report, and, taking minutes, all of it."""

import io
import json
from pathlib import Path
from typing import Any

import pytest
from skeletons import human
from wrinkle_synthesis.demo import packages
from wrinkle_synthesis.demo.figures import draw_figures
from wrinkle_synthesis.demo.picture import compose
from wrinkle_synthesis.demo.progress import Progress, duration, time_left
from wrinkle_synthesis.demo.recipe import FULL, QUICK
from wrinkle_synthesis.demo.report import describe_machine, to_markdown, write_report
from wrinkle_synthesis.demo.results import Results
from wrinkle_synthesis.demo.run import Demo, hardest_frames, run_demo
from wrinkle_synthesis.demo.samples import choose_samples
from wrinkle_synthesis.wrinkle_addon.joints import find_joints
from wrinkle_synthesis.wrinkle_addon.plan import paper_plan

EXPECTED = {"bake": 100.0, "film": 50.0}
METHODS = ("skinning", "nearest", "paper", "ours")


def evaluation(error: float) -> dict[str, Any]:
    """A result of the verb `evaluate`."""
    errors = {name: error * (4 - k) for k, name in enumerate(METHODS)}
    return {
        "frame_count": 8,
        "rmse_mm": errors,
        "max_mm": {name: 9 * value for name, value in errors.items()},
        "frames": [],
        "regions": {"arm_L": {"rmse_mm": errors, "max_mm": errors}},
        "curvature_ratio": 0.913,
        "curvature_correlation": None,
        "inside_share": 0.0123,
        "inside_overlap_share": 0.0023,
        "deepest_mm": 4.5,
        "acceleration_ratio": None,
        "reference": {"residual": 0.25, "self_intersections": 7},
    }


@pytest.fixture
def report() -> dict[str, Any]:
    return {
        "recipe": {"garment": "shirt", "clip": "kick"},
        "machine": {"processor": "A processor", "cores": 2, "device": "cpu", "versions": {}},
        "frames": 46,
        "setup": {"vertices": 11_775},
        "plan": {
            "simulated": 37,
            "symmetric": True,
            "joints": {"elbow_L": {"grid": [5], "angles_deg": [[-7.1, 0.0, 28.9, 57.9, 86.8]]}},
        },
        "database": {
            "samples": 72,
            "sample_bytes": 2_500_000,
            "bytes": 3_000_000,
            "raw_bytes": 10_000_000,
            "times_smaller_than_raw": 4.0,
            "worst_residual": 0.3,
            "unconverged": 0,
            "left_out": ["hip_L-0-0-1"],
            "inside": 3,
            "self_intersections": 12,
        },
        "settle": evaluation(1.0),
        "simulate": evaluation(2.0),
        "times": {
            "bake": {"seconds": 400.2, "processor_seconds": 790.0},
            "film": {"seconds": 100.0, "processor_seconds": 180.0},
        },
    }


# --- progress -----------------------------------------------------------------------------------------------------


def test_time_left_is_what_was_expected_until_something_is_known() -> None:
    assert time_left(EXPECTED, {}, "bake", 0.0, 0.0) == 150.0


def test_time_left_follows_the_pace_of_the_stage_at_work() -> None:
    # Half done in 200 s: as much again, and the film as expected.
    assert 150.0 < time_left(EXPECTED, {}, "bake", 200.0, 0.5) <= 250.0
    assert time_left(EXPECTED, {}, "bake", 400.0, 1.0) == 50.0


def test_time_left_learns_from_finished_stages() -> None:
    assert time_left(EXPECTED, {"bake": 200.0}, "film", 0.0, 0.0) == 100.0


def test_a_resumed_stage_does_not_make_the_rest_seem_to_take_no_time() -> None:
    assert time_left(EXPECTED, {"bake": 0.01}, "film", 0.0, 0.0) == 50.0


def test_plain_output_has_a_line_for_each_stage() -> None:
    stream = io.StringIO()
    progress = Progress(EXPECTED, stream)
    for stage in EXPECTED:
        progress.begin(stage)
        progress.update(0.5, "sample 1 of 2")
        progress.end("it is done")
    lines = stream.getvalue().splitlines()
    assert [line for line in lines if "it is done" in line] == [
        "[1/2] bake: 0 s, it is done",
        "[2/2] film: 0 s, it is done",
    ]
    assert "about 2 min left in all" in lines[0] and "\r" not in stream.getvalue()


def test_durations_are_said_as_people_say_them() -> None:
    assert (duration(4.4), duration(89.0), duration(600.0)) == ("4 s", "89 s", "10 min")


@pytest.mark.parametrize(("recipe", "minutes"), [(FULL, 25), (QUICK, 5)])
def test_a_recipe_expects_to_keep_within_its_time_and_names_every_stage(
    tmp_path: Path, recipe: Any, minutes: int
) -> None:
    assert sum(recipe.expected.values()) < 60 * minutes
    assert list(Demo(tmp_path, recipe).stages) == list(recipe.expected)


def test_the_recipes_keep_to_their_promises() -> None:
    assert FULL.vertex_count >= 10_000 and FULL.samples <= 36
    assert QUICK.vertex_count <= 4_000 and QUICK.samples <= 6


# --- results ------------------------------------------------------------------------------------------------------


def test_a_stage_that_is_done_is_not_done_again(tmp_path: Path) -> None:
    made = []
    for _ in range(2):
        results = Results(tmp_path, {"samples": 6})
        assert results.keep("bake", lambda: made.append(1) or {"samples": (7, 8)}) == {"samples": [7, 8]}
    assert made == [1]


def test_an_interrupted_stage_leaves_its_time_but_no_result(tmp_path: Path) -> None:
    results = Results(tmp_path, {})

    def fail() -> dict[str, Any]:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), results.timed("bake"):
        results.keep("bake", fail)
    assert results.keep("bake", lambda: {"done": 1}) == {"done": 1}
    assert results.times["bake"]["seconds"] >= 0.0


def test_a_folder_of_another_demo_is_refused(tmp_path: Path) -> None:
    Results(tmp_path, {"samples": 6})
    with pytest.raises(ValueError, match="another demo"):
        Results(tmp_path, {"samples": 36})


# --- pictures -----------------------------------------------------------------------------------------------------


def pictures(folder: Path, count: int, size: tuple[int, int] = (100, 120)) -> list[Path]:
    image = pytest.importorskip("PIL.Image")
    paths = [folder / f"{size[0]}-{k}.png" for k in range(count)]
    for k, path in enumerate(paths):
        image.new("RGB", size, (40 * k, 0, 200)).save(path)
    return paths


def test_pictures_stand_in_their_row_and_column(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    made = pictures(tmp_path, 4)
    sheet = image.open(compose([made[:2], made[2:]], ["left", "right"], [["", ""]] * 2, tmp_path / "new" / "sheet.png"))
    assert sheet.width % 2 == sheet.height % 2 == 0
    width, height = sheet.size
    corners = [(20, height - 20), (width - 20, height - 20), (20, height // 2 - 30), (width - 20, height // 2 - 30)]
    assert [sheet.getpixel(corner) for corner in corners] == [(40 * k, 0, 200) for k in (2, 3, 0, 1)]


def test_pictures_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    mixed = [*pictures(tmp_path, 1), *pictures(tmp_path, 1, (50, 50))]
    with pytest.raises(ValueError, match="different sizes"):
        compose([mixed], ["left", "right"], [["", ""]], tmp_path / "sheet.png")
    with pytest.raises(ValueError, match="a picture for each column"):
        compose([mixed], ["left"], [[""]], tmp_path / "sheet.png")


def test_pictured_samples_come_from_all_over_the_plan() -> None:
    plan = paper_plan([find_joints(human()).joints["elbow_L"]])
    nodes = [sample.index[0] for sample in choose_samples(plan.samples, 4)]
    assert len(set(nodes)) == 4 and sorted(nodes)[0] < plan.grids[0].rest[0] < sorted(nodes)[-1]
    assert choose_samples(plan.samples, 100) == list(plan.samples)


def test_the_hardest_frames_lie_apart() -> None:
    frames = [{"frame": k, "rmse_mm": {"skinning": error}} for k, error in enumerate([1, 2, 9, 8, 7, 1, 1, 5, 1, 1])]
    assert hardest_frames(frames, 2) == [2, 4]
    assert hardest_frames(frames, 1) == [2]


# --- report -------------------------------------------------------------------------------------------------------


def test_the_report_is_the_same_in_both_forms(tmp_path: Path, report: dict[str, Any]) -> None:
    as_json, as_text = write_report(tmp_path, report)
    assert json.loads(as_json.read_text(encoding="utf-8")) == report
    page = as_text.read_text(encoding="utf-8")
    for said in (
        "11,775 vertices",
        "| whole garment | 4.00 (36) | 3.00 (27) | 2.00 (18) | 1.00 (9) |",
        "share of skinning's: 0.25",
        "Sum of curvature, ours to the reference's: 0.913.",
        "1.23 %, of these 0.23 % where the body cuts into itself, the deepest 4.5 mm",
        "residual 0.25, self intersections 7",
        "| elbow_L | 5 | -7 to 87 |",
        "4.0 times smaller",
        "| in all | 500 | 970 |",
    ):
        assert said in page


def test_the_report_leaves_out_what_was_not_measured(report: dict[str, Any]) -> None:
    report["settle"]["inside_share"] = report["simulate"]["inside_share"] = None
    page = to_markdown(report)
    assert "None" not in page and "inside the body by more" not in page


def test_the_machine_is_described() -> None:
    machine = describe_machine({"versions": {"python": "3"}, "device": "cpu"})
    assert machine["cores"] >= 1 and machine["processor"]


# --- the whole ----------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_quick_demo_makes_all_that_it_promises(tmp_path: Path) -> None:
    pytest.importorskip("bpy")
    try:
        for package in (packages.BODY, packages.MOTION):
            packages.package_folder(package)
    except packages.PackageError as error:
        pytest.skip(str(error))
    made = run_demo(tmp_path, QUICK)
    for name in (
        *(
            "scene.blend",
            "wrinkles.blend",
            "playback.blend",
            "film.mp4",
            "side_by_side.png",
            "report.json",
            "report.md",
        ),
        *("plots/settle/error.png", "plots/simulate/curvature.png", "shirt.wrinkles/manifest.json"),
    ):
        assert (tmp_path / name).stat().st_size > 0, name
    assert made["plan"]["simulated"] <= 1 + QUICK.samples and made["setup"]["vertices"] <= 4_000
    # Even six samples beat none.
    assert made["settle"]["rmse_mm"]["ours"] < made["settle"]["rmse_mm"]["skinning"]
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.pc2")}
    again = run_demo(tmp_path, QUICK)
    assert again["settle"] == made["settle"]
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.pc2")} == before
    figures = draw_figures(tmp_path, tmp_path / "figures")
    assert figures["garment"] == QUICK.garment and figures["pictured_frame"] in range(*QUICK.simulated)
    for name in ("figure_2.jpg", "figure_9.png", "figures.json"):
        assert (tmp_path / "figures" / name).stat().st_size > 0, name
