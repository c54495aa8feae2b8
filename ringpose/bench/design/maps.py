"""Accuracy before a rig is built: Cramér-Rao bounds over the working volume, and the best of a sweep (section 14).

At each place the features that an image would show are predicted, with the errors that the scene's lasers, lens and
sensor cause; the bound includes the covariance of the rig's calibration and its stability since then.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import degrees, inf, nan, radians

import numpy as np

from ringpose.bench.design.bounds import cramer_rao
from ringpose.bench.design.rig_changes import elevations_rad, with_changes
from ringpose.bench.table import number
from ringpose.estimate.covariance import standard_deviation
from ringpose.estimate.nuisance import with_stability
from ringpose.geometry.rays import rays
from ringpose.geometry.rotations import facing_normal
from ringpose.measure.stream import pose_line
from ringpose.pose.advice import RADIUS_SD_M
from ringpose.simulate.features import Deviations, drawn_features
from ringpose.simulate.light import radiance_along
from ringpose.simulate.pipeline import illuminated_ring
from ringpose.simulate.placement import image_ray, ring_rotation
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import NOISE_ONLY, RigStability
from ringpose.types.detection import BreakPoints
from ringpose.types.pose import KnownRadii, PoseFlag, PoseLine
from ringpose.types.rig import Rig
from ringpose.types.scene import RingView, Scene
from ringpose.types.table import Table

_CENTER_WEAK = PoseFlag.CENTER_WEAK | PoseFlag.SIDE_UNKNOWN

WEAK: Mapping[str, PoseFlag] = {
    "center_m": _CENTER_WEAK,
    "normal_rad": PoseFlag.NORMAL_WEAK,
    "radius_outer_m": PoseFlag.RADIUS_WEAK,
    "grasp_m": PoseFlag.GRASP_WEAK,
}
"""Flags with which errors of a quantity are not at the bound: a linear approximation does not describe them."""

WEAK_KNOWN: Mapping[str, PoseFlag] = {"center_known_m": _CENTER_WEAK, "normal_known_rad": PoseFlag.NORMAL_WEAK}
"""The same of the quantities with known radii."""

PAPER_ANGLES = {"the paper's +-1.5 deg": radians(1.5), "the paper's +-10 deg": radians(10.0)}

QUANTITIES = ("center_m", "normal_rad", "radius_outer_m", "grasp_m", "center_known_m", "normal_known_rad")
"""Standard deviations at a place; `known`: with known radii."""

SWEPT = ("laser_angle_rad", "baseline_m", "focal_px", "dark_noise_e", "lasers")
"""What a sweep may change."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A place of the ring: where the middle of the visible section of its face is, and how the ring is turned."""

    distance_m: float
    """Depth of the place in the camera frame."""
    offset_x: float = 0.0
    offset_y: float = 0.0
    """Offset of the place from the image centre, as a share of the image's width and height."""
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceResult:
    """The accuracy with which a rig can measure the ring at a place."""

    place: Place
    stripes: int
    """Number of stripes whose two break points are in view."""
    sd: Mapping[str, float]
    """Bounds by the names of `QUANTITIES`; NaN where the quantity is not determined."""
    weak_quantities: frozenset[str]
    """Those of which the estimator does not reach the bound."""
    light_beyond: bool
    """Whether light of the same laser on another surface hides an end of a stripe, which the bound does not include."""
    ambiguous: bool
    """Whether the stripes of one frame with all lasers on can be assigned to the lasers in several ways."""

    def above_bound(self, quantity: str) -> bool:
        """Whether errors of a quantity are known to be larger than the bound."""
        return self.light_beyond or quantity in self.weak_quantities

    @property
    def weak(self) -> bool:
        """Whether the estimator does not reach a bound of the ring without known radii."""
        return any(quantity in self.weak_quantities for quantity in WEAK)

    @property
    def weak_known(self) -> bool:
        """The same with known radii."""
        return any(quantity in self.weak_quantities for quantity in WEAK_KNOWN)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Design:
    """A rig of the sweep, with its map."""

    name: str
    changes: Mapping[str, float]
    rig: Rig
    results: tuple[PlaceResult, ...]
    reference: bool = False
    """Whether it is shown for comparison only."""

    def coverage(self) -> float:
        """Share of the places at which all stripes are in view."""
        lasers = len(self.rig.lasers.names)
        return sum(result.stripes == lasers for result in self.results) / len(self.results)

    def share(self, attribute: str) -> float:
        """Share of the places at which an attribute such as `weak` is true."""
        return sum(bool(getattr(result, attribute)) for result in self.results) / len(self.results)

    def median(self, quantity: str, distance_m: float | None = None) -> float:
        """Median over the places (of one distance); infinite where most do not determine the quantity."""
        values = [
            result.sd[quantity] if np.isfinite(result.sd[quantity]) else inf
            for result in self.results
            if distance_m is None or result.place.distance_m == distance_m
        ]
        return float(np.median(values)) if values else nan

    def full_view_m(self) -> tuple[float, float] | None:
        """Nearest and farthest distance at which all stripes are in view at the image centre; None if there is none."""
        lasers = len(self.rig.lasers.names)
        seen = [
            result.place.distance_m
            for result in self.results
            if result.stripes == lasers and abs(result.place.offset_x) < 1e-9
        ]
        return (min(seen), max(seen)) if seen else None


