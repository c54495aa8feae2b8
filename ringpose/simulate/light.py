"""Light on the target: laboratory, sun, Earth and the sheets of the line lasers.

Directions are those of the camera frame; the ray caster turns them into the target frame.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ringpose.geometry.rotations import cross
from ringpose.kernels import render
from ringpose.kernels.render import TargetTables
from ringpose.simulate.placement import Placement
from ringpose.types.arrays import Array, Bool, Float32, Float64
from ringpose.types.rig import LaserBow, LaserPlanes
from ringpose.types.scene import Earth, LaserLight, Light

_LAMP_DIRECTIONS = np.array([[0.45, -0.75, -0.50], [-0.85, -0.25, -0.45], [0.20, 0.60, -0.77], [0.95, 0.10, -0.30]])
"""Directions towards the lamps and windows of a laboratory."""

_LAMP_SHARPNESS = np.array([25.0, 8.0, 40.0, 15.0])
"""Sharpness k of the lobe exp(k (cos - 1)) of each lamp."""

_LAMP_SHARES = np.array([0.25, 0.20, 0.10, 0.10])
"""Share of each lamp in the irradiance; uniformly grey walls contribute the rest."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IlluminatedTarget:
    """A target with its placements in the camera frame and the light on it."""

    target: TargetTables
    placement: Placement
    """Placement in the middle of the exposure."""
    during: tuple[Placement, ...]
    """Placements at equal steps of the exposure, an odd number; `placement` alone if the target hardly moves."""
    planes: LaserPlanes
    laser_light: LaserLight
    light: Light
    lasers: tuple[int, ...]
    """Lasers that are on in at least one frame; the layers of the others stay black."""
    bows: Mapping[str, LaserBow] = field(default_factory=dict)
    """By the laser's name, bends that the rig states, in addition to that of all lasers in `laser_light`."""

    @property
    def bow_per_rad(self) -> Float64[Array, "laser"]:
        """How each laser's sheet is bent."""
        of_rig = [self.bows[name].per_rad if name in self.bows else 0.0 for name in self.planes.names]
        return self.laser_light.bow_per_rad + np.array(of_rig)

    @property
    def has_ambient_light(self) -> bool:
        """Whether there is light other than that of the lasers."""
        return self.light.ambient_w_m2 > 0 or self.light.sun_w_m2 > 0

    @property
    def sheets(self) -> "Sheets":
        """The light planes in the target frame, in the middle of the exposure."""
        planes, placement = self.planes, self.placement
        return Sheets(
            normal=placement.vectors_target(planes.normal.T).T,
            distance_m=planes.distance_m - planes.normal @ placement.translation_m,
            projector_m=placement.points_target(planes.projector_m.T).T,
            axis=placement.vectors_target(_fan_axes(planes).T).T,
            light=self.laser_light,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheets:
    """The light planes in a target's frame."""

    normal: Float64[Array, "laser xyz=3"]
    distance_m: Float64[Array, "laser"]
    projector_m: Float64[Array, "laser xyz=3"]
    axis: Float64[Array, "laser xyz=3"]
    """Central direction of each fan, a unit vector in its plane."""
    light: LaserLight


def _fan_axes(planes: LaserPlanes) -> Float64[Array, "laser xyz=3"]:
    """In each plane, the direction nearest to the optical axis."""
    axes: Float64[Array, "laser xyz=3"] = np.array([0.0, 0.0, 1.0]) - planes.normal[:, 2:] * planes.normal
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return axes


def half_thickness_m(light: LaserLight, range_m: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Standard deviation of a sheet's thickness at a distance from the projector."""
    thickness: Float64[Array, "n"] = np.hypot(light.sigma_m, light.divergence_rad * range_m)
    return thickness


def in_fan(sheet: Sheets, laser: int, point: Float64[Array, "xyz=3 n"]) -> Bool[Array, "n"]:
    """Whether points lie within the fan angle."""
    from_projector = point - sheet.projector_m[laser][:, None]
    along = sheet.axis[laser] @ from_projector
    aside = cross(sheet.normal[laser], sheet.axis[laser]) @ from_projector
    inside: Bool[Array, "n"] = np.abs(np.arctan2(aside, along)) <= sheet.light.fan_rad / 2
    return inside


def bend_m(
    planes: LaserPlanes, bow_per_rad: Float64[Array, "laser"], point_m: Float64[Array, "laser *shape xyz=3"]
) -> Float64[Array, "laser *shape"]:
    """Distance of each laser's bent sheet from its plane where points are projected on it, along the normal."""
    shape = (len(planes.names), *[1] * (point_m.ndim - 2), 3)
    normal, axis = planes.normal.reshape(shape), _fan_axes(planes).reshape(shape)
    from_projector = point_m - planes.projector_m.reshape(shape)
    aside = (np.cross(normal, axis) * from_projector).sum(axis=-1)
    angle = np.arctan2(aside, (axis * from_projector).sum(axis=-1))
    bow = bow_per_rad.reshape(shape[:-1])
    bent: Float64[Array, "laser *shape"] = bow * angle**2 * np.linalg.norm(from_projector, axis=-1)
    return bent


# What the ray caster takes


def caster_view(
    illuminated: IlluminatedTarget,
    angle_per_px: float,
    xy: Float64[Array, "xy=2 pixel"],
    per_px: Float64[Array, "axis=2 xy=2 pixel"] | None,
    width: int,
) -> render.View:
    """The input of the ray caster: target, placements and light, for camera rays (x, y, 1).

    `per_px` are the derivatives of the rays by the pixel, `width` is the image's width in pixels, and `angle_per_px`
    the width of a pixel at depth 1.
    """
    planes, laser, light = illuminated.planes, illuminated.laser_light, illuminated.light
    lamps = _LAMP_DIRECTIONS / np.linalg.norm(_LAMP_DIRECTIONS, axis=1, keepdims=True)
    on = np.zeros(len(planes.distance_m))
    on[list(illuminated.lasers)] = 1.0
    return render.View(
        target=illuminated.target,
        poses=np.array([[*pose.rotation.ravel(), *pose.translation_m] for pose in illuminated.during]),
        lamps=np.column_stack([lamps, _LAMP_SHARPNESS, _LAMP_SHARES]),
        lasers=np.column_stack(
            [
                planes.normal,
                planes.distance_m,
                planes.projector_m,
                _fan_axes(planes),
                on,
                illuminated.bow_per_rad,
            ]
        ),
        light=render.SceneLight(
            ambient_w_m2=light.ambient_w_m2,
            **_sky(light),
            power_w=laser.power_w,
            sigma_m=laser.sigma_m,
            divergence_rad=laser.divergence_rad,
            fan_rad=laser.fan_rad,
            angle_per_px=angle_per_px,
        ),
        xy=xy,
        per_px=per_px,
        width=width,
    )


def _sky(light: Light) -> dict[str, float]:
    """Irradiance, direction and angular radius of sun and Earth, the Earth's lit direction and its radiance."""
    sun = light.sun_direction / np.linalg.norm(light.sun_direction)
    sky = {"sun_w_m2": light.sun_w_m2, "sun_radius_rad": light.sun_diameter_rad / 2} | _components("sun", sun)
    if light.earth is None or light.sun_w_m2 == 0.0:
        nothing = {"earth_w_m2": 0.0, "earth_radius_rad": 0.0, "earth_radiance": 0.0}
        return sky | nothing | _components("earth", np.zeros(3)) | _components("lit", np.zeros(3))
    earth = light.earth.direction / np.linalg.norm(light.earth.direction)
    return {
        **sky,
        **_components("earth", earth),
        **_components("lit", _lit_direction(light.earth, earth, sun)),
        "earth_w_m2": earthshine_w_m2(light.earth, light.sun_w_m2, light.sun_direction),
        "earth_radius_rad": light.earth.angular_radius_rad,
        "earth_radiance": light.earth.albedo * light.sun_w_m2 / np.pi,
    }


def _components(name: str, direction: Float64[Array, "xyz=3"]) -> dict[str, float]:
    """The components of a direction by names like sun_x."""
    return dict(zip((f"{name}_x", f"{name}_y", f"{name}_z"), direction.tolist(), strict=True))


def earthshine_w_m2(earth: Earth, sun_w_m2: float, sun_direction: Float64[Array, "xyz=3"]) -> float:
    """Irradiance by the Earth, a Lambert sphere: 1/220 of the sun's at full phase in geostationary orbit.

    E = S 2/3 A (R/d)^2 phi(a), with the phase function phi(a) = (sin a + (pi - a) cos a) / pi.
    """
    cosine = -float(earth.direction @ sun_direction) / float(
        np.linalg.norm(earth.direction) * np.linalg.norm(sun_direction)
    )
    phase_rad = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    phi = (np.sin(phase_rad) + (np.pi - phase_rad) * np.cos(phase_rad)) / np.pi
    return float(sun_w_m2 * 2 / 3 * earth.albedo * np.sin(earth.angular_radius_rad) ** 2 * phi)


def _lit_direction(
    earth: Earth, direction: Float64[Array, "xyz=3"], sun: Float64[Array, "xyz=3"]
) -> Float64[Array, "xyz=3"]:
    """Towards the middle of the Earth's lit part, taken as a point: from full to new it moves to the limb."""
    aside = sun - float(sun @ direction) * direction
    length = float(np.linalg.norm(aside))
    if length < 1e-9:
        return direction
    dark_share = (1 + float(direction @ sun)) / 2
    shifted = direction + np.tan(earth.angular_radius_rad) * dark_share * aside / length
    lit: Float64[Array, "xyz=3"] = shifted / np.linalg.norm(shifted)
    return lit


def radiance_along(
    illuminated: IlluminatedTarget, direction: Float64[Array, "ray xyz=3"]
) -> Float32[Array, "source ray"]:
    """Radiance in the middle of the exposure along rays of the camera frame: ambient light, then each laser."""
    xy = np.ascontiguousarray(direction[:, :2].T / direction[:, 2])
    view = caster_view(illuminated, 0.0, xy, None, max(len(direction), 1))
    image = view.blank_image()
    if len(direction):
        render.render(view._replace(poses=view.poses[[len(view.poses) // 2]]), image)
    return image.radiance
