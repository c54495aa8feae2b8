"""What images of a view would show of the ring: the exposure, and the standard deviations of its features.

The features are the stripes, the break points and the visible edges. They are computed once per view, because small
motions, rig errors and outliers hardly change their standard deviations.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringpose.geometry.rays import project, rays
from ringpose.geometry.ring import EDGE_SIGN, RingArcs, edge_points, predicted_break_points, ring_arcs
from ringpose.optics import feature_errors
from ringpose.optics.image_noise import PIXEL_GRAIN, PIXEL_VARIANCE, ImageNoise
from ringpose.optics.sensor import electrons_per_radiance, saturation_dn
from ringpose.simulate.break_points import inside_image
from ringpose.simulate.exposure import face_stripe_radiance, view_exposure_s
from ringpose.simulate.light import IlluminatedTarget, half_thickness_m, in_fan, radiance_along
from ringpose.simulate.pipeline import illuminated_ring
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.image import searched_frames
from ringpose.types.rig import Camera
from ringpose.types.scene import RingView, Scene


def view_arcs(scene: Scene, view: RingView) -> RingArcs:
    """The ring of a view as `RingArcs` whose origin is the point of the ring nearest to the middle of the image."""
    camera = scene.rig.camera
    axis = rays(np.array([camera.image_width - 1, camera.image_height - 1]) / 2, camera)
    cosine = float(axis @ view.normal)
    near_m = axis * (float(view.center_m @ view.normal) / cosine if abs(cosine) > _GRAZING else 0.0)
    radius_m = np.array([scene.ring.radius_inner_m, scene.ring.radius_outer_m])
    return ring_arcs(view.center_m, view.normal, radius_m, near_m)


_GRAZING = 1e-6
"""Cosine below which the optical axis is treated as parallel to the ring's plane."""


class LaserFrames(NamedTuple):
    """For each laser, the frame of a shot in which the detector searches for its stripe."""

    number: Int64[Array, "laser"]
    """Index of that frame in the shot; -1 for a laser that is off in all frames."""
    together: Int64[Array, "laser"]
    """Number of lasers whose stripes the detector may find in that frame."""
    subtracted: Bool[Array, "laser"]
    """Whether the detector subtracts another frame, without these lasers, from it."""

    def labelled(self, seen: Bool[Array, "laser"]) -> bool:
        """Whether each frame shows the stripe of one laser only, so that no stripe has to be assigned."""
        return bool((self.together[seen] == 1).all())


def laser_frames(sequence: tuple[int, ...], lasers: int) -> LaserFrames:
    """For each laser, the frame with the fewest lasers on among the frames of the sequence in which it is on."""
    number, together = np.full(lasers, -1), np.zeros(lasers, dtype=np.int64)
    subtracted = np.zeros(lasers, dtype=bool)
    for frame, shown, also_on in searched_frames(sequence, lasers):
        which = list(shown)
        number[which], together[which], subtracted[which] = frame, len(which), also_on in sequence
    return LaserFrames(number, together, subtracted)


class Appearance(NamedTuple):
    """The exposure of a view, and the standard deviations of what the detector measures in its images."""

    exposure_s: float
    arcs: RingArcs
    axes: Float64[Array, "3 3"]
    """Columns: x, y and z axis of the ring."""
    lit: Bool[Array, "laser"]
    """Which light planes reach the whole face on the side that is in view."""
    centers: tuple[feature_errors.CenterErrors | None, ...]
    """Errors of the centres of each laser's stripe; None for a laser whose stripe the detector would not find."""
    end_sigma_px: Float64[Array, "laser edge=2"]
    """Standard deviation of the break points along the stripe."""
    edges: "VisibleEdges"

    @property
    def seen(self) -> Bool[Array, "laser"]:
        """Which lasers' stripes the detector would find, if they are in view."""
        return np.array([center is not None for center in self.centers], dtype=np.bool_)


