"""Records of every kind: read as they were written, and with any value spoiled read or rejected with one clear line."""

import json
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from schemas import validated
from spoiled_values import outcome, spoiled_once
from whole_records import VERSION_1, complete_line, complete_track, complete_truth, full_detection, record_of, square

from ringpose.files import records
from ringpose.files.cameras.ros import CameraFile, CameraInfo, Matrix
from ringpose.files.records.detections import detection_of
from ringpose.files.records.poses import pose_line_of
from ringpose.files.rigs import LaserEntry, MountEntry, RigFile
from ringpose.files.scenes.motions import MotionEntry, TimedPose
from ringpose.files.scenes.rings import FormEntry, RingEntry
from ringpose.files.scenes.scene import LightEntry, SceneFile, SunEntry
from ringpose.files.scenes.targets import (
    BoxEntry,
    ConeEntry,
    CylinderEntry,
    DiscEntry,
    FaceEdges,
    PanelEntry,
    RevolutionEntry,
    TargetEntry,
)
from ringpose.files.scenes.views import BoardsEntry, BoardSetEntry, BoardViewEntry, GeneratedViews, ViewEntry
from ringpose.files.schemas import RECORDS
from ringpose.files.studies.specification import AssumeEntry, StudyFile, TrackEntry
from ringpose.types.assumptions import RigStability
from ringpose.types.board import Board
from ringpose.types.capture import Arm, CaptureLine, CaptureLoop, FloatingBase, GripperState, TrueRing
from ringpose.types.obstacles import Blanket, Cable, Heads
from ringpose.types.options import PoseFrame
from ringpose.types.points import LeftOut, ShotPoints, StripePoints
from ringpose.types.rig import ParameterCovariance, RobotPose, ToolPose
from ringpose.types.scene import (
    Approach,
    Beacon,
    BoardApproach,
    Earth,
    Ghost,
    LaserLight,
    Optics,
    Sensor,
    Speckle,
)
from ringpose.types.session import Capture, Session
from ringpose.types.study import Drawn, Factors, Limits, StudyMethod
from ringpose.types.target import MATERIALS, MOTION_PRESETS, Body, Foil, Gap, Grid, Material

Values = dict[str, Any]


