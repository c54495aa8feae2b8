"""Rings whose break points are known by construction, seen by the two rigs of the paper.

Nothing here is taken from the code under test: each light plane is brought into the ring's own frame, where its
line is cut with the two circles by the formula for quadratic equations; OpenCV projects what comes out.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ringpose.types.detection import BreakPoints, RingEdgePoints, joined_edge_points
from ringpose.types.rig import Camera, LaserPlanes, Rig

SIZES = {"R597": (0.567, 0.597), "R833": (0.803, 0.833), "R1194": (1.154, 1.194)}


def make_camera(size, focal, principal, distortion=(0.0,) * 5):
    """A camera with an image of this width and height; pixels, and five or eight coefficients."""
    return Camera(
        camera_name="test",
        image_width=size[0],
        image_height=size[1],
        camera_matrix=np.array([[focal[0], 0.0, principal[0]], [0.0, focal[1], principal[1]], [0.0, 0.0, 1.0]]),
        distortion_model="plumb_bob" if len(distortion) == 5 else "rational_polynomial",
        distortion_coefficients=np.array(distortion, dtype=np.float64),
    )


def make_rig(focal, principal, distortion, normal, distance):
    camera = make_camera((1600, 1200), focal, principal, distortion)
    unit = np.array(normal) / np.linalg.norm(normal, axis=-1, keepdims=True)
    lasers = LaserPlanes(
        names=("left", "middle", "right"),
        normal=unit,
        distance_m=np.array(distance),
        projector_m=np.full((3, 3), np.nan),
    )
    return Rig(camera=camera, lasers=lasers)


RIGS = {
    "A": make_rig(
        (960.0, 960.0),
        (799.5, 599.5),
        [0.0] * 5,
        [[0.0, 0.999657324976, 0.026176948308], [0.0, 1.0, 0.0], [0.0, 0.999657324976, -0.026176948308]],
        [-0.1, -0.1, -0.1],
    ),
    "B": make_rig(
        (1781.3, 1780.6),
        (803.7, 596.2),
        [-0.105, 0.118, 0.00055, -0.0004, 0.0],
        [
            [0.00566835033, 0.984148362139, -0.17725651216],
            [-0.004363296259, 0.9999874955, 0.002443458521],
            [-0.007049019511, 0.985054082892, 0.172101031672],
        ],
        [-0.039535984995, -0.070047993855, -0.039613633901],
    ),
}


PITCH_RAD = np.radians([10.0, 0.0, -10.0])
PROJECTORS_M = np.array([[-0.03, -0.04, 0.0], [0.0, -0.07, -0.02], [0.03, -0.04, 0.0]])
ACROSS = np.stack([np.zeros(3), np.cos(PITCH_RAD), -np.sin(PITCH_RAD)], axis=1)
PROJECTED = LaserPlanes(
    names=("left", "middle", "right"),
    normal=ACROSS,
    distance_m=(ACROSS * PROJECTORS_M).sum(axis=1),
    projector_m=PROJECTORS_M,
)
"""Light planes of which the projectors are known."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ring:
    """A ring in the camera frame; the normal points towards the camera."""

    center_m: np.ndarray
    normal: np.ndarray
    radius_m: np.ndarray

    def moved_by(self, matrix: np.ndarray) -> "Ring":
        """The ring after a rigid motion."""
        center_m, normal = matrix[:3, :3] @ self.center_m + matrix[:3, 3], matrix[:3, :3] @ self.normal
        return replace(self, center_m=center_m, normal=normal)

    def break_points_m(self, lasers: LaserPlanes) -> np.ndarray:
        """Where each light plane meets each edge, on the side of the ring nearer to the camera's axis."""
        points = self.crossings_m(lasers)
        nearer = np.abs(points[..., 0] / points[..., 2]).argmin(axis=-1)
        return np.take_along_axis(points, nearer[..., None, None], axis=2)[:, :, 0]

    def crossings_m(self, lasers: LaserPlanes) -> np.ndarray:
        """Both places where each light plane meets each edge, (laser, edge, left or right, xyz)."""
        points = np.full((len(lasers.normal), 2, 2, 3), np.nan)
        first = np.cross(self.normal, [0.3, 1.0, 0.2])
        first /= np.linalg.norm(first)
        axes = np.stack([first, np.cross(self.normal, first)])
        for laser, (m, d) in enumerate(zip(lasers.normal, lasers.distance_m, strict=True)):
            (a, b), c = axes @ m, d - m @ self.center_m
            for edge, radius in enumerate(self.radius_m):
                root = np.sqrt(radius**2 * (a * a + b * b) - c * c)
                u = (a * c + np.array([-1, 1]) * b * root) / (a * a + b * b)
                v = (b * c - np.array([-1, 1]) * a * root) / (a * a + b * b)
                both = self.center_m + np.stack([u, v], axis=-1) @ axes
                points[laser, edge] = both[np.argsort(both[:, 0])]
        return points