class VisibleEdges(NamedTuple):
    """Points of the ring's inner and outer edge at which ambient light makes a step of brightness."""

    frame: int
    """Index of the frame in which the detector searches for them."""
    along_m: Float64[Array, "place"]
    """Distance from the origin of the view's arcs, along the middle of the face."""
    edge: Int64[Array, "place"]
    """0 for the inner edge, 1 for the outer."""
    sigma_px: Float64[Array, "place"]


NO_EDGES = VisibleEdges(0, np.empty(0), np.empty(0, dtype=np.int64), np.empty(0))


@lru_cache(maxsize=16)
def expected_appearance(scene: Scene, view: RingView) -> Appearance:
    """The appearance of a view: its exposure, and the errors of stripes, break points and edges in its images."""
    illuminated, lasers = illuminated_ring(scene, view, scene.sequence), scene.rig.lasers
    frames = laser_frames(scene.sequence, len(lasers.names))
    exposure_s, arcs = view_exposure_s(scene, illuminated), view_arcs(scene, view)
    centers: list[feature_errors.CenterErrors | None] = [None] * len(lasers.names)
    end_sigma_px = np.full((len(centers), 2), np.nan)
    edges = NO_EDGES
    point_m = predicted_break_points(arcs, lasers.normal, lasers.distance_m)
    reached = _illuminated(illuminated, point_m) & (view.target == "ring")
    lit = np.flatnonzero(reached & (frames.number >= 0))
    if len(lit):
        middle_m = point_m[lit].mean(axis=1)
        rows_per_m, edge_per_row = _image_scales(arcs, lasers.normal[lit], point_m[lit], scene.rig.camera)
        range_m = np.linalg.norm(middle_m - lasers.projector_m[lit], axis=1)
        sigma_px = half_thickness_m(scene.lasers, range_m) * rows_per_m
        rate = electrons_per_radiance(scene.sensor, scene.lens) * exposure_s
        peak_e = rate * face_stripe_radiance(illuminated, scene.ring, middle_m, lit)
        background_e = np.zeros(len(lit))
        if illuminated.has_ambient_light:
            background_e = rate * radiance_along(illuminated, middle_m)[0].astype(np.float64)
        for number, laser in enumerate(lit):
            noise = image_noise(scene, subtracted=bool(frames.subtracted[laser]))
            stripe = feature_errors.Stripe(
                sigma_px=float(sigma_px[number]),
                peak_e=float(peak_e[number]),
                background_e=float(background_e[number]),
            )
            centers[laser] = center = feature_errors.center_errors(stripe, noise)
            if center is not None:
                pooled = 2 * int((frames.number[lit] == frames.number[laser]).sum())
                end_sigma_px[laser] = feature_errors.end_errors_px(stripe, noise, edge_per_row[number], pooled)
        if illuminated.has_ambient_light:
            edges = visible_edges(scene, illuminated, arcs, point_m[lit], exposure_s)
    return Appearance(
        exposure_s=exposure_s,
        arcs=arcs,
        axes=illuminated.placement.rotation,
        lit=reached,
        centers=tuple(centers),
        end_sigma_px=end_sigma_px,
        edges=edges,
    )


def image_noise(scene: Scene, *, subtracted: bool) -> ImageNoise:
    """The noise of a scene's frames; `subtracted` if a frame without the lasers is subtracted."""
    sensor, frames = scene.sensor, 2 if subtracted else 1
    gain = sensor.overall_system_gain_dn_per_e
    full_dn = (saturation_dn(sensor) - sensor.black_level_dn) / gain
    return ImageNoise(
        blur_px=scene.lens.blur_px,
        contrast=scene.speckle.contrast,
        grain_px=max(scene.speckle.grain_px, 1.0) * PIXEL_GRAIN,
        dark_e2=frames * (sensor.temporal_dark_noise_e**2 + PIXEL_VARIANCE / gain**2),
        frames=frames,
        response=sensor.photo_response_non_uniformity,
        full_e=min(full_dn, sensor.saturation_capacity_e),
    )