def places(
    distances_m: Sequence[float], offsets: Sequence[float], pitch_rad: float = 0.0, yaw_rad: float = 0.0
) -> list[Place]:
    """A grid over distance and horizontal offset."""
    return [
        Place(distance_m=float(distance_m), offset_x=float(offset), pitch_rad=pitch_rad, yaw_rad=yaw_rad)
        for distance_m, offset in product(distances_m, offsets)
    ]


def designs(
    scene: Scene, sweep: Mapping[str, Sequence[float]], where: Sequence[Place], stability: RigStability
) -> Iterator[Design]:
    """The scene's rig, every combination of the sweep, and the angles of the paper's rigs for comparison."""
    swept = [dict(zip(sweep, values, strict=True)) for values in product(*sweep.values())] if sweep else []
    named = [(", ".join(change_text(*change) for change in changes.items()), changes) for changes in swept]
    references = [(name, {"laser_angle_rad": angle_rad}) for name, angle_rad in PAPER_ANGLES.items()]
    for index, (name, changes) in enumerate([("as given", {}), *named, *references]):
        changed = with_changes(scene, changes)
        uncertain = replace(changed, rig=with_stability(changed.rig, stability))
        results = tuple(place_result(uncertain, place) for place in where)
        yield Design(name=name, changes=changes, rig=changed.rig, results=results, reference=index > len(swept))


def change_text(name: str, value: float) -> str:
    """A change of the rig as the tables name it, such as `+-10 deg`."""
    if name == "laser_angle_rad":
        return f"+-{degrees(value):.3g} deg"
    if name == "lasers":
        return f"{value:.0f} lasers"
    if name == "baseline_m":
        return f"baseline {1e3 * value:g} mm"
    return f"focal length {value:g} px" if name == "focal_px" else f"dark noise {value:g} e"


def best(mapped: Iterable[Design], quantity: str, min_coverage: float) -> Design | None:
    """The design with the smallest median of a quantity among those with this coverage; None if there is none."""
    allowed = [design for design in mapped if not design.reference and design.coverage() >= min_coverage]
    finite = [design for design in allowed if design.median(quantity) < inf]
    return min(finite, key=lambda design: design.median(quantity), default=None)