RNG = np.random.default_rng(1)
SESSION = Session(
    captures=(
        Capture(camera="files:x", lasers="none:", shots=("c",)),
        Capture(
            camera="sim:scene.yaml", camera_name="drawn", lasers="sim:", laser_count=3, laser_names=("a", "b", "c"),
            sequence="off,1,2,3,off", exposure_s=0.01, rate_hz=10.0, state="finished", shots=("a", "b"),
            provenance={"version": "0"},
        ),
    )
)  # fmt: skip
TOOL = ToolPose(position_m=np.array([0.5, 0.0, 1.0]), orientation_xyzw=np.array([0.0, 0.6, 0.0, 0.8]))
CAMERA = CameraFile(
    image_width=640, image_height=480, camera_name="a",
    camera_matrix=Matrix(rows=3, cols=3, data=np.array([700.0, 0, 320.5, 0, 710.0, 240.25, 0, 0, 1])),
    distortion_model="plumb_bob",
    distortion_coefficients=Matrix(rows=1, cols=5, data=np.array([-0.1, 0.12, 1e-4, -2e-4, 0.03])),
    covariance=ParameterCovariance(parameters=("fx", "k1"), data=np.array([[1.0, 1e-4], [1e-4, 1e-6]])),
    provenance={"version": "0"},
)  # fmt: skip
RIG = RigFile(
    camera=CameraInfo(**{field.name: getattr(CAMERA, field.name) for field in fields(CameraInfo)}),
    lasers=(
        LaserEntry(name="l", normal=np.array([0.0, 0.6, -0.8]), distance_m=-0.04, projector_m=np.array([0.1, 0, 0])),
        LaserEntry(name="r", normal=np.array([0.0, 0.6, -0.8]), distance_m=0.04),
    ),
    covariance=ParameterCovariance(parameters=("l.tilt_1",), data=np.array([[1e-8]])),
    stability=RigStability(plane_tilt_rad=1e-3),
    mount=MountEntry(
        tool_from_camera=np.eye(4),
        covariance=np.eye(6),
        delay_s=0.1,
        delay_sd_s=0.01,
        robot_rotation_sd_rad=1e-4,
        robot_translation_sd_m=1e-4,
        pose_covariance=np.eye(6),
    ),
)
GRID = Grid(cell_m=(0.1, 0.2), line_m=0.01, diffuse=0.1, specular=0.2, roughness=0.3)
PAINT = Material(diffuse=0.1, specular=0.2, roughness=0.3, grid=GRID)
PROFILE_M = np.array([[0.5, 0.0], [0.5, 0.1], [0.6, 0.1]])
FORM = FormEntry(inner_m=np.full((3, 2), 1e-4), outer_m=np.zeros((3, 2)), axial_m=np.zeros((3, 2)))
RING = {"slope_rad": 0.1, "gaps": (Gap(angle_rad=1.0, width_m=0.1, depth_m=0.01),), "form": FORM, "chamfer_m": 0.001}
COMMON = {"position_m": np.ones(3), "rotation_rad": np.ones(3), "material": PAINT, "mass_kg": {"dry": 1.0, "wet": 2.0}}
SCENE = SceneFile(
    rig="rig.yaml", seed=2, sequence="off,1,all", exposure_s=0.01, stripe_dn=170.0, period_s=0.2, start_s=3.0,
    ring=RingEntry(
        radius_inner_m=0.5, radius_outer_m=0.6, height_m=0.1, profile_m=PROFILE_M, face=MATERIALS["matt"], wall=PAINT,
        **RING,
    ),
    body=Body(size_m=np.ones(3), offset_m=np.ones(2), material=PAINT, foil=Foil(rms_m=1e-3, crinkle_m=0.1, seed=3)),
    target=TargetEntry(
        model="sinosat2", state="stowed", mass="dry",
        parts=(
            BoxEntry(name="a", shape="box", size_m=np.ones(3), foil=Foil(seed=2), **COMMON),
            PanelEntry(name="b", shape="panel", size_m=np.ones(2), thickness_m=0.1, back=MATERIALS["white"], **COMMON),
            CylinderEntry(name="c", shape="cylinder", radius_m=1.0, height_m=2.0, **COMMON),
            ConeEntry(name="d", shape="cone", radius_m=1.0, top_radius_m=0.0, height_m=2.0, **COMMON),
            DiscEntry(name="e", shape="disc", radius_m=1.0, inner_radius_m=0.5, **COMMON),
            RevolutionEntry(
                name="f", shape="revolution", profile_m=PROFILE_M, edges=FaceEdges(inner=1, outer=2), wall=PAINT,
                **(COMMON | RING | {"form": FormEntry(tolerance_m=1e-3, seed=2), "mass_kg": 3.0}),
            ),
        ),
    ),
    gripper=(BoxEntry(name="finger", shape="box", size_m=np.ones(3), material=MATERIALS["black"]),),
    sun=SunEntry(irradiance_w_m2=30.0, direction=np.ones(3), diameter_rad=0.01),
    earth=Earth(direction=np.ones(3), orbit_radius_m=1e7, albedo=0.5),
    motion=MotionEntry(
        preset=MOTION_PRESETS["stress"], angular_velocity_rad_s=np.full(3, 0.1), inertia_kg_m2=np.eye(3),
        center_of_mass_m=np.ones(3), velocity_m_s=np.full(3, 0.1), file="poses.csv", shots=3,
        camera=(TimedPose(time_s=0.0, position_m=np.ones(3), orientation_xyzw=np.array([0.0, 0.6, 0.0, 0.8])),),
    ),
    obstacles=(
        Heads(kind="heads", height_m=0.01, width_m=0.02, spacing_m=0.1, angle_rad=1.0, count=2, material=PAINT),
        Cable(kind="cable", angle_rad=1.0, direction_rad=0.5, width_m=0.01, length_m=0.2, material=PAINT),
        Blanket(
            kind="blanket", angle_rad=1.0, length_m=0.2, overlap_m=0.01, beyond_m=0.1, material=PAINT,
            foil=Foil(seed=2),
        ),
    ),
    lasers=LaserLight(
        power_w=0.1, sigma_m=1e-3, divergence_rad=1e-3, fan_rad=1.0, bow_per_rad=0.01,
        ghost=Ghost(rows_px=-15.0, ratio=0.1),
    ),
    lights={
        "dim": None,
        "sun": LightEntry(
            ambient_w_m2=1.0, sun_w_m2=2.0, sun_direction=np.ones(3),
            beacon=Beacon(ambient_w_m2=8.0, on_s=0.5, off_s=0.25, phase_s=0.1),
        ),
    },
    lens=Optics(f_number=4.0, transmission=0.8, blur_px=1.0),
    sensor=Sensor(
        bits=12, pixel_m=5e-6, quantum_efficiency=0.4, wavelength_m=6e-7, saturation_capacity_e=1e4,
        temporal_dark_noise_e=9.0, overall_system_gain_dn_per_e=0.1, black_level_dn=3.0,
        photo_response_non_uniformity=0.01,
    ),
    speckle=Speckle(contrast=0.2, grain_px=2.0),
    trajectory=(
        ViewEntry(
            name="a", center_m=np.ones(3), normal=np.array([0.0, 0.6, -0.8]), pitch_rad=0.1, yaw_rad=0.1, roll_rad=1.0,
            light="sun", target="body", groups={"distance_m": 0.5, "foil": True, "rig": "B", "count": 3},
        ),
        GeneratedViews(
            generate=Approach(
                count=2, distances_m=(0.5, 1.0), lights=("sun",), tilt_rad=0.1, clock_rad=0.1, offset=0.2, name="n",
                seed=2,
            )
        ),
    ),
    boards=BoardsEntry(
        camera=BoardSetEntry(
            board=Board(kind="chessboard", squares_x=7, squares_y=5, square_m=0.03), ambient_w_m2=1.0, exposure_s=0.1,
            sequence="all",
            views=(BoardViewEntry(name="a", camera_from_board_rvec=np.ones(3), camera_from_board_tvec_m=np.ones(3)),),
            generate=BoardApproach(count=2, distances_m=(0.3, 0.5), tilt_rad=0.1, turn_rad=0.1, offset=0.1, seed=2),
        ),
    ),
)  # fmt: skip
STUDY = StudyFile(
    title="small", scene="scene.yaml", level="features", count=2, seed=3,
    vary=Factors(
        distance_m=(0.3, 0.5), light="dim", sequence=("off,all", "off,1"), tilt_rad=Drawn(uniform=(0.1, 0.2)),
        target=Drawn(choice=("ring", "body")), rig_errors=(True, False), offset=Drawn(choice=(0.1, 0.2)), blur_px=1.0,
    ),
    cases={"none": Factors(), "blurred": Factors(blur_px=2.0)},
    assume=AssumeEntry(
        still=True, max_speed_m_s=0.1, max_rate_rad_s=0.2, ring_tolerance_m=1e-3, rig_stability=2.0
    ),
    methods=(StudyMethod.TRACK, StudyMethod.ELLIPSE_REFINED), table="case", calibrate=True,
    track=TrackEntry(shots=3, period_s=0.5),
    capture=CaptureLoop(timeout_s=30.0, arm=Arm(delay_s=0.1), base=FloatingBase(mass_kg=200.0)),
    limits=Limits(max_center_m=0.1, max_ok_wrong_share={"none": 0.5}),
)  # fmt: skip
KNOWN: Mapping[str, Any] = {
    "study": STUDY,
    "scene": SCENE,
    "pose": complete_line(RNG),
    "track": complete_track(RNG),
    "detection": full_detection(RNG, centers=2),
    "truth": complete_truth(RNG),
    "session": SESSION,
    "rig": RIG,
    "camera": CAMERA,
    "board": Board(
        kind="charuco",
        squares_x=7,
        squares_y=5,
        square_m=0.03,
        marker_m=0.02,
        dictionary="DICT_4X4_50",
        legacy_pattern=True,
    ),
    "robot-pose": RobotPose(stamp_s=1.7e9, base_from_tool=TOOL),
    "points": ShotPoints(
        software="ringpose 0.2.0",
        shot="a",
        stamp_s=1.5,
        frame=PoseFrame.BASE,
        lasers=("l", "r"),
        points=StripePoints(
            position_m=RNG.normal(size=(2, 3)),
            covariance_m2=np.stack([square(RNG, 3), square(RNG, 3)]),
            noise_m=RNG.normal(size=(2, 3)),
            intensity_dn=np.array([120.0, 80.0]),
            laser=np.array([0, 1]),
            stamp_s=np.array([1.4, 1.5]),
            position_px=RNG.normal(size=(2, 2)),
        ),
        left_out=LeftOut(laser_unknown=1, no_intersection=2, no_robot_pose=3),
        calibration_covariance=True,
        rig="0" * 64,
    ),
    "capture": CaptureLine(
        run="a",
        method="track",
        groups={"light": "dark", "rate": 0.1},
        closed_s=12.5,
        capture_probability=0.99,
        gripper=GripperState(grasp_m=np.ones(3), approach=np.array([0.0, 0.6, 0.8]), radial_m=0.003, tilt_rad=0.02),
        ring=TrueRing(center_m=np.ones(3), normal=np.array([0.0, -0.6, -0.8]), radius_inner_m=0.5, radius_outer_m=0.6),
    ),
}
"""Of each kind a record in which everything is known."""