def _illuminated(illuminated: IlluminatedTarget, point_m: Float64[Array, "laser edge=2 xyz=3"]) -> Bool[Array, "laser"]:
    """Whether camera and laser are in front of the face, and both ends of the stripe are in the laser's fan."""
    sheet, eye = illuminated.sheets, illuminated.placement.eye_m
    point = illuminated.placement.points_target(point_m.reshape(-1, 3).T).T.reshape(point_m.shape)
    height_m = point[..., 2].max(axis=1)  # NaN if the light plane misses an edge
    front = (point_m[..., 2].min(axis=1) > 0) & (eye[2] > height_m) & (sheet.projector_m[:, 2] > height_m)
    return np.array(
        [is_front and bool(in_fan(sheet, laser, point[laser].T).all()) for laser, is_front in enumerate(front)]
    )


_STEP_M = 1e-5
"""Step of numerical derivatives of the projection."""


def _image_scales(
    arcs: RingArcs,
    light_normal: Float64[Array, "stripe xyz=3"],
    point_m: Float64[Array, "stripe edge=2 xyz=3"],
    camera: Camera,
) -> tuple[Float64[Array, "stripe"], Float64[Array, "stripe edge=2"]]:
    """Scale of each stripe in the image, and the inclination of the ring's edges to it.

    The scale is in rows per metre of distance from the light plane; the inclination in columns along the stripe by
    which an edge is displaced per row across it.
    """
    along = np.cross(light_normal, arcs.normal)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    across = np.cross(arcs.normal, along)
    tangent = np.cross(arcs.normal, point_m - arcs.center)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    middle_m = point_m.mean(axis=1, keepdims=True)
    places = np.concatenate([middle_m, middle_m, point_m], axis=1)
    steps = _STEP_M * np.concatenate([along[:, None], across[:, None], tangent], axis=1)
    moved_px = (project(places + steps, camera) - project(places - steps, camera)) / (2 * _STEP_M)
    slope = (moved_px[:, 0, 1] / moved_px[:, 0, 0])[:, None]
    columns, rows = moved_px[:, 1:, 0], moved_px[:, 1:, 1] - slope * moved_px[:, 1:, 0]
    off_plane = np.abs((light_normal * across).sum(axis=1))
    return np.abs(rows[:, 0]) / off_plane, columns[:, 1:] / rows[:, 1:]


# Visible edges

EDGE_SPACING_PX = 12.0
"""Distance between places on an edge: the detector averages the image over this number of pixels."""

EDGE_MARGIN_PX = 8.0
"""Minimum distance of a place from the image's border."""

BESIDE_STRIPE_PX = 12.0
"""Distance from a break point within which a frame with lasers does not show an edge."""

LIGHT_OFFSETS_PX = (-3, 1, 2, 4)
"""Distances beyond an edge at which the light is sampled: on the face, then each for the pixels up to the next."""

NEIGHBOURS = 5
"""Number of neighbouring places by whose scatter the standard deviation of each is judged."""