def place_result(scene: Scene, place: Place) -> PlaceResult:
    """The bounds at one place; the rig's covariance includes its stability."""
    at_place = scene_at(scene, place)
    radius_m = np.array([scene.ring.radius_inner_m, scene.ring.radius_outer_m])
    radii = KnownRadii(radius_m=radius_m, sd_m=np.full(2, RADIUS_SD_M))
    drawn = next(drawn_features(at_place, Deviations(noise=False), 1))
    exact = drawn.detection
    line, known = (pose_line(exact, scene.rig, known=given, options=NOISE_ONLY) for given in (None, radii))
    together = replace(at_place, sequence=((1 << len(scene.rig.lasers.names)) - 1,))
    one_frame = pose_line(
        next(drawn_features(together, Deviations(noise=False), 1)).detection, scene.rig, options=NOISE_ONLY
    )
    points = exact.break_points
    stripes = int(points.seen.all(axis=1).sum()) if isinstance(points, BreakPoints) else 0
    bound, bound_known = cramer_rao(line), cramer_rao(known)
    sd = dict.fromkeys(QUANTITIES, nan)
    if bound is not None:
        sd |= bound.standard_deviations
    if bound_known is not None:
        sd |= {"center_known_m": bound_known.center_sd_m, "normal_known_rad": bound_known.normal_sd_rad}
    grasp_m2 = None if line.pose is None else line.pose.covariance_grasp_m2
    if grasp_m2 is not None and np.isfinite(grasp_m2).all():
        sd["grasp_m"] = standard_deviation(grasp_m2)
    return PlaceResult(
        place=place,
        stripes=stripes,
        sd=sd,
        weak_quantities=_weak(line, WEAK) | _weak(known, WEAK_KNOWN),
        light_beyond=drawn.truth.break_points_px is not None and _light_beyond(at_place, drawn.truth.break_points_px),
        ambiguous=bool(one_frame.flags & PoseFlag.ASSIGNMENT_AMBIGUOUS),
    )


def scene_at(scene: Scene, place: Place) -> Scene:
    """The scene with one view, in which the visible section of the face is at a place, left of the ring's centre."""
    normal = facing_normal(place.pitch_rad, place.yaw_rad)
    point_m = place.distance_m * image_ray(scene.rig.camera, np.array([place.offset_x, place.offset_y]))
    axis = ring_rotation(normal, 0.0)[:, 0]
    radius_m = 0.5 * (scene.ring.radius_inner_m + scene.ring.radius_outer_m)
    view = RingView(name="place", center_m=point_m + radius_m * axis, normal=normal, light=next(iter(scene.lights)))
    return replace(scene, views=(view,), approaches=(), camera_boards=None, plane_boards=None)


BEYOND_COLUMNS, BEYOND_ROWS = 12, 12.0
"""Columns on either side of an end, and rows about its stripe, in which the light is compared."""

SECTION_SIGMAS = 3.0
"""Half height of a stripe, in standard deviations of its section, in which the detector measures it."""

HALF_WIDTHS = 2.355
"""Full width at half maximum of a Gaussian section, in standard deviations."""

BEYOND_LEVEL = 0.25
"""Ratio of the light beyond an end to that on the face above which it is another stripe, not a wall (as in detect)."""


def _light_beyond(scene: Scene, break_points_px: Float64[Array, "laser edge=2 xy=2"]) -> bool:
    """Whether an end's section overlaps with that of the same laser's stripe on another surface, beyond the end.

    The detector flags such an end as unclear; its standard deviation is several times that of an end in the dark.
    """
    camera, illuminated = scene.rig.camera, illuminated_ring(scene, scene.views[0], scene.sequence)
    columns = np.arange(-BEYOND_COLUMNS, BEYOND_COLUMNS + 1, 2)
    columns = columns[np.abs(columns) > scene.lens.blur_px]
    rows = np.arange(-BEYOND_ROWS, BEYOND_ROWS + 0.25, 0.5)
    blur = np.exp(-0.5 * ((rows[:, None] - rows) / max(scene.lens.blur_px, 0.25)) ** 2)
    for laser, ends_px in enumerate(break_points_px):
        if not np.isfinite(ends_px).all():
            continue
        for end_px, outward_px in zip(ends_px, ends_px - ends_px[::-1], strict=True):
            along_px = end_px + columns[:, None, None] * outward_px / abs(outward_px[0])
            directions = rays((along_px + rows[:, None] * np.array([0.0, 1.0])).reshape(-1, 2), camera)
            light = radiance_along(illuminated, directions)[1 + laser].reshape(len(columns), len(rows)) @ blur
            on_face, beyond = light[columns < 0].mean(axis=0), light[columns > 0].mean(axis=0)
            sigma = np.count_nonzero(on_face > 0.5 * on_face.max()) * (rows[1] - rows[0]) / HALF_WIDTHS
            near = abs(rows[np.argmax(beyond)]) < 2 * SECTION_SIGMAS * sigma
            if near and beyond.max() > BEYOND_LEVEL * on_face.max():
                return True
    return False


