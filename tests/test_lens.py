import json

import board_pictures as boards
import cv2
import numpy as np
import pytest

from usdskin.capture.lens.board import Board, BoardView, find_board, parse_board
from usdskin.capture.lens.calibrate import calibrate_lens, import_lens
from usdskin.capture.lens.fit import fit_lens
from usdskin.capture.lens.models import MODELS
from usdskin.capture.lens.solve import solve
from usdskin.commands.calibrate import COMMANDS
from usdskin.commands.reporter import GlobalOptions
from usdskin.errors import ImageError, UsageError
from usdskin.fisheye import project
from usdskin.layers import open_stage
from usdskin.prims import read_lens
from usdskin.validate import validate

SIZE = (2000, 1500)
CENTER = np.array([1003.2, 748.4])
F, K = 620.0, np.array([-0.02, 0.004, -0.003, 0.0004])
RADIUS = boards.polynomial(F, K)


def synthetic(seed=0, *, count=20, largest_deg=75.0, noise_px=0.2, **given):
    rng = np.random.default_rng(seed)
    given = {"radius": RADIUS, "center": CENTER, "resolution": SIZE, **given}
    return boards.views(rng, count=count, largest_deg=largest_deg, noise_px=noise_px, **given)


def as_views(found, tmp_path, name="view", size=SIZE):
    return [
        BoardView(tmp_path / f"{name}{index:02}.png", size, board, pixel)
        for index, (board, pixel) in enumerate(found)
    ]


def solved(found, model="fisheye"):
    board, pixel = zip(*found, strict=True)
    return solve(MODELS[model], board, pixel, SIZE)


# The solver


@pytest.mark.parametrize("largest_deg", [10.0, 50.0, 75.0, 88.0])
def test_perfect_corners_give_the_lens_back_whatever_their_angle(largest_deg):
    found = synthetic(largest_deg=largest_deg, noise_px=0.0)
    solution = solved(found)
    np.testing.assert_allclose(solution.parameters[0], F, rtol=1e-7)
    np.testing.assert_allclose(solution.center_px, CENTER, atol=1e-5)
    reach = max(angle.max() for angle in solution.angles_rad)
    assert reach > np.radians(90.0) or largest_deg < 88.0
    angles = np.linspace(0.0, reach, 50)
    assert np.abs(solution.model.radius(solution.parameters, angles) - RADIUS(angles)).max() < 1e-4


def test_errors_are_what_the_covariance_says():
    """The sum of squared, whitened errors of 10 seeds is chi-squared."""
    total = 0.0
    for seed in range(10):
        solution = solved(synthetic(seed, largest_deg=80.0))
        error = np.concatenate([solution.parameters - [F, *K], solution.center_px - CENTER])
        precision = np.linalg.inv(0.2**2 * solution.covariance[:7, :7])
        total += error @ precision @ error
    assert abs(total - 10 * 7) < 4.0 * np.sqrt(2 * 10 * 7)


def test_agrees_with_opencv_where_opencv_works():
    """Its own calibration knows corners in front of the camera only, and two focal lengths."""
    found = synthetic(largest_deg=60.0, reach_deg=75.0)
    solution = solved(found)
    flags = {name: getattr(cv2.fisheye, f"CALIB_{name}", None) for name in FLAGS}  # OpenCV 4
    flags = {n: v if v is not None else getattr(cv2, f"CALIB_{n}") for n, v in flags.items()}
    matrix = np.array(
        [[SIZE[0] / np.pi, 0, SIZE[0] / 2], [0, SIZE[0] / np.pi, SIZE[1] / 2], [0, 0, 1]]
    )
    rms, matrix, k, _, _ = cv2.fisheye.calibrate(
        [np.column_stack([board, np.zeros(len(board))])[None] for board, _ in found],
        [(pixel - 0.5)[None] for _, pixel in found],
        SIZE,
        matrix,
        np.zeros((4, 1)),
        flags=sum(flags.values()),
        criteria=(3, 200, 1e-12),
    )
    ours = np.concatenate(solution.residuals_px)
    assert np.sqrt((ours**2).sum(axis=1).mean()) == pytest.approx(rms, rel=2e-3)
    theirs = 0.5 * (matrix[0, 0] + matrix[1, 1])
    assert solution.parameters[0] == pytest.approx(theirs, rel=3e-4)
    np.testing.assert_allclose(solution.center_px, matrix[:2, 2] + 0.5, atol=0.3)
    angles = np.radians(np.arange(0, 71, 10.0))
    opencv = boards.polynomial(theirs, k.ravel())(angles)
    np.testing.assert_allclose(solution.model.radius(solution.parameters, angles), opencv, atol=0.5)