def break_points_of(position_px, sigma_px=np.nan):
    """Break points at these pixels, each with the same round covariance."""
    lasers = len(position_px)
    unknown = np.full((lasers, 2), np.nan)
    return BreakPoints(
        position_px=position_px,
        covariance_px2=np.broadcast_to(sigma_px**2 * np.eye(2), (lasers, 2, 2, 2)).copy(),
        flags=np.zeros((lasers, 2), dtype=np.int64),
        face_start_undistorted_px=unknown,
        face_end_undistorted_px=unknown,
        face_sigma_px=unknown,
        labelled=True,
    )


def with_lines(points, ends_px, sigma_px):
    """With the lines of the stripes between two places each, undistorted, and standard deviations at these."""
    sigma = np.broadcast_to(sigma_px, ends_px.shape[:2]).copy()
    return replace(
        points, face_start_undistorted_px=ends_px[:, 0], face_end_undistorted_px=ends_px[:, 1], face_sigma_px=sigma
    )


def pixels_of(points_m, camera):
    """OpenCV's projection of points in the camera frame; NaN stays NaN."""
    flat = points_m.reshape(-1, 3)
    pixels = np.full((len(flat), 2), np.nan)
    seen = ~np.isnan(flat[:, 0])
    pixels[seen] = cv2.projectPoints(
        flat[seen], np.zeros(3), np.zeros(3), camera.camera_matrix, camera.distortion_coefficients
    )[0].reshape(-1, 2)
    return pixels.reshape(*points_m.shape[:-1], 2)


def ring_at(rig, *, distance_m=0.5, across=0.0, tilt_rad=(0.1, -0.1), turn_rad=0.1, side=1, size="R597"):
    """A ring whose middle line passes through the middle light plane, `across` * distance beside the camera's axis.

    Tilted about x and y, its centre to the right (side 1) or left (side -1), turned out of the horizontal.
    """
    m, d = rig.lasers.normal[1], rig.lasers.distance_m[1]
    x, z = across * distance_m, distance_m
    on_band = np.array([x, (d - m[0] * x - m[2] * z) / m[1], z])
    turned = cv2.Rodrigues(np.array([*tilt_rad, 0.0]))[0]
    radius = np.array(SIZES[size] if isinstance(size, str) else size)
    inward = side * np.array([np.cos(turn_rad), np.sin(turn_rad), 0.0])
    return Ring(center_m=on_band + radius.mean() * turned @ inward, normal=-turned[:, 2], radius_m=radius)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A rig, a ring, and the true break points in space and in the image."""

    rig: Rig
    ring: Ring
    points_m: np.ndarray
    position_px: np.ndarray

    def break_points(self, sigma_px=np.nan, rng=None):
        """True break points, or with a generator noisy ones."""
        noise = 0.0 if rng is None else sigma_px * rng.normal(size=self.position_px.shape)
        return break_points_of(self.position_px + noise, sigma_px)


def make_scene(rig="B", **pose):
    """A rig by its name, or a `Rig`, and `ring_at` before it."""
    rig = RIGS[rig] if isinstance(rig, str) else rig
    return scene_of(rig, ring_at(rig, **pose))


def scene_of(rig, ring, points_m=None):
    """A ring before a rig; with points, it is these that the lasers show."""
    points_m = ring.break_points_m(rig.lasers) if points_m is None else points_m
    return Scene(rig=rig, ring=ring, points_m=points_m, position_px=pixels_of(points_m, rig.camera))


def line_of_face(scene, laser):
    """Undistorted pixels of the face's stripe at both edges, left one first: its line in the image."""
    camera = scene.rig.camera
    matrix = camera.camera_matrix
    points = scene.points_m[laser]
    straight = points[:, :2] / points[:, 2:] * [matrix[0, 0], matrix[1, 1]] + [matrix[0, 2], matrix[1, 2]]
    return straight[np.argsort(straight[:, 0])]


def face_points_of(scene, sigma_px, line_px, rng=None):
    """Break points and the lines of the stripes between them; with a generator both have noise.

    A line's middle errs by `line_px`, its ends by twice that with a correlation of -1/2, as those of a line fitted to
    evenly spread centres do.
    """
    points = scene.break_points(sigma_px, rng)
    lines = np.array([line_of_face(scene, laser) for laser in range(len(points.flags))])
    if rng is not None:
        middle, slope = line_px * rng.normal(size=(2, len(lines), 1))
        lines[:, :, 1] += middle + np.sqrt(3.0) * slope * [-1.0, 1.0]
    return with_lines(points, lines, 2.0 * line_px)


