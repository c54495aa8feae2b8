"""Draws the principle, examples/principle.svg, from the geometry of a rig and a ring: python3 examples/principle.py."""

from pathlib import Path

import numpy as np

from ringpose.files.rigs import read_rig
from ringpose.geometry.ring import predicted_break_points, ring_arcs

EXAMPLES = Path(__file__).parent
RADIUS_M = np.array([0.567, 0.597])
CENTER_M = np.array([-0.565, -0.03, 0.56])  # camera frame: x right, y down, z forward
NORMAL = np.array([0.10, 0.03, -1.0]) / np.linalg.norm([0.10, 0.03, -1.0])
FACE_HEIGHT_M = 0.06  # of the ring's face before the satellite's body
FAN_HALF_WIDTH_M = 0.17  # of a light sheet where it meets the ring

# The eye from which the scene is drawn, in the camera frame, and its focal length in units of the drawing.
EYE_M = np.array([0.92, -0.50, -0.42])
LOOKS_AT_M = np.array([-0.11, -0.01, 0.36])
FOCAL = 840.0
SIZE = (860, 470)
MIDDLE = (415, 232)

LASER_COLORS = ("#1f6fd6", "#1b9e3e", "#c236b4")
FOIL, METAL, WALL, INK = "#e9d7a6", "#aeb6bf", "#858e98", "#222222"
GRASP = "#d62728"


def seen(points_m):
    """Places in the drawing of points in the camera frame: a pinhole camera at `EYE_M`."""
    forward = (LOOKS_AT_M - EYE_M) / np.linalg.norm(LOOKS_AT_M - EYE_M)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    at = (np.asarray(points_m, dtype=float) - EYE_M) @ np.stack([right, np.cross(forward, right), forward]).T
    return np.array(MIDDLE) + FOCAL * at[..., :2] / at[..., 2:]