FLAGS = ("USE_INTRINSIC_GUESS", "RECOMPUTE_EXTRINSIC", "FIX_SKEW")


def test_omnidir_finds_the_image_heights_of_opencvs_omnidirectional_camera():
    gamma, xi, k1, k2 = 1150.0, 0.9, -0.05, 0.01

    def radius(phi):
        points = np.column_stack([np.sin(phi), np.zeros_like(phi), np.cos(phi)])[:, None]
        matrix = np.diag([gamma, gamma, 1.0])
        distortion = np.array([[k1, k2, 0.0, 0.0]])
        pixels, _ = cv2.omnidir.projectPoints(
            points, np.zeros(3), np.zeros(3), matrix, xi, distortion
        )
        return np.abs(pixels[:, 0, 0])

    solution = solved(synthetic(radius=radius, noise_px=0.1), "omnidir")
    reach = max(angle.max() for angle in solution.angles_rad)
    angles = np.linspace(0.0, reach, 50)
    error = np.abs(solution.model.radius(solution.parameters, angles) - radius(angles))
    assert error.max() < 4.0 * solution.radius_sigma_px(reach, 0.1) < 2.0


# What does not belong


def test_single_wrong_corners_have_no_influence(tmp_path):
    found = synthetic()
    for index in range(0, 20, 4):
        found[index][1][5] += [9.0, -30.0]
    notes = []
    calibration = fit_lens(as_views(found, tmp_path), "fisheye", notes)
    assert calibration.dropped_corners == 5
    assert calibration.rms_px < 0.35 and not notes


def test_photographs_through_another_lens_are_left_out_and_named(tmp_path):
    views = as_views(synthetic(count=16), tmp_path)
    other = synthetic(5, count=3, radius=boards.polynomial(700.0, K))
    notes = []
    calibration = fit_lens([*views, *as_views(other, tmp_path, "zoomed")], "fisheye", notes)
    assert {view.path.stem for view in calibration.rejected} == {"zoomed00", "zoomed01", "zoomed02"}
    assert {note.code for note in notes} == {"image-rejected"}
    assert calibration.solution.parameters[0] == pytest.approx(F, abs=1.5)


def test_a_heap_of_unlike_photographs_is_refused(tmp_path):
    found = synthetic(count=16)
    rng = np.random.default_rng(4)
    found[10:] = [(rng.permutation(board), pixel) for board, pixel in found[10:]]
    with pytest.raises(ImageError, match="6 of 16 photographs disagree with the others"):
        fit_lens(as_views(found, tmp_path), "fisheye", [])


def test_photographs_through_many_lenses_are_refused(tmp_path):
    found = []
    for seed, f in enumerate(np.linspace(400.0, 900.0, 12)):
        found += synthetic(seed + 3, count=1, radius=boards.polynomial(f, K))
    with pytest.raises(ImageError, match=r"directions are uncertain|corners fit with an rms"):
        fit_lens(as_views(found, tmp_path), "fisheye", [])


def test_two_lenses_that_cannot_be_told_apart_are_suspected(tmp_path):
    """Each pose takes most of the difference upon itself."""
    found = synthetic(count=10) + synthetic(3, count=7, radius=boards.polynomial(700.0, K))
    notes = []
    fit_lens(as_views(found, tmp_path), "fisheye", notes)
    assert "corners-misfit" in {note.code for note in notes}