def without(points, *places):
    """Without these break points, each a laser and an edge."""
    position, covariance = points.position_px.copy(), points.covariance_px2.copy()
    for place in places:
        position[place], covariance[place] = np.nan, np.nan
    return replace(points, position_px=position, covariance_px2=covariance)


def with_stripes(points, *lasers):
    """Only these lasers' break points and lines."""
    others = [laser for laser in range(len(points.flags)) if laser not in lasers]
    parts = {}
    for name in (
        "position_px",
        "covariance_px2",
        "face_start_undistorted_px",
        "face_end_undistorted_px",
        "face_sigma_px",
    ):
        parts[name] = getattr(points, name).copy()
        parts[name][others] = np.nan
    return replace(points, **parts)


def axes_across(normal):
    """The tilt basis that the formats define: e1 along z x n, e2 = n x e1."""
    first = np.cross([0.0, 0.0, 1.0], normal)
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def turn_between(first, second):
    """The smallest rotation from one unit vector to another."""
    axis = np.cross(first, second)
    sine = np.linalg.norm(axis)
    return cv2.Rodrigues(axis * (np.arcsin(sine) / sine if sine > 0 else 1.0))[0]


def moved_rig(rig, names, steps):
    """The rig with its named parameters moved, from their definition in the file format."""
    matrix, coefficients = rig.camera.camera_matrix.copy(), rig.camera.distortion_coefficients.copy()
    normal, distance_m = rig.lasers.normal.copy(), rig.lasers.distance_m.copy()
    places = {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}
    order = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    for name, step in zip(names, steps, strict=True):
        laser, _, what = name.partition(".")
        if name in places:
            matrix[places[name]] += step
        elif name in order:
            coefficients[order.index(name)] += step
        elif what == "distance":
            distance_m[rig.lasers.names.index(laser)] += step
        else:
            number = rig.lasers.names.index(laser)
            normal[number] += step * axes_across(rig.lasers.normal[number])[int(what == "tilt_2")]
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    camera = replace(rig.camera, camera_matrix=matrix, distortion_coefficients=coefficients)
    return replace(rig, camera=camera, lasers=replace(rig.lasers, normal=normal, distance_m=distance_m))


def edges_in_frames(rig, rings, count, sigma_px, rng):
    """`visible_edges_of` a moving ring, which is given by the stamp of each frame."""
    frames = []
    for stamp_s, ring in rings.items():
        edges = visible_edges_of(scene_of(rig, ring), count, sigma_px, rng)
        frames.append(replace(edges, stamp_s=np.full(len(edges.edge), stamp_s)))
    return joined_edge_points(frames)


def nees(pose, ring):
    """Squared errors over their covariance, by degree of freedom: of normal, grasp point (axial and radial), centre."""
    tilt_rad = axes_across(pose.normal) @ ring.normal / (pose.normal @ ring.normal)
    from_center = pose.grasp_m - ring.center_m
    axial_m = from_center @ ring.normal
    outward = from_center - axial_m * ring.normal
    radius_m = np.linalg.norm(outward)
    axes = np.stack([ring.normal, outward / radius_m])
    errors = {
        "normal": (tilt_rad, pose.covariance[:2, :2]),
        "grasp": (np.array([axial_m, radius_m - ring.radius_m.mean()]), axes @ pose.covariance_grasp_m2 @ axes.T),
        "center": (pose.center_m - ring.center_m, pose.covariance_center_m2),
    }
    return {
        name: np.nan if covariance is None else float(error @ np.linalg.solve(covariance, error)) / len(error)
        for name, (error, covariance) in errors.items()
    }


def visible_edges_of(scene, count, sigma_px, rng=None):
    """Points of both edges within 11 degrees of the middle stripe, seen across the edge."""
    ring = scene.ring
    inward = scene.points_m[1, 0] - ring.center_m
    inward /= np.linalg.norm(inward)
    along = np.cross(ring.normal, inward)
    angle = np.linspace(-0.2, 0.2, count // 2)
    radial = np.cos(angle)[:, None] * inward + np.sin(angle)[:, None] * along
    places = [pixels_of(ring.center_m + radius * radial, scene.rig.camera) for radius in ring.radius_m]
    position = np.concatenate(places)
    tangent = np.concatenate([np.gradient(place, axis=0) for place in places])
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / np.linalg.norm(tangent, axis=-1, keepdims=True)
    if rng is not None:
        position = position + sigma_px * rng.normal(size=len(position))[:, None] * normal
    return RingEdgePoints(
        position_px=position,
        normal=normal,
        sigma_px=np.full(len(position), sigma_px),
        edge=np.repeat([0, 1], count // 2),
    )