def outline(points_m):
    """Points as an SVG list of coordinates."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in seen(points_m))


def polygon(points_m, fill, opacity=1.0, stroke="none"):
    """A filled area."""
    return f'<polygon points="{outline(points_m)}" fill="{fill}" fill-opacity="{opacity}" stroke="{stroke}"/>'


def line(points_m, stroke, width, extra=""):
    """A line through points."""
    return f'<polyline points="{outline(points_m)}" fill="none" stroke="{stroke}" stroke-width="{width}" {extra}/>'


def dot(point_m, fill, radius):
    """A point with a white rim."""
    x, y = seen(point_m)
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{fill}" stroke="white" stroke-width="1.2"/>'


def label(point_m, text, shift, color=INK, anchor="start"):
    """A text beside a point."""
    x, y = seen(point_m) + np.array(shift)
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{color}" text-anchor="{anchor}">{text}</text>'


def leader(point_m, shift, color):
    """A thin line from a point to its label."""
    (x, y), (to_x, to_y) = seen(point_m), seen(point_m) + np.array(shift) + np.array([-3 * np.sign(shift[0]), -5])
    return f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{to_x:.1f}" y2="{to_y:.1f}" stroke="{color}" stroke-width="0.8"/>'


def circle(radius_m, height_m=0.0):
    """Points on a circle about the ring's axis, this far in front of its face."""
    angle = np.linspace(0.0, 2.0 * np.pi, 121)[:, None]
    across = np.cross(NORMAL, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    return CENTER_M + height_m * NORMAL + radius_m * (np.cos(angle) * across + np.sin(angle) * np.cross(NORMAL, across))


def lowest(points_m):
    """The point that lies lowest in the drawing."""
    return points_m[int(np.argmax(seen(points_m)[:, 1]))]


def stripe(plane_normal, distance_m, height_m, middle_m):
    """The two ends of a light sheet's line on a plane parallel to the ring's face, as wide as the sheet."""
    along = np.cross(plane_normal, NORMAL)
    along /= np.linalg.norm(along)
    along *= np.sign(along[0])
    equations = np.stack([plane_normal, NORMAL, along])
    level = NORMAL @ CENTER_M + height_m
    foot = np.linalg.solve(equations, [distance_m, level, along @ middle_m])
    return np.stack([foot - FAN_HALF_WIDTH_M * along, foot + FAN_HALF_WIDTH_M * along])


def drawing():
    """The elements of the drawing from back to front."""
    rig = read_rig(EXAMPLES / "scene-rig.yaml")
    lasers = rig.lasers
    arcs = ring_arcs(CENTER_M, NORMAL, RADIUS_M, np.array([0.0, 0.0, CENTER_M[2]]))
    points_m = predicted_break_points(arcs, lasers.normal, lasers.distance_m)  # laser, edge (inner, outer), xyz
    grasp_m = points_m.mean(axis=(0, 1))
    outward = grasp_m - CENTER_M
    grasp_m = CENTER_M + RADIUS_M.mean() * outward / np.linalg.norm(outward)

    yield from satellite()
    for laser in range(len(lasers.names)):
        color = LASER_COLORS[laser]
        sheet = (lasers.normal[laser], lasers.distance_m[laser])
        on_body = stripe(*sheet, -FACE_HEIGHT_M, grasp_m)
        apex = lasers.projector_m[laser]
        yield polygon([apex, *on_body], color, 0.10, color)
        inner, outer = points_m[laser]
        yield line([on_body[0], on_body[0] + (inner - on_body[0]) * 0.93], color, 1.6, 'stroke-opacity="0.75"')
        yield line([outer + (on_body[1] - outer) * 0.07, on_body[1]], color, 1.6, 'stroke-opacity="0.75"')
        yield line([inner, outer], color, 3.2)
        yield dot(inner, color, 4)
        yield dot(outer, color, 4)
        yield dot(apex, color, 5)
    yield from camera(rig.camera)
    yield line([grasp_m, grasp_m + 0.11 * NORMAL], GRASP, 2.4, 'marker-end="url(#arrow)"')
    yield dot(grasp_m, GRASP, 5)
    yield label(lasers.projector_m[1], "three line lasers", (-8, -14), INK, "end")
    for point_m, text, shift, color in (
        (points_m[2, 1], "six break points", (70, -52), INK),
        (grasp_m, "grasp point and normal", (74, 130), GRASP),
        (lowest(circle(RADIUS_M[1])), "launch-adapter ring", (-78, 34), INK),
    ):
        yield leader(point_m, shift, color)
        yield label(point_m, text, shift, color, "start" if shift[0] > 0 else "end")


def satellite():
    """The body behind the ring, the ring's wall and its face."""
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([0.72, 0.85])
    across, down = np.array([1.0, 0.0, 0.1]) / np.hypot(1.0, 0.1), np.array([0.0, 1.0, 0.03])
    body = CENTER_M - FACE_HEIGHT_M * NORMAL + corner[:, :1] * across + corner[:, 1:] * down
    yield polygon(body, FOIL, 1.0, "#c9b57e")
    outer, inner, foot = circle(RADIUS_M[1]), circle(RADIUS_M[0]), circle(RADIUS_M[1], -FACE_HEIGHT_M)
    for here, there in ((circle(RADIUS_M[0]), circle(RADIUS_M[0], -FACE_HEIGHT_M)), (outer, foot)):
        for i in range(len(here) - 1):
            yield polygon([here[i], here[i + 1], there[i + 1], there[i]], WALL, 1.0, WALL)
    annulus = f"M {outline(outer)} Z M {outline(inner)} Z"
    yield f'<path d="{annulus}" fill="{METAL}" fill-rule="evenodd" stroke="{INK}" stroke-width="0.6"/>'


def camera(intrinsics):
    """The camera's centre and the edges of its field of view, up to an image plane 0.1 m in front of it."""
    width, height = intrinsics.image_width, intrinsics.image_height
    pixels = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], dtype=float)
    corner = 0.10 * np.linalg.solve(intrinsics.camera_matrix, pixels.T).T
    yield polygon(corner, "white", 0.55, INK)
    for each in corner:
        yield line([np.zeros(3), each], INK, 1.0)
    yield dot(np.zeros(3), INK, 5)
    yield label(np.zeros(3), "camera", (8, 22))


def main():
    """Write the drawing beside this file."""
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIZE[0]} {SIZE[1]}" font-family="sans-serif" '
        'font-size="15"><title>Three light sheets cross the ring; six break points give its pose</title>'
        '<defs><marker id="arrow" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="6" markerHeight="6" '
        'orient="auto">'
        f'<path d="M 0 0 L 10 5 L 0 10 z" fill="{GRASP}"/></marker></defs>'
        f'<rect width="{SIZE[0]}" height="{SIZE[1]}" fill="white"/>'
    )
    (EXAMPLES / "principle.svg").write_text("\n".join([head, *drawing(), "</svg>"]) + "\n")


if __name__ == "__main__":
    main()