def test_boards_that_all_face_the_camera_are_refused(tmp_path):
    """Their distance and the focal length are one unknown."""
    rng = np.random.default_rng(2)
    found = []
    for _ in range(8):
        translation = np.array([*rng.uniform(-0.5, 0.5, 2) - [3.5, 2.5], rng.uniform(9, 10)])
        points = np.column_stack([boards.corners_of(), np.zeros(24)]) + translation
        pixels, _ = boards.project(points, RADIUS, CENTER)
        found.append((boards.corners_of(), pixels + 0.2 * rng.normal(size=pixels.shape)))
    with pytest.raises(ImageError, match=r"directions are uncertain by .* tilted by 30 deg"):
        fit_lens(as_views(found, tmp_path), "fisheye", [])


@pytest.mark.parametrize(("factor", "outcome"), [(1.03, "refused"), (1.003, "noted"), (1.0, "")])
def test_stretched_photographs_are_not_taken_for_round_ones(tmp_path, factor, outcome):
    found = [(board, pixel * [factor, 1.0]) for board, pixel in synthetic(count=25)]
    views, notes = as_views(found, tmp_path), []
    if outcome == "refused":
        with pytest.raises(ImageError, match=r"focal lengths \+[23]"):
            fit_lens(views, "fisheye", notes)
        return
    fit_lens(views, "fisheye", notes)
    assert [note.code for note in notes] == (["pixels-not-square"] if outcome else [])


# From photographs