WRITTEN: Mapping[str, Values] = {name: record_of(RECORDS[name].write(known)) for name, known in KNOWN.items()}


def earlier_detection(values: Values) -> Values:
    """As version 1 had it."""
    added = ("lasers_on", "rejected", "rig", "ring", "repeated", "opposite", "software")
    parts = ("break_points", "stripes", "segments", "ring_edges")
    older = {part: {key: value for key, value in values[part].items() if key != "stamp_s"} for part in parts}
    kept = {key: value for key, value in (values | older).items() if key not in added}
    return kept | {"schema": "ringpose/detection/1"}


EARLIER: Mapping[str, Values] = {"pose": VERSION_1, "detection": earlier_detection(WRITTEN["detection"])}

READ: Mapping[str, Callable[[Values, str], Any]] = {
    **{name: each.read for name, each in RECORDS.items()},
    "pose": pose_line_of,
    "detection": detection_of,
}


def rewritten(name: str, found: Any) -> Values:
    """The record that is written of what was read; it fits its schema."""
    values: Values = json.loads(records.line_of(RECORDS[name].write(found)))
    return validated(values, name)


def test_there_is_an_example_of_every_kind():
    assert set(KNOWN) == set(RECORDS)


@pytest.mark.parametrize("name", WRITTEN)
def test_a_record_is_read_as_it_was_written_and_other_keys_are_ignored(name):
    values = WRITTEN[name]

    found = READ[name](values | {"x_more": {"a": [1]}}, "x")

    assert rewritten(name, found) == values


@pytest.mark.parametrize("name", WRITTEN)
def test_unknown_keys_are_ignored_in_records_and_rejected_in_what_people_write(name):
    found = outcome(lambda values: READ[name](values, "x"), WRITTEN[name] | {"more": 1}, "x: unknown key 'more'; ")

    assert (found is None) == RECORDS[name].strict


@pytest.mark.parametrize(
    ("name", "values"),
    [*WRITTEN.items(), *EARLIER.items()],
    ids=[*WRITTEN, *(f"{name} of version 1" for name in EARLIER)],
)
@given(data=st.data())
def test_a_spoiled_record_is_rejected_with_its_place_or_read(name, values, data):
    assert READ[name](values, "x") is not None

    found = outcome(lambda spoiled: READ[name](spoiled, "x"), data.draw(spoiled_once(values)), "x: ")

    if found is not None:
        once = json.loads(records.line_of(RECORDS[name].write(found)))
        named = "rig" in once and not RECORDS[name].is_file  # tests call a rig by any name
        validated(once | ({"rig": None} if named else {}), name)
        assert json.loads(records.line_of(RECORDS[name].write(READ[name](once, "x")))) == once
