"""The picture of a pose: what is drawn lies where OpenCV projects the true ring."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from ring_scenes import break_points_of, make_scene, pixels_of

from ringpose.report.overlay import (
    REJECTED_COLOR,
    RING_COLORS,
    STATUS_COLORS,
    WHITE,
    Drawing,
    overlay,
    picture_of,
    write_labels,
)
from ringpose.types.detection import UNLABELLED, Detection, NoBreakPoints, Rejection, RingEdgePoints, Stripes
from ringpose.types.image import Shot
from ringpose.types.options import PoseFrame
from ringpose.types.pose import LaserState, PoseFlag, PoseLine, RingPose
from ringpose.types.rig import Mount

NO_POINTS = Detection(shot="a", stamp_s=0.0, break_points=NoBreakPoints.NO_RING)


@pytest.fixture(scope="module")
def scene():
    return make_scene("B")


def pose_of(scene, **changes):
    ring = scene.ring
    grasp = scene.points_m[1].mean(axis=0)
    given = {
        "center_m": ring.center_m,
        "normal": ring.normal,
        "radius_inner_m": ring.radius_m[0],
        "radius_outer_m": ring.radius_m[1],
        "grasp_m": grasp,
        "method": "ml",
        "condition_number": 1.0,
        "residual_rms_px": 0.1,
        "covariance_grasp_m2": np.diag([0.5e-3, 0.5e-3, 0.5e-3]) ** 2,
    }
    return RingPose(**(given | changes))


def line_of(pose, **changes):
    return PoseLine(**({"shot": "a", "stamp_s": 0.0, "pose": pose, "reason": None if pose else "dark"} | changes))


def drawn(scene, pose, **changes):
    image = np.zeros((1200, 1600), np.uint8)
    detection = changes.pop("detection", NO_POINTS)
    return overlay(image, detection, line_of(pose, **changes), changes.pop("rig", scene.rig))


def has_color_near(picture, position_px, color, within_px=2):
    column, row = np.round(position_px).astype(int)
    patch = picture[row - within_px : row + within_px + 1, column - within_px : column + within_px + 1].astype(int)
    return (np.abs(patch - np.array(color)).max(axis=2) < 60).any()


def test_edges_with_a_radius_are_drawn_where_the_true_edges_project(scene):
    picture = drawn(scene, pose_of(scene))

    for laser in range(3):
        for edge in range(2):
            assert has_color_near(picture, scene.position_px[laser, edge], RING_COLORS[edge])
    without_inner = drawn(scene, pose_of(scene, radius_inner_m=np.nan))
    assert not has_color_near(without_inner, scene.position_px[2, 0], RING_COLORS[0])
    assert has_color_near(without_inner, scene.position_px[2, 1], RING_COLORS[1])


def test_grasp_point_lies_where_opencv_projects_it_and_its_ellipse_is_ten_sigmas(scene):
    pose = pose_of(scene, normal=np.full(3, np.nan))
    picture = drawn(scene, pose)
    position = pixels_of(pose.grasp_m[None], scene.rig.camera)[0]
    radius_px = 10 * 0.5e-3 * 1781.0 / pose.grasp_m[2]

    assert has_color_near(picture, position, WHITE)
    for angle in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        assert has_color_near(picture, position + radius_px * np.array([np.cos(angle), np.sin(angle)]), WHITE, 3)


def test_a_pose_in_the_tool_frame_is_drawn_as_in_the_camera_frame(scene):
    from ringpose.pose.transform import pose_in_frame

    mount = np.eye(4)
    mount[:3, :3] = cv2.Rodrigues(np.array([0.3, -0.5, 1.0]))[0]
    mount[:3, 3] = [0.1, 0.2, -0.3]
    rig = replace(scene.rig, mount=Mount(carrier_from_camera=mount, root=np.zeros((6, 6))))
    image = np.zeros((1200, 1600), np.uint8)

    in_tool = overlay(image, NO_POINTS, line_of(pose_in_frame(pose_of(scene), mount), frame=PoseFrame.TOOL), rig)
    in_camera = overlay(image, NO_POINTS, line_of(pose_of(scene)), rig)

    middle = slice(200, 1050)  # below the status, above the numbers
    assert np.abs(in_tool[middle].astype(int) - in_camera[middle].astype(int)).mean() < 0.01
    without_mount = overlay(image, NO_POINTS, line_of(pose_of(scene), frame=PoseFrame.TOOL), scene.rig)
    assert not without_mount[middle].any()


@pytest.mark.parametrize(
    ("pose", "flags", "status"), [(True, PoseFlag(0), "ok"), (True, PoseFlag.MOTION, "degraded"), (False, 0, "none")]
)
def test_status_has_its_colour(scene, pose, flags, status):
    picture = drawn(scene, pose_of(scene) if pose else None, flags=PoseFlag(flags))

    assert (picture[:60, :400] == STATUS_COLORS[status]).all(axis=2).any()


def test_rejected_measurements_are_red(scene):
    points = scene.break_points(0.1)
    detection = Detection(shot="a", stamp_s=0.0, break_points=points)
    states = {"left": LaserState.REJECTED, "middle": LaserState.PARTLY, "right": LaserState.USED}
    rejections = (
        Rejection(what="stripe", laser="left"),
        Rejection(what="point", laser="middle", edge="inner"),
        Rejection(what="stripe", laser="unknown"),
    )
    picture = drawn(scene, pose_of(scene), detection=detection, lasers=states, rejected=rejections)

    is_red = [[has_color_near(picture, scene.position_px[k, e], REJECTED_COLOR) for e in (0, 1)] for k in range(3)]
    assert is_red == [[True, True], [True, False], [False, False]]


def test_an_end_that_detection_rejected_is_red_though_it_is_no_break_point(scene):
    points = scene.break_points(0.1)
    inner, outer = scene.position_px[1]
    seen = points.position_px.copy()
    seen[1, 0] = np.nan
    share = np.linspace(0.0, 1.0, 200)[:, None]
    stripes = Stripes(
        position_px=inner + share * (outer - inner),
        sigma_px=np.ones(200),
        peak_dn=np.ones(200),
        piece=np.zeros(200, int),
        laser=np.array([UNLABELLED]),
    )
    detection = Detection(shot="a", stamp_s=0.0, break_points=break_points_of(seen), stripes=stripes)
    rejected = (Rejection(what="point", laser="middle", edge="inner"),)

    pictures = [drawn(scene, pose_of(scene), detection=detection, rejected=each) for each in (rejected, ())]

    assert [has_color_near(picture, inner, REJECTED_COLOR) for picture in pictures] == [True, False]
    assert not has_color_near(pictures[0], outer, REJECTED_COLOR)


def test_visible_edges_that_were_rejected_are_red(scene):
    place = np.array([[800.0, 600.0], [820.0, 600.0]])
    edges = RingEdgePoints(
        position_px=place, edge=np.array([0, 1]), normal=np.array([[1.0, 0.0]] * 2), sigma_px=np.full(2, 0.1)
    )
    detection = replace(NO_POINTS, ring_edges=edges)

    picture = drawn(scene, None, detection=detection, rejected=(Rejection(what="edge", edge="inner"),))

    assert [has_color_near(picture, each, REJECTED_COLOR) for each in place] == [True, False]


def test_labels_lie_beside_each_other():
    drawing = Drawing(np.zeros((300, 400, 3), np.uint8))
    for number in range(8):
        drawing.labels.append((f"label {number}", np.array([200.0 + number, 150.0]), WHITE))

    write_labels(drawing)

    boxes = drawing.taken
    assert len(boxes) == 8
    for number, (left, top, right, bottom) in enumerate(boxes):
        for other in boxes[number + 1 :]:
            assert right < other[0] or left > other[2] or bottom < other[1] or top > other[3]


def test_a_ring_behind_the_camera_draws_nothing(scene):
    behind = pose_of(scene, center_m=-scene.ring.center_m, grasp_m=np.array([0.0, 0.0, -0.5]))

    assert not drawn(scene, behind)[200:1050].any()


def test_picture_of_a_switched_shot_shows_the_stripes_of_all_lasers():
    images = np.zeros((4, 8, 8), np.uint8)
    images[0] = 200  # lasers off, bright
    images[1, 2], images[2, 4], images[3, 6] = 50, 60, 70
    stamps = np.arange(4.0)
    lasers = np.array([0, 1, 2, 4], np.uint8)

    picture = picture_of(Shot(name="a", images=images, lasers=lasers, stamp_s=stamps, exposure_s=stamps))

    assert picture[:, 0].tolist() == [0, 0, 50, 0, 60, 0, 70, 0]


def letters(picture):
    """Number of pixels of white letters, on black."""
    return int((picture.min(axis=2) > 200).sum())


def test_texts_in_a_small_picture_are_complete_and_do_not_overlap(scene):
    pose = pose_of(scene, normal=np.full(3, np.nan), center_m=np.full(3, np.nan), grasp_m=np.full(3, np.nan))
    line = line_of(pose, reason="the inner break point of laser left contradicts the others and was left out")

    small, large = (
        letters(overlay(np.zeros(shape, np.uint8), NO_POINTS, line, scene.rig)) for shape in ((240, 320), (990, 990))
    )

    assert small == large > 500


def test_labels_at_the_border_are_moved_into_the_picture():
    points_px = np.full((2, 2, 2), np.nan)
    counts = []
    for place in ((100.0, 100.0), (318.0, 238.0)):
        points_px[0, 0] = place
        points = break_points_of(points_px.copy())
        picture = overlay(np.zeros((240, 320), np.uint8), replace(NO_POINTS, break_points=points))
        counts.append(int((picture[40:].max(axis=2) > 200).sum()))  # below the summary

    assert counts[1] > 0.6 * counts[0]  # the marker is cut off, the label is not
