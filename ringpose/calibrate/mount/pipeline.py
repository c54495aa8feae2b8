"""From views of a board and robot poses to an assessed mount (ringpose-method(7), section 13)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, sqrt

import numpy as np

from ringpose.calibrate.boards.corner_errors import without_distortion_bias
from ringpose.calibrate.boards.pose import board_pose
from ringpose.calibrate.mount import closed_form
from ringpose.calibrate.mount.adjustment import (
    AT_BOUND,
    MIN_FREE_VIEWS,
    ROTATION_BOUNDS_RAD,
    TRANSLATION_BOUNDS_M,
    MountSolution,
    adjusted_mount,
)
from ringpose.calibrate.mount.causes import CONTRADICTION_RAD, likely_cause, other_rotations, rotation_error_rad
from ringpose.calibrate.mount.closed_form import moving_from_fixed
from ringpose.calibrate.mount.delay import OpenDelay, delayed_covariance, open_delay
from ringpose.calibrate.mount.moving import DELAY_PRIOR_S, ToolMotion, check_clocks, coarse_delay
from ringpose.calibrate.mount.stations import Sighting, Station
from ringpose.calibrate.mount.systematic import SystematicError, systematic_error
from ringpose.calibrate.mount.validation import (
    MIN_VIEWS,
    LeftOut,
    board_scale,
    left_out,
    validated_covariance,
    wrong_views,
)
from ringpose.errors import DataError
from ringpose.geometry.least_squares import square_root
from ringpose.geometry.robot_conventions import PoseConvention
from ringpose.geometry.rotations import rotation_vector
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.image import name_order
from ringpose.types.options import PoseFrame
from ringpose.types.rig import Camera, Mount
from ringpose.types.robot import ReportedPose

MAX_WRONG_SHARE = 1 / 3
"""Share of the views up to which single ones are left out as wrong."""

MAX_SCALE = 1.1
"""Factor between the robot's and the board's lengths from which one of them has another unit or a wrong size."""

OTHER_UNITS = (
    (1e3, "the robot's positions are in millimetres"),
    (1e2, "the robot's positions are in centimetres and are read as metres"),
    (1e1, "the robot's positions are in millimetres and are read as centimetres"),
    (1 / 0.0254, "the robot's positions are in inches and are read as metres"),
    (1 / 0.3048, "the robot's positions are in feet and are read as metres"),
    (1 / 25.4, "the robot's positions are in inches and are read as millimetres"),
    (1e-1, "the robot's positions are in centimetres and are read as millimetres"),
    (1e-3, "the robot's positions are in metres and are read as millimetres"),
)
"""Factors between the robot's and the board's lengths, and the mistakes that they are of."""

MIN_TURN_SHARE = 0.1
"""Share of the board's largest rotation by which the robot's poses turn at least, where they are not frozen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountCalibration:
    """The mount with its covariance, and what the views say about it."""

    stations: tuple[Station, ...]
    """The views used, in the order of their names."""
    rejected: Mapping[str, str]
    """Views left out, and why."""
    solution: MountSolution
    covariance: Float64[Array, "common common"]
    """Of mount and board (rotation vector, translation, each in its frame), and of the delay if the robot moved."""
    pose_covariance: Float64[Array, "6 6"]
    """Of the camera at another pose of the robot, by the errors of mount and robot (`camera_errors`)."""
    systematic: SystematicError
    """The part of the robot's error that depends on its pose, and how probable it is."""
    disagreement: tuple[float, float]
    """Factors by which the views disagree more about rotation and translation than their likelihood explains."""
    without: LeftOut
    """The solutions without each view; NaN where the others do not determine a mount."""
    turns: closed_form.Turns
    board_scale: tuple[float, float]
    """By what share the board is larger than given, and the standard deviation."""
    eye_to_hand: bool
    board_moved: str = ""
    """How the board moved between the views, if it did."""
    open_delay: OpenDelay | None = None
    """The delay as far as it is known, of a moving robot whose views do not determine it."""

    @property
    def has_prior(self) -> bool:
        """Whether the robot's error is also taken from its prior."""
        return len(self.stations) < MIN_FREE_VIEWS

    @property
    def mount(self) -> Mount:
        """The mount as the rig has it."""
        return Mount(
            carrier_from_camera=self.solution.state.mount.matrix,
            carrier=PoseFrame.BASE if self.eye_to_hand else PoseFrame.TOOL,
            root=square_root(self.covariance[:6, :6]),
            pose_root=square_root(self.pose_covariance),
            delay_s=self.solution.state.delay_s,
            delay_sd_s=hypot(self.delay_sd_s, self.solution.stamp_sd_s),
        )

    @property
    def is_moving(self) -> bool:
        """Whether the robot moved, so that its clock matters."""
        return any(station.sighting is not None for station in self.stations)

    @property
    def is_delay_known(self) -> bool:
        """Whether the views tell more about the delay than its bounds do."""
        return self.open_delay is None and bool(self.delay_sd_s < 0.5 * DELAY_PRIOR_S)

    @property
    def speeds(self) -> tuple[float, float]:
        """Highest velocity (m/s) and rate (rad/s) of the tool at the views."""
        twists = np.array([station.twist for station in self.stations])
        rates, speeds = (np.linalg.norm(twists[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
        return float(speeds.max()), float(rates.max())

    @property
    def delay_sd_s(self) -> float:
        """Standard deviation of the delay; 0 if the robot was at rest."""
        if self.open_delay is not None:
            return self.open_delay.sd_s
        return float(sqrt(self.covariance[12, 12])) if self.solution.has_delay else 0.0


def stations_of(views: Sequence[BoardView], poses: Sequence[ReportedPose | DataError]) -> list[Station]:
    """The views that have a pose of the robot."""
    return [
        Station(view=view, base_from_tool=closed_form.Transform(pose.rotation, pose.position_m), location=pose.location)
        for view, pose in zip(views, poses, strict=True)
        if not isinstance(pose, DataError)
    ]


def moving_stations(
    views: Sequence[BoardView],
    camera: Camera,
    stamps_s: Sequence[float],
    exposures_s: Sequence[float],
    motion: ToolMotion,
    *,
    eye_to_hand: bool,
    convention: PoseConvention | None = None,
) -> tuple[list[Station], list[DataError]]:
    """The views with the pose of a moving robot at the delay that fits best, and why others have none.

    If its poses fit in another convention only, the delay is that of this reading, so that the cause can be named.
    """
    if len(views) < MIN_VIEWS:
        _check_turns(closed_form.Turns(np.zeros((0, 3)), np.zeros((0, 3))), len(views), eye_to_hand)
    boards = [_transform(board_pose(view, camera)) for view in views]
    coarse = coarse_delay(stamps_s, boards, motion, eye_to_hand)
    if CONTRADICTION_RAD < coarse.misfit_rad < np.inf:
        readings = [
            coarse_delay(stamps_s, boards, motion.turned(rotations), eye_to_hand)
            for rotations, _ in other_rotations(list(motion.poses.rotation), convention)
        ]
        coarse = min([coarse, *readings], key=lambda one: one.misfit_rad)
    check_clocks(coarse, stamps_s, boards, motion, eye_to_hand)
    delay_s = coarse.delay_s
    stations, problems = [], []
    for view, stamp_s, exposure_s in zip(views, stamps_s, exposures_s, strict=True):
        instant = motion.at(stamp_s + delay_s)
        if instant is None:
            finding = motion.why_not_at(stamp_s + delay_s)
            problems.append(DataError(view.name, finding, "give the robot's poses before and after it, too"))
            continue
        sighting = Sighting(motion=motion, stamp_s=stamp_s, exposure_s=exposure_s, delay_s=delay_s)
        station = Station(view=view, base_from_tool=instant.base_from_tool, sighting=sighting)
        stations.append(station.at(delay_s))
    return stations, problems


def calibrate_mount(
    stations: Sequence[Station],
    camera: Camera,
    *,
    eye_to_hand: bool = False,
    refine_camera: bool = False,
    convention: PoseConvention | None = None,
) -> MountCalibration:
    """The mount of the views that agree; DataError if they do not determine it.

    `convention`: the one in which the robot's poses were given, for the likely cause of a contradiction.
    """
    stations = sorted(stations, key=lambda station: name_order(station.name))
    stations = [replace(one, view=without_distortion_bias(one.view, camera)) for one in stations]
    boards = [board_pose(station.view, camera) for station in stations]
    _check_motions(stations, boards, eye_to_hand, convention)
    rejected: dict[str, str] = {}
    board_moved = ""
    delay: OpenDelay | None = None
    used = list(range(len(stations)))
    while True:
        chosen = [stations[index] for index in used]
        own = [boards[index] for index in used]
        solution = _solved(chosen, own, camera, eye_to_hand, refine_camera)
        chosen = [station.at(solution.state.delay_s) for station in chosen]
        wrong = wrong_views(solution)
        slipped = wrong is not None and wrong.slipped and not board_moved
        if wrong is None or (not slipped and len(rejected) + 1 > MAX_WRONG_SHARE * len(stations)):
            delay = delay or open_delay(solution, chosen)
            if delay is None or not solution.has_delay:
                break
            stations = [station.held_at(delay.delay_s) for station in stations]
            continue
        rest = [index for index in range(len(chosen)) if index not in wrong.views]
        others = _solved(
            [chosen[index] for index in rest], [own[index] for index in rest], camera, eye_to_hand, refine_camera
        )
        if slipped:
            board_moved = _slip(wrong.views, chosen, own, others, eye_to_hand)
            reasons = [board_moved] * len(wrong.views)
        else:
            reasons = [_wrong_pose(chosen[index], own[index], others, eye_to_hand) for index in wrong.views]
        rejected |= {chosen[index].name: reason for index, reason in zip(wrong.views, reasons, strict=True)}
        used = [index for position, index in enumerate(used) if position not in wrong.views]
        _check_turns(_turns(stations, boards, used, eye_to_hand), len(used), eye_to_hand)
    _check_fit(solution)
    without = left_out(solution, chosen)
    fixed = None if refine_camera or camera.covariance is None else camera.covariance.data
    systematic = systematic_error(solution, chosen, eye_to_hand)
    validated = validated_covariance(solution, chosen, without, fixed, systematic, eye_to_hand)
    covariance = validated.covariance
    if delay is not None:
        covariance = covariance + delayed_covariance(solution, chosen, delay.sd_s)
    return MountCalibration(
        stations=tuple(chosen),
        rejected=rejected,
        solution=solution,
        covariance=covariance,
        pose_covariance=validated.pose_covariance,
        systematic=systematic,
        disagreement=validated.disagreement,
        without=_where_determined(without, stations, boards, used, eye_to_hand),
        turns=_turns(stations, boards, used, eye_to_hand),
        board_scale=board_scale(solution),
        eye_to_hand=eye_to_hand,
        board_moved=board_moved,
        open_delay=delay,
    )


def _transform(pose: BoardPose) -> closed_form.Transform:
    return closed_form.Transform(pose.rotation, pose.translation_m)


def _turns(
    stations: Sequence[Station], boards: Sequence[BoardPose], used: Sequence[int], eye_to_hand: bool
) -> closed_form.Turns:
    robot = [moving_from_fixed(stations[index].base_from_tool, eye_to_hand) for index in used]
    return closed_form.turns_between(robot, [_transform(boards[index]) for index in used])


def _solved(
    stations: Sequence[Station], boards: Sequence[BoardPose], camera: Camera, eye_to_hand: bool, refine_camera: bool
) -> MountSolution:
    robot = [moving_from_fixed(station.base_from_tool, eye_to_hand) for station in stations]
    board = [_transform(pose) for pose in boards]
    mount, fixed, _ = closed_form.closed_form_mount(robot, board, closed_form.turns_between(robot, board))
    try:
        return adjusted_mount(
            stations, camera, (mount, fixed), eye_to_hand=eye_to_hand, refine_camera=refine_camera, poses=boards
        )
    except np.linalg.LinAlgError as error:
        finding = "views and robot poses contradict each other so far that no mount fits them"
        remedy = "check their order and names, the board's sizes and the robot's convention"
        raise DataError("", finding, remedy) from error


def _check_motions(
    stations: Sequence[Station], boards: Sequence[BoardPose], eye_to_hand: bool, convention: PoseConvention | None
) -> None:
    """Raise DataError if the views determine no mount, or if another unit or convention explains them much better."""
    turns = _check_turns(_turns(stations, boards, range(len(stations)), eye_to_hand), len(stations), eye_to_hand)
    turned, seen = (float(np.linalg.norm(each, axis=1).max()) for each in turns)
    if turned < MIN_TURN_SHARE * seen:
        finding = (
            f"the robot's poses are turned against each other by at most {np.degrees(turned):.2g} degrees, the board "
            f"in the images by {np.degrees(seen):.2g}"
        )
        raise DataError("", finding, "likely the same pose was written for each view: read it anew")
    transforms = [_transform(pose) for pose in boards]
    error_rad = rotation_error_rad(turns)
    if error_rad > CONTRADICTION_RAD:
        cause = likely_cause(stations, transforms, eye_to_hand, convention)
        if cause:
            finding = "the robot's rotations contradict those of the board in the images"
            raise DataError("", finding, f"likely {cause}")
    robot = [moving_from_fixed(station.base_from_tool, eye_to_hand) for station in stations]
    _, _, scale = closed_form.closed_form_mount(robot, transforms, turns)
    for factor, words in OTHER_UNITS:
        if MAX_SCALE > scale * factor > 1 / MAX_SCALE:
            finding = f"the robot's lengths are {1 / scale:.4g} times those of the board"
            wrong = f"{1 / factor:.4g} times too large" if factor < 1.0 else f"{factor:.4g} times too small"
            raise DataError("", finding, f"likely {words}, or the board's sizes are {wrong}")


def _check_turns(turns: closed_form.Turns, views: int, eye_to_hand: bool) -> closed_form.Turns:
    """Raise DataError unless the views are turned about two axes."""
    if views < MIN_VIEWS:
        finding = f"{views} view{'s' * (views != 1)} with a pose of the robot, at least {MIN_VIEWS} are needed"
        raise DataError("", finding, "ten or more are good, turned by 20 degrees or more about two axes")
    largest, across, _ = turns.spread_rad.tolist()
    frame = "base" if eye_to_hand else "tool"
    if largest < closed_form.MIN_TURN_RAD:
        finding = f"the views are turned against each other by at most {np.degrees(largest):.2g} degrees, 5 are needed"
        raise DataError("", finding, f"turn the tool by 20 degrees or more about two axes of the {frame}")
    if across < closed_form.MIN_ACROSS_RAD:
        axis = turns.main_axis
        missing = "xyz"[int(np.argmin(np.abs(axis)))]
        words = ", ".join(f"{value:.2f}" for value in axis * np.sign(axis[np.argmax(np.abs(axis))]))
        finding = (
            f"all views are turned about one axis, ({words}) in the {frame} frame, and by at most "
            f"{np.degrees(across):.2g} degrees about another: the mount's place along it is not determined"
        )
        raise DataError("", finding, f"add views that are turned about the {frame}'s {missing} axis")
    return turns


def _check_fit(solution: MountSolution) -> None:
    """Raise DataError if the robot's error is at the bound of its estimate, as no robot's is."""
    sigmas, bounds = solution.sigmas, (ROTATION_BOUNDS_RAD[1], TRANSLATION_BOUNDS_M[1])
    at_bound = [value > AT_BOUND * bound for value, bound in zip(sigmas, bounds, strict=True)]
    if any(at_bound):
        turn, shift = (" or more" if reached else "" for reached in at_bound)
        finding = (
            f"the robot's poses do not fit the views: its error would be {1e3 * sigmas.translation_m:.3g} mm{shift} "
            f"and {np.degrees(sigmas.rotation_rad):.3g} degrees{turn}"
        )
        remedy = "likely they are in another order than the images, of another session, or their columns are exchanged"
        raise DataError("", finding, remedy)


def _slip(
    later: Sequence[int],
    stations: Sequence[Station],
    boards: Sequence[BoardPose],
    solution: MountSolution,
    eye_to_hand: bool,
) -> str:
    """Between which views the board was moved, and how far."""
    is_end = later[-1] == len(stations) - 1
    before, after = (later[0] - 1, later[0]) if is_end else (later[-1], later[-1] + 1)
    mount = solution.state.mount
    placed = [
        moving_from_fixed(station.base_from_tool, eye_to_hand).inverse().after(mount).after(_transform(pose))
        for station, pose in zip(stations, boards, strict=True)
    ]
    place_m = np.array([one.translation_m for one in placed])
    chosen = np.isin(np.arange(len(stations)), later)
    moved_m = float(np.linalg.norm(np.median(place_m[chosen], axis=0) - np.median(place_m[~chosen], axis=0)))
    what = "the board slipped on the tool" if eye_to_hand else "the board was moved"
    return f"{what} between {stations[before].name} and {stations[after].name}, by about {1e3 * moved_m:.2g} mm"


def _wrong_pose(station: Station, board: BoardPose, others: MountSolution, eye_to_hand: bool) -> str:
    """In what the robot's pose differs from the one that the other views predict for this image."""
    state, seen = others.state, _transform(board)
    # of the board in the image and the others' mount: X T Y^-1 = G
    robot = state.mount.after(seen).after(state.board.inverse())
    expected, given = moving_from_fixed(robot, eye_to_hand), station.base_from_tool
    shift_m = expected.translation_m - given.translation_m
    turn_rad = float(np.linalg.norm(rotation_vector(given.rotation.T @ expected.rotation)))
    place = f"{station.location}: " if station.location else ""
    text = (
        f"{place}the robot's pose is {1e3 * np.linalg.norm(shift_m):.3g} mm and {np.degrees(turn_rad):.2g} degrees off "
        "by the other views"
    )
    axis = int(np.argmax(np.abs(shift_m)))
    others_m = np.delete(np.abs(shift_m), axis).max()
    if abs(shift_m[axis]) > 5 * others_m and abs(shift_m[axis]) > 2e-3:
        given_m, fitting_m = float(given.translation_m[axis]), float(expected.translation_m[axis])
        return f"{text}: likely its {'xyz'[axis]} is mistyped, {1e3 * given_m:.1f} mm; {1e3 * fitting_m:.1f} would fit"
    return f"{text}: likely a wrong pose or image, or the board was moved"


def _where_determined(
    without: LeftOut, stations: Sequence[Station], boards: Sequence[BoardPose], used: Sequence[int], eye_to_hand: bool
) -> LeftOut:
    """Held-out errors are NaN where the other views do not determine a mount."""
    known = np.array(
        [_determined([one for one in used if one != index], stations, boards, eye_to_hand) for index in used]
    )
    return without._replace(
        distance_m=np.where(known, without.distance_m, np.nan), angle_rad=np.where(known, without.angle_rad, np.nan)
    )


def _determined(
    used: Sequence[int], stations: Sequence[Station], boards: Sequence[BoardPose], eye_to_hand: bool
) -> bool:
    if len(used) < MIN_VIEWS:
        return False
    largest, across, _ = _turns(stations, boards, used, eye_to_hand).spread_rad.tolist()
    return bool(largest >= closed_form.MIN_TURN_RAD and across >= closed_form.MIN_ACROSS_RAD)