def _weak(line: PoseLine, flags: Mapping[str, PoseFlag]) -> frozenset[str]:
    """The quantities that a pose does not determine, or weakly."""
    return frozenset(name for name, weak in flags.items() if line.pose is None or line.flags & weak)


MEDIANS_NOTE = (
    "Medians of the standard deviations over the places of a distance, in mm and degrees; known: the centre, with "
    "known radii; >: at half of the places or more, errors are larger than this (hatched in the maps); -: not "
    "determined."
)


def median_table(mapped: Sequence[Design]) -> Table:
    """A row of text for each design and distance: medians over the places."""
    medians = {
        "center": ("center_m", 1e3),
        "normal": ("normal_rad", degrees(1.0)),
        "r_out": ("radius_outer_m", 1e3),
        "grasp": ("grasp_m", 1e3),
        "known": ("center_known_m", 1e3),
    }
    rows = []
    for design in mapped:
        for distance_m in sorted({result.place.distance_m for result in design.results}):
            results = tuple(result for result in design.results if result.place.distance_m == distance_m)
            here = replace(design, results=results)
            values = [_bound(here, name, factor) for name, factor in medians.values()]
            rows.append([design.name, f"{1e3 * distance_m:.0f}", f"{100 * here.coverage():.0f} %", *values])
    return Table(headings=["rig", "mm", "in view", *medians], rows=rows)


def _bound(design: Design, quantity: str, factor: float) -> str:
    """The median of a quantity, and whether errors are larger at most places."""
    median = design.median(quantity)
    is_above = np.mean([result.above_bound(quantity) for result in design.results]) >= 0.5
    return f"{'>' if is_above and np.isfinite(median) else ''}{number(factor * median)}"


def summary_lines(mapped: Sequence[Design]) -> list[str]:
    """For each design its field of view, the distances with all stripes in view, and ambiguous assignments."""
    lines = []
    for design in mapped:
        camera, range_m = design.rig.camera, design.full_view_m()
        focal = camera.camera_matrix[0, 0], camera.camera_matrix[1, 1]
        size = np.array([camera.image_width, camera.image_height])
        view = np.degrees(2 * np.arctan2(size / 2, focal)).tolist()
        seen = "never" if range_m is None else f"from {1e3 * range_m[0]:.0f} to {1e3 * range_m[1]:.0f} mm"
        angles = ", ".join(
            f"{round(degrees(elevation_rad), 2) + 0.0:g}" for elevation_rad in elevations_rad(design.rig.lasers)
        )
        lines.append(
            f"{design.name}: field of view {view[0]:.1f} x {view[1]:.1f} deg, light planes at {angles} deg; "
            f"all stripes in view {seen}; assignment ambiguous at {100 * design.share('ambiguous'):.0f} % of the places"
        )
    return lines


PLACE_FLAGS = ("weak", "weak_known", "light_beyond", "ambiguous")
"""What is true or false of a place (`PlaceResult`)."""


def place_table(mapped: Iterable[Design]) -> Table:
    """A row for each design and place, in metres and radians."""
    headings = (
        "rig", "reference", *SWEPT, "distance_m", "offset_x", "offset_y", "pitch_rad", "yaw_rad", "stripes",
        *(f"sd_{name}" for name in QUANTITIES), *PLACE_FLAGS,
    )  # fmt: skip
    rows = [
        [
            *(design.name, design.reference),
            *(design.changes.get(name) for name in SWEPT),
            *(place.distance_m, place.offset_x, place.offset_y, place.pitch_rad, place.yaw_rad),
            result.stripes,
            *(result.sd[name] for name in QUANTITIES),
            *(bool(getattr(result, name)) for name in PLACE_FLAGS),
        ]
        for design in mapped
        for result in design.results
        for place in [result.place]
    ]
    return Table(headings=headings, rows=rows)