def visible_edges(
    scene: Scene,
    illuminated: IlluminatedTarget,
    arcs: RingArcs,
    point_m: Float64[Array, "stripe edge=2 xyz=3"],
    exposure_s: float,
) -> VisibleEdges:
    """Points of both edges whose step of brightness the detector would find, with their standard deviations.

    A step is displaced by noise, and by light beyond the edge that is not uniform: another surface, a shadow, crinkles
    of the foil. That light is sampled by rays; the detector judges this error by the scatter of neighbouring points.
    """
    camera, sensor = scene.rig.camera, scene.sensor
    number = min(range(len(scene.sequence)), key=lambda each: (scene.sequence[each].bit_count(), each))
    step_m = EDGE_SPACING_PX * float(arcs.origin[2]) / float(camera.camera_matrix[0, 0])
    half = int(min(2.0 * arcs.mean_radius_m, 1.5 * float(arcs.origin[2])) / step_m)
    along_m = np.tile(step_m * np.arange(-half, half + 1), 2)
    edge = np.repeat(np.array([0, 1]), 2 * half + 1)
    place_m, outward = edge_points(arcs, along_m, np.array(EDGE_SIGN)[edge])
    position_px = project(place_m, camera)
    shown = inside_image(position_px, EDGE_MARGIN_PX, camera)
    if scene.sequence[number]:
        stripe_px = project(point_m, camera).reshape(-1, 1, 2)
        near_px = np.sqrt(((position_px - stripe_px) ** 2).sum(axis=-1)).min(axis=0)
        shown &= near_px > BESIDE_STRIPE_PX
    if np.count_nonzero(shown) < feature_errors.MINIMUM_POINTS:
        return NO_EDGES._replace(frame=number)
    along_m, edge, place_m = along_m[shown], edge[shown], place_m[shown]
    off_face = np.array(EDGE_SIGN)[edge, None] * outward[shown]

    noise, (influence, gain) = (
        image_noise(scene, subtracted=False),
        feature_errors.edge_step_influence(scene.lens.blur_px),
    )
    rate = electrons_per_radiance(sensor, scene.lens) * exposure_s
    _, px_per_m = edge_normals_px(place_m, off_face, arcs, camera)
    steps_m = (np.array(LIGHT_OFFSETS_PX) / px_per_m[:, None])[..., None] * off_face[:, None]
    toward_m = place_m[:, None] + steps_m
    light_e = rate * radiance_along(illuminated, toward_m.reshape(-1, 3))[0].reshape(toward_m.shape[:2])
    face_e, beyond_e = light_e[:, 0], light_e[:, 1:]
    height_e = np.abs(face_e - beyond_e[:, 0])
    pixel_e = np.sqrt(noise.dark_e2 + np.minimum(face_e, beyond_e[:, 0]))
    of_offset = np.add.reduceat(influence, np.array(LIGHT_OFFSETS_PX[1:], dtype=np.int64) - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        sensor_px = gain * pixel_e / height_e / np.sqrt(EDGE_SPACING_PX)
        displaced_px = (beyond_e - beyond_e[:, :1]) @ of_offset / height_e
    scatter_px = np.sqrt(_means_of_neighbours(np.fmin(displaced_px**2, 1.0), edge))
    sigma_px = np.sqrt(sensor_px**2 + scatter_px**2 + feature_errors.BLUR_SIGMA_PX**2)
    seen = (height_e * sensor.overall_system_gain_dn_per_e > feature_errors.STEP_DN) & (
        sigma_px < feature_errors.POINT_SIGMA_PX
    )
    seen &= height_e > feature_errors.STEP_SIGMAS * pixel_e / 2.0
    if np.count_nonzero(seen) < feature_errors.MINIMUM_POINTS:
        return NO_EDGES._replace(frame=number)
    return VisibleEdges(number, along_m[seen], edge[seen], sigma_px[seen])


def edge_normals_px(
    place_m: Float64[Array, "n xyz=3"], off_face: Float64[Array, "n xyz=3"], arcs: RingArcs, camera: Camera
) -> tuple[Float64[Array, "n xy=2"], Float64[Array, "n"]]:
    """Unit normals of the ring's edges in the image, and the image scale along them in pixels per metre.

    For points on the edges in the camera frame; `off_face` are unit vectors in the ring's plane that point away from
    the face, as the normals in the image do.
    """
    steps = _STEP_M * np.stack([np.cross(arcs.normal, off_face), off_face])
    moved_px = (project(place_m + steps, camera) - project(place_m - steps, camera)) / (2 * _STEP_M)
    (x, y), off = moved_px[0].T, moved_px[1].T
    across = np.stack([-y, x]) / np.sqrt(x * x + y * y)
    px_per_m = (across * off).sum(axis=0)
    return np.ascontiguousarray((across * np.sign(px_per_m)).T), np.abs(px_per_m)


def _means_of_neighbours(values: Float64[Array, "n"], edge: Int64[Array, "n"]) -> Float64[Array, "n"]:
    """Mean of each value and its neighbours on the same edge."""
    means = np.empty(len(values))
    for each in (0, 1):
        here = np.flatnonzero(edge == each)
        window = np.ones(min(NEIGHBOURS, max(len(here), 1)))
        count = np.convolve(np.ones(len(here)), window, mode="same") if len(here) else np.ones(0)
        means[here] = np.convolve(values[here], window, mode="same") / count if len(here) else 0.0
    return means
