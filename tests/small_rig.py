"""A rig of a small camera and three lasers, fast to render."""

_RIG = """\
ringpose: rig/1
camera:
  image_width: {width}
  image_height: {height}
  camera_name: small
  camera_matrix: {{rows: 3, cols: 3, data: [{focal}, 0.0, {x}, 0.0, {focal}, {y}, 0.0, 0.0, 1.0]}}
  distortion_model: plumb_bob
  distortion_coefficients: {{rows: 1, cols: 5, data: [0.0, 0.0, 0.0, 0.0, 0.0]}}
lasers:
- {{name: left, normal: [0.0, 0.984807753, -0.173648178], distance_m: -0.0394, projector_m: [0.0, -0.04, 0.0]}}
- {{name: middle, normal: [0.0, 1.0, 0.0], distance_m: -0.07, projector_m: [0.0, -0.07, 0.0]}}
- {{name: right, normal: [0.0, 0.984807753, 0.173648178], distance_m: -0.0394, projector_m: [0.0, -0.04, 0.0]}}
"""

SMALL_RIG = _RIG.format(width=160, height=120, focal=178.0, x=80.0, y=60.0)

SERVED_RIG = _RIG.format(width=200, height=150, focal=222.0, x=99.5, y=74.5)
"""Wider, for cameras that are served over the network."""