SMALL, MIDDLE, SHORT = (640, 480), np.array([322.3, 238.8]), 200.0
SMALL_RADIUS = boards.polynomial(SHORT, K)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Pictures of a board all over a 640 x 480 frame that reaches 90 degrees."""
    folder, rng, paths = tmp_path_factory.mktemp("board"), np.random.default_rng(0), []
    drawn = boards.texture()
    for index, angle in enumerate((5, 20, 30, 40, 50, 55, 60, 65, 68, 70, 72, 74)):
        pose = boards.random_pose(rng, angle, (4.5, 6.0), tilt=0.3)
        shot = boards.picture(drawn, SMALL_RADIUS, MIDDLE, SMALL, *pose, rng)
        paths.append(folder / f"shot{index:02}.png")
        cv2.imwrite(str(paths[-1]), shot)
    return paths


@pytest.fixture(scope="module")
def report(photographs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lens")
    return calibrate_lens(
        photographs, folder / "lens.usda", board="charuco:7x5", plot=folder / "lens.png"
    )


def test_photographs_of_a_board_give_the_lens(report):
    lens = report.lens
    assert report.calibration.rms_px < 0.12
    assert lens.focal_length_px == pytest.approx(SHORT, abs=0.15)
    np.testing.assert_allclose(lens.center_px, MIDDLE, atol=0.15)
    assert lens.max_angle_deg > 75.0
    angles = np.radians(np.linspace(0.0, lens.max_angle_deg, 40))
    found = boards.polynomial(lens.focal_length_px, lens.distortion)(angles)
    assert np.abs(found - SMALL_RADIUS(angles)).max() < 0.15


def test_the_layer_holds_the_lens_and_how_good_it_is(report, photographs):
    stage = open_stage(report.path)
    prim = stage.GetDefaultPrim()
    assert str(prim.GetPath()) == "/Lens" and prim.GetTypeName() == "Camera"
    lens = read_lens(prim)
    assert lens.projection == "opencv" and lens.resolution == SMALL
    np.testing.assert_array_equal(lens.distortion, report.lens.distortion)
    quality = prim.GetCustomDataByKey("usdskin:calibration")
    assert quality["rms"] == report.calibration.rms_px
    assert list(quality["images"]) == [path.name for path in photographs]
    record = stage.GetRootLayer().customLayerData["usdskin"]["calibrateLens"]
    assert len(record["inputsSha256"]) == len(photographs)
    assert validate(report.path) == []


def test_opencv_puts_rays_where_the_written_lens_puts_them(report):
    stage = open_stage(report.path)
    lens = read_lens(stage.GetDefaultPrim())
    rng = np.random.default_rng(1)
    phi, psi = np.radians(rng.uniform(0, lens.max_angle_deg, 200)), rng.uniform(0, 6.28, 200)
    rays = np.column_stack([np.sin(phi) * np.cos(psi), np.sin(phi) * np.sin(psi), -np.cos(phi)])
    f, (cx, cy) = lens.focal_length_px, lens.center_px
    matrix = np.array([[f, 0, cx - 0.5], [0, f, cy - 0.5], [0, 0, 1.0]])
    as_opencv = (rays * [1.0, -1.0, -1.0])[None]  # y down, looking along +z
    pixels, _ = cv2.fisheye.projectPoints(
        as_opencv, np.zeros(3), np.zeros(3), matrix, lens.distortion
    )
    np.testing.assert_allclose(project(lens, rays), pixels[0] + 0.5, atol=1e-6)


def test_the_plot_is_a_picture_and_comes_out_twice_alike(report, photographs, tmp_path):
    again = calibrate_lens(
        photographs, tmp_path / "lens.usda", board="charuco:7x5", plot=tmp_path / "lens.png"
    )
    first = (report.path.parent / "lens.png").read_bytes()
    assert first[:8] == b"\x89PNG\r\n\x1a\n" and (tmp_path / "lens.png").read_bytes() == first
    assert again.as_dict() == report.as_dict()


def test_beyond_the_board_nothing_is_known_and_that_is_said(photographs, tmp_path):
    notes = []
    written = calibrate_lens(
        photographs, tmp_path / "lens.usda", board="charuco:7x5", max_angle_deg=90.0, notes=notes
    )
    assert written.lens.max_angle_deg == 90.0
    assert [note.code for note in notes] == ["beyond-the-board"]


def test_a_chessboard_does_too(tmp_path):
    rng = np.random.default_rng(3)
    rotation, translation = boards.random_pose(rng, 30.0, (5.5, 6.0), tilt=0.2)
    shot = boards.picture(
        boards.checkers((7, 5)), SMALL_RADIUS, MIDDLE, SMALL, rotation, translation, rng
    )
    cv2.imwrite(str(tmp_path / "a.png"), shot)
    view = find_board(tmp_path / "a.png", parse_board("chessboard:6x4"))
    true, _ = boards.project(
        boards.corners_of((7, 5)) @ rotation[:, :2].T + translation, SMALL_RADIUS, MIDDLE
    )
    nearest = np.linalg.norm(view.pixel[:, None] - true, axis=2).min(axis=1)
    assert len(view.pixel) == 24 and nearest.max() < 0.2


@pytest.mark.parametrize("legacy", [False, True])
def test_boards_with_an_even_number_of_rows_are_found_in_both_patterns(tmp_path, legacy):
    rng = np.random.default_rng(1)
    pose = boards.random_pose(rng, 20.0, (6.0, 6.5), tilt=0.1, squares=(5, 4))
    drawn = boards.texture((5, 4), legacy)
    cv2.imwrite(
        str(tmp_path / "a.png"), boards.picture(drawn, SMALL_RADIUS, MIDDLE, SMALL, *pose, rng)
    )
    view = find_board(tmp_path / "a.png", Board("charuco", 5, 4))
    points = view.board @ pose[0][:, :2].T + pose[1]
    true, _ = boards.project(points, SMALL_RADIUS, MIDDLE)
    assert len(view.pixel) == 12 and np.abs(view.pixel - true).max() < 0.3


def test_linear_16_bit_and_grey_pictures_are_read(photographs, tmp_path):
    grey = cv2.imread(str(photographs[1]), cv2.IMREAD_GRAYSCALE)
    linear = (65535.0 * 0.2 * (grey / 255.0) ** 2.2).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "linear.png"), linear)
    want = find_board(photographs[1], Board("charuco", 7, 5))
    got = find_board(tmp_path / "linear.png", Board("charuco", 7, 5))
    assert len(got.pixel) == len(want.pixel)
    np.testing.assert_allclose(got.pixel, want.pixel, atol=0.25)


def test_pictures_without_a_board_are_named(photographs, tmp_path):
    blank = tmp_path / "blank.png"
    cv2.imwrite(str(blank), np.full((SMALL[1], SMALL[0]), 90, np.uint8))
    notes = []
    calibrate_lens([*photographs, blank], tmp_path / "lens.usda", board="charuco:7x5", notes=notes)
    assert [(note.code, note.path) for note in notes] == [("board-not-found", str(blank))]
    with pytest.raises(ImageError, match=r"found in 2 of 3 photographs \(not in blank.png\)"):
        calibrate_lens([*photographs[:2], blank], tmp_path / "x.usda", board="charuco:7x5")
    with pytest.raises(ImageError, match="found in 0 of 5 photographs"):
        calibrate_lens(photographs[:5], tmp_path / "x.usda", board="charuco:7x5,6x6_250")
    assert not (tmp_path / "x.usda").exists()


def test_pictures_of_two_sizes_are_refused(photographs, tmp_path):
    other = tmp_path / "turned.png"
    cv2.imwrite(str(other), cv2.imread(str(photographs[0])).swapaxes(0, 1))
    with pytest.raises(ImageError, match=r"turned.png: has 480 x 640 pixels and .* 640 x 480"):
        calibrate_lens([*photographs, other], tmp_path / "x.usda", board="charuco:7x5")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("charuco", "no board"),
        ("charuco:2x5", "3 to 100"),
        ("charuco:7x5,30", "does not read"),
        ("charuco:7x5,22,30", "marker of 30 does not fit a square of 22"),
        ("charuco:7x5,9x9_50", "has no dictionary '9x9_50'; it has .*4x4_50"),
        ("charuco:20x20", "needs 200 markers and dictionary '4x4_50' has 50"),
        ("chessboard:9x6,30,22", "does not read"),
    ],
)
def test_boards_that_are_none(text, reason):
    with pytest.raises(UsageError, match=reason):
        parse_board(text)


def test_boards_in_words():
    assert parse_board("charuco:7x5") == Board("charuco", 7, 5, 0.75, "4x4_50")
    assert parse_board("charuco:8x6,40,30,DICT_5X5_100") == Board("charuco", 8, 6, 0.75, "5x5_100")
    assert parse_board("chessboard:9x6") == Board("chessboard", 9, 6)


# The command


def run(*arguments, **settings):
    """Run ``usdskin calibrate``."""
    options = GlobalOptions(**settings)
    return COMMANDS[0].main([*map(str, arguments)], obj=options, standalone_mode=False)


def test_the_command_tells_what_it_found(photographs, tmp_path, capfd):
    lens, plot = tmp_path / "lens.usda", tmp_path / "lens.png"
    arguments = ["lens", *photographs, "--board", "charuco:7x5", "-o", lens, "--plot", plot]
    run(*arguments)
    out, err = capfd.readouterr()
    assert out.split() == [str(lens), str(plot)]
    assert "corners in 12 photographs, rms 0.0" in err and "f 20" in err
    run(*arguments, json=True)
    events = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    found = next(event for event in events if event["event"] == "calibration")
    assert found["rms"] < 0.12 and len(found["imageRms"]) == 12
    assert [event["path"] for event in events if event["event"] == "wrote"] == [
        str(lens),
        str(plot),
    ]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["a.png"], "give photographs and their --board"),
        (["--board", "charuco:7x5"], "give photographs and their --board"),
        (["a.png", "--board", "charuco:7x5", "--f-number", "4"], "--f-number belongs to --from"),
        (["--from", "a.pto", "--plot", "a.png"], "--plot: no use together with --from"),
        (["a.png", "--from", "a.pto"], "photographs: no use together with --from"),
        (["a.png", "--board", "charuco:7x5", "--max-angle", "200"], "--max-angle 200"),
        (["a.png", "a.png", "--board", "charuco:7x5"], "a.png: is given twice"),
        (["a.png", "--board", "charuco:7x5", "--plot", "a.jpg"], "end its name in .png"),
    ],
)
def test_arguments_that_make_no_sense(tmp_path, arguments, reason):
    with pytest.raises(UsageError, match=reason):
        run("lens", *arguments, "-o", tmp_path / "lens.usda")


def test_the_output_may_not_be_an_input(photographs, tmp_path):
    output = tmp_path / "lens.usda"
    output.touch()
    with pytest.raises(UsageError, match="is an input of this calibration"):
        calibrate_lens([*photographs, output], output, board="charuco:7x5")
    with pytest.raises(UsageError, match=r"end its name in \.usda"):
        import_lens(photographs[0], photographs[0])
